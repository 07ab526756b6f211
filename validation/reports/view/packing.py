"""Pictures and numbers as text inside a page: WebP for the eye, deflated 16-bit integers for values that are read."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

NO_VALUE = 0  # integer of a packed map where there is no value
LARGEST = 2**16 - 1


def lossy(image: NDArray[Any], quality: int) -> str:
    """Display values 0..1, [h, w] or [h, w, 3], as WebP of a quality 1 to 100, in base64."""
    encoded = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    done, data = cv2.imencode(
        ".webp", encoded[..., ::-1] if encoded.ndim == 3 else encoded, [cv2.IMWRITE_WEBP_QUALITY, quality]
    )
    if not done:
        raise OSError("the WebP encoder failed")
    return base64.b64encode(data.tobytes()).decode()


def lossless(values: NDArray[np.uint16]) -> str:
    """Integers [h, w] as zlib data in base64: differences along rows, the high bytes before the low bytes.

    Neighbours are alike, so that most differences are small and most of their high bytes equal.
    """
    steps = np.asarray(values, np.uint16).copy()
    steps[:, 1:] -= values[:, :-1]
    planes = np.stack([steps >> 8, steps & 255]).astype(np.uint8)
    return base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode()


def unpacked(text: str, shape: tuple[int, int]) -> NDArray[np.uint16]:
    """The integers [h, w] of :func:`lossless`; the page's script does the same."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(2, *shape).astype(np.uint16)
    return np.cumsum(planes[0] << np.uint16(8) | planes[1], axis=1, dtype=np.uint16)


def packed_map(values: NDArray[Any]) -> dict[str, Any]:
    """A map [h, w] in 65,535 even steps from its smallest to its largest finite value; ``NO_VALUE`` elsewhere.

    An integer n above ``NO_VALUE`` stands for low + (n - 1) step. The error is at most half a step.
    """
    known = np.isfinite(values)
    low, high = (float(values[known].min()), float(values[known].max())) if known.any() else (0.0, 0.0)
    step = (high - low) / (LARGEST - 1)
    numbers = np.rint((np.where(known, values, low).astype(np.float64) - low) / (step or 1.0)) + 1
    return {"low": low, "step": step, "data": lossless(np.where(known, numbers, NO_VALUE).astype(np.uint16))}
