"""Examples to train :mod:`recon.depth.surface_net` on: the evidence of a layered capture, and its true levels."""

from __future__ import annotations

import numpy as np

import recon
from dasim.typing import Float32Array
from recon.depth.raw_levels import Frame, joint_evidence, variances
from recon.picture import mosaic
from validation.training import layered
from validation.training.captures import SIZE_PX, TIME_S, Conditions, Setup, drawn

SEEDS = {"plain": 78, "textured": 79}
LIGHTS = (0.4, 0.2, 0.2, 0.2)  # shares of the bank's lights, of which the last has hardly any infrared
CONDITIONS = {
    "plain": Conditions(300, (3.0, 30.0), (250.0, 6000.0)),
    "textured": Conditions(396, (2.5, 26.0), (600.0, 8000.0)),
}


def example(family: str, number: int, setups: list[Setup]) -> dict[str, Float32Array]:
    """Evidence and levels of the example of a family and number.

    ``inputs`` [h, w, input], ``picture`` [NODE h, NODE w, channel] and ``level`` [NODE h, NODE w].
    """
    random = np.random.default_rng((SEEDS[family], number))
    shot = drawn(random, family, CONDITIONS[family], LIGHTS, setups)
    camera, bank, light = shot.setup.camera, shot.setup.bank, shot.light
    capture = layered.photographed(shot.scene, shot.setup.lenses[light], camera, shot.green_e, TIME_S, number)
    raw_e, saturated = mosaic.linearise(capture)
    frame = Frame(raw_e, variances(raw_e, capture), saturated, camera, bank.kernel[light], bank.signature[light])
    found = joint_evidence(frame, recon.PRESETS["best"])
    width, height = SIZE_PX
    blocks = layered.level_of(shot.scene).reshape(height // 2, 2, width // 2, 2).swapaxes(1, 2)
    level = np.median(blocks.reshape(height // 2, width // 2, 4), axis=-1)
    return {"inputs": found.inputs, "picture": found.picture, "level": level}
