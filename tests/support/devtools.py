"""A page in a headless browser that a test drives: scripts, keys, pointers, screens of any size, light or dark."""

from __future__ import annotations

import base64
import contextlib
import json
import shutil
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.support.browser import NAMES

FLAGS = (
    "--headless", "--no-sandbox", "--disable-background-networking", "--no-first-run", "--disable-sync",
    "--remote-debugging-port=0", "--hide-scrollbars", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip
DEADLINE_S = 120.0
FAILED = ("Runtime.exceptionThrown", "Runtime.consoleAPICalled", "Log.entryAdded")


class Page:
    """One page; ``messages`` collects what it says on the console, and ``requests`` what it asks the network for."""

    def __init__(self, socket: Any) -> None:
        """Take over the page behind a socket."""
        self._socket = socket
        self._number = 0
        self.messages: list[str] = []
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Result of a command of the DevTools protocol."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=DEADLINE_S))
            if answer.get("method") in FAILED:
                self.messages.append(json.dumps(answer["params"])[:2000])
            elif answer.get("method") == "Network.requestWillBeSent":
                self.requests.append(answer["params"]["request"]["url"][:200])
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression; a promise is awaited."""
        answer = self.call("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def until(self, condition: str) -> None:
        """Wait until a JavaScript expression is true."""
        end = time.monotonic() + DEADLINE_S
        while not self.run(condition):
            assert time.monotonic() < end, f"never true: {condition}; {self.messages}"
            time.sleep(0.05)

    def screen(self, width: int, height: int, *, dark: bool = False, touch: bool = False) -> None:
        """A screen of a size in CSS pixels with a colour scheme, with or without touch."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=touch)
        self.call("Emulation.setTouchEmulationEnabled", enabled=touch)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])

    def open(self, path: Path, ready: str) -> None:
        """Load a file and wait until a JavaScript expression is true."""
        self.call("Page.navigate", url=path.resolve().as_uri())
        self.until(f"document.readyState === 'complete' && ({ready})")

    def key(self, key: str, *, code: str = "", shift: bool = False) -> None:
        """Press and release a key."""
        text = {"text": key} if len(key) == 1 else {}
        for kind in ("keyDown", "keyUp"):
            also = text if kind == "keyDown" else {}
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, modifiers=8 if shift else 0, **also)

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A mouse event: mousePressed, mouseReleased, mouseMoved or mouseWheel."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x: float, y: float) -> None:
        """Click at a place of the window, CSS pixels."""
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", clickCount=1)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag with the left button."""
        self.mouse("mousePressed", *start, button="left", clickCount=1)
        for share in (0.5, 1.0):
            x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, button="left", buttons=1)
        self.mouse("mouseReleased", *end, button="left", clickCount=1)

    def touch(self, *steps: list[tuple[float, float]]) -> None:
        """Touch with one finger or more: their places at each step; then lift them."""
        for number, fingers in enumerate(steps):
            points = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(fingers)]
            self.call("Input.dispatchTouchEvent", type="touchMove" if number else "touchStart", touchPoints=points)
        self.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def picture(self, **options: Any) -> NDArray[np.uint8]:
        """Screenshot, [h, w, 3] BGR."""
        return decoded(self.call("Page.captureScreenshot", format="png", **options)["data"])

    def canvas(self, selector: str) -> NDArray[np.uint8]:
        """Pixels of a canvas, [h, w, 3] BGR."""
        return decoded(self.run(f"document.querySelector({json.dumps(selector)}).toDataURL()").split(",")[1])


def decoded(text: str) -> NDArray[np.uint8]:
    """Picture of a PNG in base64, [h, w, 3] BGR."""
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(text), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture, np.uint8)


@contextlib.contextmanager
def browsing(profile: Path, *flags: str) -> Iterator[Page]:
    """A page of a headless browser with a profile folder of its own; skips the test where there is no browser."""
    browser = next((path for name in NAMES if (path := shutil.which(name))), None)
    if browser is None:
        pytest.skip(f"no browser is installed; one is needed of {', '.join(NAMES)}")
    client = pytest.importorskip("websockets.sync.client", reason="websockets is not installed (extra test)")
    command = [browser, *FLAGS, *flags, f"--user-data-dir={profile}", "about:blank"]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port = _port(profile / "DevToolsActivePort", process)
        with client.connect(_address(port), max_size=None) as socket:
            yield Page(socket)
    finally:
        process.terminate()
        process.wait(timeout=DEADLINE_S)


def _port(file: Path, process: subprocess.Popen[bytes]) -> int:
    """The port that the browser chose and wrote down."""
    end = time.monotonic() + DEADLINE_S
    while not (file.is_file() and file.read_text().count("\n")):
        assert process.poll() is None, "the browser has ended"
        assert time.monotonic() < end, "the browser does not answer"
        time.sleep(0.05)
    return int(file.read_text().split()[0])


def _address(port: int) -> str:
    """Address of the first page of the browser at a port."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=DEADLINE_S) as answer:
        pages = [entry for entry in json.loads(answer.read()) if entry["type"] == "page"]
    return str(pages[0]["webSocketDebuggerUrl"])
