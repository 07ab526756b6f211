"""The exact pictures of a view: through a pinhole, and through the lens with every depth in focus.

Tested in tests/dasim/simulation/test_exact.py.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import radiometry, wavefront
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.rings import at_pixels, rings
from dasim.camera.specification import Camera
from dasim.render import passes
from dasim.simulation import rendering_noise
from dasim.simulation.adaptive_sampling import allotted_spp
from dasim.simulation.checks import check_finite
from dasim.simulation.rendering import (
    IN_FOCUS,
    SHARP,
    Sampling,
    SharpPictures,
    View,
    glared,
    irradiance,
    picture_seed,
    stop_picture,
)
from dasim.simulation.rendering_noise import Picture, Sums
from dasim.spectra import colour, grid, illuminants
from dasim.typing import Float32Array, FloatArray, Progress

TWIN = "bayer-mobile"  # the camera whose colours ``sharp_srgb`` has
SHARP_SPP = 32  # of the pinhole picture, which has no lens to sample
FOCUS_SPP = 4  # rays through a stop of each of the two pilot pictures in focus; twice as many in ``scalar_spectral``
MORE_SPP = 4.0  # additional samples of a picture, placed where its pilot is noisy; mean over the pixels


@dataclass(frozen=True)
class ExactPictures:
    """The truth of a capture's picture: without blur, and with that of the lens in focus."""

    sharp: NDArray[Any]  # [h, w, channel] through a pinhole, mean electrons per second
    srgb: Float32Array  # [h, w, 3] the same of a Bayer camera without near-infrared, see :func:`srgb`
    focus: NDArray[Any]  # [h, w, channel] what the open lens would show with every depth in focus


def exact_pictures(view: View, sharp: SharpPictures, seed: int, progress: Progress) -> ExactPictures:
    """The exact pictures.

    For a lens without diffraction, aberrations and glare, the in-focus picture is the pinhole picture. For discs and
    rings with wave optics and without aberrations, it is convolved from pinhole rays
    (:mod:`dasim.render.focus_pictures`). For other stops, it is rendered with its own rays, and with more of them where
    a pilot is noisy: on gloss, glass and fine texture. The pinhole picture also gets more rays where the halves of its
    rays differ.
    """
    perfect = wavefront.is_perfect(view.camera)
    if view.diffraction == "off" and perfect and not any(stop.glare_share for stop in view.camera.stops):
        rate = sharp.rate * np.float32(view.light_level)
        return ExactPictures(rate, _twin_srgb(view, sharp.twin), rate)
    pinhole = _Pinhole(sharp.rate, sharp.twin)
    focus = np.zeros_like(pinhole.rate) if sharp.in_focus is None else sharp.in_focus.copy()
    if sharp.others:
        own, pinhole = _traced(view, sharp, seed, progress)
        focus += _glared(view.camera, own)
    elif sharp.more_spp is not None:
        pinhole = _with_more(view, sharp, sharp.more_spp.astype(np.int64), seed, progress)
    focus *= np.float32(view.light_level)
    check_finite(view.scene, focus, view.objects_at)
    return ExactPictures(pinhole.rate * np.float32(view.light_level), _twin_srgb(view, pinhole.twin), focus)


def _glared(camera: Camera, of_stops: dict[int, NDArray[Any]]) -> FloatArray:
    """Sum of the pictures of some stops by their numbers, with glare; they are taken out of ``of_stops``."""
    return glared(camera, lambda number: (of_stops.pop(number), np.zeros((), np.float32)), list(of_stops))[0]


class _Pinhole(NamedTuple):
    """Pictures through a pinhole, mean electrons per second, at the light level of ``View.world``."""

    rate: Float32Array  # [h, w, channel] of the camera
    twin: Float32Array  # [h, w, 3] of ``TWIN``


def _traced(
    view: View, sharp: SharpPictures, seed: int, progress: Progress
) -> tuple[dict[int, NDArray[Any]], _Pinhole]:
    """The pictures in focus of the other stops of ``sharp`` by their numbers, before glare, by rays through each stop;
    and those through a pinhole.
    """
    stops = sharp.others
    in_focus = replace(sharp, controls=[None] * len(view.camera.stops))

    def picture(number: int, index: int, spp: NDArray[np.int64]) -> Picture:
        own, label = picture_seed(seed, index, IN_FOCUS), f", in focus, picture {index + 1}"
        ratios = stop_picture(view, in_focus, number, sharp.field, spp, own, progress, label, in_focus=True)
        arrays: list[Any] = [each[None] for each in ratios]
        return Picture(spp[None], *arrays)

    def pilot(number: int) -> Sums:
        first, second = picture(number, 0, few), picture(number, 1, few)
        sums = rendering_noise.no_pairs(first)
        rendering_noise.add(sums, first, second)
        return sums

    is_scalar = view.variant.startswith("scalar")
    few = np.full((1, 1), 2 * FOCUS_SPP) if is_scalar else np.full(view.blur_px.shape, FOCUS_SPP)
    parts = [pilot(number) for number in stops]
    pinhole = _Pinhole(sharp.rate, sharp.twin)
    if not is_scalar:
        more = allotted_spp(parts, MORE_SPP)
        for own, part, number in zip(more, parts, stops, strict=True):
            rendering_noise.add(part, picture(number, 2, own), picture(number, 3, own))
        pinhole = _with_more(view, sharp, more.max(axis=0), seed, progress)
    rates = (rendering_noise.measured(part).rate[0] for part in parts)
    return dict(zip(stops, rates, strict=True)), pinhole


def _with_more(view: View, sharp: SharpPictures, spp: NDArray[np.int64], seed: int, progress: Progress) -> _Pinhole:
    """The pictures through a pinhole with ``spp`` samples more, [h, w]."""
    twin, report = cameras.load_camera(TWIN), partial(progress, "rendering the pinhole picture, picture 2")
    sampling = passes.Sampling(spp, picture_seed(seed, 1, SHARP), report)
    more = passes.pinhole_pass(view.world.scene, view.camera, sampling, sharp.field, twin)
    check_finite(view.scene, more, view.objects_at)
    share, own = (spp / (SHARP_SPP + spp)).astype(np.float32)[..., None], sharp.rate.shape[-1]
    rate, of_twin = (
        np.asarray(known + share * (new - known), np.float32)
        for known, new in ((sharp.rate, more[..., :own]), (sharp.twin, more[..., own:]))
    )
    return _Pinhole(rate, of_twin)


def _pair(halves: NDArray[Any]) -> Sums:
    """Halves of the rays through a pinhole as a pair of pictures."""
    none, spp = np.broadcast_to(0.0, halves[:1].shape), np.full((1, *halves.shape[1:3]), SHARP_SPP // 2)
    first, second = (Picture(spp, half[None], none) for half in halves)
    sums = rendering_noise.no_pairs(first)
    rendering_noise.add(sums, first, second)
    return sums


def sharp_pictures(view: View, sampling: Sampling, progress: Progress) -> SharpPictures:
    """Render through a pinhole, for the camera and its Bayer twin in one pass, and prepare the control variates."""
    twin = cameras.load_camera(TWIN)
    scene, camera = view.world.scene, view.camera
    seed, report = picture_seed(sampling.seed, 0, SHARP), partial(progress, "rendering the pinhole picture")
    field = irradiance(view, sampling, 0)
    sharp = passes.sharp_pass(
        scene,
        camera,
        passes.Sampling(SHARP_SPP, seed, report),
        field,
        twin,
        diffraction=view.diffraction,
        max_blur_px=view.reach_px,
    )
    mean = sharp.rate.mean(axis=0)
    check_finite(view.scene, mean, view.objects_at)
    channels = len(sensors.channels(camera.sensor))
    rate, of_twin = (part.astype(np.float32) for part in np.split(mean, [channels], axis=-1))
    others = [number for number in range(len(camera.stops)) if number not in sharp.in_focus]
    in_focus = _glared(camera, sharp.in_focus).astype(np.float32) if sharp.in_focus else None
    more_spp = None
    if sharp.fine is not None and not others:
        more_spp = (2 * allotted_spp([_pair(sharp.rate[..., :channels])], MORE_SPP)[0]).astype(np.uint16)
    fine = sharp.fine
    del sharp, mean
    controls = []
    for stop in camera.stops:
        controls.append(passes.control_of(scene, camera, stop, fine, max_blur_px=view.reach_px, field=field))
        if fine is not None:
            del fine[stop.name]  # large, and the next control is as large
    return SharpPictures(rate, of_twin, field, controls, in_focus, others, more_spp)


def _twin_srgb(view: View, rate: NDArray[Any]) -> Float32Array:
    return srgb(rate, view.camera, cameras.load_camera(TWIN), view.illuminant)


def srgb(rate: NDArray[Any], camera: Camera, twin: Camera, illuminant: str) -> Float32Array:
    """Picture in sRGB, 0..1, from electrons [h, w, 3] of a camera without near-infrared, white-balanced for the
    illuminant on each ring of the frame of ``camera``.
    """
    power, (angles, place) = illuminants.illuminant(illuminant), rings(camera, twin)
    matrix = colour.fitted_matrix(radiometry.response(twin), power)
    white = np.stack([grid.integrate(radiometry.response(twin, angle) * power) for angle in angles])
    linear = (rate * at_pixels(white[0] / white, place)).astype(np.float32)
    return colour.to_srgb(linear, matrix, colour.exposure_scale(linear, matrix))
