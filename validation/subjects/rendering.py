"""Small scenes and modified cameras for claims, and renders of them.

Tested in tests/validation/claims/test_light_checks.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

import dasim
from dasim.base.toml import parse
from dasim.camera import radiometry
from dasim.camera.specification import Camera
from dasim.render import backend
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.typing import FloatArray

# Even light without noise: every ray that leaves a surface meets the dome, which has the same radiance everywhere.
# The lamp is behind all objects and contributes nothing; without a lamp the renderer would also sample the dome as an
# emitter, which adds noise.
EVEN_LIGHT: tuple[dict[str, Any], ...] = (
    {"kind": "dome", "illuminant": "D65", "lux": 500.0},
    {
        "kind": "lamp",
        "illuminant": "D65",
        "lux": 1e-6,
        "position_cm": [0, 0, 500],
        "target_cm": [0, 0, 400],
        "radius_cm": 1,
    },
)
# A lamp beside and behind the lens: it lights what faces the camera and is never in view, so the background is dark.
LAMP: tuple[dict[str, Any], ...] = (
    {
        "kind": "lamp",
        "illuminant": "D65",
        "lux": 1000.0,
        "position_cm": [0, -30, -60],
        "target_cm": [0, 0, 20],
        "radius_cm": 5,
    },
)


class NotRun(Exception):
    """Raised if a claim cannot be measured on this computer; the message states the reason."""


def seeds_of(seed: int, count: int, part: int = 0) -> range:
    """Seeds of ``count`` pictures that no other seed of a claim has, for up to 1000 / ``count`` seeds per part."""
    return range(1000 * part + count * seed, 1000 * part + count * (seed + 1))


def activate() -> str:
    """Activate the fastest Mitsuba variant of this computer and return its name."""
    choice = backend.choose()
    backend.activate(choice)
    return choice.variant


def block_means(pictures: FloatArray, block_px: int) -> FloatArray:
    """Means over square blocks of ``block_px`` of pictures [..., h, w, channel]; incomplete blocks are left out."""
    *before, height, width, channels = pictures.shape
    rows, columns = height // block_px, width // block_px
    whole = pictures[..., : rows * block_px, : columns * block_px, :]
    return np.asarray(whole.reshape(*before, rows, block_px, columns, block_px, channels).mean(axis=(-4, -2)))


def needs_wave() -> None:
    """Activate the renderer; raise NotRun if it has no wave-true blur."""
    if activate().startswith("scalar"):
        raise NotRun("only scalar_spectral works here, which has no wave-true blur; install LLVM 17 or newer")


def make_scene(
    objects: Sequence[dict[str, Any]],
    lights: Sequence[dict[str, Any]] = LAMP,
    materials: Mapping[str, dict[str, Any]] | None = None,
) -> Scene:
    """A scene from tables of objects, lights and own materials by name, as scene files have them."""
    tables = {"lights": list(lights), "objects": list(objects), "materials": dict(materials or {})}
    return parse(Scene, {"name": "claim", **tables}, "scene of a claim")


def changed(
    camera: Camera,
    *,
    lens: dict[str, Any] | None = None,
    sensor: dict[str, Any] | None = None,
    stops: Sequence[dict[str, Any]] | None = None,
) -> Camera:
    """The camera with some values of its lens or sensor replaced, or with other stops."""
    data = camera.model_dump()
    data["lens"] |= lens or {}
    data["sensor"] |= sensor or {}
    if stops is not None:
        data["stops"] = list(stops)
    return parse(Camera, data, "camera of a claim")


def stop_pictures(
    scene: Any,
    camera: Camera,
    spp: int,
    seed: int,
    *,
    diffraction: str,
    max_blur_px: float,
    spectrum: FloatArray | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> FloatArray:
    """Mean electrons per second through each stop, [stop, h, w, channel].

    ``scene`` is a scene or a loaded Mitsuba scene, ``spp`` the number of samples per pixel and stop, ``diffraction``
    one of 'wave', 'airy' and 'off', and ``max_blur_px`` a bound of the visible blur diameter. If the ``spectrum`` of
    the lights is given, irradiance is interpolated as it is for captures; otherwise all light is traced.
    """
    from dasim.render import passes, translate

    loaded = translate.load(scene) if isinstance(scene, Scene) else scene
    field = None if spectrum is None else passes.irradiance_field(loaded, camera, spectrum, max_blur_px, spp, seed)
    pictures = []
    for index, stop in enumerate(camera.stops):
        pictures.append(
            passes.stop_pass(
                loaded,
                camera,
                stop,
                passes.Sampling(spp, seed),
                diffraction=diffraction,
                max_blur_px=max_blur_px,
                field=field,
            )
        )
        progress((index + 1) / len(camera.stops))
    return np.stack(pictures)


def capture_rate(
    scene: Scene | MitsubaScene, camera: Camera, spp: int, seed: int, *, diffraction: str | None = None
) -> FloatArray:
    """Mean electrons per second of a capture (``mean_e`` of ``dasim.simulate``), [h, w, channel]."""
    shot = dasim.simulate(scene, camera, seed, spp=spp, diffraction=diffraction)
    return shot.truth.mean_e.astype(np.float64) / shot.capture.exposure_s


def stop_electrons(camera: Camera, spectrum: FloatArray) -> FloatArray:
    """Share of each channel's electrons that each stop contributes under a spectrum, [stop, channel]; sums to 1."""
    from dasim.spectra import grid

    signal = np.stack([grid.integrate(radiometry.stop_response(camera, stop) * spectrum) for stop in camera.stops])
    return signal / signal.sum(axis=0)


def blur_px(camera: Camera, depth_m: float) -> float:
    """Signed visible blur diameter in pixels at a depth, c = A s (1/d - 1/d_f) / p, from the camera's data sheet.

    It is positive in front of the focal plane and does not use the simulator's geometry.
    """
    lens = camera.lens
    focal_m, focus_m = lens.focal_length_mm * 1e-3, lens.focus_distance_m
    image_m = 1 / (1 / focal_m - 1 / focus_m)
    return focal_m / lens.f_number * image_m * (1 / depth_m - 1 / focus_m) / (camera.sensor.pixel_pitch_um * 1e-6)


def depth_m(camera: Camera, blur: float) -> float:
    """Depth in metres at which the signed visible blur diameter is ``blur`` pixels, the inverse of :func:`blur_px`."""
    lens = camera.lens
    focal_m, focus_m = lens.focal_length_mm * 1e-3, lens.focus_distance_m
    image_m = 1 / (1 / focal_m - 1 / focus_m)
    return 1 / (1 / focus_m + blur * camera.sensor.pixel_pitch_um * 1e-6 * lens.f_number / (focal_m * image_m))


def pixel_at_m(camera: Camera, depth: float) -> float:
    """Size in metres of a pixel projected to a depth in metres, p d / s."""
    lens = camera.lens
    image_m = 1 / (1 / (lens.focal_length_mm * 1e-3) - 1 / lens.focus_distance_m)
    return camera.sensor.pixel_pitch_um * 1e-6 * depth / image_m
