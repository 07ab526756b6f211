"""Screenshots of pages in a headless browser."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import pytest
from numpy.typing import NDArray

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = "--headless --no-sandbox --disable-gpu --disable-background-networking --no-first-run --disable-sync"
DEADLINE_S = 120


def screenshot(page: Path, width: int = 1200, height: int = 2400) -> NDArray[Any]:
    """Screenshot of a page, [height, width, 3] BGR. Fails on console messages; skips the test without a browser."""
    browser = next((path for name in NAMES if (path := shutil.which(name))), None)
    if browser is None:
        pytest.skip(f"no browser is installed; one is needed of {', '.join(NAMES)}")
    shot = page.with_name("shot.png")
    command = [browser, *FLAGS.split(), f"--user-data-dir={page.with_name('profile')}", "--enable-logging=stderr"]
    command += [f"--window-size={width},{height}", "--virtual-time-budget=5000", f"--screenshot={shot}", page.as_uri()]
    process = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert process.returncode == 0, process.stderr
    assert not [line for line in process.stderr.splitlines() if "CONSOLE" in line]
    picture = cv2.imread(str(shot))
    assert picture is not None and picture.shape == (height, width, 3)
    return picture
