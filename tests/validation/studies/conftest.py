"""Cameras that the tests of studies share."""

from __future__ import annotations

import pytest

import dasim
from dasim.camera import specification as cameras


@pytest.fixture(scope="session")
def camera() -> dasim.Camera:
    """da-mobile, focused at the far end of the paper's first working range."""
    return cameras.refocused(dasim.load_camera("da-mobile"), 0.4)
