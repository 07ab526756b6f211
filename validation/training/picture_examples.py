"""Examples to train :mod:`recon.sharp.restoration` on: what it sees of a capture, layered or path-traced, and the
picture in focus.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

import recon
from dasim.camera.specification import Camera
from dasim.typing import BoolArray, Float32Array, FloatArray
from dasim.values import Capture, PsfBank
from recon.depth import raw_levels
from recon.depth.peak import confidence_of
from recon.picture import develop, field, mosaic
from recon.sharp import all_in_focus, sharpen
from validation.scores.pictures import infrared_free
from validation.training import layered, traced
from validation.training.captures import TIME_S, Conditions, Setup, Shot, drawn

SEEDS = {"plain": 186, "textured": 187, "traced": 188}
LIGHTS = (0.3, 0.25, 0.25, 0.2)  # shares of the bank's lights
CONDITIONS = {
    "plain": Conditions(75, (3.0, 30.0), (250.0, 6000.0)),
    "textured": Conditions(75, (2.5, 26.0), (600.0, 8000.0)),
}
# Per part of the work.
EXAMPLES = {name: of.examples for name, of in CONDITIONS.items()} | dict.fromkeys(traced.FAMILIES, 123)
QUIET, MOST_WELL = 0.2, 100.0  # share of sensors with a larger full well, and its largest factor: a tenth of the noise
QUIET_BITS = 16
# Level errors that the standard deviation does not reflect, because windows are sometimes sure of a wrong level:
MISTAKES = (1.0, 0.1)  # standard deviation of the strength of mistakes, in levels and relative to the level
MISTAKES_GRID = (5, 6)  # rows and columns between which mistakes change smoothly
FALSE_BLUR = 0.5  # share of examples in which surfaces in focus are taken to be blurred
MOST_FALSE_BLUR, FOCUS_LEVELS = 4.0, 1.5  # levels: largest false blur, and the level at which it has fallen to 1 / e


class _Seen(NamedTuple):
    capture: Capture
    bank: PsfBank
    light: int  # index into the bank's lights
    in_focus: FloatArray  # without infrared, [3, h, w] electrons
    nothing: BoolArray  # pixels without a truth, [h, w]


def example(family: str, number: int, setups: list[Setup], folder: Path) -> dict[str, NDArray[Any]]:
    """What the network sees of the example of a family and number, and what it should show; ``folder`` keeps captures
    that were rendered.

    Pictures are relative to bright white: ``stack`` and ``draft`` [4, h, w], ``truth`` [3, h, w]; ``level``, its
    standard deviation ``sd`` and the mask ``clipped`` are [h, w]; ``noise`` is [4] and ``sparse`` a number. Draft and
    level are stored twice, once with mistakes that ``sd`` does not reflect.
    """
    if family in traced.FAMILIES:
        random = np.random.default_rng((SEEDS["traced"], traced.FAMILIES.index(family), number))
        seen = _traced(family, number, setups, folder)
    else:
        random = np.random.default_rng((SEEDS[family], number))
        seen = _layered(random, family, number, setups)
    frame, kernels, noise_e = _frame(seen)
    found: dict[str, NDArray[Any]] = {}
    stack = all_in_focus.channels(frame)
    noise_e = all_in_focus.with_model_error(noise_e, stack, frame)
    shown = all_in_focus.seen(frame, stack, stack, noise_e)
    unit = shown.unit_e[:, None, None]
    for name, level in (("", frame.level), ("mistaken_", _mistaken(random, frame.level))):
        draft = sharpen.linear(stack, level, kernels, noise_e)
        found |= {f"{name}draft": draft / unit, f"{name}level": level}
    found |= {"stack": shown.stack / unit, "sd": shown.sd, "truth": seen.in_focus / unit[:3]}
    noise = (shown.noise_e / shown.unit_e).astype(np.float32)
    clipped = np.any(frame.clipped, axis=-1) | seen.nothing
    return found | {"clipped": clipped, "noise": noise, "sparse": np.array(shown.sparse, np.float32)}


def _layered(random: np.random.Generator, family: str, number: int, setups: list[Setup]) -> _Seen:
    shot = drawn(random, family, CONDITIONS[family], LIGHTS, setups)
    well = float(np.exp(random.uniform(0, np.log(MOST_WELL)))) if random.random() < QUIET else 1.0
    camera = _with_well(shot.setup.camera, well)
    lens = layered.without_pixel(shot.setup.lenses[shot.light])
    capture = layered.photographed(shot.scene, lens, camera, shot.green_e * well, TIME_S, number)
    sharp = in_focus(shot, lens, shot.green_e * well)
    return _Seen(capture, shot.setup.bank, shot.light, sharp, np.zeros(sharp.shape[1:], bool))


def _traced(family: str, number: int, setups: list[Setup], folder: Path) -> _Seen:
    capture, truth = traced.kept(family, number, folder / "captures")
    setup, light = traced.setup_and_light(capture, setups)
    assert truth.focus_e is not None  # every rendered capture has it
    sharp = np.moveaxis(infrared_free(truth.focus_e, capture.camera, setup.bank.lights[light]), -1, 0)
    return _Seen(capture, setup.bank, light, sharp, ~truth.valid)


def in_focus(shot: Shot, lens: layered.Optics, green_e: float) -> FloatArray:
    """What the lens shows of a room in focus, without infrared, [3, h, w] electrons."""
    height, width = lens.transfer.shape[2], 2 * (lens.transfer.shape[3] - 1)
    fine = np.stack([cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in shot.scene.radiance[:3]])
    sharp = fft.irfft2(fft.rfft2(fine) * lens.transfer[0, :3], (height, width))
    visible = (lens.white[:3] - lens.leak * lens.white[3])[:, None, None] * sharp
    inner = slice(layered.MARGIN, -layered.MARGIN)
    return np.asarray(green_e * visible[:, inner, inner])


def _with_well(camera: Camera, well: float) -> Camera:
    """A camera whose full well is larger by a factor, with a finer converter."""
    bits = QUIET_BITS if well > 1 else camera.sensor.adc_bits
    changes = {"full_well_e": camera.sensor.full_well_e * well, "adc_bits": bits}
    return camera.model_copy(update={"sensor": camera.sensor.model_copy(update=changes)})


def _mistaken(random: np.random.Generator, level: Float32Array) -> Float32Array:
    """Levels [h, w] with mistakes."""
    strengths = np.abs(random.normal(0, MISTAKES))
    grid = random.standard_normal(MISTAKES_GRID).astype(np.float32)
    field = cv2.resize(grid, level.shape[::-1], interpolation=cv2.INTER_CUBIC)
    blur = random.uniform(0, MOST_FALSE_BLUR) * (random.random() < FALSE_BLUR)
    wrong = level + field * (strengths[0] + strengths[1] * level) + blur * np.exp(-level / FOCUS_LEVELS)
    return np.maximum(wrong, 0).astype(np.float32)


def _frame(seen: _Seen) -> tuple[all_in_focus.Frame, Float32Array, NDArray[Any]]:
    """The capture with its levels, the kernels [level, channel, size, size] without infrared, the noise [channel]."""
    capture, bank, light = seen.capture, seen.bank, seen.light
    camera = capture.camera
    raw_e, saturated = mosaic.linearise(capture)
    white, variances = bank.signature[light], raw_levels.variances(raw_e, capture)
    found = raw_levels.joint_levels(
        raw_levels.Frame(raw_e, variances, saturated, camera, bank.kernel[light], white), recon.PRESETS["best"]
    )
    size = raw_e.shape[::-1]
    level, confidence = (
        np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_LINEAR), np.float32)
        for part in (found.level, confidence_of(found.sd).astype(np.float32))
    )
    separation = field.separation(camera, bank.lights[light], recon.PRESETS["best"])
    none = np.zeros((*raw_e.shape, 3), np.float32)  # the network does not see the picture of reduced noise
    frame = all_in_focus.Frame(
        raw_e, none, none[..., 0], develop.clipped(saturated, camera), variances, level, confidence, separation, camera,
        white,
    )  # fmt: skip
    kernels = sharpen.visible_kernels(bank.kernel[light], white, separation.on_axis)
    return frame, kernels, sharpen.visible_noise(all_in_focus.interpolated_noise_e(variances), separation.on_axis)
