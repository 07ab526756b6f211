"""Pictures by Blender's Cycles, a path tracer with a thin lens, of the boards and the lamp of a scene.

Cycles renders red, green and blue, no spectra. Each of the camera's channels is therefore integrated over wavelength
beforehand, and the rendered numbers are electrons per second: the radiance of the lamp is given in electrons of the
channel, and the reflectance of a texel is the mean weighted by these electrons. This is exact for light that is
reflected once.

Needs the extra ``cycles``; :mod:`validation.references.blender_process` holds the settings of Cycles.

Tested in tests/validation/references/test_blender.py.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dasim.camera import geometry, radiometry
from dasim.camera.specification import Camera
from dasim.materials.surfaces import Diffuse, Mixture, Surface
from dasim.render.translate import MAX_PATH_DEPTH
from dasim.scene import object_materials
from dasim.scene import specification as scenes
from dasim.scene.lights import Lamp, radiance_per_lux
from dasim.scene.shapes import Plane, half_extent_m
from dasim.scene.specification import Scene
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray
from validation.references import blender_process

# Depth 1 is a visible lamp, depth 2 light reflected by one surface; Cycles counts the latter as zero bounces.
MAX_BOUNCES = MAX_PATH_DEPTH - 2


class Renders(NamedTuple):
    """Pictures of independent seeds."""

    pictures: FloatArray  # [seed, h, w, channel] mean electrons per second
    processor_s: FloatArray  # [seed] of all threads


def is_installed() -> bool:
    """Whether ``bpy``, Blender as a Python module, is installed."""
    return importlib.util.find_spec("bpy") is not None


def renders(scene: Scene, camera: Camera, spp: int, seeds: Sequence[int]) -> Renders:
    """Pictures of a scene by Cycles with ``spp`` samples per pixel.

    The scene has planes of one reflectance or of a mixture of two, and one lamp; the camera has three channels, one
    round stop, its axis in the middle of the frame, and coatings that do not move with the angle (``coating_index`` 0).
    """
    (lamp,) = scene.lights
    assert isinstance(lamp, Lamp)
    power = illuminants.illuminant(lamp.illuminant) * lamp.lux * radiance_per_lux(lamp)
    electrons = radiometry.response(camera) * power  # [channel, wavelength]
    to_camera = scenes.world_to_camera(scene)
    position, target = (
        (to_camera @ [*np.multiply(place, 1e-2), 1.0])[:3] for place in (lamp.position_cm, lamp.target_cm)
    )
    request: dict[str, Any] = {
        "spp": spp,
        "seeds": list(seeds),
        "max_bounces": MAX_BOUNCES,
        "camera": {
            "width_px": camera.sensor.width_px,
            "height_px": camera.sensor.height_px,
            "pixel_pitch_m": camera.sensor.pixel_pitch_um * 1e-6,
            "image_distance_m": geometry.image_distance_m(camera),
            "focus_distance_m": camera.lens.focus_distance_m,
            "aperture_m": geometry.aperture_m(camera),
        },
        "lamp": {
            "position_m": position.tolist(),
            "target_m": target.tolist(),
            "radius_m": lamp.radius_cm * 1e-2,
            "radiance": grid.integrate(electrons).tolist(),
        },
        "boards": [
            {"corners_m": _corners_m(item, scene).tolist(), "texture": object_materials.material_of(item)}
            for item in scene.objects
        ],
    }
    textures = {
        object_materials.material_of(item): _texture(object_materials.surface_of(item, scene), electrons)
        for item in scene.objects
    }
    result = _run(request, textures)
    return Renders(result.pictures * radiometry.relative_illumination(camera)[..., None], result.processor_s)


def _corners_m(item: Any, scene: Scene) -> FloatArray:
    """Corners [4, 3] of a plane in camera axes, those of its picture: from the lower left counter-clockwise."""
    assert isinstance(item, Plane)
    _, (x, y, _) = half_extent_m(item, scene.folder)
    local = np.array([[-x, y, 0, 1], [x, y, 0, 1], [x, -y, 0, 1], [-x, -y, 0, 1]])
    return np.asarray((local @ scenes.object_to_camera(item, scene).T)[:, :3])


def _texture(surface: Surface, electrons: FloatArray) -> FloatArray:
    """Reflectance [h, w, channel] of a surface for light of ``electrons`` [channel, wavelength], repeats included.

    It is linear in the weight of a mixture of two, so that interpolating it or the weight is the same.
    """
    if isinstance(surface, Diffuse):
        return _mean_reflectance(surface, electrons)[None, None]
    assert isinstance(surface, Mixture)
    first, second = (_mean_reflectance(part, electrons) for part in (surface.first, surface.second))
    across, down = (round(often) for often in surface.repeat)
    assert (across, down) == surface.repeat, "whole repeats"
    rows = np.concatenate([surface.weight[:: 1 - 2 * (row % 2)] for row in reversed(range(down))])
    weight = np.concatenate([rows[:, :: 1 - 2 * (column % 2)] for column in range(across)], axis=1)
    return first + weight[..., None] * (second - first)


def _mean_reflectance(surface: Surface, electrons: FloatArray) -> FloatArray:
    assert isinstance(surface, Diffuse)
    return np.asarray(grid.integrate(electrons * surface.reflectance) / grid.integrate(electrons))


def _run(request: dict[str, Any], textures: dict[str, FloatArray]) -> Renders:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(folder / "textures.npz", allow_pickle=False, **textures)
        (folder / "request.json").write_text(json.dumps(request | {"textures": str(folder / "textures.npz")}))
        command = [
            sys.executable,
            "-P",
            blender_process.__file__,
            str(folder / "request.json"),
            str(folder / "out.npz"),
        ]
        process = subprocess.run(command, capture_output=True, text=True)
        if process.returncode != 0:
            message = (process.stderr.strip().splitlines() or ["the process was killed"])[-1]
            raise RuntimeError(f"Cycles failed: {message}")
        with np.load(folder / "out.npz") as result:
            return Renders(result["pictures"].astype(np.float64), result["processor_s"])
