"""Captures that the networks are trained with: random rooms through the layered lenses of bundled cameras.

Tested in tests/validation/training/test_level_examples.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import dasim
import recon
from dasim.camera.specification import Camera
from dasim.values import PsfBank
from recon.picture import field, infrared
from validation.training import layered
from validation.training.rooms import FAMILIES, Room, room

SIZE_PX = (384, 288)
# Name, focus in metres, and share of the examples.
CAMERAS = (("da-mobile", 0.8, 0.7), ("da-8mm", 0.8, 0.12), ("da-4x4", 0.4, 0.18))
TIME_S = 0.03


class Conditions(NamedTuple):
    """Of the captures of a family of rooms."""

    examples: int  # per part of the work
    level: tuple[float, float]  # least and largest value of the largest level of a room
    green_e: tuple[float, float]  # electrons of white in green


class Setup(NamedTuple):
    """A camera at its focus."""

    camera: Camera
    bank: PsfBank
    lenses: list[layered.Optics]  # of each light


class Shot(NamedTuple):
    """A room in front of a camera."""

    scene: Room
    setup: Setup
    light: int  # index into the bank's lights
    green_e: float  # electrons of white in green


def setups() -> list[Setup]:
    """The cameras of ``CAMERAS``, in their order."""
    return [_setup(name, focus) for name, focus, _ in CAMERAS]


def _setup(name: str, focus_m: float) -> Setup:
    camera = dasim.cropped(dasim.load_camera(name), *SIZE_PX)
    camera = camera.model_copy(update={"lens": camera.lens.model_copy(update={"focus_distance_m": focus_m})})
    bank = field.with_infrared_of_axis(recon.calibrate(dasim.calibration_captures(camera)))
    alpha = infrared.crosstalk(camera, None).astype(np.float64)
    width, height = SIZE_PX
    return Setup(camera, bank, [layered.optics(bank, light, alpha, height, width) for light in range(len(bank.lights))])


def drawn(
    random: np.random.Generator, family: str, conditions: Conditions, lights: tuple[float, ...], among: list[Setup]
) -> Shot:
    """A random room of a family, before a camera of :func:`setups`; ``lights`` are shares of the bank's lights."""
    setup = among[random.choice(len(CAMERAS), p=[share for _, _, share in CAMERAS])]
    width, height = SIZE_PX
    margin = 2 * layered.MARGIN
    most = float(np.exp(random.uniform(*np.log(conditions.level))))
    scene = room(random, height + margin, width + margin, most, FAMILIES[family])
    light = int(random.choice(len(setup.bank.lights), p=lights))
    return Shot(scene, setup, light, float(np.exp(random.uniform(*np.log(conditions.green_e)))))
