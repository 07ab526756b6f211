"""Rendering passes: one per stop, each with a plain pupil and the wavelengths that its stop passes.

The camera is linear, so that its picture is the sum of its stops' pictures. In the JIT variants a pass is a ray loop of
our own, for every shape of stop (:mod:`dasim.render.ray_loop`); ``scalar_spectral`` has the stock plugins
(:mod:`dasim.render.stock`). Both return mean electrons per second for every channel,
E = pi L (r/s)^2 cos^4 summed over the spectrum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dasim.camera import distortion, glare, radiometry, wavefront
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop, ring
from dasim.render import control_variate, focus_pictures, irradiance, pinhole, ray_loop, stock, transport
from dasim.render.control_variate import Control, Fine
from dasim.render.irradiance import Field
from dasim.render.ray_loop import Ratios, Sampling
from dasim.render.ray_pass import light_of, px_per_m
from dasim.render.wavelengths import (
    BANDS,
    at_bands,
    frame_density,
    pinhole_responses,
    separate_responses,
    stop_responses,
)
from dasim.typing import FloatArray

MOST_MARGIN_PX = 300.0
FOCUS_RAYS = focus_pictures.NODES  # samples per pixel of :func:`in_focus_pass` are multiples of this
# Of the pinhole's picture: beyond the largest blur's half; at least, for what diffraction brings from beside the frame
# in focus; at most.
SHARP_MARGIN_PX, LEAST_SHARP_MARGIN_PX, MOST_SHARP_MARGIN_PX = 12.0, 20.0, 60.0


def stop_pass(
    mitsuba_scene: Any,
    camera: Camera,
    stop: Stop,
    sampling: Sampling,
    *,
    diffraction: str = "off",
    max_blur_px: float = 0.0,
    illuminant: str = "D65",
    field: Field | None = None,
    in_focus: bool = False,
    control: Control | None = None,
) -> FloatArray:
    """Mean electrons per second through one stop, [h, w, channel].

    Args:
        mitsuba_scene: a Mitsuba scene.
        camera: the camera.
        stop: one of its stops.
        sampling: samples per pixel and seed.
        diffraction: ``wave``, ``airy`` or ``off``.
        max_blur_px: largest visible blur in the scene, for the wave tables; passes of equal value share them.
        illuminant: weights the in-focus kernel of ``airy``.
        field: the irradiance where it is known, see :func:`irradiance_field`.
        in_focus: whether every depth is in focus: the geometry of a pinhole in the middle of the lens, with the
            diffraction, the aberrations and the glare of the stop in focus.
        control: the control variate, see :func:`control_of`.
    """
    picture = stop_ratios(
        mitsuba_scene,
        camera,
        stop,
        sampling,
        diffraction=diffraction,
        max_blur_px=max_blur_px,
        illuminant=illuminant,
        field=field,
        in_focus=in_focus,
        control=control,
    )
    rate = picture.value
    rate -= picture.variate
    return with_glare(np.maximum(rate, 0.0, out=rate), camera, stop)


def with_glare(rate: FloatArray, camera: Camera, stop: Stop) -> FloatArray:
    """A picture through a stop with the glare of the stop."""
    return glare.spread(rate, stop.glare_share, glare.radius_px(camera, stop))


def stop_ratios(
    mitsuba_scene: Any,
    camera: Camera,
    stop: Stop,
    sampling: Sampling,
    *,
    diffraction: str,
    max_blur_px: float,
    illuminant: str,
    field: Field | None,
    in_focus: bool = False,
    control: Control | None = None,
) -> Ratios:
    """The picture of :func:`stop_pass` before glare, and its control variate, mean electrons per second."""
    import mitsuba as mi

    responses = stop_responses(camera, stop)
    falloff = radiometry.relative_illumination(camera)[..., None]
    if mi.variant().startswith("scalar"):
        assert isinstance(sampling.spp, int)
        stock.check(camera)
        if in_focus:
            rate = stock.pinhole_pass(mitsuba_scene, camera, responses, sampling)
        else:
            rate = stock.stop_pass(mitsuba_scene, camera, stop, responses, sampling)
        if diffraction == "airy":
            rate = stock.in_focus_diffraction(rate, camera, stop, illuminant)
        even = np.ones_like(rate, dtype=np.float32)
        return Ratios(rate * falloff, np.zeros_like(rate), even, even)
    waves = max_blur_px if diffraction == "wave" else None
    picture = ray_loop.render(
        mitsuba_scene, camera, stop, sampling, waves, field, responses, in_focus=in_focus, control=control
    )
    value, variate = picture.value, picture.variate
    value *= falloff
    if control is not None:
        variate *= falloff
    return picture


def convolved_stops(
    camera: Camera, fine: dict[str, Fine] | None, *, max_blur_px: float, field: Field | None
) -> list[int]:
    """Numbers of the stops whose pictures with every depth in focus :func:`in_focus_pass` makes."""
    return focus_pictures.convolvable(camera, field, fine, max_blur_px)


def in_focus_pass(
    mitsuba_scene: Any,
    camera: Camera,
    stops: Sequence[int],
    sampling: Sampling,
    fine: dict[str, Fine],
    also: Camera,
    *,
    max_blur_px: float,
    field: Field | None,
) -> focus_pictures.Pictures:
    """The pictures of some stops with every depth in focus, before glare, and that of :func:`pinhole_pass`, of the same
    rays; ``stops`` are numbers of :func:`convolved_stops`.
    """
    pictures = focus_pictures.pictures(mitsuba_scene, camera, stops, sampling, field, fine, also, max_blur_px)
    falloff = radiometry.relative_illumination(camera)[..., None]
    for picture in (pictures.sharp, *pictures.of_stops):
        picture *= falloff
    return pictures


def control_of(
    mitsuba_scene: Any,
    camera: Camera,
    stop: Stop,
    fine: dict[str, Fine] | None,
    *,
    max_blur_px: float,
    field: Field | None,
) -> Control | None:
    """The control variate of a stop from a pinhole's picture; None where there is none for its shape."""
    if fine is None:
        return None
    responses, own = stop_responses(camera, stop), fine[stop.name]
    return ray_loop.control_of(mitsuba_scene, camera, stop, max_blur_px, field, responses, own)


def sample_count(spp: int) -> int:
    """Samples per pixel that a pass actually takes: the sampler of ``scalar_spectral`` rounds up to a grid."""
    import mitsuba as mi

    if not mi.variant().startswith("scalar"):
        return spp
    return int(mi.load_dict({"type": "multijitter", "sample_count": spp}).sample_count())


def irradiance_field(
    mitsuba_scene: Any, camera: Camera, spectrum: FloatArray, max_blur_px: float, spp: float, seed: int
) -> Field | None:
    """The irradiance that all passes of a picture share; None in ``scalar_spectral``.

    ``spectrum`` is that of all lights together; blurred rays reach ``max_blur_px`` / 2 beyond the frame.
    """
    import mitsuba as mi

    if mi.variant().startswith("scalar"):
        return None
    return irradiance.field(
        mitsuba_scene,
        transport.path_integrator(),
        size_px=(camera.sensor.width_px, camera.sensor.height_px),
        axis_px=principal_point(camera.sensor),
        px_per_m=px_per_m(camera),
        margin_px=min(max_blur_px, MOST_MARGIN_PX) / 2 + irradiance.STRIDE_PX + distortion.most_outwards_px(camera),
        spectrum=spectrum,
        spp=spp,
        seed=seed,
    )


def pinhole_pass(
    mitsuba_scene: Any,
    camera: Camera,
    sampling: Sampling,
    field: Field | None = None,
    also: Camera | None = None,
) -> FloatArray:
    """Mean electrons per second with every stop shrunk to a point at unchanged light, [h, w, channel].

    All stops see the same rays through a point, so that one pass serves them all. The channels of ``also``, another
    camera behind the same lens, follow those of the camera.
    """
    import mitsuba as mi

    responses = pinhole_responses(camera, also)
    if mi.variant().startswith("scalar"):
        rate = stock.pinhole_pass(mitsuba_scene, camera, responses, sampling)
    else:
        rate = ray_loop.render(mitsuba_scene, camera, None, sampling, None, field, responses).value
    rate *= radiometry.relative_illumination(camera)[..., None]
    return rate


@dataclass(frozen=True)
class Sharp:
    """Pictures through a pinhole."""

    rate: FloatArray  # [h, w, channel] of the camera and of another one, mean electrons per second
    fine: dict[str, Fine] | None  # by the stops' names; None where no stop has a control variate


def sharp_pass(
    mitsuba_scene: Any,
    camera: Camera,
    sampling: Sampling,
    field: Field | None,
    also: Camera,
    *,
    diffraction: str,
    max_blur_px: float,
) -> Sharp:
    """The pictures of :func:`pinhole_pass`, and those of each stop on a finer grid with a margin, of the same rays."""
    radial = any(ring(stop) is not None for stop in camera.stops) and wavefront.is_perfect(camera)
    if diffraction != "wave" or not radial:
        return Sharp(pinhole_pass(mitsuba_scene, camera, sampling, field, also), None)
    cells = control_variate.cells_of(camera)
    margin = int(np.ceil(np.clip(max_blur_px / 2 + SHARP_MARGIN_PX, LEAST_SHARP_MARGIN_PX, MOST_SHARP_MARGIN_PX)))
    wider = control_variate.wider(camera, margin)
    light = light_of(field)
    densities = [frame_density(stop_responses(camera, stop), light) for stop in camera.stops]
    responses, parts = separate_responses(wider, also, light, densities), [BANDS] * len(camera.stops)
    pictures = pinhole.pictures(mitsuba_scene, wider, sampling, cells, field, responses, parts)
    rate = pictures.rate[margin:-margin, margin:-margin] * radiometry.relative_illumination(camera)[..., None]
    for part in pictures.nodes:
        at_bands(part)
    fine = {stop.name: Fine(cells, part, margin) for stop, part in zip(camera.stops, pictures.nodes, strict=True)}
    return Sharp(rate, fine)
