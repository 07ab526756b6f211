"""From a scene and a camera to a capture and its exact ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dasim.base.errors import InputError
from dasim.camera import geometry as camera_geometry
from dasim.camera import noise, pointspread, radiometry
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.pointspread import DIFFRACTION_MODELS
from dasim.camera.specification import Camera, as_camera
from dasim.loading import as_scene
from dasim.render import backend, stock
from dasim.scene import specification as scenes
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation import adaptive_sampling
from dasim.spectra import colour, illuminants
from dasim.typing import Progress
from dasim.values import Capture, Truth

DEFAULT_SPP = 64  # a power of two, in which the samples are most even
MOST_SPP = 65_536
TWIN = "bayer-mobile"  # whose colours the truth's picture has
SHARP_SPP = 64  # the pinhole pass has no lens to sample
BLUR_MARGIN = 1.1  # something nearer than all that is seen may lie just outside the frame


@dataclass(frozen=True)
class Shot:
    """A simulated capture and its ground truth."""

    capture: Capture
    truth: Truth


def simulate(
    scene: Scene | MitsubaScene | str | Path,
    camera: Camera | str | Path,
    seed: int = 0,
    *,
    spp: int | Literal["auto"] = DEFAULT_SPP,
    noise_share: float = adaptive_sampling.NOISE_SHARE,
    exposure: Exposure | None = None,
    diffraction: str | None = None,
    variant: str | None = None,
    progress: Progress = lambda stage, share: None,
) -> Shot:
    """Photograph a scene: render each stop, expose, add noise, and keep the ground truth.

    The same seed and variant give the same bytes. The camera owns the focus, also where it is given by name;
    ``dasim.focused(camera, scene)`` sets the focus that a scene proposes.

    Args:
        scene: a Scene or MitsubaScene, or the name or path of one: ``dasim.simulate("desk", "da-mobile")``
        camera: a Camera, a bundled name or a path
        seed: of all random numbers, 0 or above
        spp: samples per pixel and stop, or ``auto``: as many as bring the rendering noise below ``noise_share``
        noise_share: rendering noise over the sensor's own noise, at the median pixel of every channel
        exposure: exposure time and gain; automatic by default
        diffraction: ``wave`` (JIT variants only, their default), ``airy`` (default of ``scalar_spectral``) or ``off``
        variant: the Mitsuba variant; by default the fastest that works here
        progress: called with the name of a stage and the share of it that is done

    Returns a :class:`Shot`; its ``truth.mean_e`` is the light through the lens, before electronic crosstalk.
    """
    camera = as_camera(camera)
    scene = as_scene(scene, camera)
    exposure = exposure or Exposure()
    check_options(spp, seed, diffraction, noise_share)
    choice = backend.choose(variant)
    diffraction = diffraction_model(diffraction, choice.variant)
    check_camera(camera, choice.variant)
    backend.activate(choice)
    from dasim.render import passes, translate, truth  # after the variant is chosen

    progress("geometry", 0.0)
    world = translate.world(scene, camera)
    mitsuba_scene = world.scene
    geometry = truth.geometry(mitsuba_scene, camera)
    check_in_view(scene, geometry.depth_m)
    blur_px = truth.signed_blur_px(geometry.depth_m, camera)
    progress("geometry", 1.0)

    illuminant = scenes.main_illuminant(scene)
    spectrum = scenes.light_spectrum(scene)
    names = cameras.channels(camera.sensor)

    reach_px = float(np.abs(blur_px).max()) * BLUR_MARGIN
    fields: dict[int, Any] = {}

    def stop_pictures(key: int, samples: tuple[int, ...], label: str = "") -> np.ndarray:
        fields.clear()
        fields[key] = passes.irradiance_field(mitsuba_scene, camera, spectrum, reach_px, max(samples), key)
        pictures = []
        for stop, spp in zip(camera.stops, samples, strict=True):
            stage = partial(progress, f"rendering through stop '{stop.name}'{label}")
            pictures.append(
                passes.stop_pass(
                    mitsuba_scene,
                    camera,
                    stop,
                    passes.Sampling(spp, key, stage),
                    diffraction=diffraction,
                    max_blur_px=reach_px,
                    illuminant=illuminant,
                    field=fields[key],
                )
            )
        return np.stack(pictures)

    def exposure_time_s(rate: np.ndarray) -> float:
        return exposure.time_s or noise.auto_exposure_s(rate, camera, exposure)

    def sensor_noise(rate: np.ndarray) -> np.ndarray:
        time_s = exposure_time_s(rate)
        variance = noise.temporal_variance(camera.sensor, time_s, exposure.gain)
        return np.sqrt(variance.at(rate * time_s)) / time_s

    sampled: dict[str, Any] = {}
    if spp == "auto":

        def numbered(index: int, samples: tuple[int, ...]) -> np.ndarray:
            key = int(np.random.SeedSequence((seed, index)).generate_state(1)[0])
            samples = tuple(passes.sample_count(count) for count in samples)
            return stop_pictures(key, samples, f", picture {index + 1} of {max(samples)} samples")

        found = adaptive_sampling.quiet_picture(numbered, sensor_noise, stops=len(camera.stops), wanted=noise_share)
        lens_rate = found.rate
        sampled = {
            "spp": dict(zip((stop.name for stop in camera.stops), found.spp, strict=True)),
            "rendering_noise_share": dict(zip(names, found.share, strict=True)),
            "rendering_noise_share_wanted": noise_share,
        }
    else:
        samples = passes.sample_count(spp)
        lens_rate = stop_pictures(seed, (samples,) * len(camera.stops)).sum(axis=0)
        sampled = {"spp": samples}
    check_lit(scene, lens_rate, [world.objects[number - 1] for number in np.unique(geometry.object_id) if number])
    sampling = passes.Sampling(SHARP_SPP, seed, partial(progress, "rendering the pinhole picture"))
    twin = cameras.load_camera(TWIN)
    response = np.concatenate([radiometry.response(camera), radiometry.response(twin)])
    (field,) = fields.values()
    pinhole_rate = passes.pinhole_pass(mitsuba_scene, camera, sampling, field, response)
    pinhole_rate, twin_rate = np.split(pinhole_rate, [len(names)], axis=-1)

    if diffraction == "airy":
        sampled["airy_errors"] = airy_errors(camera, illuminant)
    time_s = exposure_time_s(lens_rate)
    mean_e = lens_rate * time_s
    collected_e = noise.electronic_crosstalk(noise.mosaic(mean_e, camera), camera.sensor)
    raw_dn, saturated = noise.expose(collected_e, camera.sensor, time_s, seed, gain=exposure.gain)
    capture = Capture(
        raw_dn=raw_dn,
        camera=camera,
        exposure_s=time_s,
        gain=exposure.gain,
        seed=seed,
        illuminant=illuminant,
        provenance={
            "scene": scene.model_dump(mode="json", exclude={"folder", "file"}),
            "renderer": choice.variant,
            "diffraction": diffraction,
            **sampled,
            "exposure": exposure.model_dump(mode="json"),
            "saturated_pixels": saturated,
            "notes": world.notes + notes(lens_rate, saturated) + sampling_notes(sampled),
        },
    )
    exact = Truth(
        depth_m=geometry.depth_m.astype(np.float32),
        valid=~np.isnan(geometry.depth_m),
        normal=geometry.normal.astype(np.float32),
        object_id=geometry.object_id,
        material_id=world.material_number[geometry.object_id],
        blur_px=blur_px.astype(np.float32),
        level=(blur_px / camera_geometry.level_blur_px(camera)[1]).astype(np.float32),
        boundary=truth.boundary(blur_px),
        channels=names,
        mean_e=mean_e.astype(np.float32),
        sharp_e=(pinhole_rate * time_s).astype(np.float32),
        sharp_srgb=srgb(twin_rate, twin, illuminant),
        objects=tuple(world.objects),
        materials=tuple(world.materials),
    )
    return Shot(capture, exact)


def check_options(
    spp: int | str | None, seed: int, diffraction: str | None, noise_share: float = adaptive_sampling.NOISE_SHARE
) -> None:
    """InputError for samples, seed, diffraction model or share of noise that no variant takes."""
    if isinstance(spp, str) and spp != "auto":
        raise InputError(f"spp is '{spp}'; a whole number or 'auto' is needed")
    if isinstance(spp, int) and not 1 <= spp <= MOST_SPP:
        raise InputError(f"spp is {spp}; 1 to {MOST_SPP} samples a pixel are allowed")
    if not 0.01 <= noise_share <= 10:
        raise InputError(f"noise_share is {noise_share:g}; 0.01 to 10 of the sensor's own noise is allowed")
    if seed < 0:
        raise InputError(f"seed is {seed}; 0 or a positive whole number is needed")
    if diffraction is not None and diffraction not in DIFFRACTION_MODELS:
        raise InputError(f"diffraction '{diffraction}' is unknown; allowed are {', '.join(DIFFRACTION_MODELS)}")


def check_in_view(scene: Scene | MitsubaScene, depth_m: np.ndarray) -> None:
    """InputError where no pixel's ray meets anything."""
    if np.isnan(depth_m).all():
        units = f"; unit_cm is {scene.unit_cm:g}" if isinstance(scene, MitsubaScene) else ""
        raise InputError(
            f"scene '{scene.name}': the camera looks at nothing; turn its view towards an object, or move one into it"
            + units
        )


def check_lit(scene: Scene | MitsubaScene, rate: np.ndarray, seen: list[str]) -> None:
    """InputError where no light at all reaches the sensor."""
    if rate.max() <= 0:
        names = ", ".join(f"'{name}'" for name in seen[:3]) + (" and others" if len(seen) > 3 else "")
        raise InputError(
            f"scene '{scene.name}': no light reaches the sensor, which looks at {names or 'a lamp from behind'}; is "
            "a light hidden or turned away, the camera inside an object, or a light so small as to need more samples?"
        )


def check_camera(camera: Camera, variant: str) -> None:
    """InputError where the variant cannot render through the camera's stops and lens."""
    if variant.startswith("scalar"):
        stock.check(camera)


def srgb(rate: np.ndarray, twin: Camera, illuminant: str) -> np.ndarray:
    """Picture 0..1 of electrons [h, w, 3] of a camera without near-infrared, its white balanced for the illuminant."""
    matrix = colour.fitted_matrix(radiometry.response(twin), illuminants.illuminant(illuminant))
    linear = rate.astype(np.float32)
    return colour.to_srgb(linear, matrix, colour.exposure_scale(linear, matrix))


def notes(rate_e_s: np.ndarray, saturated: int) -> list[str]:
    """What a user should know of a capture that is legal but odd."""
    found = []
    if saturated > 0.05 * rate_e_s[..., 0].size:
        found.append(f"{saturated / rate_e_s[..., 0].size:.0%} of the pixels are saturated")
    return found


def airy_errors(camera: Camera, illuminant: str) -> dict[str, Any]:
    """Largest errors of ``airy`` for ``meta.json``: encircled energy and MTF, each {channel: [level]}."""
    names = cameras.channels(camera.sensor)
    tables = zip(("encircled_energy", "mtf"), pointspread.airy_errors(camera, illuminant), strict=True)
    return {what: {n: errors[:, i].round(3).tolist() for i, n in enumerate(names)} for what, errors in tables}


def sampling_notes(sampled: dict[str, Any]) -> list[str]:
    """What to say of an approximation, and where the wanted rendering noise was not reached."""
    found = []
    if "airy_errors" in sampled:
        worst = {name: max(row) for name, row in sampled["airy_errors"]["encircled_energy"].items()}
        listed = ", ".join(f"{name} {value:.2f}" for name, value in worst.items())
        found.append(
            f"diffraction 'airy' is approximate: encircled energy is off by up to {listed} (by level in meta.json); "
            "a JIT variant renders 'wave'"
        )
    shares = sampled.get("rendering_noise_share", {})
    missed = {name: share for name, share in shares.items() if share > sampled["rendering_noise_share_wanted"]}
    if missed:
        listed = ", ".join(f"{name} {share:.2f}" for name, share in missed.items())
        found.append(
            f"{max(sampled['spp'].values())} samples were not enough: rendering noise over the sensor's own is {listed}"
        )
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
