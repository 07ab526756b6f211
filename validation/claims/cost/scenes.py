"""Claims on scenes and their truth: registration, interpolated irradiance, and the time to render a picture."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import dasim
from dasim.camera import depth_blur
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.scene import loading
from dasim.scene import specification as scenes
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure
from validation.subjects import rendering

# --- registration --------------------------------------------------------------------------------

GRID_SIZE_PX = (192, 144)
GRID_STEP_PX = 37.3  # not a whole number, so that the discs have different sub-pixel positions
GRID_RADIUS_PX = 4.0
GRID_BLURS_PX = (0.0, 6.0)  # in focus, and defocused
GRID_WINDOW_PX = 14
GRID_SPP = 256


def registration(progress: ShareDone) -> Evidence:
    """Truth and capture are registered: each scene point has the same pixel position in both.

    Rationale: an offset of half a pixel between truth and capture would look like an error of every algorithm that is
    scored.

    Set-up: a grid of 15 white discs of 4 px radius before a black wall, once in focus (40 cm) and once at 6 px of
    visible blur; da-mobile, central 192 x 144 px, all four channels, wave-true blur where the variant supports it. The
    discs face the camera, and their distances are not whole numbers of pixels.

    Expectation: the centroids of the light in ``mean_e`` (through the lens) and in ``sharp_e`` (through a pinhole), and
    those of the labels ``object_id``, lie at the projections of the discs' centres, s X / Z from the frame's centre.

    Limit: 0.05 px for every disc in both pictures. Labels are whole pixels, so the limit applies to the mean error over
    the grid.

    Source: the thin lens; central projection.
    """
    variant = rendering.activate()
    focus_m = 0.4
    camera = dasim.refocused(dasim.cropped(dasim.load_camera("da-mobile"), *GRID_SIZE_PX), focus_m)
    figures = []
    for part, blur in enumerate(GRID_BLURS_PX):
        depth_m = rendering.depth_m(camera, blur)
        pixel_cm = rendering.pixel_at_m(camera, depth_m) * 100
        offsets = [
            (x * GRID_STEP_PX + 0.37 * y, y * GRID_STEP_PX - 0.21 * x) for y in range(-1, 2) for x in range(-2, 3)
        ]
        discs: list[dict[str, Any]] = [
            {
                "name": f"disc {index}",
                "shape": "disc",
                "radius_cm": GRID_RADIUS_PX * pixel_cm,
                "position_cm": (x * pixel_cm, y * pixel_cm, depth_m * 100),
                "material": "white-paper",
            }
            for index, (x, y) in enumerate(offsets)
        ]
        wall = {"name": "wall", "shape": "plane", "size_cm": (80, 80), "position_cm": (0, 0, depth_m * 100 + 1e-3)}
        scene = rendering.make_scene([*discs, wall | {"material": "carbon-black"}])
        shot = dasim.simulate(scene, camera, 0, spp=GRID_SPP)
        centre = np.array(GRID_SIZE_PX) / 2 + np.array(offsets)
        label = f"blur-{blur:g}"
        for what in ("mean_e", "sharp_e"):
            picture = getattr(shot.truth, what).astype(float)
            for channel, name in enumerate(channels(camera.sensor)):
                errors = [_centroid(picture[..., channel], place) - place for place in centre]
                worst = float(np.abs(errors).max())
                text = f"{what}, {name}: largest error of the centroids of {len(centre)} discs, {variant}"
                figures.append(Figure(f"{label}.{what}.{name}", worst, "px", text))
        labels = [
            np.argwhere(shot.truth.object_id == index + 1).mean(axis=0)[::-1] + 0.5 for index in range(len(centre))
        ]
        bias = float(np.abs(np.mean(np.array(labels) - centre, axis=0)).max())
        text = "object_id: mean error of the discs' centroids, on the worse axis"
        figures.append(Figure(f"{label}.object_id", bias, "px", text))
        progress((part + 1) / len(GRID_BLURS_PX))
    return Evidence(figures)


def _centroid(picture: FloatArray, about: FloatArray) -> FloatArray:
    """Centroid (x, y) in pixels, centres at +0.5, of the light above the background in a window around ``about``.

    The background is the median over the window's border.
    """
    left, top = (round(float(value)) - GRID_WINDOW_PX for value in about)
    left, top = max(left, 0), max(top, 0)
    part = picture[top : top + 2 * GRID_WINDOW_PX, left : left + 2 * GRID_WINDOW_PX]
    part = part - np.median(np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]]))
    y, x = np.mgrid[: part.shape[0], : part.shape[1]] + 0.5
    return np.array([(part * x).sum(), (part * y).sum()]) / part.sum() + (left, top)


# --- light from all around and between surfaces --------------------------------------------------

LIGHT_SCENES = ("desk", "adam", "coats")
LIGHT_COATS = 7, 0  # seed and number of a random scene with eight coated objects
LIGHT_SIZE_PX = (256, 192)
LIGHT_SPP = 256
LIGHT_TRACED_SPP = 1024
LIGHT_BLOCK_PX = 8


def interreflection(progress: ShareDone) -> Evidence:
    """Interpolated irradiance from domes and from other surfaces gives the same pictures as path tracing.

    Rationale: the renderer traces indirect light and the light of domes on a grid, and interpolates it where it is
    smooth (irradiance caching, Ward 1988). Interpolation is an approximation, so it is compared with full path tracing.

    Set-up: the bundled scenes ``desk`` and ``adam``, and a random scene with eight coated objects, central 256 x 192
    px, da-mobile, both stops, diffraction off. Two renders of 256 samples per pixel with interpolated irradiance, and
    two of 1,024 samples traced throughout.

    Expectation: means over blocks of 8 x 8 pixels agree within rendering noise. The noise is estimated from the
    difference within each pair, and its variance is subtracted from the mean square difference.

    Limit: 0.5 % for the root mean square of the blocks' relative differences, 0.2 % for the mean of the picture.

    Source: path tracing of the same scene.
    """
    from dasim.render import passes, translate, truth

    if rendering.activate().startswith("scalar"):
        raise rendering.NotRun("only scalar_spectral works here, which traces all light; install LLVM 17 or newer")
    figures = []
    for number, name in enumerate(LIGHT_SCENES):
        scene = dasim.random_scene(*LIGHT_COATS) if name == "coats" else loading.load_scene(name)
        camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *LIGHT_SIZE_PX), scene)
        loaded = translate.load(scene)
        blur = depth_blur.signed_blur_px(truth.geometry(loaded, camera).depth_m, camera)
        reach = float(np.abs(blur).max())
        spectrum = scenes.light_spectrum(scene)
        fields = [passes.irradiance_field(loaded, camera, spectrum, reach, LIGHT_SPP, seed) for seed in (1, 2)]
        assert fields[0] is not None
        runs = [(LIGHT_SPP, field) for field in fields] + [(LIGHT_TRACED_SPP, None)] * 2
        pictures = []
        for seed, (samples, field) in enumerate(runs):
            parts = [
                passes.stop_pass(loaded, camera, stop, passes.Sampling(samples, seed), field=field)
                for stop in camera.stops
            ]
            pictures.append(rendering.block_means(np.sum(parts, axis=0), LIGHT_BLOCK_PX))
            progress((len(runs) * number + seed + 1) / (len(runs) * len(LIGHT_SCENES)))
        (ours, ours_noise), (traced, traced_noise) = (
            ((first + second) / 2, (first - second) / 2) for first, second in (pictures[:2], pictures[2:])
        )
        difference = (ours - traced) / traced
        noise = (ours_noise**2 + traced_noise**2) / traced**2
        for channel, colour in enumerate(channels(camera.sensor)):
            square = float(np.mean(difference[..., channel] ** 2 - noise[..., channel]))
            rms = max(square, 0.0) ** 0.5
            mean = float(ours[..., channel].mean() / traced[..., channel].mean() - 1)
            rms_text = f"{name}, {colour}: RMS relative difference of block means, noise variance subtracted"
            noise_text = f"{name}, {colour}: RMS rendering noise of the difference, which is subtracted"
            mean_text = f"{name}, {colour}: relative difference of the picture's mean"
            figures.append(Figure(f"{name}.rms.{colour}", rms, "1", rms_text))
            figures.append(Figure(f"{name}.noise.{colour}", float(noise[..., channel].mean()) ** 0.5, "1", noise_text))
            figures.append(Figure(f"{name}.mean.{colour}", mean, "1", mean_text))
        share_text = f"{name}: share of the grid's cells that are interpolated"
        figures.append(Figure(f"{name}.interpolated", fields[0].share, "1", share_text))
    return Evidence(figures)


# --- speed ---------------------------------------------------------------------------------------

SPEED_SIZE_PX = (512, 384)
FULL_SCENE, FULL_SIZE_PX, FULL_SPP = "desk", (2048, 1536), 2
SPEED_TRIANGLES = 500_000
SPEED_EXCLUDED = ("staircase", "depth-steps")  # test targets, which stand for many similar scenes

_TIMED = """
import json, sys, time
import dasim
from dasim.base.memory import peak_bytes
name, size, spp, renders = json.loads(sys.argv[1])
scene = dasim.load_scene(name)
camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *size), scene)
seconds = []
for _ in range(renders):
    begin = time.perf_counter()
    shot = dasim.simulate(scene, camera, 0, spp=spp)
    seconds.append(time.perf_counter() - begin)
peak = peak_bytes()
about = shot.capture.provenance
print(json.dumps({"first_s": seconds[0], "s": seconds[-1], "memory_gb": peak / 1e9, "spp": about["spp"],
                  "share": max(about["rendering_noise_share"]["50"].values())}))
"""


def scenes_speed(progress: ShareDone) -> Evidence:
    """Every bundled scene renders in seconds, and a large mesh loads in a few seconds.

    Rationale: datasets consist of thousands of pictures.

    Set-up: every bundled scene at 512 x 384 px with da-mobile at the default noise target (``--spp auto``: rendering
    noise is a quarter of the sensor noise at the median pixel). Each scene is rendered twice in a separate process, and
    the second render counts, since kernels are compiled once and cached. ``full-frame`` is ``desk`` in 3 Mpx at 2
    samples per pixel, rendered once. The time to load a mesh is that of a scene with a mesh of 500,000 triangles less
    that of the same scene with a disc in its place.

    Expectation: times are those of this computer with its present load, so run this claim alone.

    Limit: 12 s per scene, 3 s for the mesh, 2 GB of memory, on two cores with LLVM.

    Source: the project's own limits.
    """
    variant = rendering.activate()
    names = [name for name in loading.scene_names() if name not in SPEED_EXCLUDED]
    figures: list[Figure] = []
    rows: list[list[str]] = []
    for index, name in enumerate(names):
        timing = _timing(name, SPEED_SIZE_PX, "auto", renders=2)
        rows.append(
            [
                name,
                *(f"{timing[key]:.{digits}f}" for key, digits in (("first_s", 1), ("s", 1), ("memory_gb", 2))),
                " + ".join(str(count) for count in timing["spp"].values()),
                f"{timing['share']:.2f}",
            ]
        )
        figures.append(Figure(f"{name}.seconds", timing["s"], "s", f"{name}: time per picture, {variant}"))
        figures.append(Figure(f"{name}.memory", timing["memory_gb"], "GB", f"{name}: largest memory of the process"))
        progress((index + 1) / (len(names) + 2))
    full = _timing(FULL_SCENE, FULL_SIZE_PX, FULL_SPP, renders=1)
    width, height = FULL_SIZE_PX
    text = f"{FULL_SCENE}, {width} x {height} px at {FULL_SPP} samples per pixel: largest memory of the process"
    figures.append(Figure("full-frame.memory", full["memory_gb"], "GB", text))
    text = f"time to load a mesh of {SPEED_TRIANGLES:,} triangles from PLY"
    figures.append(Figure("mesh.seconds", _mesh_seconds(), "s", text))
    progress(1.0)
    head = [
        "scene",
        "first picture, s",
        "second picture, s",
        "memory, GB",
        "samples per pixel of each stop",
        "rendering noise over sensor noise",
    ]
    return Evidence(figures, [], [(f"Rendering on {os.cpu_count()} cores, {variant}", head, rows)])


def _timing(name: str, size_px: tuple[int, int], spp: int | str, *, renders: int) -> dict[str, Any]:
    """Seconds, memory and samples of a scene's renders in a separate process."""
    command = [sys.executable, "-c", _TIMED, json.dumps([name, size_px, spp, renders])]
    process = subprocess.run(command, capture_output=True, text=True)
    if process.returncode != 0:
        message = (process.stderr.strip().splitlines() or ["the process was killed"])[-1]
        raise RuntimeError(f"rendering scene {name} failed: {message}")
    return dict(json.loads(process.stdout.splitlines()[-1]))


def _mesh_seconds() -> float:
    """Seconds to read, check and translate a large mesh, beyond those of the same scene with a disc in its place."""
    import trimesh

    side = int(np.ceil(np.sqrt(SPEED_TRIANGLES / 2)))
    y, x = np.mgrid[: side + 1, : side + 1] / side - 0.5
    vertices = np.stack([x, y, 0.02 * np.sin(40 * x) * np.cos(31 * y)], axis=-1).reshape(-1, 3)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    below = corner + side + 1
    faces = np.concatenate([np.stack([corner, below, corner + 1], -1), np.stack([corner + 1, below, below + 1], -1)])
    camera = dasim.load_camera("da-mobile")
    with tempfile.TemporaryDirectory() as folder:
        trimesh.Trimesh(vertices, faces, process=False).export(Path(folder) / "large.ply")
        large = 'shape = "mesh"\nfile = "large.ply"\nunit_cm = 10\n'
        return _load_seconds(Path(folder), large, camera) - _load_seconds(
            Path(folder), 'shape = "disc"\nradius_cm = 5\n', camera
        )


def _load_seconds(folder: Path, shape: str, camera: Camera) -> float:
    """Seconds to load and translate a scene of one object, whose shape is given in TOML."""
    from dasim.render import translate

    text = 'name = "large"\n[[lights]]\nkind = "dome"\nilluminant = "D65"\nlux = 500\n'
    text += '[[objects]]\nname = "thing"\nmaterial = "grey-card"\nposition_cm = [0, 0, 30]\n' + shape
    (folder / "large.toml").write_text(text)
    begin = time.perf_counter()
    translate.world(dasim.load_scene(folder / "large.toml"), camera)
    return time.perf_counter() - begin
