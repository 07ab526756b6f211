"""The designs that are compared: each is one camera, or two that photograph through the same lens at the same time.

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
    sweep_um: tuple[float, ...] = (0.0,)  # of the focal length, at moments of the exposure that are equally long


# From a focus of 80 cm to 12 cm in steps of 2.4 px of blur, by a lens of variable power: the picture keeps its scale.
SWEEP_UM = (0.0, -11.0, -22.0, -33.0, -44.0, -55.0, -66.0, -77.0, -88.0)

DESIGNS = (
    Design("dual-aperture", "visible light through the open lens, near-infrared through the hole", ("da-mobile",)),
    Design("green-stop", "green through a smaller stop (Chakrabarti and Zickler)", ("chakrabarti-zickler",)),
    Design("axial-colour", "red, green and blue in focus at different distances", ("chromatic-mobile",)),
    Design("dual-pixel", "the two halves of the lens side by side", ("dual-pixel-left", "dual-pixel-right")),
    Design("coded-aperture", "one coded mask for all light", ("coded-mobile",)),
    Design("open-lens", "one open lens for all light", ("bayer-mobile",)),
    Design("focal-sweep", "one open lens whose focus moves during the exposure", ("bayer-mobile",), SWEEP_UM),
)


def cameras(design: Design, size_px: tuple[int, int], scene: Scene) -> list[Camera]:
    """The cameras of a design, cropped to (width, height) pixels and focused as a scene proposes."""
    return [dasim.focused(dasim.cropped(dasim.load_camera(name), *size_px), scene) for name in design.cameras]


def shifted(camera: Camera, focal_um: float) -> Camera:
    """The camera with another focal length, and with its sensor and the scale of its picture as they are."""
    if not focal_um:
        return camera
    lens = camera.lens.model_copy(update={"focal_shift_um": ((400.0, focal_um), (830.0, focal_um))})
    return camera.model_copy(update={"lens": lens})


def open_share(design: Design) -> float:
    """Share of the lens that visible light passes: the pictures together, for green."""
    return sum(_green_area(dasim.load_camera(name)) for name in design.cameras)


def _green_area(camera: Camera) -> float:
    green = 540
    return sum(
        stops.open_area(stop) for stop in camera.stops if any(low <= green <= high for low, high in stop.passes_nm)
    )
