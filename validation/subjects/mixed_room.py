"""A room under lights of different spectra, and its pictures with interpolated and with traced light.

Tested in tests/validation/claims/test_light_checks.py.
"""

from __future__ import annotations

from typing import Any

import dasim
from dasim.camera.specification import Camera
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.typing import FloatArray
from validation.subjects import rendering

SENSOR = {"width_px": 96, "height_px": 72, "pixel_pitch_um": 20.0}  # the whole view in few pixels
SPP, SEEDS = 256, range(1, 9)  # of the captures
TRACED_SPP, TRACED_SEEDS = 1024, range(11, 15)

DOME: dict[str, Any] = {"kind": "dome", "lux": 400.0}
# It shines upwards at the ceiling, so that its light reaches what is seen by reflection only.
LAMP: dict[str, Any] = {
    "kind": "lamp",
    "lux": 4000.0,
    "position_cm": [0, -15, 30],
    "target_cm": [0, -40, 30],
    "radius_cm": 3,
}
LIGHTS: dict[str, tuple[dict[str, Any], ...]] = {
    "D65-F11": (DOME | {"illuminant": "D65"}, LAMP | {"illuminant": "F11"}),
    "energy-saving-D65": (DOME | {"illuminant": "energy-saving-3500K"}, LAMP | {"illuminant": "D65"}),
    "D65-A": (DOME | {"illuminant": "D65"}, LAMP | {"illuminant": "A"}),
    "daylight": ({"kind": "daylight", "lux": 1000.0, "elevation_deg": 35, "azimuth_deg": 200},),
}
OBJECTS: tuple[dict[str, Any], ...] = (
    {"name": "wall", "shape": "plane", "size_cm": [90, 70], "position_cm": [0, 0, 45], "material": "wood-light"},
    {
        "name": "floor",
        "shape": "plane",
        "size_cm": [90, 60],
        "position_cm": [0, 12, 30],
        "rotation_deg": [90, 0, 0],
        "material": "cotton-red",
    },
    {
        "name": "ceiling",
        "shape": "plane",
        "size_cm": [90, 60],
        "position_cm": [0, -40, 30],
        "rotation_deg": [90, 0, 0],
        "material": "white-paper",
    },
    {"name": "ball", "shape": "sphere", "radius_cm": 5, "position_cm": [-7, 6, 34], "material": "leaf-green"},
    {"name": "card", "shape": "plane", "size_cm": [10, 9], "position_cm": [8, 5, 36], "material": "grey-card"},
)


def camera(name: str) -> Camera:
    """A bundled camera whose frame has the whole view in few pixels."""
    return rendering.changed(dasim.load_camera(name), sensor=SENSOR)


def pictures(scene: Scene | MitsubaScene, camera: Camera) -> tuple[list[FloatArray], list[FloatArray]]:
    """Mean electrons per second of captures, and of renders without any interpolation, each [h, w, channel]."""
    from dasim.render import translate

    captures = [rendering.capture_rate(scene, camera, SPP, seed, diffraction="off") for seed in SEEDS]
    loaded = translate.world(scene, camera).scene
    traced = [
        rendering.stop_pictures(loaded, camera, TRACED_SPP, seed, diffraction="off", max_blur_px=0.0).sum(axis=0)
        for seed in TRACED_SEEDS
    ]
    return captures, traced
