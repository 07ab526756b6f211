"""From a scene and a camera to a capture and its exact ground truth.

Four stages, each a function of values: prepare (the scene in the renderer, and its geometry), render (mean electrons
per second through the lens and through a pinhole), expose (raw numbers), describe (capture and truth).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dasim.base.loading import function_name
from dasim.camera import geometry as camera_geometry
from dasim.camera import noise as sensor_noise
from dasim.camera import pointspread, radiometry
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.noise import Exposure, NoiseModel
from dasim.camera.rings import at_pixels, rings
from dasim.camera.specification import Camera, as_camera
from dasim.loading import as_scene
from dasim.render import backend, light_spectra, translate, truth
from dasim.render.foreign.reading import render_error
from dasim.scene import specification as scenes
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation import adaptive_sampling, checks, rendering
from dasim.simulation.rendering import LensPicture, Sampling, SharpPictures, View
from dasim.spectra import colour, grid, illuminants
from dasim.typing import FloatArray, Progress
from dasim.values import Capture, Truth

DEFAULT_SPP = 64  # a power of two, for which Sobol' points are most even
NOTED_NOISE = 0.5  # rendering noise over the sensor's own, in one pixel of twenty, from which a note says so
NOTED_SATURATION = 0.05  # share of saturated pixels from which a note says so


@dataclass(frozen=True)
class Shot:
    """A simulated capture and its ground truth."""

    capture: Capture
    truth: Truth


@dataclass(frozen=True)
class Frame:
    """An exposed frame."""

    raw_dn: NDArray[np.uint16]  # [h, w]
    saturated: int  # pixels
    exposure: Exposure
    time_s: float
    noise: str  # name of the noise model


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

    The same seed and variant give the same bytes. The camera owns the focus, also where it is given by name;
    ``dasim.focused(camera, scene)`` sets the focus that a scene proposes.

    Args:
        scene: a Scene or MitsubaScene, or the name or path of one: ``dasim.simulate("desk", "da-mobile")``
        camera: a Camera, a bundled name or a path
        seed: of all random numbers, 0 or above
        spp: samples per pixel and stop, or ``auto``: as many as bring the rendering noise below ``noise_share``
        noise_share: rendering noise over the sensor's own noise, in every channel
        noise_at: percentile of the pixels at which ``noise_share`` is meant, 1 to 99.9: the median by default; at 95,
            one pixel in twenty has more rendering noise
        independent_mean: whether ``truth.mean_e`` has samples of its own, so that its rendering noise is independent of
            that of ``raw_dn``; costs a second picture
        exposure: exposure time and gain; automatic by default
        diffraction: ``wave`` (JIT variants only, their default), ``airy`` (default of ``scalar_spectral``) or ``off``
        variant: the Mitsuba variant; by default the fastest that works here
        noise: the noise model, see :data:`dasim.camera.noise.NoiseModel`; the provenance holds its name
        progress: called with the name of a stage and the share of it that is done

    Returns a :class:`Shot`; its ``truth.mean_e`` is the light through the lens, before electronic crosstalk.
    """
    camera = as_camera(camera)
    scene = as_scene(scene, camera)
    exposure = exposure or Exposure()
    checks.check_options(spp, seed, diffraction, noise_share, noise_at)
    sampling = Sampling(spp, noise_share, noise_at, seed)
    try:
        view, lens, mean, sharp, focus = _rendered(
            scene, camera, sampling, independent_mean, exposure, diffraction, variant, progress
        )
    except RuntimeError as error:  # Mitsuba's
        if isinstance(scene, MitsubaScene):
            raise render_error(scene, error) from None
        raise
    frame = expose(lens.rate, camera, exposure, seed, noise)
    capture = describe_capture(view, lens, frame, seed, independent_mean)
    return Shot(capture, describe_truth(view, mean, sharp, focus, frame.time_s))


def _rendered(
    scene: Scene | MitsubaScene,
    camera: Camera,
    sampling: Sampling,
    independent_mean: bool,
    exposure: Exposure,
    diffraction: str | None,
    variant: str | None,
    progress: Progress,
) -> tuple[View, LensPicture, LensPicture, SharpPictures, FloatArray]:
    """The view, its pictures through the lens for ``raw_dn`` and ``mean_e``, through a pinhole, and in focus."""
    view = prepare(scene, camera, diffraction, variant, progress)
    lens = rendering.lens_picture(view, sampling, exposure, progress)
    mean = rendering.independent_picture(view, lens, sampling.seed, progress) if independent_mean else lens
    sharp = rendering.sharp_pictures(view, lens.field, sampling.seed, progress)
    focus = rendering.focus_picture(view, sharp.rate, lens.field, sampling.seed, progress)
    return view, lens, mean, sharp, focus


def prepare(
    scene: Scene | MitsubaScene, camera: Camera, diffraction: str | None, variant: str | None, progress: Progress
) -> View:
    """Activate the variant, load the scene into it, and trace the geometry at the pixel centres."""
    choice = backend.choose(variant)
    diffraction = checks.diffraction_model(diffraction, choice.variant)
    checks.check_camera(camera, choice.variant)
    backend.activate(choice)
    progress("geometry", 0.0)
    world = translate.world(scene, camera)
    geometry = truth.geometry(world.scene, camera)
    checks.check_in_view(scene, geometry.depth_m)
    blur_px = truth.signed_blur_px(geometry.depth_m, camera)
    progress("geometry", 1.0)
    return View(
        scene,
        camera,
        choice.variant,
        diffraction,
        world,
        geometry,
        blur_px,
        illuminant=scenes.main_illuminant(scene),
        spectrum=light_spectra.total(scene, world.scene),
    )


def expose(rate: FloatArray, camera: Camera, exposure: Exposure, seed: int, noise: NoiseModel) -> Frame:
    """Expose [h, w, channel] mean electrons per second through the mosaic with a noise model."""
    time_s = rendering.exposure_time_s(rate, camera, exposure)
    collected_e = electronic_crosstalk(sensor_noise.mosaic(rate * time_s, camera), camera)
    raw_dn, saturated = sensor_noise.apply(noise, collected_e, camera.sensor, time_s, seed, exposure.gain)
    return Frame(raw_dn, saturated, exposure, time_s, function_name(noise))


def describe_capture(view: View, lens: LensPicture, frame: Frame, seed: int, independent_mean: bool) -> Capture:
    """The capture, with the provenance and notes that ``meta.json`` holds."""
    sampling = dict(lens.sampling)
    if view.diffraction == "airy":
        sampling["airy_errors"] = airy_errors(view.camera, view.illuminant)
    return Capture(
        raw_dn=frame.raw_dn,
        camera=view.camera,
        exposure_s=frame.time_s,
        gain=frame.exposure.gain,
        seed=seed,
        illuminant=view.illuminant,
        provenance={
            "scene": view.scene.model_dump(mode="json", exclude={"folder", "file"}),
            "renderer": view.variant,
            "diffraction": view.diffraction,
            "noise": frame.noise,
            **sampling,
            "independent_mean": independent_mean,
            "exposure": frame.exposure.model_dump(mode="json"),
            "saturated_pixels": frame.saturated,
            "notes": view.world.notes + saturation_notes(frame) + sampling_notes(sampling),
        },
    )


def describe_truth(view: View, mean: LensPicture, sharp: SharpPictures, focus: FloatArray, time_s: float) -> Truth:
    """The ground truth of a frame of an exposure time; the pictures are mean electrons per second."""
    geometry, world = view.geometry, view.world
    return Truth(
        depth_m=geometry.depth_m.astype(np.float32),
        valid=~np.isnan(geometry.depth_m),
        normal=geometry.normal.astype(np.float32),
        object_id=geometry.object_id,
        material_id=world.material_number[geometry.object_id],
        blur_px=view.blur_px.astype(np.float32),
        level=(view.blur_px / camera_geometry.level_blur_px(view.camera)[1]).astype(np.float32),
        boundary=truth.boundary(view.blur_px),
        channels=cameras.channels(view.camera.sensor),
        mean_e=(mean.rate * time_s).astype(np.float32),
        sharp_e=(sharp.rate * time_s).astype(np.float32),
        sharp_srgb=srgb(sharp.twin_rate, view.camera, sharp.twin, view.illuminant),
        objects=tuple(world.objects),
        materials=tuple(world.materials),
        mean_e_variance=None if mean.variance is None else (mean.variance * time_s**2).astype(np.float32),
        focus_e=(focus * time_s).astype(np.float32),
    )


def srgb(rate: FloatArray, camera: Camera, twin: Camera, illuminant: str) -> np.ndarray:
    """Picture in sRGB, 0..1, from electrons [h, w, 3] of a camera without near-infrared, white-balanced for the
    illuminant on each ring of the frame of ``camera``.
    """
    power, (angles, place) = illuminants.illuminant(illuminant), rings(camera, twin)
    matrix = colour.fitted_matrix(radiometry.response(twin), power)
    white = np.stack([grid.integrate(radiometry.response(twin, angle) * power) for angle in angles])
    linear = (rate * at_pixels(white[0] / white, place)).astype(np.float32)
    return colour.to_srgb(linear, matrix, colour.exposure_scale(linear, matrix))


def airy_errors(camera: Camera, illuminant: str) -> dict[str, Any]:
    """Largest errors of ``airy`` for ``meta.json``: encircled energy and MTF, each {channel: [level]}."""
    names = cameras.channels(camera.sensor)
    tables = zip(("encircled_energy", "mtf"), pointspread.airy_errors(camera, illuminant), strict=True)
    return {what: {n: errors[:, i].round(3).tolist() for i, n in enumerate(names)} for what, errors in tables}


def saturation_notes(frame: Frame) -> list[str]:
    """A note if many pixels are saturated."""
    share = frame.saturated / frame.raw_dn.size
    return [f"{share:.0%} of the pixels are saturated"] if share > NOTED_SATURATION else []


def sampling_notes(sampling: dict[str, Any]) -> list[str]:
    """Notes on an approximation, on much rendering noise, and where its target was not reached."""
    notes = []
    if "airy_errors" in sampling:
        worst = {name: max(row) for name, row in sampling["airy_errors"]["encircled_energy"].items()}
        listed = ", ".join(f"{name} {value:.2f}" for name, value in worst.items())
        notes.append(
            f"diffraction 'airy' is approximate: encircled energy is off by up to {listed} (by level in meta.json); "
            "a JIT variant renders 'wave'"
        )
    wanted = sampling.get("rendering_noise_share_wanted")
    if wanted is None:
        return notes + noise_notes(sampling)
    missed = {name: share for name, share in sampling["rendering_noise_share_reached"].items() if share > wanted}
    if missed:
        listed = ", ".join(f"{name} {share:.2f}" for name, share in missed.items())
        samples, at = max(sampling["spp"].values()), sampling["rendering_noise_at"]
        notes.append(
            f"{samples} samples were not enough: rendering noise over the sensor's own is {listed} at percentile "
            f"{at:g} of the pixels"
        )
    return notes


def noise_notes(sampling: dict[str, Any]) -> list[str]:
    """A note where a given number of samples leaves rendering noise above half of the sensor's in many pixels."""
    shares = sampling.get("rendering_noise_share", {})
    high = {name: share for name, share in shares.get("95", {}).items() if share > NOTED_NOISE}
    if not high:
        return []
    listed = ", ".join(f"{name} {share:.2f} (median {shares['50'][name]:.2f})" for name, share in high.items())
    return [
        f"rendering noise exceeds half of the sensor's own: {listed} of it at percentile 95 of the pixels with "
        f"{sampling['spp']} samples; take more, or spp 'auto' with noise_at 95"
    ]
