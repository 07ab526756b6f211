"""Rendering passes: one per stop, each with a plain pupil and the wavelengths that its stop passes.

The camera is linear, so that its picture is the sum of its stops' pictures. In the JIT variants a pass is a ray loop of
our own, for every shape of stop (:mod:`dasim.render.ray_loop`); ``scalar_spectral`` has the stock plugins
(:mod:`dasim.render.stock`). Both return mean electrons per second for every channel,
E = pi L (r/s)^2 cos^4 summed over the spectrum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.camera import distortion, glare, radiometry, wavefront
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop, ring
from dasim.render import (
    backend,
    control_variate,
    focus_pictures,
    irradiance,
    irradiance_tracing,
    one_surface,
    pinhole,
    ray_loop,
    stock,
    transport,
)
from dasim.render.control_variate import Control, Fine
from dasim.render.irradiance import Field
from dasim.render.ray_batches import Sampling
from dasim.render.ray_loop import Ratios
from dasim.render.ray_pass import light_of, px_per_m
from dasim.render.wavelengths import (
    BANDS,
    at_bands,
    frame_density,
    pinhole_responses,
    separate_responses,
    stop_responses,
)
from dasim.typing import Float32Array, FloatArray

MOST_MARGIN_PX = 300.0
# Margin of the pinhole picture: width beyond half of the largest blur; least width, for in-focus diffraction from
# outside the frame; largest width.
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
    rate = picture.value.astype(float)
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
    return irradiance_tracing.field(
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
) -> NDArray[np.floating]:
    """Mean electrons per second with every stop shrunk to a point at unchanged light, [h, w, channel].

    All stops see the same rays through a point, so that one pass serves them all. The channels of ``also``, another
    camera behind the same lens, follow those of the camera.
    """
    import mitsuba as mi

    responses = pinhole_responses(camera, also)
    rate: NDArray[np.floating]
    if mi.variant().startswith("scalar"):
        rate = stock.pinhole_pass(mitsuba_scene, camera, responses, sampling)
    else:
        rate = ray_loop.render(mitsuba_scene, camera, None, sampling, None, field, responses).value
    rate *= radiometry.relative_illumination(camera)[..., None]
    return rate


@dataclass(frozen=True)
class Sharp:
    """Pictures through a pinhole."""

    # [part, h, w, channel] of the camera and of another one, mean electrons per second: of halves of the rays, or of
    # all of them where ``fine`` is None
    rate: NDArray[Any]
    fine: dict[str, Fine] | None  # by the stops' names; None where no stop has a control variate
    in_focus: dict[int, Float32Array]  # [h, w, channel] with every depth in focus, before glare, by the stops' numbers


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
    """The pictures of :func:`pinhole_pass` and, from the same rays, those of each stop on a finer grid with a margin
    and the all-in-focus pictures of discs and rings without aberrations.
    """
    radial = any(ring(stop) is not None for stop in camera.stops) and wavefront.is_perfect(camera)
    if diffraction != "wave" or not radial:
        return Sharp(pinhole_pass(mitsuba_scene, camera, sampling, field, also)[None], None, {})
    cells = control_variate.cells_of(camera)
    margin = int(np.ceil(np.clip(max_blur_px / 2 + SHARP_MARGIN_PX, LEAST_SHARP_MARGIN_PX, MOST_SHARP_MARGIN_PX)))
    wider = control_variate.wider(camera, margin)
    light = light_of(field)
    densities = [frame_density(stop_responses(camera, stop), light) for stop in camera.stops]
    in_focus = focus_pictures.InFocus(camera, field, max_blur_px, margin)
    responses, totals = separate_responses(wider, also, light, densities, in_focus.stops)
    channels = pinhole.Channels([BANDS] * len(camera.stops), totals, in_focus.count, in_focus.collect)
    border = margin - focus_pictures.MARGIN_PX
    pictures = pinhole.pictures(mitsuba_scene, wider, sampling, cells, field, responses, channels, border)
    backend.release_memory()
    falloff = radiometry.relative_illumination(camera)[..., None].astype(np.float32)
    for part in pictures.nodes:
        at_bands(part)
    edge_px = one_surface.edge_blur_px(mitsuba_scene, camera, margin, field)
    fine = {
        stop.name: Fine(cells, part, margin, edge_px) for stop, part in zip(camera.stops, pictures.nodes, strict=True)
    }
    focused = {number: picture * falloff for number, picture in in_focus.pictures(field, fine).items()}
    return Sharp(pictures.rate[:, margin:-margin, margin:-margin] * falloff, fine, focused)
