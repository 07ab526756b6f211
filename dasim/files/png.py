"""16-bit grey PNG files.

Tested in tests/dasim/files/test_captures.py.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base import atomic, untrusted
from dasim.base.errors import InputError


def write_png16(path: Path, image: NDArray[np.uint16]) -> None:
    """Write an image [h, w] as a 16-bit grey PNG."""
    success, data = cv2.imencode(".png", np.ascontiguousarray(image, dtype=np.uint16))
    if not success:
        raise OSError(f"{path}: the PNG encoder failed")
    atomic.write(path, data.tobytes())


def read_png16(path: Path) -> NDArray[np.uint16]:
    """Image [h, w] of a 16-bit grey PNG; raises InputError if the file is missing, truncated or of another kind."""
    if not path.exists():
        raise InputError(f"{path}: is missing")
    image = untrusted.picture(path, str(path), cv2.IMREAD_UNCHANGED)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(f"{path}: is not a 16-bit grey PNG")
    return image.astype(np.uint16, copy=False)
