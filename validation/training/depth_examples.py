"""Examples to train :mod:`recon.depth.learned` on: random rooms through lenses of any hole, focus and light.

Lenses are those of ``da-mobile`` with another hole and focus, by Hopkins's integral (:mod:`dasim.bounds.pupils`): no
bank is calibrated for them. An example holds mean electrons, so that it can be exposed in several lights.

Tested in tests/validation/training/test_fit_depth.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

import dasim
from dasim.bounds import pupils
from dasim.camera import noise
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera, crosstalk
from dasim.camera.stops import Disc
from dasim.typing import Float32Array, ShareDone
from dasim.values import Capture
from recon.depth.grid import plane_mean
from validation.training import layered
from validation.training.rooms import FAMILIES, room

SIZE_PX = (192, 144)
BLUR_PER_LEVEL_PX = 1 / (1 - 0.46)  # of the levels that rooms are drawn in
MOST_LEVEL = 32
THICKNESS = 2.0  # of the slices, relative to those of the other trainings
HOLE = (0.3, 0.65)
FOCUS_DIOPTRE = (1.0, 8.0)
LIGHTS = ("D65", "D55", "A", "energy-saving-3500K")
LARGEST_LEVEL = (2.5, 30.0)  # of a room
PER_LENS = 12  # examples in a row that share a lens
GREEN_E = (200.0, 8000.0)  # electrons of white in green
TIME_S = 0.03
MEASURED_BLUR_PX, PATCH = 52.0, 128  # of the last level of banks; samples of a patch that holds its kernels


class Example(NamedTuple):
    """A room through a lens."""

    mean: Float32Array  # [h, w] electrons of the mosaic per electron of white in green
    blur_px: Float32Array  # [h/2, w/2] visible blur diameter
    camera: Camera
    hole: float


class Lens(NamedTuple):
    """A camera and its transfer functions."""

    camera: Camera
    hole: float
    optics: layered.Optics


def make(count: int, seed: int = 0, progress: ShareDone = lambda share: None) -> list[Example]:
    """Examples 0 to ``count``; each depends on the seed and its number alone."""
    examples: list[Example] = []
    for number in range(count):
        if number % PER_LENS == 0:
            lens = lens_of(np.random.default_rng((seed, 0, number // PER_LENS)))
        examples.append(example(np.random.default_rng((seed, 1, number)), number, lens))
        progress((number + 1) / count)
    return examples


def lens_of(random: np.random.Generator) -> Lens:
    """A random lens: its hole, its focus and the light."""
    camera = dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX)
    hole, focus_m = float(random.uniform(*HOLE)), float(1 / random.uniform(*FOCUS_DIOPTRE))
    visible, stop = (one for one in camera.stops if isinstance(one, Disc))
    stop = stop.model_copy(update={"radius_ratio": hole})
    lens = camera.lens.model_copy(update={"focus_distance_m": focus_m})
    camera = camera.model_copy(update={"stops": (visible, stop), "lens": lens})
    light = str(random.choice(LIGHTS))
    width, height = (side + 2 * layered.MARGIN for side in SIZE_PX)
    blurs = np.asarray(BLUR_PER_LEVEL_PX * np.arange(MOST_LEVEL + 1), np.float64)
    parts = [pupils.disc_transfers(camera, one, blurs, light, (height, width), 1.0) for one in (visible, stop)]
    transfer = np.concatenate([parts[0][0][:, :3], parts[1][0][:, 3:]], axis=1).real.astype(np.float32)
    white = parts[0][1] + parts[1][1]
    optics = layered.Optics(transfer, white / white[1], crosstalk(camera))
    return Lens(camera, hole_of(camera), layered.without_pixel(optics))


def hole_of(camera: Camera) -> float:
    """Radius of the infrared aperture over that of the visible one as :func:`recon.depth.learned.hole_of` measures it.

    The sum of the squares of a kernel is the mean of those of its transfer function, here at ``MEASURED_BLUR_PX``.
    """
    transfer, _ = pupils.stop_transfers(camera, np.array([MEASURED_BLUR_PX]), "D65", (PATCH, PATCH))
    names = channels(camera.sensor)
    green, ir = (plane_mean(np.abs(transfer[0, names.index(name)]) ** 2, PATCH) for name in ("G", "IR"))
    return float(np.sqrt(green / ir))


def example(random: np.random.Generator, number: int, lens: Lens) -> Example:
    """A random room through a lens; even numbers are of the family ``plain``."""
    width, height = SIZE_PX
    most = float(np.exp(random.uniform(*np.log(LARGEST_LEVEL))))
    family = FAMILIES[("plain", "textured")[number % 2]]
    scene = room(random, height + 2 * layered.MARGIN, width + 2 * layered.MARGIN, most, family)
    mean = layered.mean_mosaic(scene, lens.optics, lens.camera, THICKNESS)
    blocks = layered.level_of(scene).reshape(height // 2, 2, width // 2, 2).swapaxes(1, 2)
    level = np.median(blocks.reshape(height // 2, width // 2, 4), axis=-1)
    return Example(mean.astype(np.float32), (BLUR_PER_LEVEL_PX * level).astype(np.float32), lens.camera, lens.hole)


def exposed(one: Example, random: np.random.Generator) -> Capture:
    """A capture of an example with a random amount of light, and noise of its own."""
    camera, green_e = one.camera, float(np.exp(random.uniform(*np.log(GREEN_E))))
    seed = int(random.integers(2**31))
    raw, _ = noise.expose((green_e * one.mean).astype(np.float64), camera.sensor, TIME_S, seed)
    return Capture(raw_dn=raw, camera=camera, exposure_s=TIME_S, gain=1.0, seed=seed)
