"""Lights: level, spectrum and direction of each kind, on a white diffuser that is rendered."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from dasim import illuminants, spectra
from dasim import scene as scenes
from dasim.lights import direction
from dasim.materials import reflectance
from dasim.scene import Scene
from dasim.specification import parse

LEVEL = 0.01  # the level that a light is sold with
QUADRATURE = 2e-3  # midpoints of 1,024 rows of a map that steps at the horizon
AT_NM = (450.0, 550.0, 700.0, 800.0)  # of one ray; 800 nm lies beyond what RGB and the CIE's tables reach
MATERIAL = "white-paper"
RAYS, SCALAR_RAYS = 1 << 16, 1 << 11

UP, LEFT, AHEAD, BACK = (0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
KINDS: dict[str, tuple[dict, tuple[float, float, float]]] = {  # the light, and where its diffuser faces
    "dome": ({"illuminant": "A"}, LEFT),
    "lamp": ({"illuminant": "D65", "position_cm": [30, -20, -30], "target_cm": [0, 0, 0], "radius_cm": 10}, ()),
    "panel": ({"illuminant": "F11", "position_cm": [0, -40, 0], "target_cm": [0, 0, 0], "size_cm": [60, 30]}, UP),
    "bulb": ({"illuminant": "LED-B1", "position_cm": [0, 0, -20], "target_cm": [0, 0, 0], "radius_cm": 6}, BACK),
    "sun": ({"illuminant": "sun-30deg", "elevation_deg": 30, "azimuth_deg": 70}, tuple(direction(30, 70))),
    "sky": ({"illuminant": "sky-30deg"}, UP),
    "overcast": ({"kind": "sky", "illuminant": "D75", "distribution": "overcast"}, UP),
    "clear": ({"kind": "sky", "illuminant": "D75", "distribution": "clear", "sun_azimuth_deg": 30}, UP),
    "daylight": ({"elevation_deg": 40, "azimuth_deg": 200}, UP),
    "environment": ({"illuminant": "energy-saving-3500K", "image": "map.png", "rotation_deg": 25}, UP),
}
KINDS["lamp"] = (KINDS["lamp"][0], tuple(np.array([30, -20, -30]) / np.linalg.norm([30, -20, -30])))


def lit(folder: Path, facing, *sources: dict) -> Scene:
    """A small white diffuser at the origin of the scene, facing somewhere, seen by nobody."""
    x, y, z = facing
    # A plane faces -z: turned about x, then about y.
    turn = [float(np.degrees(np.arcsin(np.clip(y, -1, 1)))), float(np.degrees(np.arctan2(-x, -z))), 0.0]
    plane = {"name": "card", "shape": "plane", "material": MATERIAL, "size_cm": [0.1, 0.1], "rotation_deg": turn}
    view = {"position_cm": [3, -5, -70], "look_at_cm": [2, 1, 0]}  # askew, so that all axes count
    data = {"name": "test", "lights": list(sources), "objects": [plane], "folder": folder, "view": view}
    return parse(Scene, data, "test")


def radiance(scene: Scene, facing, rays: int) -> np.ndarray:
    """Radiance of the diffuser at ``AT_NM``, W m^-2 sr^-1 nm^-1, the mean of many paths."""
    import drjit as dr
    import mitsuba as mi

    from dasim.render import translate

    loaded = translate.load(scene)
    axes = scenes.world_to_camera(scene)
    start, towards = axes[:3, :3] @ np.multiply(facing, 0.01) + axes[:3, 3], -axes[:3, :3] @ np.array(facing)
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    sampler = mi.load_dict({"type": "independent", "sample_count": rays})
    ray = mi.RayDifferential3f(mi.Point3f(*start.tolist()), mi.Vector3f(*towards.tolist()))
    ray.wavelengths = mi.Spectrum(*AT_NM)
    if mi.variant().startswith("scalar"):
        sampler.seed(0)
        found = [np.array(integrator.sample(loaded, sampler, ray)[0]) for _ in range(rays)]
        return np.mean(found, axis=0)
    sampler.seed(0, rays)
    found = integrator.sample(loaded, sampler, ray)[0]
    return np.array([dr.mean(found[k]).numpy().item() for k in range(4)])


def source(kind: str, folder: Path, lux: float = 700.0) -> dict:
    if kind == "environment":
        rng = np.random.default_rng(1)
        cv2.imwrite(str(folder / "map.png"), rng.integers(10, 255, (16, 32, 3), dtype=np.uint8))
    return {"kind": kind, "lux": lux, **KINDS[kind][0]}


def expected(light: dict, scene: Scene) -> np.ndarray:
    """The diffuser's radiance, rho E / pi, with E of the light's own level and illuminant."""
    name = scene.lights[0].illuminant
    curve = light["lux"] * illuminants.illuminant(name) * reflectance(MATERIAL) / np.pi
    return np.interp(AT_NM, spectra.WAVELENGTH_NM, curve)


@pytest.mark.parametrize("kind", KINDS)
def test_level_and_spectrum(kind, tmp_path, renderer):
    """Rationale: scenes are lit in lux, from 400 to 830 nm. Expectation: a diffuser has the radiance rho E / pi at
    450, 550, 700 and 800 nm, to within 1 %.
    """
    light = source(kind, tmp_path)
    scene = lit(tmp_path, KINDS[kind][1], light)
    rays = SCALAR_RAYS if renderer.startswith("scalar") else RAYS
    np.testing.assert_allclose(radiance(scene, KINDS[kind][1], rays), expected(light, scene), rtol=LEVEL)
