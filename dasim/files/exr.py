"""Writing of EXR files, whose library raises errors of its own.

Tested in tests/dasim/base/test_full_disk.py.
"""

from __future__ import annotations

import errno
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def write_exr(path: Path, parts: Sequence[Any]) -> None:
    """Write parts (``OpenEXR.Part``) as one file; OSError with the path where the library cannot write it."""
    import OpenEXR

    try:
        OpenEXR.File(list(parts)).write(str(path))
    except RuntimeError as error:  # "... to image file "PATH". No space left on device."
        _, _, reason = " ".join(str(error).split()).rstrip(".").rpartition('". ')
        raise OSError(errno.EIO, reason or "cannot be written", str(path)) from None
