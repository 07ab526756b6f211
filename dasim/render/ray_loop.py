"""A pass of the JIT variants: rays through a stop of any shape, or through a point, traced block by block of pixels.

A pass is set up (:mod:`dasim.render.ray_pass`) and its rays are divided into blocks (:mod:`dasim.render.ray_batches`).
The rays of a block are aimed and weighted for wave optics (:mod:`dasim.render.ray_block`), traced and summed per pixel
(``_trace``), and the sums become electrons as a ratio whose denominator is known. In pixels that see several depths,
the sums are made again for each layer in depth (``_layered``, :mod:`dasim.render.layers`). A picture through a pinhole
takes out most of the noise (:mod:`dasim.render.control_variate`).

Tested in tests/dasim/render/test_passes.py and tests/dasim/render/test_ray_loop.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import geometry
from dasim.camera.rings import at_pixels
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import layers, splitting, transport
from dasim.render.control_variate import Control, Fine
from dasim.render.frozen import frozen
from dasim.render.irradiance import Field
from dasim.render.plugin import aligned
from dasim.render.radial_blur import RadialBlur, spectrum_of
from dasim.render.ray_batches import Batch, Block, Pixels, Sampling, blocks
from dasim.render.ray_block import (
    HERO,
    Lanes,
    Rays,
    aim,
    entries_of,
    lanes_of,
    lit_by,
    wave_weights,
    wavelength_places,
)
from dasim.render.ray_pass import Pass, drawn, light_of, middle_ring, prepare, px_per_m
from dasim.render.sobol import Sobol
from dasim.render.wavelengths import Responses
from dasim.typing import FloatArray

# Least share of the weights at the depth of the pixel centre for a pixel that sees one depth: tails of diffraction
# reach other depths everywhere.
ONE_DEPTH_SHARE = 0.97


class Ratios(NamedTuple):
    """A picture and its control variate, whose expectation is 0, [h, w, channel].

    Both are ratios of sums over the rays, whose bias :func:`dasim.simulation.rendering_noise.measured` takes out by the
    denominators.
    """

    value: NDArray[np.floating]
    variate: NDArray[np.floating]  # zeros where there is no control
    light: NDArray[np.float32]  # denominator of ``value`` over its expectation; 1 where layers are joined
    variate_light: NDArray[np.float32]  # of ``variate``; both 1 through a pinhole


class _Weighted(NamedTuple):
    """What the weights of wave optics depend on, for each ray."""

    blur: Any  # signed visible blur where the ray ends, pixels
    rho: Any
    delta: Any
    tangent: Any
    first: Any
    ring: Any
    drawn: Any


@dataclass(frozen=True)
class Traced:
    """Results of traced rays, evaluated."""

    values: list[Any]  # signal and control, alternating by channel
    seen: list[Any]  # C s of the control variate by channel; empty without one
    kernel: list[Any]  # C of the control variate by channel; empty without one
    depth_share: list[Any]  # sums of all weights and of those at the pixel centre's depth; empty without wave optics
    weighted: tuple[Any, ...]  # the fields of :class:`_Weighted`; empty without wave optics


def render(
    scene: Any,
    camera: Camera,
    stop: Stop | None,
    sampling: Sampling,
    max_blur_px: float | None,
    field: Field | None,
    responses: Responses,
    *,
    in_focus: bool = False,
    control: Control | None = None,
) -> Ratios:
    """Mean electrons per second through a stop, [h, w, channel], before the falloff of relative illumination.

    Args:
        scene: a Mitsuba scene.
        camera: the camera; its frame, lens and focus are used.
        stop: the stop, or None for a pinhole.
        sampling: samples per pixel and seed.
        max_blur_px: largest visible blur in the scene; None for geometric optics.
        field: irradiance that is known beforehand.
        responses: of the channels, with the frame's rings.
        in_focus: whether all depths are in focus: the perspective of the middle of the lens, and the diffraction
            pattern of the stop in focus.
        control: the control variate, see :func:`control_of`.
    """
    mean_signal = responses.mean_signal(light_of(field))
    if mean_signal.max() <= 0:
        nothing = np.zeros((*responses.place.shape, responses.channels))
        even = np.ones_like(nothing, dtype=np.float32)
        return Ratios(nothing, nothing, even, even)
    picture = ratios(scene, camera, stop, sampling, max_blur_px, field, responses, in_focus=in_focus, control=control)
    for channel in range(responses.channels):  # apart, in place: arrays of large frames are gigabytes
        signal = at_pixels(mean_signal[:, channel], responses.place)
        picture.value[..., channel] *= signal
        if control is not None:
            picture.variate[..., channel] *= signal
    return picture


def ratios(
    scene: Any,
    camera: Camera,
    stop: Stop | None,
    sampling: Sampling,
    max_blur_px: float | None,
    field: Field | None,
    responses: Responses,
    *,
    in_focus: bool = False,
    control: Control | None = None,
) -> Ratios:
    """Electrons over those of a surface of the lights' spectral radiance, see :func:`render`."""
    shape = (*responses.place.shape, responses.channels)
    shared = prepare(scene, camera, stop, max_blur_px, field, responses, in_focus, control)
    none, even = (np.broadcast_to(np.float32(value), shape) for value in (0, 1))
    light = even if stop is None else np.ones(shape, np.float32)
    variates = (none, even) if control is None else (np.zeros(shape, np.float32), np.ones(shape, np.float32))
    result = Ratios(np.zeros(shape, np.float32), variates[0], light, variates[1])
    wanted: list[Any] = [part.reshape(-1, shape[-1]) if part.flags.writeable else None for part in result]

    def keep(pixels: Pixels, channel: int, traced: Ratios) -> None:
        for whole, values in zip(wanted, traced, strict=True):
            if whole is not None:
                whole[pixels, channel] = values

    place, mean_signal = responses.place.ravel(), responses.mean_signal(light_of(field))
    traced, layers_from = frozen(trace_rays), sampling.layers_from
    for block in blocks(responses.place.size, sampling, stop):
        signal = HERO * mean_signal, place[block.pixels]
        _trace(shared, block, traced, signal, partial(keep, block.pixels), layers_from)
    return result


def control_of(
    scene: Any,
    camera: Camera,
    stop: Stop,
    max_blur_px: float | None,
    field: Field | None,
    responses: Responses,
    fine: Fine,
) -> Control | None:
    """The control variate of a stop from a pinhole's picture; None for kernels that are not radial, or too fine.

    Arguments are those of :func:`render`; ``fine`` has the bands of the stop.
    """
    mean_signal = responses.mean_signal(light_of(field))
    if mean_signal.max() <= 0:
        return None
    shared = prepare(scene, camera, stop, max_blur_px, field, responses, False, None)
    if not isinstance(shared.blur, RadialBlur) or shared.blur.aberrated is not None:
        return None
    px_per_vergence, vergence = 2 * geometry.aperture_m(camera) / 2 * px_per_m(camera), 1 / camera.lens.focus_distance_m
    middle = np.array(shared.middle, dtype=float).reshape(responses.place.shape)
    table = drawn(camera, responses, light_of(field))[1][middle_ring(responses)]
    colour_px = px_per_vergence * (table[:, 1] - vergence)
    spectrum = spectrum_of(table[:, 0], table[:, 2:-1] * table[:, -1:], colour_px, fine.ratio.shape[-1])
    return shared.blur.control(fine, px_per_vergence * (middle - vergence), spectrum)


def _trace(
    shared: Pass,
    block: Block,
    traced: Callable[[Pass, Batch], Traced],
    signal: tuple[FloatArray, FloatArray],
    keep: Callable[[int, Ratios], None],
    layers_from: int,
) -> None:
    """Trace the rays of a block; ``keep`` gets each channel with the ratios of the block's pixels, [pixel].

    Response x light x weight has a known mean, ``signal``, and dividing by its sampled mean takes out the noise of
    drawing wavelengths and weights. ``signal`` is that mean on the rings, [ring, channel], and the pixels' places.
    ``traced`` is :func:`trace_rays`, frozen or not; ``layers_from`` is that of :class:`Sampling`.
    """
    rays = traced(shared, block.batch)
    values = rays.values
    several, layered = np.empty(0, dtype=np.intp), np.empty((0, shared.channels))
    if rays.weighted:
        total, near = (block.sums(value) for value in rays.depth_share)
        several = np.flatnonzero((near < ONE_DEPTH_SHARE * total) & (block.counts >= layers_from))
        if len(several):
            layered = _layered(shared, block, _Weighted(*rays.weighted), values, several)
    for channel in range(shared.channels):
        expected_light = at_pixels(signal[0][:, channel], signal[1])
        ratio, light = _sum_ratio(block, values[2 * channel :], expected_light)
        ratio[several], light[several] = layered[:, channel], 1.0
        variate, variate_light = np.broadcast_to(0.0, ratio.shape), np.broadcast_to(np.float32(1.0), ratio.shape)
        if shared.control is not None:
            expected = shared.control.expected[block.pixels, channel]
            variate, variate_light = _sum_ratio(
                block, (rays.seen[channel], rays.kernel[channel]), expected_light, expected
            )
            if shared.control.lacking is not None:
                ratio += shared.control.lacking[block.pixels, channel]
        keep(channel, Ratios(ratio, variate, light, variate_light))


def trace_rays(shared: Pass, batch: Batch) -> Traced:
    """Trace the rays of a batch."""
    import drjit as dr
    import mitsuba as mi

    lanes = lanes_of(shared, batch)
    numbers = Sobol(batch.points, lanes.sample, lanes.stream)
    # The first dimensions are the most even: they go to what matters most.
    lens, film, aim_at, direction, pattern = (numbers.next_2d() for _ in range(5))
    first, lobe = wavelength_places(shared, lanes, lanes.sample), numbers.next_1d()

    rays = aim(shared, batch, lanes, (lens, film, pattern, first))
    si = shared.scene.ray_intersect(rays.ray, ray_flags=mi.RayFlags.All, coherent=True)
    weight: list[Any] = [mi.Float(1.0)] * HERO
    depth_share: list[Any] = []
    weighted: tuple[Any, ...] = ()
    if shared.blur is not None and shared.in_focus:
        wavelengths = [entry[0] for entry in rays.entries]
        weights = shared.blur.weights(-rays.delta, mi.Float(0.0), rays.tangent, wavelengths)
        weight = [rays.drawn * value for value in weights]
    elif shared.blur is not None:
        weight, depth_share, blur_px = wave_weights(shared, shared.blur, rays, si)
        weighted = blur_px, rays.rho, rays.delta, rays.tangent, rays.first, lanes.ring, rays.drawn
    values = signals(shared, lanes, rays, si, weight, (aim_at, direction, lobe))
    seen, kernel = rays.variate or ([], [])
    # One kernel for all: summing first would trace the rays once per sum.
    dr.eval(*depth_share, *values, *seen, *kernel, *weighted)
    return Traced(values, seen, kernel, depth_share, weighted)


def signals(
    shared: Pass, lanes: Lanes, rays: Rays, si: Any, weight: list[Any], numbers: tuple[Any, Any, Any]
) -> list[Any]:
    """Response x weight x radiance of each ray, and response x weight x light, alternating by channel.

    The radiance is that of the point where the ray ends, the light the spectrum of all lights together; ``numbers`` are
    those of :func:`transport.radiance`.
    """
    shifts = splitting.uv_shifts(shared, rays, si)
    radiance = transport.radiance(
        shared.scene, shared.emitters, shared.integrator, lanes.sampler, rays.ray, si, numbers, shared.field, shifts
    )
    values, lit = [], lit_by(rays.entries)
    for channel in range(shared.channels):
        share = [rays.entries[k][2 + channel] * weight[k] for k in range(HERO)]
        values += [sum(share[k] * radiance[k] for k in range(HERO)), sum(share[k] * lit[k] for k in range(HERO))]
    return values


def _sum_ratio(
    block: Block, values: Sequence[Any], light: FloatArray, less: NDArray[np.floating] | float = 0.0
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Ratio of the sums of two values, less ``less``, and the sum of the second over its expectation, [pixel].

    ``light`` is that expectation per ray.
    """
    signal, control = (block.sums(value) for value in values[:2])
    return ratio_of(signal - less * control, control), ratio_of(control, block.counts * light, 1.0).astype(np.float32)


def ratio_of(signal: FloatArray, control: FloatArray, otherwise: float = 0.0) -> FloatArray:
    """The ratio of two arrays; ``otherwise`` where the second is not positive."""
    return np.divide(signal, control, out=np.full_like(signal, otherwise), where=control > 0)


def _layered(
    shared: Pass, block: Block, weighted: _Weighted, values: list[Any], chosen: NDArray[np.intp]
) -> FloatArray:
    """The estimate for pixels that see several depths, [pixel, channel]; see :func:`layers.estimate`.

    Args:
        shared: what all blocks share.
        block: the rays of the block.
        weighted: what their weights depend on.
        values: signal and control of all rays, alternating by channel.
        chosen: numbers of the pixels in the block.
    """
    starts, result = block.starts(), np.zeros((len(chosen), shared.channels))
    for spp in np.unique(block.counts[chosen]):
        here = np.flatnonzero(block.counts[chosen] == spp)
        lanes = starts[chosen[here], None] + np.arange(spp)
        blur_px, *rays = (value.reshape(lanes.shape) for value in _read([weighted.blur, *values], lanes))
        signal, control = rays[0::2], rays[1::2]

        def beyond(at: NDArray[np.intp], depth_px: FloatArray, lanes: NDArray[np.int64] = lanes) -> FloatArray:
            return _beyond(shared, depth_px, lanes.ravel()[at], weighted)

        result[here] = layers.estimate(signal, control, blur_px, beyond)
    return result


def _read(values: Sequence[Any], lanes: NDArray[np.int64]) -> list[FloatArray]:
    """Values of some rays alone, in double precision."""
    import drjit as dr
    import mitsuba as mi

    index = mi.UInt32(aligned(lanes.astype(np.uint32).ravel()))
    parts = [dr.gather(mi.Float, value, index) for value in values]
    dr.eval(parts)
    return [np.array(part, dtype=np.float64) for part in parts]


def _beyond(shared: Pass, depth_px: FloatArray, lanes: NDArray[np.int64], weighted: _Weighted) -> FloatArray:
    """Control of some rays if they ended where the visible blur is ``depth_px``, [ray, channel]."""
    import drjit as dr
    import mitsuba as mi

    assert shared.blur is not None
    index = mi.UInt32(aligned(lanes.astype(np.uint32)))
    _, rho, delta, tangent, first, ring, drawn = (dr.gather(type(value), value, index) for value in weighted)
    entries = entries_of(shared, first, ring)
    at = mi.Float(aligned(depth_px.astype(np.float32)))
    at -= shared.px_per_vergence * (entries[0][1] - shared.vergence) if shared.axial_colour else 0.0
    ratios = shared.blur.weights(-delta - rho * (at / 2), at, tangent, [entry[0] for entry in entries])
    lit = lit_by(entries)
    light = [drawn * ratios[k] * lit[k] for k in range(HERO)]
    sums = [sum(entries[k][2 + channel] * light[k] for k in range(HERO)) for channel in range(shared.channels)]
    dr.eval(*sums)
    return np.stack([np.array(value, dtype=np.float64) for value in sums], axis=-1)
