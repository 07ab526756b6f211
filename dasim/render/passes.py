"""Rendering passes: one per stop, each with a plain pupil and the wavelengths that its stop passes.

The camera is linear, so that its picture is the sum of its stops' pictures. In the JIT variants a pass is a ray loop of
our own, for every shape of stop (:mod:`dasim.render.ray_loop`); ``scalar_spectral`` has the stock plugins
(:mod:`dasim.render.stock`). Both return mean electrons per second for every channel,
E = pi L (r/s)^2 cos^4 summed over the spectrum.
"""

from __future__ import annotations

from typing import Any

from dasim.camera import distortion, glare, radiometry
from dasim.camera.specification import Camera, principal_point
from dasim.camera.stops import Stop
from dasim.render import irradiance, ray_loop, stock, transport
from dasim.render.irradiance import Field
from dasim.render.ray_loop import Sampling
from dasim.render.wavelengths import pinhole_responses, stop_responses
from dasim.typing import FloatArray

MOST_MARGIN_PX = 300.0


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
    """
    import mitsuba as mi

    responses = stop_responses(camera, stop)
    if mi.variant().startswith("scalar"):
        stock.check(camera)
        if in_focus:
            rate = stock.pinhole_pass(mitsuba_scene, camera, responses, sampling)
        else:
            rate = stock.stop_pass(mitsuba_scene, camera, stop, responses, sampling)
        if diffraction == "airy":
            rate = stock.in_focus_diffraction(rate, camera, stop, illuminant)
    else:
        waves = max_blur_px if diffraction == "wave" else None
        rate = ray_loop.render(mitsuba_scene, camera, stop, sampling, waves, field, responses, in_focus=in_focus)
    rate = rate * radiometry.relative_illumination(camera)[..., None]
    return glare.spread(rate, stop.glare_share, glare.radius_px(camera, stop))


def sample_count(spp: int) -> int:
    """Samples per pixel that a pass actually takes: the sampler of ``scalar_spectral`` rounds up to a grid."""
    import mitsuba as mi

    if not mi.variant().startswith("scalar"):
        return spp
    return int(mi.load_dict({"type": "multijitter", "sample_count": spp}).sample_count())


def irradiance_field(
    mitsuba_scene: Any, camera: Camera, spectrum: FloatArray, max_blur_px: float, spp: int, seed: int
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
        px_per_m=ray_loop.px_per_m(camera),
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
        rate = ray_loop.render(mitsuba_scene, camera, None, sampling, None, field, responses)
    return rate * radiometry.relative_illumination(camera)[..., None]
