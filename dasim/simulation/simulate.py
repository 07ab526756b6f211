"""From a scene and a camera to a capture and its exact ground truth.

Three stages, each a function of values: prepare (the scene in the renderer, and its geometry), render (mean electrons
per second through the lens and through a pinhole), expose (raw numbers, capture and truth:
:mod:`dasim.simulation.exposure`).
"""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dasim.base.errors import InputError
from dasim.camera import depth_blur, pointspread
from dasim.camera import geometry as camera_geometry
from dasim.camera import noise as sensor_noise
from dasim.camera import sensor as sensors
from dasim.camera.noise import Exposure, NoiseModel
from dasim.camera.specification import Camera, as_camera
from dasim.loading import as_scene
from dasim.render import backend, frozen, light_spectra, translate, truth
from dasim.render.foreign.reading import render_error
from dasim.scene import specification as scenes
from dasim.scene.classes import class_numbers
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation import adaptive_sampling, checks, exact, rendering
from dasim.simulation.exact import ExactPictures
from dasim.simulation.exposure import SensorLight, Shot, photograph, to_precision
from dasim.simulation.rendering import LensPicture, Sampling, View
from dasim.typing import Progress
from dasim.values import Truth

RENDERED_LUX = 1000.0  # all lights together, while they are rendered
_RENDERING = threading.RLock()  # the renderer has one active variant and one memory, for all threads
DEFAULT_SPP = 64  # a power of two, for which Sobol' points are most even


def simulate(
    scene: Scene | MitsubaScene | str | Path,
    camera: Camera | str | Path,
    seed: int = 0,
    *,
    spp: int | Literal["auto"] = DEFAULT_SPP,
    noise_share: float = adaptive_sampling.NOISE_SHARE,
    noise_at: float = adaptive_sampling.NOISE_AT,
    independent_mean: bool = False,
    exposure: Exposure | None = None,
    diffraction: str | None = None,
    variant: str | None = None,
    noise: NoiseModel = sensor_noise.expose,
    progress: Progress = lambda stage, share: None,
) -> Shot:
    """Photograph a scene: render each stop, expose, add noise, and keep the ground truth.

    The same seed and variant give the same bytes. The focus is that of the camera, even if the camera is given by name;
    ``dasim.focused(camera, scene)`` sets the focus that the scene suggests. Threads of one process take turns; use
    processes to render in parallel.

    Args:
        scene: a Scene or MitsubaScene, or the name or path of one: ``dasim.simulate("desk", "da-mobile")``
        camera: a Camera, a bundled name or a path
        seed: seed of rendering and of temporal sensor noise, 0 or above; ``sensor.sensor_seed`` is that of the pattern
        spp: samples per pixel and stop, or ``auto``: as many as are needed to bring the rendering noise below
            ``noise_share``
        noise_share: limit of the rendering noise relative to the sensor noise, in every channel
        noise_at: percentile of the pixels to which ``noise_share`` applies, 1 to 99.9: the median by default; at 95,
            one pixel in twenty has more rendering noise
        independent_mean: whether ``truth.mean_e`` has samples of its own, so that its rendering noise is independent of
            that of ``raw_dn``; this costs a second picture
        exposure: exposure time and gain; automatic by default
        diffraction: ``wave`` (JIT variants only, their default), ``airy`` (default of ``scalar_spectral``) or ``off``
        variant: the Mitsuba variant; by default the fastest that works on this computer
        noise: the noise model, see :data:`dasim.camera.noise.NoiseModel`; the provenance holds its name
        progress: called with the name of a stage and the fraction of it that is done

    Returns a :class:`Shot`; its ``truth.mean_e`` is the light through the lens, before electronic crosstalk.
    """
    light = sensor_light(
        scene,
        camera,
        seed,
        spp=spp,
        noise_share=noise_share,
        noise_at=noise_at,
        independent_mean=independent_mean,
        exposure=exposure,
        diffraction=diffraction,
        variant=variant,
        progress=progress,
    )
    return photograph(light, exposure or Exposure(), seed, noise)


def sensor_light(
    scene: Scene | MitsubaScene | str | Path,
    camera: Camera | str | Path,
    seed: int = 0,
    *,
    spp: int | Literal["auto"] = DEFAULT_SPP,
    noise_share: float = adaptive_sampling.NOISE_SHARE,
    noise_at: float = adaptive_sampling.NOISE_AT,
    independent_mean: bool = False,
    exposure: Exposure | None = None,
    diffraction: str | None = None,
    variant: str | None = None,
    progress: Progress = lambda stage, share: None,
) -> SensorLight:
    """Render the light that reaches the sensor, for one exposure or many; see :func:`simulate`.

    ``exposure`` is that for which ``spp = "auto"`` takes samples.
    """
    camera = as_camera(camera)
    scene = as_scene(scene, camera)
    if spp is None:  # which stands for a default in the command line
        raise InputError("spp is None; it must be a whole number or 'auto'")
    checks.check_options(spp, seed, diffraction, noise_share, noise_at)
    checks.check_exposure(exposure)
    sampling = Sampling(spp, noise_share, noise_at, seed)
    with _RENDERING, frozen.sharing():
        light = _rendered(scene, camera, sampling, independent_mean, exposure, diffraction, variant, progress)
        backend.release_memory()  # of the scene and its pictures
        return light


def _rendered(
    scene: Scene | MitsubaScene,
    camera: Camera,
    sampling: Sampling,
    independent_mean: bool,
    exposure: Exposure | None,
    diffraction: str | None,
    variant: str | None,
    progress: Progress,
) -> SensorLight:
    """The light that reaches the sensor, of checked options."""
    try:
        view = prepare(scene, camera, diffraction, variant, progress)
        sharp = exact.sharp_pictures(view, sampling, progress)
        backend.release_memory()
        lens = mean = _rounded(
            rendering.lens_picture(view, sharp, sampling, exposure or Exposure(), progress, again=independent_mean)
        )
        if independent_mean:
            mean = _rounded(rendering.independent_picture(view, sharp, lens, sampling, progress))
        pictures = exact.exact_pictures(view, sharp, sampling.seed, progress)
    except RuntimeError as error:  # Mitsuba's
        if isinstance(scene, MitsubaScene):
            raise render_error(scene, error) from None
        raise
    of_second = describe_truth(view, mean, pictures)
    origin = describe_origin(view, lens, sampling.seed, independent_mean)
    return SensorLight(camera, lens.rate, lens.variance, of_second, view.illuminant, origin, view.world.notes)


def _rounded(picture: LensPicture) -> LensPicture:
    """The picture rounded to single precision, see :mod:`dasim.simulation.exposure`, once its sums are complete."""
    variance = None if picture.variance is None else to_precision(picture.variance)
    backend.release_memory()
    return replace(picture, rate=to_precision(picture.rate), variance=variance)


def prepare(
    scene: Scene | MitsubaScene, camera: Camera, diffraction: str | None, variant: str | None, progress: Progress
) -> View:
    """Activate the variant, load the scene into it, and trace the geometry at the pixel centres."""
    choice = backend.choose(variant)
    diffraction = checks.diffraction_model(diffraction, choice.variant)
    checks.check_camera(camera, choice.variant)
    backend.activate(choice)
    progress("geometry", 0.0)
    lit = scenes.at_light_level(scene, RENDERED_LUX) if isinstance(scene, Scene) else scene
    world = translate.world(lit, camera)
    geometry = truth.geometry(world.scene, camera)
    checks.check_in_view(scene, geometry.depth_m)
    blur_px = depth_blur.signed_blur_px(geometry.depth_m, camera)
    largest_px = truth.largest_blur_px(world.scene, camera) if diffraction == "wave" else 0.0
    progress("geometry", 1.0)
    return View(
        scene,
        camera,
        choice.variant,
        diffraction,
        world,
        geometry,
        blur_px,
        largest_px,
        illuminant=scenes.main_illuminant(scene),
        spectrum=light_spectra.total(lit, world.scene),
        light_level=scenes.light_level(scene) / scenes.light_level(lit),
    )


def describe_origin(view: View, lens: LensPicture, seed: int, independent_mean: bool) -> dict[str, Any]:
    """The provenance that ``meta.json`` holds, except for what the exposure decides."""
    sampling = dict(lens.sampling)
    if view.diffraction == "airy":
        sampling["airy_errors"] = airy_errors(view.camera, view.illuminant)
    return {
        "scene": view.scene.model_dump(mode="json", exclude={"folder", "file"}),
        "renderer": view.variant,
        "diffraction": view.diffraction,
        "rendering_seed": seed,
        **sampling,
        "independent_mean": independent_mean,
        **({"world_to_camera": scenes.world_to_camera(view.scene).tolist()} if isinstance(view.scene, Scene) else {}),
        "objects": [
            {"object_id": number, "name": name, "class": kind}
            for number, (name, kind) in enumerate(zip(view.world.objects, view.world.classes, strict=True), 1)
        ],
    }


def describe_truth(view: View, mean: LensPicture, pictures: ExactPictures) -> Truth:
    """The ground truth of a frame of one second; the pictures are mean electrons per second, rounded."""
    geometry, world = view.geometry, view.world
    return Truth(
        depth_m=geometry.depth_m.astype(np.float32),
        valid=~np.isnan(geometry.depth_m),
        normal=geometry.normal,
        object_id=geometry.object_id,
        material_id=world.material_number[geometry.object_id],
        blur_px=view.blur_px.astype(np.float32),
        level=(view.blur_px / camera_geometry.level_blur_px(view.camera)[1]).astype(np.float32),
        boundary=depth_blur.boundary(view.blur_px),
        channels=sensors.channels(view.camera.sensor),
        mean_e=mean.rate,
        sharp_e=to_precision(pictures.sharp),
        sharp_srgb=pictures.srgb,
        class_id=class_numbers(world.classes)[geometry.object_id],
        objects=tuple(world.objects),
        materials=tuple(world.materials),
        mean_e_variance=mean.variance,
        focus_e=to_precision(pictures.focus),
    )


def airy_errors(camera: Camera, illuminant: str) -> dict[str, Any]:
    """Largest errors of ``airy`` for ``meta.json``: encircled energy and MTF, each {channel: [level]}."""
    names = sensors.channels(camera.sensor)
    tables = zip(("encircled_energy", "mtf"), pointspread.airy_errors(camera, illuminant), strict=True)
    return {what: {n: errors[:, i].round(3).tolist() for i, n in enumerate(names)} for what, errors in tables}
