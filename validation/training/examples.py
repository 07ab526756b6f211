"""Examples to train :mod:`recon.depth.surface_net` on: the evidence of a layered capture, and its true levels."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

import dasim
import recon
from dasim.camera.specification import Camera
from dasim.typing import Float32Array, FloatArray, Progress
from dasim.values import PsfBank
from recon.depth.raw_levels import Frame, joint_evidence, variances
from recon.picture import field, infrared, mosaic
from validation.training import layered
from validation.training.rooms import room

SIZE_PX = (384, 288)
# Name, focus in metres, and share of the examples.
CAMERAS = (("da-mobile", 0.8, 0.7), ("da-8mm", 0.8, 0.12), ("da-4x4", 0.4, 0.18))
LEAST_RANGE, MOST_RANGE = 2.5, 28.0  # largest level of a room
LEAST_E, MOST_E = 120.0, 5500.0  # electrons of white in green
TIME_S = 0.03
SEED = 77


class _Setup(NamedTuple):
    camera: Camera
    bank: PsfBank
    alpha: FloatArray  # of eq. (8)


def make(folder: Path, first: int, last: int, progress: Progress = lambda stage, share: None) -> None:
    """Write the examples ``first`` to ``last - 1`` to ``NUMBER.npz`` each; those that exist are left as they are.

    A file holds ``inputs`` [h, w, input] and ``level`` [NODE h, NODE w], both float16. An example depends on its number
    alone, so that several processes may share the work.
    """
    folder.mkdir(parents=True, exist_ok=True)
    setups = [_setup(name, focus) for name, focus, _ in CAMERAS]
    for number in range(first, last):
        file = folder / f"{number}.npz"
        if not file.exists():
            inputs, level = _example(number, setups)
            partial = file.with_suffix(".partial.npz")
            np.savez(partial, inputs=inputs.astype(np.float16), level=level.astype(np.float16))
            partial.replace(file)
        progress("examples", (number + 1 - first) / (last - first))


def _setup(name: str, focus_m: float) -> _Setup:
    camera = dasim.cropped(dasim.load_camera(name), *SIZE_PX)
    camera = camera.model_copy(update={"lens": camera.lens.model_copy(update={"focus_distance_m": focus_m})})
    bank = field.with_infrared_of_axis(recon.calibrate(dasim.calibration_captures(camera)))
    return _Setup(camera, bank, infrared.crosstalk(camera, None).astype(np.float64))


def _example(number: int, setups: list[_Setup]) -> tuple[Float32Array, Float32Array]:
    """Evidence and levels of the example of a number."""
    random = np.random.default_rng((SEED, number))
    camera, bank, alpha = setups[random.choice(len(CAMERAS), p=[share for _, _, share in CAMERAS])]
    width, height = SIZE_PX
    margin = 2 * layered.MARGIN
    most = float(np.exp(random.uniform(np.log(LEAST_RANGE), np.log(MOST_RANGE))))
    scene = room(random, height + margin, width + margin, most)
    light = int(random.integers(len(bank.lights)))
    green_e = float(np.exp(random.uniform(np.log(LEAST_E), np.log(MOST_E))))
    lens = layered.optics(bank, light, alpha, height, width)
    capture = layered.photographed(scene, lens, camera, green_e, TIME_S, number)
    raw_e, saturated = mosaic.linearise(capture)
    frame = Frame(raw_e, variances(raw_e, capture), saturated, camera, bank.kernel[light], bank.signature[light])
    found = joint_evidence(frame, recon.PRESETS["best"])
    blocks = layered.level_of(scene).reshape(height // 2, 2, width // 2, 2).swapaxes(1, 2)
    return found.inputs, np.median(blocks.reshape(height // 2, width // 2, 4), axis=-1)
