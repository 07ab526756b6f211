"""The part of a frame that a truth covers, which may lack a margin of it.

Tested in tests/validation/scores/test_margin.py.
"""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.values import Reconstruction, Truth


def central(image: Any, shape: tuple[int, ...]) -> Any:
    """The central part of an image [h, w, ...] of the height and width of a ``shape``; smaller ones are as they are."""
    top, left = (max(have - want, 0) // 2 for have, want in zip(image.shape, shape, strict=False))
    return image[top : top + shape[0], left : left + shape[1]]


def framed(image: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """A map [h, w] in the middle of a frame of a ``shape``, NaN around it."""
    whole = np.full(shape, np.nan, np.result_type(image.dtype, np.float32))
    central(whole, image.shape)[...] = image
    return whole


def is_inside(shape: tuple[int, ...], whole: tuple[int, ...]) -> bool:
    """Whether a ``shape`` is that of a ``whole`` frame, or of one without a margin that is the same on all sides."""
    margins = {have - want for have, want in zip(whole[:2], shape[:2], strict=True)}
    return len(margins) == 1 and min(margins) >= 0 and min(margins) % 2 == 0


def has_margin(camera: Camera, truth: Truth) -> bool:
    """Whether a truth lacks a margin of a camera's frame."""
    return truth.depth_m.shape != (camera.sensor.height_px, camera.sensor.width_px)


def within(result: Reconstruction, truth: Truth) -> Reconstruction:
    """A reconstruction in the frame of a truth, if that is its own without a margin."""
    shape, whole = truth.depth_m.shape, result.depth_m.shape
    if shape == whole or not is_inside(shape, whole):
        return result
    sensor = result.camera.sensor
    top, left = ((have - want) // 2 for have, want in zip(whole, shape, strict=True))
    x, y = principal_point(sensor)
    changed = {"height_px": shape[0], "width_px": shape[1], "principal_point_px": (x - left, y - top)}
    camera = result.camera.model_copy(update={"sensor": sensor.model_copy(update=changed)})
    parts: dict[str, Any] = {part.name: getattr(result, part.name) for part in fields(result)}
    images = {name: a for name, a in parts.items() if isinstance(a, np.ndarray) and a.shape[:2] == whole}
    return replace(result, camera=camera, **{name: central(image, shape) for name, image in images.items()})
