"""The pictures of a view in mean electrons per second: through the lens, stop by stop, and through a pinhole.

Tested in tests/dasim/simulation/test_simulate.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dasim.camera import noise, wavefront
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import passes
from dasim.render.foreign.scene import World
from dasim.render.truth import Geometry
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation import rendering_noise
from dasim.simulation.adaptive_sampling import StopPictures, render_to_noise_target
from dasim.simulation.checks import check_finite, check_lit
from dasim.typing import FloatArray, Progress

TWIN = "bayer-mobile"  # the camera whose colours ``sharp_srgb`` has
SHARP_SPP = 64  # of the pinhole picture, which has no lens to sample
FOCUS_SPP = 32  # of the picture in focus, per stop
LENS, OWN_MEAN, IN_FOCUS = range(3)  # uses of a capture's seed
BLUR_MARGIN = 1.1  # something nearer than all that is seen may lie just outside the frame


@dataclass(frozen=True)
class View:
    """A scene in front of a camera, ready to be rendered."""

    scene: Scene | MitsubaScene
    camera: Camera
    variant: str
    diffraction: str
    world: World
    geometry: Geometry
    blur_px: FloatArray  # [h, w] signed diameter of visible blur
    illuminant: str  # of the main light
    spectrum: FloatArray  # of all lights together

    @property
    def reach_px(self) -> float:
        """Largest diameter of visible blur that tables and margins must cover."""
        return float(np.abs(self.blur_px).max()) * BLUR_MARGIN

    def objects_at(self, pixels: NDArray[np.bool_]) -> list[str]:
        """Names of the objects that are visible at the centres of some of the ``pixels``, [h, w]."""
        numbers = np.unique(self.geometry.object_id[pixels])
        return [self.world.objects[number - 1] for number in numbers if number]


@dataclass(frozen=True)
class Sampling:
    """How the lens picture is sampled: samples per pixel and stop, or the share of the sensor's noise to reach."""

    spp: int | Literal["auto"]
    noise_share: float
    noise_at: float  # percentile of the pixels at which ``noise_share`` is meant
    seed: int


@dataclass(frozen=True)
class LensPicture:
    """The picture through all stops together."""

    rate: FloatArray  # [h, w, channel] mean electrons per second
    variance: FloatArray | None  # [h, w, channel] of ``rate`` by rendering noise; None for one sample per pixel
    spp: tuple[int, ...]  # samples per pixel of each stop
    field: Any  # irradiance, for further passes of the same view
    sampling: dict[str, Any]  # for provenance: samples per pixel, and the target of rendering noise


@dataclass(frozen=True)
class SharpPictures:
    """The pictures through a pinhole that admits as much light as the lens, mean electrons per second."""

    rate: FloatArray  # [h, w, channel] of the camera
    twin_rate: FloatArray  # [h, w, 3] of a Bayer camera without near-infrared
    twin: Camera


def lens_picture(view: View, sampling: Sampling, exposure: Exposure, progress: Progress) -> LensPicture:
    """Render through every stop; raises InputError if no light reaches the sensor."""
    if sampling.spp == "auto":
        picture = _adaptive_picture(view, sampling, exposure, progress)
    else:
        picture = _fixed_picture(view, sampling, progress)
    check_lit(view.scene, picture.rate, view.objects_at(np.ones(picture.rate.shape[:2], bool)))
    return picture


def independent_picture(view: View, like: LensPicture, seed: int, progress: Progress) -> LensPicture:
    """A picture of as many samples and the same seed as another, with independent rendering noise.

    Its random numbers and its irradiance are its own.
    """
    rate, variance, _, _ = _halves(view, like.spp, seed, OWN_MEAN, progress)
    return replace(like, rate=rate, variance=variance)


def _fixed_picture(view: View, sampling: Sampling, progress: Progress) -> LensPicture:
    """The lens picture with a given number of samples per pixel and stop."""
    assert sampling.spp != "auto"
    counts = (sampling.spp,) * len(view.camera.stops)
    rate, variance, spp, field = _halves(view, counts, sampling.seed, LENS, progress)
    return LensPicture(rate, variance, spp, field, {"spp": spp[0]})


def _halves(
    view: View, spp: tuple[int, ...], seed: int, stream: int, progress: Progress
) -> tuple[FloatArray, FloatArray | None, tuple[int, ...], Any]:
    """Mean of two independent pictures that share ``spp[stop]`` samples, its variance, actual samples, irradiance.

    One sample per pixel cannot be halved: its variance is None.
    """
    parts = [tuple(n - n // 2 for n in spp), tuple(n // 2 for n in spp)] if min(spp) > 1 else [spp]
    counts = [tuple(passes.sample_count(n) for n in part) for part in parts]
    pictures = [
        stop_pictures(view, part, picture_seed(seed, index, stream), progress, f", part {index + 1} of {len(parts)}")
        for index, part in enumerate(counts)
    ]
    if len(pictures) == 1:
        return pictures[0].rate.sum(axis=0), None, counts[0], pictures[0].field
    pair = rendering_noise.Pair((counts[0], counts[1]), pictures[0].rate, pictures[1].rate)
    mean = rendering_noise.measured([pair])
    return mean.rate, mean.variance.sum(axis=0), mean.spp, pictures[1].field


def picture_seed(seed: int, index: int, stream: int = LENS) -> int:
    """Seed of a picture of a capture: the ``index``-th of the lens, or of another use of the seed."""
    return int(np.random.SeedSequence((seed, index, stream)).generate_state(1)[0])


def stop_pictures(view: View, spp: tuple[int, ...], seed: int, progress: Progress, label: str = "") -> StopPictures:
    """One picture through each stop with ``spp[stop]`` samples per pixel, and the irradiance that they share."""
    field = passes.irradiance_field(view.world.scene, view.camera, view.spectrum, view.reach_px, max(spp), seed)
    pictures = [
        _through(
            view,
            stop,
            passes.Sampling(count, seed, partial(progress, f"rendering through stop '{stop.name}'{label}")),
            field,
        )
        for stop, count in zip(view.camera.stops, spp, strict=True)
    ]
    for picture in pictures:
        check_finite(view.scene, picture, view.objects_at)
    return StopPictures(np.stack(pictures), field)


def _through(view: View, stop: Stop, sampling: passes.Sampling, field: Any, *, in_focus: bool = False) -> FloatArray:
    """Mean electrons per second of a view through one stop, [h, w, channel]; see :func:`passes.stop_pass`."""
    return passes.stop_pass(
        view.world.scene,
        view.camera,
        stop,
        sampling,
        diffraction=view.diffraction,
        max_blur_px=view.reach_px,
        illuminant=view.illuminant,
        field=field,
        in_focus=in_focus,
    )


def _adaptive_picture(view: View, sampling: Sampling, exposure: Exposure, progress: Progress) -> LensPicture:
    """The lens picture with rendering noise below a share of the sensor's temporal noise by its data sheet."""
    camera = view.camera

    def picture(index: int, spp: tuple[int, ...]) -> StopPictures:
        seed = picture_seed(sampling.seed, index)
        spp = tuple(passes.sample_count(count) for count in spp)
        return stop_pictures(view, spp, seed, progress, f", picture {index + 1} of {max(spp)} samples")

    result = render_to_noise_target(
        picture,
        lambda rate: sensor_variance(rate, camera, exposure),
        stops=len(camera.stops),
        target=sampling.noise_share,
        percentile=sampling.noise_at,
    )
    described = {
        "spp": dict(zip((stop.name for stop in camera.stops), result.spp, strict=True)),
        "rendering_noise_share_wanted": sampling.noise_share,
        "rendering_noise_at": sampling.noise_at,
    }
    return LensPicture(result.rate, result.variance, result.spp, result.field, described)


def sensor_variance(rate: FloatArray, camera: Camera, exposure: Exposure) -> FloatArray:
    """Variance of the sensor's temporal noise by its data sheet, of [h, w, channel] mean electrons per second."""
    time_s = exposure_time_s(rate, camera, exposure)
    return noise.temporal_variance(camera.sensor, time_s, exposure.gain).at(rate * time_s) / time_s**2


def focus_picture(view: View, sharp: FloatArray, field: Any, seed: int, progress: Progress) -> FloatArray:
    """What the open lens would show with every depth in focus, mean electrons per second [h, w, channel].

    Of a lens without diffraction, aberrations and glare that is the picture through a pinhole, ``sharp``.
    """
    perfect = wavefront.is_perfect(view.camera.lens)
    if view.diffraction == "off" and perfect and not any(stop.glare_share for stop in view.camera.stops):
        return sharp
    seed = picture_seed(seed, 0, IN_FOCUS)
    rate = np.zeros_like(sharp)
    for stop in view.camera.stops:
        sampling = passes.Sampling(FOCUS_SPP, seed, partial(progress, f"rendering in focus, stop '{stop.name}'"))
        rate += _through(view, stop, sampling, field, in_focus=True)
    check_finite(view.scene, rate, view.objects_at)
    return rate


def sharp_pictures(view: View, field: Any, seed: int, progress: Progress) -> SharpPictures:
    """Render through a pinhole, for the camera and its Bayer twin in one pass."""
    twin = cameras.load_camera(TWIN)
    sampling = passes.Sampling(SHARP_SPP, seed, partial(progress, "rendering the pinhole picture"))
    both = passes.pinhole_pass(view.world.scene, view.camera, sampling, field, also=twin)
    check_finite(view.scene, both, view.objects_at)
    rate, twin_rate = np.split(both, [len(cameras.channels(view.camera.sensor))], axis=-1)
    return SharpPictures(rate, twin_rate, twin)


def exposure_time_s(rate: FloatArray, camera: Camera, exposure: Exposure) -> float:
    """The given exposure time, or the automatic one for mean electrons per second [h, w, channel]."""
    return exposure.time_s or noise.auto_exposure_s(rate, camera, exposure)
