"""Claim on the side of the focus: in front or behind, told by axial colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

import dasim
import recon
from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot
from dasim.typing import BoolArray, ShareDone
from dasim.values import Reconstruction
from validation.gates.claim import Evidence
from validation.methods import NamedMethod, bundled, prefix, reconstructed
from validation.reports.page import png_address
from validation.scores.figures import Figure
from validation.scores.texture import textured
from validation.subjects import rendering
from validation.subjects.shots import photographed

METHODS = bundled("best")
AXIAL_COLOUR_UM = ((450.0, -8.0), (550.0, 0.0), (750.0, 15.0))  # nm, added to the focal length
FOCUS_M = 0.2
SIZE_PX = (192, 144)
SPP = 160
IN_FOCUS_LEVELS = 0.5  # up to here there is no side
LIGHT: tuple[dict[str, Any], ...] = ({"kind": "dome", "illuminant": "D65", "lux": 1000.0},)
# Images and the two materials that they mix; none was used to choose the method.
TEXTURES = {
    "coins": ("skimage:coins", "denim", "cotton-undyed"),
    "text": ("skimage:page", "concrete-dark", "mortar"),
    "coffee": ("skimage:coffee", "leather-brown", "white-paper"),
    "cat": ("skimage:chelsea", "brick", "cotton-yellow"),
}
Board = tuple[str, float, tuple[float, float, float, float]]  # texture, level, and (left, top, right, bottom) 0..1
WHOLE = (-0.3, -0.3, 1.3, 1.3)
SCENES: dict[str, tuple[Board, ...]] = {
    "front": (("coins", 2.0, (-0.3, -0.3, 0.5, 1.3)), ("cat", 5.0, (0.5, -0.3, 1.3, 1.3))),
    "behind": (("coffee", -2.0, (-0.3, -0.3, 0.5, 1.3)), ("text", -5.0, (0.5, -0.3, 1.3, 1.3))),
    "both": (("coins", -4.0, WHOLE), ("coffee", 4.0, (-0.3, 0.15, 0.45, 1.3)), ("cat", -1.5, (0.6, 0.4, 1.3, 1.3))),
}


def side_of_focus(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """With axial colour, the picture tells which side of the focus a surface lies on; without it, the result says so.

    Rationale: blur alone is the same on both sides. A focal length that rises with the wavelength blurs red and
    infrared more in front of the focus, blue behind it.

    Set-up: da-mobile focused at 20 cm, 192 x 144 px, with a focal length 8 um shorter at 450 nm and 15 um longer at
    750 nm than at 550 nm. Boards with images that mix two measured materials, under a D65 dome: two in front of the
    focus (levels 2 and 5), two behind it (-2 and -5), and a scene with both sides (a board at 4 and one at -1.5 before
    a wall at -4). 160 samples per pixel and stop; a bank calibrated for the camera. A pixel is right if the sign of its
    level is that of the truth; level 0 counts as wrong. Scored are pixels with texture (as judged from the capture),
    including those that see a boundary. The shares without boundary pixels and over all pixels are reported, and so is
    the error of the signed level. The scene with both sides is also photographed without axial colour.

    Expectation: a single window contains too little information about the side, a surface contains enough. Beside a
    step in depth, a window contains both sides.

    Limit: 95 % of the textured pixels of each scene. Without axial colour no level is below 0, and the result states
    that the side is assumed.

    Source: the project's own.
    """
    rendering.needs_wave()
    figures: list[Figure] = []
    pictures = []
    plain = dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX)
    plain = rendering.changed(plain, lens={"focus_distance_m": FOCUS_M})
    camera = rendering.changed(plain, lens={"focal_shift_um": AXIAL_COLOUR_UM})
    shots = {name: (camera, photographed(scene(camera, name), camera, seed, spp=SPP)) for name in SCENES}
    shots["assumed"] = plain, photographed(scene(plain, "both"), plain, seed, spp=SPP)
    for number, (name, (its_camera, shot)) in enumerate(shots.items()):
        bank = recon.calibrate(dasim.calibration_captures(its_camera))
        for method in methods:
            result = reconstructed(shot.capture, bank, method)
            label = f"{prefix(method, METHODS)}{name}"
            figures += assumed_figures(label, result) if name == "assumed" else side_figures(label, result, shot)
            pictures.append((f"{name}, {method}: capture, true and estimated signed level", _picture(result, shot)))
        progress((number + 1) / len(shots))
    return Evidence(figures, pictures)


def scene(camera: Camera, name: str) -> Scene:
    """Boards that face the camera at signed levels; their corners are given in the picture, 0..1."""
    per_level_px = float(geometry.level_blur_px(camera)[1])
    materials, objects = {}, []
    for number, (texture, level, (left, top, right, bottom)) in enumerate(SCENES[name]):
        depth = rendering.depth_m(camera, level * per_level_px)
        pixel_cm = 100 * rendering.pixel_at_m(camera, depth)
        width, height = (side * pixel_cm for side in SIZE_PX)
        image, dark, bright = TEXTURES[texture]
        materials[texture] = {"kind": "blend", "image": image, "dark": dark, "bright": bright}
        place = [width * ((left + right) / 2 - 0.5), height * ((top + bottom) / 2 - 0.5), 100 * depth]
        size = [width * (right - left), height * (bottom - top)]
        objects.append(
            {"name": f"board-{number}", "shape": "plane", "size_cm": size, "position_cm": place, "material": texture}
        )
    return rendering.make_scene(objects, LIGHT, materials)


def side_figures(label: str, result: Reconstruction, shot: Shot) -> list[Figure]:
    """Shares of pixels with the right sign, and the error of the signed level."""
    truth = shot.truth
    sided = truth.valid & (np.abs(truth.level) > IN_FOCUS_LEVELS)
    texture = sided & textured(shot.capture)
    right = np.sign(result.level) == np.sign(truth.level)
    error = np.abs(result.level - truth.level)
    regions: dict[str, tuple[BoolArray, str]] = {
        "textured": (texture, "textured pixels"),
        "inner": (texture & ~truth.boundary, "textured pixels away from boundaries"),
        "all": (sided, "all pixels"),
    }
    figures = [
        Figure(f"{label}.{name}", float(right[where].mean()), "1", f"{label}: right side of the focus, share of {text}")
        for name, (where, text) in regions.items()
    ]
    share = float(texture.sum() / max(sided.sum(), 1))
    median = float(np.median(error[texture]))
    return [
        *figures,
        Figure(f"{label}.share", share, "1", f"{label}: share of pixels with texture"),
        Figure(f"{label}.error", median, "level", f"{label}: median error of the signed level, textured pixels"),
    ]


def assumed_figures(label: str, result: Reconstruction) -> list[Figure]:
    """What a result without axial colour says of the side."""
    behind = float((result.level < 0).mean())
    stated = float(result.side == "assumed" and any("side of the focus is assumed" in note for note in result.notes))
    return [
        Figure(f"{label}.behind", behind, "1", "without axial colour: share of pixels with a level behind the focus"),
        Figure(f"{label}.stated", stated, "1", "without axial colour: the result states that the side is assumed"),
    ]


def _picture(result: Reconstruction, shot: Shot) -> str:
    """The capture, the true and the estimated level side by side; blue behind the focus, red in front of it."""
    top = float(np.abs(shot.truth.level[shot.truth.valid]).max())
    parts: list[NDArray[Any]] = [np.asarray(result.rgb, np.float64)]
    for level in (shot.truth.level, result.level):
        parts.append(colormaps["seismic"](np.clip(0.5 + level / (2 * top), 0, 1))[..., :3])
    return png_address(np.hstack(parts))
