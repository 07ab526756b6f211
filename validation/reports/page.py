"""Common parts of the report pages: templates, colours of maps, and pictures as data URLs.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

TEMPLATE_DIR = Path(__file__).parent / "templates"
MAP = "viridis"  # colour-blind-safe
NO_ESTIMATE = "#7f7f7f"


def png_address(image: NDArray[Any]) -> str:
    """A picture of display values 0..1 as a data URL (PNG)."""
    encoded = np.rint(np.clip(np.nan_to_num(image), 0, 1) * 255).astype(np.uint8)
    _, data = cv2.imencode(".png", encoded[..., ::-1] if encoded.ndim == 3 else encoded)
    return "data:image/png;base64," + base64.b64encode(data.tobytes()).decode()
