"""The picture of a view through the lens, stop by stop, in mean electrons per second.

:mod:`dasim.simulation.exact` has those through a pinhole and in focus.

Tested in tests/dasim/simulation/test_simulate.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dasim.camera import depth_blur, noise
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.render import backend, passes
from dasim.render.control_variate import Control
from dasim.render.foreign.scene import World
from dasim.render.ray_loop import Ratios
from dasim.render.truth import Geometry
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation import rendering_noise
from dasim.simulation.adaptive_sampling import FEWEST_OF_LAYERS, FEWEST_SPP, render_to_noise_target
from dasim.simulation.checks import check_finite, check_lit
from dasim.simulation.rendering_noise import Picture
from dasim.typing import Float32Array, FloatArray, Progress

FIELD_SPP = 16  # samples per pixel assumed for the first irradiance field if ``spp`` is "auto"
LENS, OWN_MEAN, IN_FOCUS, SHARP = range(4)  # uses of a capture's seed
BLUR_MARGIN = 1.1  # objects nearer than all visible ones may lie just outside the frame


@dataclass(frozen=True)
class View:
    """A scene in front of a camera, ready to be rendered.

    It is rendered at a fixed light level, and the pictures are then scaled to the level of the scene, so that rounding
    in the renderer's single precision does not depend on it. A Mitsuba scene, whose lights have no level, is rendered
    as it is.
    """

    scene: Scene | MitsubaScene
    camera: Camera
    variant: str
    diffraction: str
    world: World
    geometry: Geometry
    blur_px: FloatArray  # [h, w] signed diameter of visible blur
    largest_px: float  # diameter of visible blur between the pixel centres, and of what blurs into the frame
    illuminant: str  # of the main light
    spectrum: FloatArray  # of all lights together
    light_level: float  # of the scene over that of ``world``

    @property
    def reach_px(self) -> float:
        """Largest diameter of visible blur that tables and margins must cover.

        It is that at the pixel centres with a margin, unless objects between them or beside the frame have more.
        """
        seen_px = float(np.abs(self.blur_px).max())
        return max(seen_px, self.largest_px if self.largest_px > seen_px * BLUR_MARGIN else 0.0) * BLUR_MARGIN

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

    rate: NDArray[Any]  # [h, w, channel] mean electrons per second, in double precision until they are rounded
    variance: NDArray[Any] | None  # of ``rate`` by rendering noise; None for one sample per pixel
    spp: NDArray[np.int64]  # [stop, h, w] or [stop, 1, 1] samples per pixel of each stop
    sampling: dict[str, Any]  # for provenance: samples per pixel, and the target of rendering noise


@dataclass(frozen=True)
class SharpPictures:
    """The pictures through a pinhole that admits as much light as the lens, mean electrons per second."""

    rate: Float32Array  # [h, w, channel] of the camera, at the light level of ``View.world``
    twin: Float32Array  # [h, w, 3] of the camera :data:`exact.TWIN`, likewise
    field: Any  # irradiance, which half of the lens picture shares
    # of each stop, see :mod:`dasim.render.control_variate`; None also after the last use: they are large
    controls: list[Control | None]
    # [h, w, channel] with every depth in focus and with glare, the sum over all stops but the ``others``; None for none
    in_focus: Float32Array | None
    others: list[int]  # numbers of the stops whose picture in focus takes rays of its own
    # [h, w] further samples through the pinhole; None where rays through the ``others`` decide, or there are no halves
    more_spp: NDArray[np.uint16] | None


def lens_picture(
    view: View,
    sharp: SharpPictures,
    sampling: Sampling,
    exposure: Exposure,
    progress: Progress,
    *,
    again: bool = True,
) -> LensPicture:
    """Render through every stop; raises InputError if no light reaches the sensor.

    Unless the control variates of ``sharp`` are needed ``again``, they are released.
    """
    if sampling.spp == "auto":
        picture = _adaptive_picture(view, sharp, sampling, exposure, progress)
    else:
        fields = sharp.field, irradiance(view, sampling, 1)
        spp = np.full((len(view.camera.stops), 1, 1), sampling.spp)
        halves = _halves(view, sharp, fields, spp, sampling.seed, LENS, progress, again=again)
        rate, variance = _at_level(view, *halves)
        picture = LensPicture(rate, variance, spp, {"spp": sampling.spp})
    if not again:
        sharp.controls[:] = [None] * len(sharp.controls)
    check_lit(view.scene, picture.rate, view.objects_at(np.ones(picture.rate.shape[:2], bool)))
    return picture


def independent_picture(
    view: View, sharp: SharpPictures, like: LensPicture, sampling: Sampling, progress: Progress
) -> LensPicture:
    """A picture of as many samples and the same seed as another, with independent rendering noise.

    Its random numbers and its irradiance are its own.
    """
    fields = irradiance(view, sampling, 0, OWN_MEAN), irradiance(view, sampling, 1, OWN_MEAN)
    halves = _halves(view, sharp, fields, like.spp, sampling.seed, OWN_MEAN, progress)
    rate, variance = _at_level(view, *halves)
    return replace(like, rate=rate, variance=variance)


def _at_level(
    view: View, rate: FloatArray, variance: NDArray[np.floating] | None
) -> tuple[FloatArray, NDArray[np.floating] | None]:
    """A picture and its variance at the scene's light level, in place: arrays of large frames are gigabytes.

    Raises InputError for light so strong that sums of it are infinite, as of a lamp beside the frame.
    """
    check_finite(view.scene, rate, view.objects_at)
    rate *= view.light_level
    if variance is not None:
        variance *= view.light_level**2
    return rate, variance


def irradiance(view: View, sampling: Sampling, index: int, stream: int = SHARP, finer: int = 1) -> Any:
    """One of the two irradiance fields of the lens picture, one for each of its halves; ``finer`` multiplies the
    directions.
    """
    spp = finer * FIELD_SPP if sampling.spp == "auto" else max(1, sampling.spp // 2)
    seed = picture_seed(sampling.seed, index, stream)
    field = passes.irradiance_field(view.world.scene, view.camera, view.spectrum, view.reach_px, spp, seed)
    backend.release_memory()
    return field


def _halves(
    view: View,
    sharp: SharpPictures,
    fields: tuple[Any, Any],
    spp: NDArray[np.int64],
    seed: int,
    stream: int,
    progress: Progress,
    *,
    again: bool = False,
) -> tuple[FloatArray, FloatArray | None]:
    """Mean of two independent pictures that share ``spp`` samples, and its variance.

    One sample per pixel cannot be halved: its variance is None. Stop by stop, each of whose control variates is
    released unless it is needed ``again``: large frames take gigabytes.
    """
    parts = [spp - spp // 2, spp // 2] if spp.min() > 1 else [spp]

    def mean_of(number: int) -> tuple[FloatArray, NDArray[Any]]:
        pictures = []
        for index, (part, field) in enumerate(zip(parts, fields, strict=False)):
            label, own = f", part {index + 1} of {len(parts)}", picture_seed(seed, index, stream)
            ratios = stop_picture(view, sharp, number, field, part[number], own, progress, label)
            arrays: list[Any] = [each[None] for each in ratios]
            pictures.append(Picture(part[[number]], *arrays))
        if not again:
            sharp.controls[number] = None
        if len(pictures) == 1:
            return pictures[0].rate[0] - pictures[0].variate[0], np.zeros(1)
        rate, left = rendering_noise.mean_and_left(*pictures)
        return rate[0], left[0]

    rate, left = glared(view.camera, mean_of)
    return rate, rendering_noise.mean_square(left) if len(parts) > 1 else None


def glared(
    camera: Camera, picture: Callable[[int], tuple[FloatArray, NDArray[Any]]], stops: Sequence[int] | None = None
) -> tuple[FloatArray, NDArray[Any]]:
    """Sums over the ``stops``, by default all, of their pictures with glare, and of the differences whose squares are
    the variance; ``picture`` returns both for the index of a stop.

    Glare spreads a fraction of the light widely, so that its noise is that of a mean over many pixels. The stops share
    the irradiance field, so their differences are added before they are squared.
    """
    together: NDArray[Any] = np.zeros(())
    differences: NDArray[Any] = np.zeros((), np.float32)
    for number in range(len(camera.stops)) if stops is None else stops:
        stop, (rate, left) = camera.stops[number], picture(number)
        # With few samples, the noise may exceed the light, and subtracting the control variate gives negative values.
        together = together + passes.with_glare(np.maximum(rate, 0.0), camera, stop)
        differences = differences + np.float32(1 - stop.glare_share) * left
        del rate, left  # before the next stop's picture is made
    return together, differences


def picture_seed(seed: int, index: int, stream: int = LENS) -> int:
    """Seed of a picture of a capture: the ``index``-th of the lens, or of another use of the seed."""
    return int(np.random.SeedSequence((seed, index, stream)).generate_state(1)[0])


def stop_picture(
    view: View,
    sharp: SharpPictures,
    number: int,
    field: Any,
    spp: NDArray[np.int64],
    seed: int,
    progress: Progress,
    label: str = "",
    *,
    in_focus: bool = False,
    layers_from: int = 1,
) -> Ratios:
    """The picture through a stop, by its number, of ``spp`` samples, [h, w] or [1, 1], before glare.

    The layers of pixels with fewer samples than ``layers_from`` are not separated.
    With ``in_focus``, all depths are in focus; the control variates of ``sharp`` must then be for this case.
    """
    stop, is_even = view.camera.stops[number], spp.size == 1 or view.variant.startswith("scalar")
    report = partial(progress, f"rendering through stop '{stop.name}'{label}")
    picture = passes.stop_ratios(
        view.world.scene,
        view.camera,
        stop,
        passes.Sampling(int(spp[0, 0]) if is_even else spp, seed, report, layers_from),
        diffraction=view.diffraction,
        max_blur_px=view.reach_px,
        illuminant=view.illuminant,
        field=field,
        in_focus=in_focus,
        control=sharp.controls[number],
    )
    check_finite(view.scene, picture.value, view.objects_at)
    backend.release_memory()
    return picture


def _adaptive_picture(
    view: View,
    sharp: SharpPictures,
    sampling: Sampling,
    exposure: Exposure,
    progress: Progress,
) -> LensPicture:
    """The lens picture with rendering noise below a share of the sensor's temporal noise by its data sheet."""
    camera = view.camera

    fields = {1: (sharp.field, irradiance(view, sampling, 1))}  # of every second picture, by how fine they are

    def picture(number: int, index: int, spp: NDArray[np.int64], finer: int) -> Picture:
        if finer not in fields:
            fields.clear()  # coarser ones are not used again
            fields[finer] = irradiance(view, sampling, 2, finer=finer), irradiance(view, sampling, 3, finer=finer)
        field, label, seed = fields[finer][index % 2], f", picture {index + 1}", picture_seed(sampling.seed, index)
        own = spp[number]
        if view.variant.startswith("scalar"):  # as many everywhere, and at least one
            own = np.full_like(own, max(np.ceil(own.mean()), 1))
        ratios = stop_picture(view, sharp, number, field, own, seed, progress, label, layers_from=FEWEST_OF_LAYERS)
        arrays: list[Any] = [each[None] for each in ratios]
        return Picture(own[None], *arrays)

    fewest = np.where(_sees_several_depths(view), FEWEST_OF_LAYERS, FEWEST_SPP)
    result = render_to_noise_target(
        picture,
        partial(_sensor_variance, view, exposure),
        np.repeat(fewest[None], len(camera.stops), axis=0),
        target=sampling.noise_share,
        percentile=sampling.noise_at,
        kept=[1 - stop.glare_share for stop in camera.stops],
    )
    sums, none = result.sums, np.zeros((), np.float32)
    total, _ = glared(camera, lambda number: (rendering_noise.rates(sums.of_stop(number))[0], none))
    rate, variance = _at_level(view, total, result.variance)
    mean_spp = sums.spp.mean(axis=(1, 2)).round(2)
    described = {
        "spp": dict(zip((stop.name for stop in camera.stops), mean_spp.tolist(), strict=True)),
        "rendering_noise_share_wanted": sampling.noise_share,
        "rendering_noise_at": sampling.noise_at,
    }
    return LensPicture(rate, variance, sums.spp, described)


def _sees_several_depths(view: View) -> NDArray[np.bool_]:
    """Mask [h, w] of the pixels that may get light from several depths, by the depths at the pixel centres; those that
    objects beside the frame may reach are among them.
    """
    mask = depth_blur.boundary(view.blur_px)
    border = int(np.ceil(view.reach_px / 2)) + 1  # as the discs of the boundary; a border of 0 would be all
    for side in (mask, mask.T):
        side[:border] = side[-border:] = True
    return mask


def sensor_variance(rate: NDArray[np.floating], camera: Camera, exposure: Exposure) -> NDArray[np.floating]:
    """Variance of the sensor's temporal noise by its data sheet, of [h, w, channel] mean electrons per second."""
    time_s = exposure_time_s(rate, camera, exposure)
    return noise.temporal_variance(camera.sensor, time_s, exposure.gain).at(rate * time_s) / time_s**2


def _sensor_variance(view: View, exposure: Exposure, rate: NDArray[np.floating]) -> Float32Array:
    """:func:`sensor_variance` of light at the level of ``View.world``, in its unit squared, channel by channel."""
    scale, camera = view.light_level, view.camera
    exposure = exposure.model_copy(update={"time_s": exposure_time_s(rate * np.float32(scale), camera, exposure)})
    result = np.empty(rate.shape, np.float32)
    for channel in range(rate.shape[-1]):
        at = np.s_[..., channel : channel + 1]
        result[at] = sensor_variance(rate[at] * scale, camera, exposure) / scale**2
    return result


def exposure_time_s(rate: NDArray[np.floating], camera: Camera, exposure: Exposure) -> float:
    """The given exposure time, or the automatic one for mean electrons per second [h, w, channel]."""
    return exposure.time_s or noise.auto_exposure_s(rate, camera, exposure)
