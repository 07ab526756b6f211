"""Claims on edges in depth: no edge between equal radiances, and silhouettes with the near kernel's edge spread."""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.scene.specification import Scene
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references import transfer
from validation.reports.plots import plot
from validation.scores.figures import Figure
from validation.subjects import planes, rendering
from validation.subjects.rendering import seeds_of

COMPARED = ("G", "IR")
FURNACE_SIZE_PX = (96, 24)
FURNACE_SPP = 64
STEPS_PX = (3.0, 10.0, 17.0, 40.0)
SLANT_DEG, SLANTED_CM = 80.0, 3.0  # angle to the wall, width: 17 px at the edge, 21 px at the side of the frame
BARS, BAR_PX = 3, 4.0  # of the fence, with gaps of two bars between them
CORNER_PX = (2048 - 96, 1536 - 24)  # of the full frame, 31 degrees off the axis
SHARED_ERROR = 5e-6  # of tables that the pixels of a column have in common, over the light
PLATEAU_PX = 12  # columns at each side of the frame; a blur of 40 px ends 16 px before them

SILHOUETTE_SIZE_PX = (64, 96)
SILHOUETTE_BLUR_PX = (8.0, 17.0)
SILHOUETTE_SPP, SILHOUETTE_SEEDS = 64, 6
FREQUENCY_STEP, HIGHEST_FREQUENCY = 0.001, 3.0  # cycles per pixel


def depth_step_furnace(progress: ShareDone, seed: int = 0) -> Evidence:
    """Surfaces of equal radiance at different depths show no edge between them.

    Rationale: a pixel receives the light of the surfaces that it sees, whatever the blur. Ray weights that create or
    lose light where two depths meet would draw a line along every object, which depth methods mistake for texture.

    Set-up: matt planes of a reflectance of 0.3 % that face the camera, all lit by one sun at the same angle, so that
    all have the same radiance. A near plane covers the left half of the view in front of another at -1 px of visible
    blur, and has 3, 10, 17 and 40 px; 17 px in the corner of the full frame; three depths (17, 6 and -1 px); a near
    plane turned by 80 degrees, with its normal as far from the sun as the wall's; a fence of bars 4 px wide at 12 px of
    blur; two planes behind the focus (-4 and -12 px); a hexagon as the open stop and the step of 10 px. Pictures are
    those of dasim.simulate with diffraction 'wave', 64 samples per pixel.

    Expectation: the ratio of the mean of each column to that of columns far from the edge is 1. For the Z-test, the
    picture is divided by one of another seed with diffraction 'off', which needs no weights and has the same
    interreflections between the planes. Columns beside the edge then differ from those far from it only by the noise of
    their pixels and by the errors of tables (irradiance, kernels) that neighbouring pixels share, 2e-6 to 6e-6 of the
    light with either sign; the standard error of a column contains 5e-6 for them. The smallest p over columns is
    corrected for their number (Sidak).

    Limit: 0.3 %, and p of at least 0.001.

    Source: conservation of radiance along rays: a lens before surfaces of equal radiance receives an even picture.
    """
    rendering.needs_wave()
    figures, lines = [], {}
    subjects = furnaces()
    for number, (name, (camera, scene)) in enumerate(subjects.items()):
        picture = planes.rendered(scene, camera, FURNACE_SPP, seed, "wave")
        plain = planes.rendered(scene, camera, FURNACE_SPP, seed + 1, "off")
        for channel in COMPARED:
            index = CHANNELS.index(channel)
            column, p = furnace_figures(picture[..., index], plain[..., index])
            lines[f"{name}, {channel}"] = column
            off = float(np.abs(column - 1).max())
            figures += [
                Figure(f"{name}.{channel}.worst", off, "1", "largest difference of a column from the even picture"),
                Figure(
                    f"{name}.{channel}.p", p, "1", "smallest p of a column beside the edge, corrected for their number"
                ),
            ]
        progress((number + 1) / len(subjects))
    return Evidence(figures, [("Column means across depth steps, over those far from them", _lines(lines))])


def furnaces() -> dict[str, tuple[Camera, Scene]]:
    """Cameras and scenes of :func:`depth_step_furnace` by name."""
    camera = planes.view_of("da-mobile", FURNACE_SIZE_PX)
    far = planes.plane("far", camera, planes.FAR_BLUR_PX)
    scenes = {
        f"two-{blur:g}px": (camera, planes.lit([planes.plane("near", camera, blur, to_px=0.0), far]))
        for blur in STEPS_PX
    }
    middle = planes.plane("middle", camera, 6.0, to_px=12.0)
    still = {"coating_index": 0.0}  # coatings that shift with the angle would shade the columns
    corner = rendering.changed(
        cameras.cropped("da-mobile", *FURNACE_SIZE_PX, at_px=CORNER_PX), lens=still, sensor=still
    )
    edge_px = FURNACE_SIZE_PX[0] / 2 - sensors.principal_point(corner.sensor)[0]
    scenes["corner"] = corner, planes.lit([planes.plane("near", corner, 17.0, to_px=edge_px), far])
    scenes["three"] = camera, planes.lit([planes.plane("near", camera, 17.0, to_px=-12.0), middle, far])
    # The sun stands between the two normals, so both planes receive the same.
    slanted = planes.plane("near", camera, 17.0, to_px=0.0, wide_cm=SLANTED_CM, turn_deg=-SLANT_DEG)
    scenes["slanted"] = camera, planes.lit([slanted, far], azimuth_deg=180.0 - SLANT_DEG / 2)
    edges = (np.arange(BARS) - (BARS - 1) / 2) * 3 * BAR_PX
    bar_cm = BAR_PX * rendering.pixel_at_m(camera, rendering.depth_m(camera, 12.0)) * 100
    fence = [
        planes.plane(f"bar {k}", camera, 12.0, to_px=at + BAR_PX / 2, wide_cm=bar_cm) for k, at in enumerate(edges)
    ]
    scenes["fence"] = camera, planes.lit([*fence, far])
    near = planes.view_of("da-mobile", FURNACE_SIZE_PX, focus_distance_m=0.1)
    scenes["behind-focus"] = (
        near,
        planes.lit([planes.plane("near", near, -4.0, to_px=0.0), planes.plane("far", near, -12.0)]),
    )
    corners = [[float(np.sin(turn)), float(np.cos(turn))] for turn in np.arange(6) * np.pi / 3]
    hexagon = {
        "name": "hexagon",
        "shape": "polygon",
        "corners_ratio": corners,
        "passes_nm": [[400, 650]],
        "edge_width_nm": 8,
    }
    shaped = rendering.changed(camera, stops=[hexagon, camera.stops[1].model_dump()])
    scenes["hexagon"] = (
        shaped,
        planes.lit([planes.plane("near", shaped, 10.0, to_px=0.0), planes.plane("far", shaped, planes.FAR_BLUR_PX)]),
    )
    return scenes


def furnace_figures(picture: FloatArray, plain: FloatArray) -> tuple[FloatArray, float]:
    """Column means over the mean of both sides of the frame, and the smallest p of ``picture`` / ``plain`` between."""
    sides = np.zeros(picture.shape[1], dtype=bool)
    sides[:PLATEAU_PX] = sides[-PLATEAU_PX:] = True
    column = picture.mean(axis=0) / picture[:, sides].mean()
    ratio = picture / plain
    beside, far = ratio[:, ~sides], ratio[:, sides]
    error = np.sqrt(beside.var(axis=0, ddof=1) / len(beside) + far.var(ddof=1) / far.size + SHARED_ERROR**2)
    z = np.abs(beside.mean(axis=0) - far.mean()) / error
    smallest = 2 * student.sf(z.max(), len(beside) - 1)
    return column, float(-np.expm1(z.size * np.log1p(-smallest)))


def silhouette(progress: ShareDone, seed: int = 0) -> Evidence:
    """A defocused near edge has the edge spread function of the near kernel, dark on bright and bright on dark.

    Rationale: by reciprocity, a pixel receives from an unoccluded surface the integral of that surface's kernel over
    the surface. The background contributes the rest, so both polarities have the edge spread of the near object.

    Set-up: a half-plane at 8 and 17 px of visible blur before a plane at -1 px, black paint before white paper and the
    reverse, under one sun; dasim.simulate with diffraction 'wave', 6 seeds of 64 samples per pixel, 96 rows.
    The edge spread function comes from Hopkins's integral of the defocused pupil, averaged over the spectrum, times the
    transfer function of the pixel; no kernel or ray is involved. The two levels are those of columns far from the edge
    (edge spread below 2 or above 98 %).

    Expectation: column means differ from it by noise alone, which is 0.3 % of the contrast in a column. The noise of a
    pixel beside the edge (edge spread 2 to 98 %) is also a figure.

    Limit: 1.5 % of the contrast; noise at most 1.5 times that of pixels that are plain means of their weighted samples,
    as they were before layers were separated.

    Source: Hopkins 1955, Proc. R. Soc. A 231, 91.
    """
    rendering.needs_wave()
    figures, lines = [], {}
    camera = planes.view_of("da-mobile", SILHOUETTE_SIZE_PX)
    polarities = {"dark-on-bright": (planes.DARK, planes.BRIGHT), "bright-on-dark": (planes.BRIGHT, planes.DARK)}
    cases = [(blur, name) for blur in SILHOUETTE_BLUR_PX for name in polarities]
    for number, (blur, name) in enumerate(cases):
        scene = planes.silhouette_scene(camera, blur, *polarities[name])
        seeds = seeds_of(seed, SILHOUETTE_SEEDS)
        pictures = np.stack([planes.rendered(scene, camera, SILHOUETTE_SPP, s, "wave") for s in seeds])
        spread = edge_spread(camera, blur)
        for channel in COMPARED:
            index = CHANNELS.index(channel)
            off, noise = silhouette_figures(pictures[..., index], spread[index])
            lines[f"{blur:g} px, {name}, {channel}"] = off
            key = f"{blur:g}px.{name}.{channel}"
            figures += [
                Figure(f"{key}.worst", float(np.abs(off).max()), "1", "largest difference of a column, over contrast"),
                Figure(f"{key}.noise", noise, "1", "noise of a pixel beside the edge (RMS), over the contrast"),
            ]
        progress((number + 1) / len(cases))
    return Evidence(figures, [("Column means less the edge spread function, over contrast", _lines(lines))])


def silhouette_figures(pictures: FloatArray, spread: FloatArray) -> tuple[FloatArray, float]:
    """Difference of column means from the edge spread between the levels far from the edge, and noise of a pixel beside
    the edge, both over the contrast.

    Args:
        pictures: [seed, h, w].
        spread: share of the near object in each column, [w].
    """
    mean, std = pictures.mean(axis=(0, 1)), pictures.std(axis=(0, 1), ddof=1)
    parts = np.stack([spread, 1 - spread], axis=-1)
    beside = (spread > 0.02) & (spread < 0.98)
    levels = np.linalg.lstsq(parts[~beside], mean[~beside], rcond=None)[0]
    contrast = abs(levels[0] - levels[1])
    return (mean - parts @ levels) / contrast, float(np.sqrt(np.mean(std[beside] ** 2)) / contrast)


def edge_spread(camera: Camera, blur_px: float) -> FloatArray:
    """Share of the light that each column takes from what covers the left half of the view, [channel, w]."""
    frequency = np.arange(FREQUENCY_STEP / 2, HIGHEST_FREQUENCY, FREQUENCY_STEP)
    light = illuminants.illuminant("D65") * library.reflectance(planes.BRIGHT)
    mtf = transfer.wave_mtf(camera, blur_px, light, frequency, 0.0)
    x = np.arange(camera.sensor.width_px) + 0.5 - camera.sensor.width_px / 2
    sines = np.sin(2 * np.pi * np.outer(x, frequency)) / (np.pi * frequency) * FREQUENCY_STEP
    return 0.5 - mtf @ sines.T


def _lines(lines: dict[str, FloatArray]) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        for panel, channel in zip(axes, COMPARED, strict=True):
            for name, values in lines.items():
                if name.endswith(channel):
                    panel.plot(values, label=name.removesuffix(f", {channel}"), linewidth=1)
            panel.set(title=channel, xlabel="column, px")
            panel.legend(fontsize=6)

    return plot(draw, columns=2, size=(5.0, 3.0))
