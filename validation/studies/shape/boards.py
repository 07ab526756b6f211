"""Textured boards at known levels of blur, on which designs are scored, and statistics of their scores."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.scene import targets
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot
from dasim.simulation.relight import exposed
from dasim.typing import FloatArray
from dasim.values import Capture

LIGHT = "D55"  # as on the desk; with one light the kernels of a mask are calibrated in a minute or two
LEVELS = (5, 11, 17, 23)  # visible blurs of 9 to 43 px with a hole of 0.46
BOARD_PX = (384, 288)
SPP = 64  # samples per pixel
SEED = 0
EXPOSURES = 3  # per picture, with independent noise
BORDER_PX = 64  # left out at the border: half of the surroundings is missing, and deblurring spreads the error


def lit_boards(camera: Camera) -> Iterator[tuple[Scene, Camera]]:
    """Boards of the same texture at each of ``LEVELS``, and the camera cropped to their frame."""
    cropped = cameras.cropped(camera, *BOARD_PX)
    for level in LEVELS:
        scene = targets.staircase(cropped, level)
        lights = tuple(light.model_copy(update={"illuminant": LIGHT}) for light in scene.lights)
        yield scene.model_copy(update={"lights": lights}), cropped


def exposures(shot: Shot) -> Iterator[Capture]:
    """The capture, then others of the same light with independent noise: rendering is the costly part."""
    yield shot.capture
    for seed in range(1, EXPOSURES):
        yield exposed(shot, 1.0, shot.capture.seed + 1000 * seed)


def inner(textured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The textured pixels that lie at least ``BORDER_PX`` within the frame, [h, w]."""
    mask = np.zeros(textured.shape, bool)
    mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    return mask & textured


def rms(values: Sequence[float] | FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def ratio(one: Sequence[float], other: Sequence[float]) -> tuple[float, float]:
    """Mean and standard deviation of the ratios of two designs, paired by exposure; NaN for a single exposure."""
    ratios = np.asarray(one) / np.asarray(other)
    return float(ratios.mean()), float(ratios.std(ddof=1)) if len(ratios) > 1 else float("nan")
