"""Claim on exposing a kept capture again: the pixels of a rendering, at a small share of its cost."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TypeVar

import numpy as np

import dasim
from dasim.camera.noise import Exposure
from dasim.scene import loading
from dasim.simulation.exposure import Shot
from dasim.typing import ShareDone
from dasim.values import Truth
from validation.gates.claim import Evidence
from validation.scores.figures import Figure
from validation.subjects import rendering

SIZE_PX = (512, 384)
SPP = 16  # fewer than a user takes, so that rendering is cheap beside an exposure
LONG_S = 0.3  # several times the automatic exposure
DIMMER = 0.1
FRAMES = 8
SEED = 5

Result = TypeVar("Result")


def exposure(progress: ShareDone) -> Evidence:
    """A kept capture exposes again without rendering: the pixels that a rendering gives, at a fraction of its cost.

    Rationale: brackets, bursts, light levels and noise draws of one view share its rendering.

    Set-up: the bundled scene ``desk``, da-mobile, central 512 x 384 px, 16 samples per pixel and stop, one seed. Three
    captures are rendered: one of 0.3 s, in which pixels saturate; one with automatic exposure; and one at a tenth of
    the light level. The first, written to a folder, is re-exposed automatically, the second at a tenth of the light
    level. Costs are processor seconds of all threads: for the second rendering, with compiled kernels; for one frame of
    a burst of 8 in memory; and for reading, re-exposing and writing a folder.

    Expectation: re-exposing the 0.3 s capture automatically gives exactly the raw numbers, truth and provenance of the
    rendering with automatic exposure, because ``mean_e`` is stored before saturation and its rounding can be undone. At
    a tenth of the light level, the renderer computes the same numbers, because scenes are rendered at one light level,
    but electrons are rounded at other values and differ by some parts in ten million. Raw numbers differ where this
    changes the number of electrons drawn, which may also shift the random draws of all following pixels; the share of
    such pixels is reported without a limit.

    Limit: no difference for another exposure; for another light level 2e-6 of the electrons. A frame costs at most 5 %
    of the rendering, a folder 20 %.

    Source: the project's own limits; the 22 bits to which electrons are rounded.
    """
    rendering.activate()
    scene = loading.load_scene("desk")
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX), scene)
    dim = tuple(light.model_copy(update={"lux": light.lux * DIMMER}) for light in scene.lights)
    long = dasim.simulate(scene, camera, SEED, spp=SPP, exposure=Exposure(time_s=LONG_S))
    progress(0.4)
    automatic, render_s = timed(lambda: dasim.simulate(scene, camera, SEED, spp=SPP))
    progress(0.6)
    dark = dasim.simulate(scene.model_copy(update={"lights": dim}), camera, SEED, spp=SPP)
    progress(0.8)
    with tempfile.TemporaryDirectory() as name:
        kept, again = Path(name) / "kept", Path(name) / "again"
        dasim.save_capture(kept, long.capture, long.truth)
        folder_s = timed(lambda: write(again, dasim.expose(kept, exposure=Exposure())))[1]
        found = Shot(dasim.load_capture(again), dasim.load_truth(again))
    frame_s = timed(lambda: list(dasim.expose_series(automatic, [None], frames=FRAMES)))[1] / FRAMES
    saturated = long.capture.provenance["saturated_pixels"] / long.capture.raw_dn.size
    figures = time_figures(found, automatic) + light_figures(dasim.expose(automatic, scale=DIMMER), dark)
    figures += cost_figures(render_s, frame_s, folder_s)
    figures.append(Figure("saturated", saturated, "1", "share of the pixels that saturate in the kept capture"))
    return Evidence(figures)


def timed(work: Callable[[], Result]) -> tuple[Result, float]:
    """The result of a function, and the processor seconds that it took."""
    begin = time.process_time()
    return work(), time.process_time() - begin


def write(path: Path, shot: Shot) -> None:
    """Write a capture folder."""
    dasim.save_capture(path, shot.capture, shot.truth)


def time_figures(exposed: Shot, rendered: Shot) -> list[Figure]:
    """Differences from a rendering of the same exposure."""
    same = exposed.capture.provenance == rendered.capture.provenance
    same &= exposed.capture.exposure_s == rendered.capture.exposure_s
    raw, exact = raw_difference(exposed, rendered), truth_difference(exposed.truth, rendered.truth)
    return [
        Figure("time.raw", raw, "1", "another exposure: share of raw numbers that differ from a rendering's"),
        Figure("time.truth", exact, "1", "another exposure: share of the truth that differs"),
        Figure("time.meta", float(not same), "1", "another exposure: whether time or provenance differ, 0 no, 1 yes"),
    ]


def light_figures(exposed: Shot, rendered: Shot) -> list[Figure]:
    """Differences from a rendering in the same light."""
    ours, theirs = exposed.truth.mean_e.astype(float), rendered.truth.mean_e.astype(float)
    worst = float((np.abs(ours - theirs) / np.maximum(theirs, theirs.mean() * 1e-6)).max())
    raw = raw_difference(exposed, rendered)
    return [
        Figure("light.raw", raw, "1", "a tenth of the light: share of raw numbers that differ from a rendering's"),
        Figure("light.electrons", worst, "1", "a tenth of the light: largest relative difference of mean electrons"),
    ]


def cost_figures(render_s: float, frame_s: float, folder_s: float) -> list[Figure]:
    """Processor seconds of rendering, of a frame of a burst and of a folder, and their ratios."""
    return [
        Figure("cost.frame", frame_s / render_s, "1", "processor time of a frame of a burst over that of a rendering"),
        Figure("cost.folder", folder_s / render_s, "1", "the same of reading, exposing and writing a folder"),
        Figure("seconds.render", render_s, "s", f"processor seconds of a rendering, {SPP} samples per pixel and stop"),
        Figure("seconds.frame", frame_s, "s", "processor seconds of a frame of a burst, in memory"),
        Figure("seconds.folder", folder_s, "s", "processor seconds of reading, exposing and writing a folder"),
    ]


def raw_difference(first: Shot, second: Shot) -> float:
    """Share of the raw numbers that differ."""
    return float(np.mean(first.capture.raw_dn != second.capture.raw_dn))


def truth_difference(first: Truth, second: Truth) -> float:
    """Share of the values of all images of the truth that differ; NaN equals NaN."""
    pairs = [(getattr(first, field.name), getattr(second, field.name)) for field in fields(Truth)]
    images = [(a, b) for a, b in pairs if isinstance(a, np.ndarray)]
    different = sum(np.count_nonzero((a != b) & ~((a != a) & (b != b))) for a, b in images)
    return different / sum(a.size for a, _ in images)
