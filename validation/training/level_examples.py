"""Examples to train :mod:`recon.depth.surface_net` on: the evidence of a capture, layered or path-traced, and its true
levels.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

import recon
from dasim.typing import Float32Array
from dasim.values import Capture
from recon.depth.raw_levels import Frame, joint_evidence, variances
from recon.picture import mosaic
from validation.training import layered, traced
from validation.training.captures import SIZE_PX, TIME_S, Conditions, Setup, drawn

SEEDS = {"plain": 78, "textured": 79, "soft": 80}
LIGHTS = (0.4, 0.2, 0.2, 0.2)  # shares of the bank's lights, of which the last has hardly any infrared
CONDITIONS = {
    "plain": Conditions(48, (3.0, 30.0), (250.0, 6000.0)),
    "textured": Conditions(48, (2.5, 26.0), (600.0, 8000.0)),
    "soft": Conditions(48, (2.5, 26.0), (600.0, 8000.0)),
}
# Per part of the work.
EXAMPLES = {name: of.examples for name, of in CONDITIONS.items()} | dict.fromkeys(traced.FAMILIES, 123)


class _Seen(NamedTuple):
    capture: Capture
    level: Float32Array  # [h, w]
    setup: Setup
    light: int  # index into the bank's lights


def example(family: str, number: int, setups: list[Setup], folder: Path) -> dict[str, Float32Array]:
    """Evidence and levels of the example of a family and number; ``folder`` keeps captures that were rendered.

    ``inputs`` [h, w, input], ``picture`` [NODE h, NODE w, channel] and ``level`` [NODE h, NODE w].
    """
    seen = _traced(family, number, setups, folder) if family in traced.FAMILIES else _layered(family, number, setups)
    capture, bank, light = seen.capture, seen.setup.bank, seen.light
    raw_e, saturated = mosaic.linearise(capture)
    variance = variances(raw_e, capture)
    frame = Frame(raw_e, variance, saturated, capture.camera, bank.kernel[light], bank.signature[light])
    found = joint_evidence(frame, recon.PRESETS["best"])
    width, height = SIZE_PX
    blocks = seen.level.reshape(height // 2, 2, width // 2, 2).swapaxes(1, 2)
    level = np.median(blocks.reshape(height // 2, width // 2, 4), axis=-1)
    return {"inputs": found.inputs, "picture": found.picture, "level": level}


def _layered(family: str, number: int, setups: list[Setup]) -> _Seen:
    random = np.random.default_rng((SEEDS[family], number))
    shot = drawn(random, family, CONDITIONS[family], LIGHTS, setups)
    lens = shot.setup.lenses[shot.light]
    capture = layered.photographed(shot.scene, lens, shot.setup.camera, shot.green_e, TIME_S, number)
    return _Seen(capture, layered.level_of(shot.scene), shot.setup, shot.light)


def _traced(family: str, number: int, setups: list[Setup], folder: Path) -> _Seen:
    capture, truth = traced.kept(family, number, folder / "captures")
    return _Seen(capture, truth.level, *traced.setup_and_light(capture, setups))
