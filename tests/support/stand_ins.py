"""A stand-in for the photographs of claims, made without a renderer."""

from __future__ import annotations

import dataclasses

import numpy as np

from dasim.simulation.exposure import Shot
from tests.support import recon_scenes, surfaces

DISKS = {"near-yellow": 64, "near-black": 192}  # objects of the stand-in and where they are, x in px
RADIUS_PX = 44


def stand_in(level: np.ndarray) -> Shot:
    """Gravel at the given blur levels [h, w], without a renderer, with two round objects."""
    height, width = level.shape
    scene = recon_scenes.make(level, photo="gravel", white_e=4000)
    truth = surfaces.truth(scene.capture.camera, scene.level, scene.sharp_e)
    y, x = np.mgrid[:height, :width]
    number = np.zeros(level.shape, np.uint32)
    for count, place in enumerate(DISKS.values(), start=1):
        number[np.hypot(y - height / 2, x - place) < RADIUS_PX] = count
    truth = dataclasses.replace(
        truth,
        mean_e=scene.mean_e,
        focus_e=truth.sharp_e,
        sharp_srgb=np.clip(truth.sharp_srgb, 0, 1),
        object_id=number,
        objects=tuple(DISKS),
    )
    return Shot(dataclasses.replace(scene.capture, provenance={"diffraction": "wave"}), truth)
