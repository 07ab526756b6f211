"""EXR files by Mitsuba, whose writer waits for ever for a second thread."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.render import backend


def write_exr(path: Path, image: np.ndarray) -> None:
    import mitsuba as mi

    with backend.reading_threads():
        mi.Bitmap(image.astype(np.float32)).write(str(path))
