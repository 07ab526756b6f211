"""16-bit grey PNG files.

Tested in tests/dasim/files/test_captures.py.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError


def write_png16(path: Path, image: NDArray[np.uint16]) -> None:
    """Write a 16-bit grey PNG."""
    done, data = cv2.imencode(".png", np.ascontiguousarray(image, dtype=np.uint16))
    if not done:
        raise OSError(f"{path}: the PNG encoder failed")
    path.write_bytes(data.tobytes())


def read_png16(path: Path) -> NDArray[np.uint16]:
    """Read a 16-bit grey PNG whole; InputError where it is missing, cut short or of another kind."""
    if not path.is_file():
        raise InputError(f"{path}: is missing")
    data = path.read_bytes()
    # The decoder fills what a cut file lacks with zeros, so the end of the file is checked first.
    if b"IEND" not in data[-16:]:
        raise InputError(f"{path}: is no PNG, or is cut short")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None or image.ndim != 2 or image.dtype != np.uint16:
        raise InputError(f"{path}: is no 16-bit grey PNG")
    return image.astype(np.uint16, copy=False)
