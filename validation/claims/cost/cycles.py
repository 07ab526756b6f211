"""Claim on the cost of rendering noise, against a production path tracer: Blender's Cycles."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

import dasim
from dasim.base.toml import parse
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence, Table
from validation.references import blender
from validation.references.blender import Renders
from validation.reports.pictures import photo_address
from validation.scores.figures import Figure
from validation.subjects import rendering

SIZE_PX = (512, 384)
CYCLES_SPP = (16, 64)
OUR_SPP = 32  # and a second count, at which the noise should be that of Cycles
MOST_SPP = 512
USUAL_SLOPE = 0.65  # of log noise against log samples, to choose that count
SEEDS = 8
BLOCK_PX = 32  # of the means that must agree
PERCENTILES = {"median": 50, "p95": 95}

_LAMP: dict[str, Any] = {
    "kind": "lamp",
    "illuminant": "D65",
    "lux": 1000.0,
    "position_cm": [-6, -9, -30],
    "target_cm": [0, 0, 20],
    "radius_cm": 7,
}
# Coloured materials mixed by photographs: the noise of which texel a ray hits differs between the channels.
_MATERIALS: dict[str, Any] = {
    name: {"kind": "blend", "image": f"skimage:{image}", "repeat": [3, 3], "dark": dark, "bright": bright}
    for name, image, dark, bright in (
        ("brick", "brick", "brick", "mortar"),
        ("gravel", "gravel", "soil", "ceramic-white"),
        ("grass", "grass", "plastic-blue", "sand"),
        ("camera", "camera", "carbon-black", "plastic-yellow"),
    )
}
_BOARD = (("board", "gravel", (4.0, 4.0), (0.0, 0.0, 10.0), (0, 0, 5)),)
# Staircase: three boards before a wall in focus, at blurs of 24, 12 and 5 px, with their penumbrae on each other.
_STEPS = (
    ("wall", "brick", (16.0, 12.0), (0.0, 0.0, 40.0), (0, 0, 5)),
    ("far", "grass", (2.4, 6.0), (1.2, 0.3, 22.0), (0, 0, -8)),
    ("middle", "gravel", (1.1, 2.6), (-0.2, -0.3, 14.0), (0, 15, 10)),
    ("near", "camera", (0.5, 1.3), (-0.75, 0.1, 8.5), (0, -20, 15)),
)


def scene_of(boards: Sequence[tuple[Any, ...]]) -> Scene:
    """A scene of textured boards (name, material, size, position, rotation) under a round lamp."""
    objects = [
        {"name": name, "shape": "plane", "material": material, "size_cm": size, "position_cm": at, "rotation_deg": turn}
        for name, material, size, at, turn in boards
    ]
    data = {"name": "boards", "lights": [_LAMP], "materials": _MATERIALS, "objects": objects}
    return parse(Scene, data, "scene of a claim")


SCENES = {"board": _BOARD, "steps": _STEPS}


def bayer_camera(size_px: tuple[int, int]) -> Camera:
    """A central crop of bayer-mobile whose coatings do not move with the angle: Cycles has one set of colours."""
    camera = dasim.cropped(dasim.load_camera("bayer-mobile"), *size_px)
    return rendering.changed(camera, sensor={"coating_index": 0})


def against_cycles(progress: ShareDone) -> Evidence:
    """A colour picture through one aperture costs less than in Cycles, the path tracer of Blender, at equal noise.

    Rationale: a renderer that is fast against a naive one may still be slow against those that are in use.

    Set-up: 512 x 384 px of bayer-mobile, focused at 40 cm, diffraction off: one aperture of f/2.8, three channels. One
    textured board at 10 cm under a disc lamp, and four boards from 8.5 to 40 cm with penumbrae on each other; all are
    mixtures of two coloured materials by a photograph. Cycles (``bpy`` of PyPI, in a process of its own) gets the same
    corners, pictures of reflectance for each channel, lamp, aperture, focus and number of bounces. It runs on all
    processor threads without denoiser, adaptive sampling or clamping, with a pixel filter of one pixel, and writes
    linear numbers; its light tree and pattern of samples are its default ones. Ours is all of ``dasim.simulate`` with
    a fixed number of samples, so that its cost includes geometry, ground truth and the pinhole pictures. Cost is the
    processor time of all threads per picture, in both after a first picture that loads or compiles. Noise is the
    standard deviation of a pixel over eight seeds, relative to its mean.

    Expectation: the median and the 95th percentile of noise over the pixels are measured at two numbers of samples:
    Cycles 16 and 64, dasim 32 and the power of two at which its noise should equal that of Cycles with 64. The figure
    is the processor time of Cycles at 64 samples, divided by the time that dasim needs for the same noise. This time
    follows from a power law of noise against samples through both points (stratified samples make the noise of both
    renderers fall faster than N^-0.5) and a time that is linear in the number of samples. Means over blocks of 32 x 32
    px agree, since both render the same scene; those of Cycles are multiplied by cos^4 of the field angle, which its
    camera lacks.

    Limit: three times faster in each channel, at the median and at the 95th percentile; block means within 2 %, and
    the picture's mean within 0.5 %.

    Source: the pictures of Cycles.
    """
    if not blender.is_installed():
        raise rendering.NotRun("Blender's module bpy is not installed: pip install -c constraints.txt -e '.[cycles]'")
    rendering.activate()
    camera = bayer_camera(SIZE_PX)
    figures: list[Figure] = []
    tables: list[Table] = []
    pairs = []
    for number, (name, boards) in enumerate(SCENES.items()):
        points, last = _measured(scene_of(boards), camera)
        progress((number + 1) / len(SCENES))
        figures += _agreement(name, last["ours"], last["Cycles"]) + _costs(name, points)
        tables.append(_table(name, points))
        white = np.percentile(last["Cycles"], 99.5, axis=(0, 1))
        shown = [(who, photo_address((picture / white) ** (1 / 2.2))) for who, picture in last.items()]
        pairs.append((f"{name}: mean of {SEEDS} pictures, each channel by its own white", shown[0], shown[1]))
    return Evidence(figures, tables=tables, pairs=pairs)


def _measured(scene: Scene, camera: Camera) -> tuple[dict[str, list[Point]], dict[str, FloatArray]]:
    """Two points of each renderer, and the mean of its pictures at the second one, by the renderer's name."""
    by_cycles, by_simulate = _by_cycles(scene, camera), _by_simulate(scene, camera)
    theirs = [by_cycles(spp) for spp in CYCLES_SPP]
    their_points = [point(spp, result) for spp, result in zip(CYCLES_SPP, theirs, strict=True)]
    first = point(OUR_SPP, by_simulate(OUR_SPP))
    spp = second_count(first, their_points[-1])
    ours = by_simulate(spp)
    points = {"ours": [first, point(spp, ours)], "Cycles": their_points}
    return points, {"ours": ours.pictures.mean(axis=0), "Cycles": theirs[-1].pictures.mean(axis=0)}


def _by_cycles(scene: Scene, camera: Camera) -> Callable[[int], Renders]:
    return lambda spp: blender.renders(scene, camera, spp, range(1, SEEDS + 1))


def _by_simulate(scene: Scene, camera: Camera) -> Callable[[int], Renders]:
    """Pictures by the simulator: mean electrons per second of captures, and their processor time."""

    def picture(spp: int, seed: int) -> tuple[FloatArray, float]:
        begin = time.process_time()
        shot = dasim.simulate(scene, camera, seed, spp=spp, diffraction="off")
        seconds = time.process_time() - begin
        assert shot.truth.mean_e is not None
        return shot.truth.mean_e.astype(np.float64) / shot.capture.exposure_s, seconds

    def render(spp: int) -> Renders:
        picture(spp, SEEDS)  # compiles the kernels
        results = [picture(spp, seed) for seed in range(SEEDS)]
        return Renders(np.stack([rate for rate, _ in results]), np.array([seconds for _, seconds in results]))

    return render


@dataclass(frozen=True)
class Point:
    """Cost and noise of pictures with a number of samples per pixel."""

    spp: int
    processor_s: float
    noise: dict[str, FloatArray]  # [channel] by percentile of the pixels


def point(spp: int, result: Renders) -> Point:
    """Cost and noise of pictures of several seeds.

    The median of standard deviations from few seeds is biased low; the bias of normal noise is corrected, by the same
    factor at all percentiles.
    """
    count = len(result.pictures)
    relative = result.pictures.std(axis=0, ddof=1) / result.pictures.mean(axis=0)
    bias = float(np.sqrt(chi2.ppf(0.5, count - 1) / (count - 1)))
    noise = {name: np.percentile(relative, share, axis=(0, 1)) / bias for name, share in PERCENTILES.items()}
    return Point(spp, float(result.processor_s.mean()), noise)


def second_count(first: Point, goal: Point) -> int:
    """The power of two at which a renderer should have the noise of ``goal``, other than its ``first`` count."""
    ratio = float(np.median(first.noise["median"] / goal.noise["median"]))
    count = 2 ** round(float(np.log2(first.spp * ratio ** (1 / USUAL_SLOPE))))
    count = min(max(count, 4), MOST_SPP)
    return count if count != first.spp else 2 * count


def seconds_to(noise: float, points: Sequence[Point], percentile: str, channel: int) -> float:
    """Processor seconds to a level of noise, from two numbers of samples.

    Noise is a power of the number of samples through both points, and time is linear in it.
    """
    first, second = points
    exponent = slope(points, percentile, channel)
    spp = second.spp * (noise / float(second.noise[percentile][channel])) ** (1 / exponent)
    per_sample = (second.processor_s - first.processor_s) / (second.spp - first.spp)
    return second.processor_s + per_sample * (spp - second.spp)


def slope(points: Sequence[Point], percentile: str, channel: int) -> float:
    """Slope of log noise against log samples."""
    first, second = points
    ratio = second.noise[percentile][channel] / first.noise[percentile][channel]
    return float(np.log(ratio) / np.log(second.spp / first.spp))


def _costs(name: str, points: dict[str, list[Point]]) -> list[Figure]:
    theirs = points["Cycles"][-1]
    figures = []
    for percentile in PERCENTILES:
        for channel, colour in enumerate(CHANNELS[:3]):
            noise = float(theirs.noise[percentile][channel])
            ours_s = seconds_to(noise, points["ours"], percentile, channel)
            text = (
                f"{name}, {colour}: processor time of Cycles with {theirs.spp} samples over ours at the same noise, "
                f"{percentile} {noise:.2%}"
            )
            figures.append(Figure(f"{name}.faster.{percentile}.{colour}", theirs.processor_s / ours_s, "1", text))
    return figures


def _agreement(name: str, ours: FloatArray, theirs: FloatArray) -> list[Figure]:
    """Differences of the mean pictures [h, w, channel], of blocks and as a whole."""
    difference = rendering.block_means(ours, BLOCK_PX) / rendering.block_means(theirs, BLOCK_PX) - 1
    figures = []
    for channel, colour in enumerate(CHANNELS[:3]):
        worst = float(np.abs(difference[..., channel]).max())
        mean = float(ours[..., channel].mean() / theirs[..., channel].mean() - 1)
        text = f"{name}, {colour}: largest relative difference of the means over blocks of {BLOCK_PX} px from Cycles'"
        figures.append(Figure(f"{name}.difference.blocks.{colour}", worst, "1", text))
        text = f"{name}, {colour}: relative difference of the picture's mean from Cycles'"
        figures.append(Figure(f"{name}.difference.mean.{colour}", mean, "1", text))
    return figures


def _table(name: str, points: dict[str, list[Point]]) -> Table:
    rows = []
    for who, both in points.items():
        for index, one in enumerate(both):
            noise = [f"{one.noise[key][channel]:.2%}" for key in PERCENTILES for channel in range(3)]
            slopes = ", ".join(f"{slope(both, 'median', channel):.2f}" for channel in range(3)) if index else ""
            rows.append([who, str(one.spp), f"{one.processor_s:.2f}", *noise, slopes])
    colours = CHANNELS[:3]
    head = [
        "renderer",
        "samples per pixel",
        "processor seconds",
        *(f"noise, {key}, {colour}" for key in PERCENTILES for colour in colours),
        "slope of the median (R, G, B)",
    ]
    return f"{name}: cost and noise", head, rows
