"""Upright planes at chosen blurs under one sun, whose shadows fall outside the view, and captures of them.

Tested in tests/validation/claims/test_optics_checks.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

import dasim
from dasim.camera import radiometry
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene
from dasim.typing import FloatArray
from validation.subjects import rendering

DARK, BRIGHT = "carbon-black", "white-paper"
# Between planes of carbon black goes 0.02 to 0.2 % of the sun's light. It is uneven, and the wave and the geometric
# kernel spread it differently: by up to 0.03 %, which a Z-test sees. So planes of equal radiance are darker.
BLACK = "black-trap"
MATERIALS = {BLACK: {"kind": "spectrum", "points": [[400.0, 0.003], [830.0, 0.003]]}}
FAR_BLUR_PX = -1.0
WIDE_CM = 100.0  # of a plane: beyond the view at any depth
SUN_ELEVATION_DEG, SUN_AZIMUTH_DEG = 20.0, 150.0  # behind the camera, to the right: shadows fall outside the view
TIME_S = 0.01


def view_of(name: str, size_px: tuple[int, int], **lens: float) -> Camera:
    """A bundled camera whose frame has ``size_px`` (width, height), about the axis."""
    sensor = {"width_px": size_px[0], "height_px": size_px[1]}
    return rendering.changed(cameras.load_camera(name), lens=lens, sensor=sensor)


def plane(
    name: str,
    camera: Camera,
    blur_px: float,
    material: str = BLACK,
    *,
    to_px: float | None = None,
    wide_cm: float = WIDE_CM,
    turn_deg: float = 0.0,
) -> dict[str, Any]:
    """An upright plane at a visible blur, to the left of ``to_px`` from the axis (its right edge), or everywhere."""
    depth_m = rendering.depth_m(camera, blur_px)
    pixel_cm = rendering.pixel_at_m(camera, depth_m) * 100
    turn = np.radians(turn_deg)
    edge_cm = np.array([(to_px or 0.0) * pixel_cm, 0.0, depth_m * 100])
    middle = edge_cm - (0.0 if to_px is None else wide_cm / 2) * np.array([np.cos(turn), 0.0, -np.sin(turn)])
    return {
        "name": name,
        "shape": "plane",
        "size_cm": [wide_cm, WIDE_CM],
        "rotation_deg": [0.0, turn_deg, 0.0],
        "position_cm": middle.tolist(),
        "material": material,
    }


def lit(objects: Sequence[dict[str, Any]], azimuth_deg: float = SUN_AZIMUTH_DEG) -> Scene:
    """Objects under one sun behind the camera."""
    sun = {"kind": "sun", "illuminant": "D65", "lux": 5e4, "elevation_deg": SUN_ELEVATION_DEG}
    return rendering.make_scene(objects, [sun | {"azimuth_deg": azimuth_deg}], MATERIALS)


def rendered(scene: Scene, camera: Camera, spp: int, seed: int, diffraction: str) -> FloatArray:
    """Mean electrons of a capture without natural vignetting, [h, w, channel]."""
    shot = dasim.simulate(scene, camera, seed, spp=spp, exposure=Exposure(time_s=TIME_S), diffraction=diffraction)
    return np.asarray(shot.truth.mean_e / radiometry.relative_illumination(camera)[..., None], dtype=np.float64)


def silhouette_scene(camera: Camera, blur_px: float, near: str, far: str) -> Scene:
    """A half-plane before a wall."""
    return lit([plane("near", camera, blur_px, to_px=0.0, material=near), plane("far", camera, FAR_BLUR_PX, far)])
