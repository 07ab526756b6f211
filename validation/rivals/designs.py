"""The designs that are compared, each a camera, or two that take their pictures through one lens at the same time.

Tested in tests/validation/rivals/test_likelihood.py and tests/validation/rivals/test_broken_designs.py.
"""

from __future__ import annotations

from typing import NamedTuple

import dasim
from dasim.camera import stops
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene


class Design(NamedTuple):
    """A way to measure depth with one lens and one exposure."""

    name: str
    text: str
    cameras: tuple[str, ...]  # bundled names; with two, both pictures are of one exposure


DESIGNS = (
    Design("dual-aperture", "visible light through the open lens, near-infrared through the hole", ("da-mobile",)),
    Design("green-stop", "green through a smaller stop (Chakrabarti and Zickler)", ("chakrabarti-zickler",)),
    Design("axial-colour", "red, green and blue in focus at different distances", ("chromatic-mobile",)),
    Design("dual-pixel", "the two halves of the lens side by side", ("dual-pixel-left", "dual-pixel-right")),
    Design("coded-aperture", "one coded mask for all light", ("coded-mobile",)),
    Design("open-lens", "one open lens for all light", ("bayer-mobile",)),
)


def cameras(design: Design, size_px: tuple[int, int], scene: Scene) -> list[Camera]:
    """The cameras of a design, cropped to (width, height) pixels and focused as a scene proposes."""
    return [dasim.focused(dasim.cropped(dasim.load_camera(name), *size_px), scene) for name in design.cameras]


def open_share(design: Design) -> float:
    """Share of the lens that visible light passes: the pictures together, for green."""
    return sum(_green_area(dasim.load_camera(name)) for name in design.cameras)


def _green_area(camera: Camera) -> float:
    green = 540
    return sum(
        stops.open_area(stop) for stop in camera.stops if any(low <= green <= high for low, high in stop.passes_nm)
    )
