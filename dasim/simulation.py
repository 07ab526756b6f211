"""simulate(scene, camera, seed): from a scene to a capture and its exact ground truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from dasim import camera as cameras
from dasim import scene as scenes
from dasim import sensor
from dasim.camera import Camera
from dasim.errors import InputError
from dasim.pointspread import DIFFRACTION_MODELS
from dasim.render import backend, stock
from dasim.scene import Scene
from dasim.sensor import Exposure
from dasim.values import Capture, Truth

DEFAULT_SPP = 144
MOST_SPP = 65_536
SHARP_SPP = 64  # the pinhole pass has no lens to sample
BLUR_MARGIN = 1.1  # something nearer than all that is seen may lie just outside the frame

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Shot:
    """A simulated capture and what is exactly known of it."""

    capture: Capture
    truth: Truth


def simulate(
    scene: Scene,
    camera: Camera,
    seed: int = 0,
    *,
    spp: int = DEFAULT_SPP,
    exposure: Exposure | None = None,
    diffraction: str | None = None,
    variant: str | None = None,
    progress: Progress = lambda stage, share: None,
) -> Shot:
    """Photograph a scene: render each stop, expose, add noise, and keep the ground truth.

    The camera's own focus is used (see ``dasim.focused``). ``diffraction`` is ``wave`` (JIT variants only, their
    default), ``airy`` (the default of ``scalar_spectral``) or ``off``. The same seed and variant give the same
    bytes. The truth's ``mean_e`` is as the lens sees it, before electronic crosstalk. ``progress`` gets the stage's
    name and the share of it that is done.
    """
    exposure = exposure or Exposure()
    check_options(spp, seed, diffraction)
    choice = backend.choose(variant)
    diffraction = diffraction_model(diffraction, choice.variant)
    check_camera(camera, choice.variant)
    backend.activate(choice)
    from dasim.render import passes, translate, truth  # after the variant is chosen

    progress("geometry", 0.0)
    scenes.check_clear(scene, cameras.aperture_m(camera) / 2)
    mitsuba_scene = translate.load(scene)
    geometry = truth.geometry(mitsuba_scene, camera)
    blur_px = truth.signed_blur_px(geometry.depth_m, camera)
    progress("geometry", 1.0)

    illuminant = scenes.main_illuminant(scene)
    names = cameras.channels(camera.sensor)
    lens_rate = np.zeros((*geometry.depth_m.shape, len(names)))
    for stop in camera.stops:
        stage = partial(progress, f"rendering through stop '{stop.name}'")
        lens_rate += passes.stop_pass(
            mitsuba_scene,
            camera,
            stop,
            passes.Sampling(spp, seed, stage),
            diffraction=diffraction,
            max_blur_px=float(np.abs(blur_px).max()) * BLUR_MARGIN,
            illuminant=illuminant,
        )
    sampling = passes.Sampling(SHARP_SPP, seed, partial(progress, "rendering the pinhole picture"))
    pinhole_rate = passes.pinhole_pass(mitsuba_scene, camera, sampling)

    time_s = exposure.time_s or sensor.auto_exposure_s(lens_rate, camera, exposure)
    mean_e = lens_rate * time_s
    collected_e = sensor.electronic_crosstalk(sensor.mosaic(mean_e, camera), camera.sensor)
    raw_dn, saturated = sensor.expose(collected_e, camera.sensor, time_s, seed, gain=exposure.gain)
    capture = Capture(
        raw_dn=raw_dn,
        camera=camera,
        exposure_s=time_s,
        gain=exposure.gain,
        seed=seed,
        illuminant=illuminant,
        provenance={
            "scene": scene.model_dump(mode="json", exclude={"folder"}),
            "renderer": choice.variant,
            "diffraction": diffraction,
            "spp": passes.sample_count(spp),
            "exposure": exposure.model_dump(mode="json"),
            "saturated_pixels": saturated,
            "notes": notes(lens_rate, geometry.depth_m, saturated, diffraction),
        },
    )
    exact = Truth(
        depth_m=geometry.depth_m.astype(np.float32),
        valid=~np.isnan(geometry.depth_m),
        normal=geometry.normal.astype(np.float32),
        object_id=geometry.object_id,
        blur_px=blur_px.astype(np.float32),
        level=(blur_px / cameras.level_blur_px(camera)[1]).astype(np.float32),
        boundary=truth.boundary(blur_px),
        channels=names,
        mean_e=mean_e.astype(np.float32),
        sharp_e=(pinhole_rate * time_s).astype(np.float32),
    )
    return Shot(capture, exact)


def check_options(spp: int | None, seed: int, diffraction: str | None) -> None:
    """InputError for samples, seed or diffraction model that no variant takes."""
    if spp is not None and not 1 <= spp <= MOST_SPP:
        raise InputError(f"spp is {spp}; 1 to {MOST_SPP} samples a pixel are allowed")
    if seed < 0:
        raise InputError(f"seed is {seed}; 0 or a positive whole number is needed")
    if diffraction is not None and diffraction not in DIFFRACTION_MODELS:
        raise InputError(f"diffraction '{diffraction}' is unknown; allowed are {', '.join(DIFFRACTION_MODELS)}")


def check_camera(camera: Camera, variant: str) -> None:
    """InputError where the variant cannot render through the camera's stops and lens."""
    if variant.startswith("scalar"):
        stock.check(camera)


def notes(rate_e_s: np.ndarray, depth_m: np.ndarray, saturated: int, diffraction: str) -> list[str]:
    """What a user should know of a capture that is legal but odd, or approximate."""
    found = []
    if np.isnan(depth_m).all():
        found.append("no object is in view")
    if rate_e_s.max() <= 0:
        found.append("no light reaches the sensor")
    if saturated > 0.05 * depth_m.size:
        found.append(f"{saturated / depth_m.size:.0%} of the pixels are saturated")
    if diffraction == "airy":
        found.append("diffraction 'airy' is approximate away from focus; a JIT variant renders 'wave'")
    return found


def diffraction_model(name: str | None, variant: str) -> str:
    """The diffraction model for a variant; InputError where it is unknown or the variant cannot do it."""
    scalar = variant.startswith("scalar")
    if name is None:
        return "airy" if scalar else "wave"
    allowed = ("airy", "off") if scalar else ("wave", "off")
    if name not in allowed:
        raise InputError(f"diffraction '{name}' is not what {variant} can do; allowed are {', '.join(allowed)}")
    return name
