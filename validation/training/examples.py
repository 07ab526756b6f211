"""Examples to train :mod:`recon.depth.surface_net` on: the evidence of a layered capture, and its true levels."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import dasim
import recon
from dasim.camera.specification import Camera
from dasim.typing import Float32Array, Progress
from dasim.values import PsfBank
from recon.depth.raw_levels import Frame, joint_evidence, variances
from recon.picture import field, infrared, mosaic
from validation.training import layered
from validation.training.rooms import FAMILIES, room

SIZE_PX = (384, 288)
# Name, focus in metres, and share of the examples.
CAMERAS = (("da-mobile", 0.8, 0.7), ("da-8mm", 0.8, 0.12), ("da-4x4", 0.4, 0.18))
TIME_S = 0.03
LIGHTS = (0.4, 0.2, 0.2, 0.2)  # shares of the bank's lights, of which the last has hardly any infrared
PARTS, APART = 2, 1500  # of the examples of a family: parts, and the distance of their first numbers


class Conditions(NamedTuple):
    """Of the captures of a family of rooms."""

    seed: int
    examples: int  # per part
    level: tuple[float, float]  # least and largest value of the largest level of a room
    green_e: tuple[float, float]  # electrons of white in green


CONDITIONS = {
    "plain": Conditions(78, 300, (3.0, 30.0), (250.0, 6000.0)),
    "textured": Conditions(79, 396, (2.5, 26.0), (600.0, 8000.0)),
}


class _Setup(NamedTuple):
    camera: Camera
    bank: PsfBank
    lenses: list[layered.Optics]  # of each light


def make(folder: Path, part: int, count: int | None = None, progress: Progress = lambda stage, share: None) -> None:
    """Write one part of the examples of each family, to ``FAMILY-NUMBER.npz``; those that exist are left as they are.

    A file holds ``inputs`` [h, w, input], ``picture`` [NODE h, NODE w, channel] and ``level`` [NODE h, NODE w], all
    float16. An example depends on family and number alone, so that several processes may share the work. ``count``
    limits the examples of each family.
    """
    folder.mkdir(parents=True, exist_ok=True)
    setups = [_setup(name, focus) for name, focus, _ in CAMERAS]
    numbers = [
        (family, part * APART + index)
        for family, conditions in CONDITIONS.items()
        for index in range(conditions.examples if count is None else count)
    ]
    for done, (family, number) in enumerate(numbers):
        file = folder / f"{family}-{number}.npz"
        if not file.exists():
            example: dict[str, Any] = {k: v.astype(np.float16) for k, v in _example(family, number, setups).items()}
            partial = file.with_suffix(".partial.npz")
            np.savez(partial, **example)
            partial.replace(file)
        progress("examples", (done + 1) / len(numbers))


def _setup(name: str, focus_m: float) -> _Setup:
    camera = dasim.cropped(dasim.load_camera(name), *SIZE_PX)
    camera = camera.model_copy(update={"lens": camera.lens.model_copy(update={"focus_distance_m": focus_m})})
    bank = field.with_infrared_of_axis(recon.calibrate(dasim.calibration_captures(camera)))
    alpha = infrared.crosstalk(camera, None).astype(np.float64)
    width, height = SIZE_PX
    return _Setup(
        camera, bank, [layered.optics(bank, light, alpha, height, width) for light in range(len(bank.lights))]
    )


def _example(family: str, number: int, setups: list[_Setup]) -> dict[str, Float32Array]:
    """Evidence and levels of the example of a family and number, by the file's names."""
    conditions = CONDITIONS[family]
    random = np.random.default_rng((conditions.seed, number))
    camera, bank, lenses = setups[random.choice(len(CAMERAS), p=[share for _, _, share in CAMERAS])]
    width, height = SIZE_PX
    margin = 2 * layered.MARGIN
    most = float(np.exp(random.uniform(*np.log(conditions.level))))
    scene = room(random, height + margin, width + margin, most, FAMILIES[family])
    light = int(random.choice(len(bank.lights), p=LIGHTS))
    green_e = float(np.exp(random.uniform(*np.log(conditions.green_e))))
    capture = layered.photographed(scene, lenses[light], camera, green_e, TIME_S, number)
    raw_e, saturated = mosaic.linearise(capture)
    frame = Frame(raw_e, variances(raw_e, capture), saturated, camera, bank.kernel[light], bank.signature[light])
    found = joint_evidence(frame, recon.PRESETS["best"])
    blocks = layered.level_of(scene).reshape(height // 2, 2, width // 2, 2).swapaxes(1, 2)
    level = np.median(blocks.reshape(height // 2, width // 2, 4), axis=-1)
    return {"inputs": found.inputs, "picture": found.picture, "level": level}
