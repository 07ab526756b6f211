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
    """A picture of the page, [height, width, 3] BGR; it may not say a word on the console. Skips without a browser."""
    browser = next((found for name in NAMES if (found := shutil.which(name))), None)
    if browser is None:
        pytest.skip(f"no browser here, looked for {', '.join(NAMES)}")
    shot = page.with_name("shot.png")
    command = [browser, *FLAGS.split(), f"--user-data-dir={page.with_name('profile')}", "--enable-logging=stderr"]
    command += [f"--window-size={width},{height}", "--virtual-time-budget=5000", f"--screenshot={shot}", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=DEADLINE_S, check=False)
    assert done.returncode == 0, done.stderr
    assert not [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    picture = cv2.imread(str(shot))
    assert picture is not None and picture.shape == (height, width, 3)
    return picture
