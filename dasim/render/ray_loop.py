"""A pass of the JIT variants: rays through a stop of any shape, or through a point, traced block by block of pixels.

A pass is set up (``_Pass``), the rays of a block are aimed (``_aim``), weighted for wave optics (``_wave_weights``),
traced and summed per pixel (``_trace``), and the sums become electrons as a ratio whose denominator is known. In pixels
that see several depths, the sums are made again for each layer in depth (``_layered``, :mod:`dasim.render.layers`).
A picture through a pinhole takes out most of the noise (:mod:`dasim.render.control_variate`).

Tested in tests/dasim/render/test_passes.py and tests/dasim/render/test_ray_loop.py.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import distortion, geometry
from dasim.camera.rings import at_pixels
from dasim.camera.specification import Camera, principal_point
from dasim.camera.stops import Stop
from dasim.render import backend, field_angle, layers, plugin, pupil, transport, wave
from dasim.render.control_variate import Control, Fine
from dasim.render.irradiance import Field
from dasim.render.plugin import texture
from dasim.render.radial_blur import RadialBlur
from dasim.render.sobol import Sobol
from dasim.render.wavelengths import Responses, draw_table, frame_density
from dasim.spectra import grid
from dasim.typing import FloatArray, ShareDone

WAVE_BLUR_PX = 150.0  # visible blur up to which weights are tabulated; beyond, blur is that of the drawn rays
ONE_DEPTH_SHARE = 0.97  # of the weights of a pixel that sees one depth: tails of diffraction reach others everywhere
MOST_SLOPE = 0.5  # of visible blur over the picture, pixels per pixel, that rays are aimed for
MOST_CHUNK = 16  # rays of a pixel that are summed at once
HERO = 4  # wavelengths per ray

Pixels = NDArray[np.intp] | slice  # numbers in the frame, row by row; a slice where they are consecutive


@dataclass(frozen=True)
class Sampling:
    """How a pass is sampled: samples per pixel, seed, and a callback for the share that is done."""

    spp: int | NDArray[np.int64]  # of all pixels, or of each, [h, w]
    seed: int
    progress: ShareDone = lambda share: None
    even_wavelengths: bool = False  # the same ones for all pixels: no noise, but colours that are a little off

    def block_seeds(self, stop: Stop | None) -> Callable[[int], int]:
        """Seed of each block of rows, independent between stops (by their names)."""
        name = zlib.crc32(stop.name.encode()) if stop is not None else 0
        return lambda block: int(np.random.SeedSequence((self.seed, name, block)).generate_state(1)[0])


@dataclass(frozen=True)
class _Pass:
    """What all blocks of a pass share.

    Numbers that change from picture to picture are opaque to the compiler: a kernel is compiled once, and found again.
    """

    scene: Any
    field: Field | None
    integrator: Any
    channels: int
    columns: Any  # opaque width of the frame in pixels
    axis: Any  # where it meets the sensor, pixels
    px_per_m: Any  # pixels on the sensor per metre at a distance of one metre
    pinhole: Callable[[Any], Any]  # from a place on the sensor to that in a pinhole's picture, pixels from the axis
    radius_m: Any  # of the lens
    px_per_vergence: Any  # pixels of visible blur per 1/m
    vergence: Any  # of the focus distance, 1/m
    table: Any  # see ``draw_table``
    rings: Any  # opaque number of rings in the table
    middle_ring: Any  # see :func:`_middle_ring`
    place: Any  # fractional ring of each pixel of the frame, row by row
    middle: Any  # inverse depth that the middle of each pixel sees, 1/m; None where it does not matter
    slope: Any  # its change along x and y, 1/m per pixel
    axial_colour: bool
    draw_pupil: pupil.Draw | None  # None for a pinhole
    blur: wave.Blur | None  # None for geometric optics
    aberration: Any | None  # geometric optics: the offset of a ray by its place on the lens, see :mod:`pupil`
    in_focus: bool  # whether every depth is, see :func:`render`
    control: Control | None


class Ratios(NamedTuple):
    """A picture and its control variate, whose expectation is 0, [h, w, channel].

    Both are ratios of sums over the rays, whose bias :func:`dasim.simulation.rendering_noise.measured` takes out by the
    denominators.
    """

    value: FloatArray
    variate: FloatArray  # zeros where there is no control
    light: NDArray[np.float32]  # denominator of ``value`` over its expectation; 1 where layers are joined
    variate_light: NDArray[np.float32]  # of ``variate``; both 1 through a pinhole


class _Block(NamedTuple):
    """Rays that are traced together: those of each pixel are consecutive, in chunks of one size."""

    pixels: Pixels
    counts: NDArray[np.int64]  # samples of each
    chunk: int  # rays; divides all ``counts``
    pixel: Any  # number in the frame of each ray's pixel
    sample: Any  # number of each ray in its pixel
    sampler: Any  # random numbers deeper in the paths
    corner: Any  # of the pixel, from the corner of the frame
    ring: Any  # fractional ring of the pixel
    seed: int

    def sums(self, values: Any) -> FloatArray:
        """Sums of the rays of each pixel, [pixel]."""
        import drjit as dr

        chunks = np.array(dr.block_sum(values, self.chunk), dtype=np.float64)
        each = self.counts[0] // self.chunk
        if len(chunks) == each * len(self.counts):  # as many of every pixel
            return chunks.reshape(-1, each).sum(axis=1) if each > 1 else chunks
        return np.add.reduceat(chunks, self.starts() // self.chunk)

    def starts(self) -> NDArray[np.int64]:
        """Number of the first ray of each pixel."""
        return np.cumsum(self.counts) - self.counts


class _Rays(NamedTuple):
    """Rays of a block from the lens to the scene."""

    ray: Any
    film: Any  # place in a pinhole's picture, pixels from the axis
    tangent: Any  # of the field angle there, a vector
    focus: Any  # vergence in focus at the ray's wavelengths, 1/m
    first: Any  # uniform number that chose the wavelengths
    entries: list[Any]  # row of the table for each of the ray's wavelengths
    rho: Any  # place on the lens, in radii
    delta: Any  # offset by diffraction, pixels
    expected: Any  # vergence that the middle of the pixel sees, 1/m; None without wave optics
    drawn: Any  # weight of having drawn place and aim so
    variate: tuple[list[Any], list[Any]] | None  # see :func:`_variate`


class _Weighted(NamedTuple):
    """What the weights of wave optics depend on, for each ray."""

    blur: Any  # signed visible blur where the ray ends, pixels
    rho: Any
    delta: Any
    tangent: Any
    first: Any
    ring: Any
    drawn: Any


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
    mean_signal = responses.mean_signal(_light(field))
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
    shared = _prepare(scene, camera, stop, max_blur_px, field, responses, in_focus, control)
    none, even = np.broadcast_to(0.0, shape), np.broadcast_to(np.float32(1.0), shape)
    light = even if stop is None else np.ones(shape, np.float32)
    variates = (none, even) if control is None else (np.zeros(shape), np.ones(shape, np.float32))
    result = Ratios(np.zeros(shape), variates[0], light, variates[1])
    wanted: list[Any] = [part.reshape(-1, shape[-1]) if part.flags.writeable else None for part in result]

    def keep(pixels: Pixels, channel: int, traced: Ratios) -> None:
        for whole, values in zip(wanted, traced, strict=True):
            if whole is not None:
                whole[pixels, channel] = values

    _trace_all(shared, sampling, sampling.block_seeds(stop), responses, keep)
    return result


def pinhole_ratios(
    scene: Any, camera: Camera, sampling: Sampling, field: Field | None, responses: Responses, parts: Sequence[int]
) -> list[NDArray[np.float32]]:
    """The value of :func:`ratios` through a pinhole for the first channels alone.

    ``parts`` are how many of them each of the results has, [h, w, channel], from which textures need no copies.
    """
    shape = responses.place.shape
    shared = replace(_prepare(scene, camera, None, None, field, responses, False, None), channels=sum(parts))
    result = [plugin.aligned_zeros((*shape, count)) for count in parts]
    columns = [column for part in result for column in part.reshape(-1, part.shape[-1]).T]

    def keep(pixels: Pixels, channel: int, traced: Ratios) -> None:
        columns[channel][pixels] = traced.value

    _trace_all(shared, sampling, sampling.block_seeds(None), responses, keep)
    return result


def _trace_all(
    shared: _Pass,
    sampling: Sampling,
    seeds: Callable[[int], int],
    responses: Responses,
    keep: Callable[[Pixels, int, Ratios], None],
) -> None:
    """Trace the frame batch by batch; ``keep`` gets pixels, a channel, and the ratios of the channel there, [pixel]."""
    place, mean_signal = responses.place.ravel(), responses.mean_signal(_light(shared.field))
    total, done = float(np.broadcast_to(sampling.spp, responses.place.shape).sum(dtype=float)), 0
    for number, (pixels, counts) in enumerate(_parts(sampling.spp, place.size)):
        block = _block(shared, pixels, counts, seeds(number))
        signal = HERO * mean_signal, place[block.pixels]
        _trace(shared, block, signal, sampling.even_wavelengths, partial(keep, block.pixels))
        done += int(counts.sum())
        sampling.progress(done / total)


def _parts(spp: int | NDArray[np.int64], size: int) -> Iterator[tuple[NDArray[np.intp], NDArray[np.int64]]]:
    """Consecutive pixels of ``size`` whose rays are traced at once, and the samples of each, of all or [h, w].

    The rays are :func:`backend.lanes` at most, or those of one pixel.
    """
    most = backend.lanes()
    if isinstance(spp, int):
        step = max(1, most // spp)
        for first in range(0, size, step):
            pixels = np.arange(first, min(first + step, size))
            yield pixels, np.full(len(pixels), spp)
        return
    ends, first, done = np.cumsum(spp), 0, 0
    while done < ends[-1]:
        own, others = np.searchsorted(ends, (done, done + most), side="right")
        last = max(int(own) + 1, int(others))
        pixels = first + np.flatnonzero(spp.ravel()[first:last])
        yield pixels, spp.ravel()[pixels]
        first, done = last, int(ends[last - 1])


def _light(field: Field | None) -> FloatArray:
    """Spectrum by which wavelengths are drawn."""
    return np.ones_like(grid.WAVELENGTH_NM) if field is None else field.light


def control_of(
    scene: Any,
    camera: Camera,
    stop: Stop,
    max_blur_px: float | None,
    field: Field | None,
    responses: Responses,
    fine: Fine,
    *,
    in_focus: bool = False,
) -> Control | None:
    """The control variate of a stop from a pinhole's picture; None for a stop whose kernels are not radial.

    Arguments are those of :func:`render`; ``fine`` has the channels of the stop.
    """
    mean_signal = responses.mean_signal(_light(field))
    if mean_signal.max() <= 0:
        return None
    shared = _prepare(scene, camera, stop, max_blur_px, field, responses, in_focus, None)
    if not isinstance(shared.blur, RadialBlur) or shared.blur.aberrated is not None:
        return None
    px_per_vergence, vergence = 2 * geometry.aperture_m(camera) / 2 * px_per_m(camera), 1 / camera.lens.focus_distance_m
    blur_px = np.zeros(responses.place.shape)
    if not in_focus:
        blur_px = px_per_vergence * (np.array(shared.middle, dtype=float).reshape(blur_px.shape) - vergence)
    colour_px = px_per_vergence * (geometry.focus_vergence(camera) - vergence) * (not in_focus)
    spectra = responses.of_pass[_middle_ring(responses)] * _light(field)
    return shared.blur.control(fine, blur_px, spectra, colour_px)


def _middle_ring(responses: Responses) -> int:
    """The ring whose responses stand for the frame's in the control variate."""
    return round(float(np.median(responses.place)))


def _to_pinhole(camera: Camera) -> Callable[[Any], Any]:
    """The lens's distortion, from pixels to pixels from the axis."""
    import drjit as dr
    import mitsuba as mi

    if not camera.lens.distortion_per_mm:
        return lambda place: place
    per_mm = [dr.opaque(mi.Float, value) for value in camera.lens.distortion_per_mm]
    pitch2 = dr.opaque(mi.Float, (camera.sensor.pixel_pitch_um * 1e-3) ** 2)
    return lambda place: place * distortion.factor(per_mm, dr.squared_norm(place) * pitch2)


def px_per_m(camera: Camera) -> float:
    """Pixels on the sensor per metre at a distance of one metre."""
    return geometry.image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)


def _prepare(
    scene: Any,
    camera: Camera,
    stop: Stop | None,
    max_blur_px: float | None,
    field: Field | None,
    responses: Responses,
    in_focus: bool,
    control: Control | None,
) -> _Pass:
    """Tables and constants of a pass."""
    import drjit as dr
    import mitsuba as mi

    light = _light(field)
    scale = dr.opaque(mi.Float, px_per_m(camera))
    radius_m = dr.opaque(mi.Float, geometry.aperture_m(camera) / 2)
    density = frame_density(responses, light)
    table = draw_table(camera, responses.of_pass, light, density)
    mean_nm = float(np.average(grid.WAVELENGTH_NM, weights=density))
    blur = None
    if stop is not None and max_blur_px is not None:
        blur = wave.blur(camera, stop, density, wave.blur_range_px(camera, max_blur_px, WAVE_BLUR_PX))
    pinhole = _to_pinhole(camera)
    axis = mi.Point2f(*(dr.opaque(mi.Float, value) for value in principal_point(camera.sensor)))
    columns = dr.opaque(mi.UInt32, camera.sensor.width_px)
    middle, slope = None, None
    if blur is not None and not in_focus:
        pixels = dr.arange(mi.UInt32, responses.place.size)
        middle = _middle_vergence(scene, pinhole(_corner(pixels, columns) + 0.5 - axis) / scale)
        steepest = MOST_SLOPE / (px_per_m(camera) * geometry.aperture_m(camera))
        along = _slopes(np.array(middle).reshape(responses.place.shape), steepest)
        slope = mi.Point2f(*(mi.Float(part.astype(np.float32).ravel()) for part in along))
    return _Pass(
        scene=scene,
        field=field,
        integrator=transport.path_integrator(),
        channels=responses.channels,
        columns=columns,
        axis=axis,
        px_per_m=scale,
        pinhole=pinhole,
        radius_m=radius_m,
        px_per_vergence=2 * radius_m * scale,
        vergence=dr.opaque(mi.Float, 1.0 / camera.lens.focus_distance_m),
        table=texture(table),
        rings=dr.opaque(mi.Float, len(table)),
        middle_ring=dr.opaque(mi.Float, _middle_ring(responses)),
        place=mi.Float(responses.place.astype(np.float32).ravel()),
        middle=middle,
        slope=slope,
        axial_colour=bool(camera.lens.focal_shift_um),
        draw_pupil=None if stop is None else pupil.drawer(stop),
        blur=blur,
        aberration=pupil.aberration(camera, mean_nm) if stop is not None and blur is None else None,
        in_focus=in_focus,
        control=control,
    )


def _corner(pixel: Any, columns: Any) -> Any:
    """Corner of a pixel of the frame, by its number row by row."""
    import mitsuba as mi

    row = pixel // columns
    return mi.Point2f(mi.Float(pixel - row * columns), mi.Float(row))


def _middle_vergence(scene: Any, slope: Any) -> Any:
    """Inverse depth that rays through the middle of the lens meet first, 1/m; 0 for nothing."""
    import drjit as dr
    import mitsuba as mi

    ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(slope.x, slope.y, 1.0))
    hit = scene.ray_intersect_preliminary(ray, coherent=True)
    vergence = dr.select(hit.is_valid(), dr.rcp(hit.t), 0.0)  # the direction's z is 1, so t is depth
    dr.eval(vergence)
    return vergence


def _slopes(vergence: NDArray[np.float32], steepest: float) -> tuple[FloatArray, FloatArray]:
    """Change of the inverse depth along x and y, [h, w] per pixel: that of a surface, and 0 beside a step in depth.

    The smaller of the differences to both sides, 0 where their signs differ; ``steepest`` bounds it.
    """

    def smaller(axis: int) -> FloatArray:
        step = np.diff(vergence, axis=axis)
        first, last = (np.take(step, [place], axis=axis) for place in (0, -1))
        before, after = np.concatenate([first, step], axis=axis), np.concatenate([step, last], axis=axis)
        least = np.where(np.abs(before) < np.abs(after), before, after)
        return np.clip(np.where(before * after > 0, least, 0.0), -steepest, steepest)

    if min(vergence.shape) < 2:
        return np.zeros(vergence.shape), np.zeros(vergence.shape)
    return smaller(1), smaller(0)


def _block(shared: _Pass, pixels: NDArray[np.intp], counts: NDArray[np.int64], seed: int) -> _Block:
    """Rays of some pixels of the frame, ``counts`` for each."""
    import drjit as dr
    import mitsuba as mi

    chunk = int(np.gcd.reduce(np.append(counts, MOST_CHUNK)))
    chunks = counts // chunk
    number = np.repeat(pixels, chunks)
    first = (np.arange(len(number)) - np.repeat(np.cumsum(chunks) - chunks, chunks)) * chunk
    lane = dr.arange(mi.UInt32, int(counts.sum()))
    size = dr.opaque(mi.UInt32, chunk)
    own = lane // size
    pixel = dr.gather(mi.UInt32, mi.UInt32(number.astype(np.uint32)), own)
    sample = dr.gather(mi.UInt32, mi.UInt32(first.astype(np.uint32)), own) + lane % size
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(dr.opaque(mi.UInt32, seed), dr.width(lane))
    ring = dr.gather(mi.Float, shared.place, pixel)
    is_whole = pixels[-1] - pixels[0] + 1 == len(pixels)
    where = slice(int(pixels[0]), int(pixels[-1]) + 1) if is_whole else pixels
    return _Block(where, counts, chunk, pixel, sample, sampler, _corner(pixel, shared.columns), ring, seed)


def _trace(
    shared: _Pass,
    block: _Block,
    signal: tuple[FloatArray, FloatArray],
    even_wavelengths: bool,
    keep: Callable[[int, Ratios], None],
) -> None:
    """Trace the rays of a block; ``keep`` gets each channel with the ratios of the block's pixels, [pixel].

    Response x light x weight has a known mean, ``signal``, and dividing by its sampled mean takes out the noise of
    drawing wavelengths and weights. ``signal`` is that mean on the rings, [ring, channel], and the pixels' places.
    """
    import drjit as dr
    import mitsuba as mi

    numbers = Sobol(int(block.counts.max()), block.sample, block.pixel + dr.opaque(mi.UInt32, block.seed))
    # The first dimensions are the most even: they go to what matters most.
    lens, film, aim_at, direction = (numbers.next_2d() for _ in range(4))
    first, pattern, lobe = numbers.next_1d(), numbers.next_2d(), numbers.next_1d()
    if even_wavelengths:
        first = (mi.Float(block.sample) + 0.5) * dr.opaque(mi.Float, 1 / (HERO * int(block.counts.max())))

    rays = _aim(shared, block, (lens, film, pattern, first))
    si = shared.scene.ray_intersect(rays.ray, ray_flags=mi.RayFlags.All, coherent=True)
    weight: list[Any] = [mi.Float(1.0)] * HERO
    depth_share: list[Any] = []
    weighted: _Weighted | None = None
    if shared.blur is not None and shared.in_focus:
        wavelengths = [entry[0] for entry in rays.entries]
        weights = shared.blur.weights(-rays.delta, mi.Float(0.0), rays.tangent, wavelengths)
        weight = [rays.drawn * value for value in weights]
    elif shared.blur is not None:
        weight, depth_share, blur_px = _wave_weights(shared, shared.blur, rays, si)
        weighted = _Weighted(blur_px, rays.rho, rays.delta, rays.tangent, rays.first, block.ring, rays.drawn)
    radiance = transport.radiance(
        shared.scene, shared.integrator, block.sampler, rays.ray, si, (aim_at, direction, lobe), shared.field
    )

    values, lit = [], _lit(rays.entries)
    for channel in range(shared.channels):
        share = [rays.entries[k][2 + channel] * weight[k] for k in range(HERO)]
        values += [sum(share[k] * radiance[k] for k in range(HERO)), sum(share[k] * lit[k] for k in range(HERO))]
    seen, kernel = rays.variate or ([], [])
    # One kernel for all: summing first would trace the rays once per sum.
    dr.eval(*depth_share, *values, *seen, *kernel, *(weighted or ()))
    several, layered = np.empty(0, dtype=np.intp), np.empty((0, shared.channels))
    if weighted is not None:
        total, near = (block.sums(value) for value in depth_share)
        several = np.flatnonzero(near < ONE_DEPTH_SHARE * total)
        if len(several):
            layered = _layered(shared, block, weighted, values, several)
    for channel in range(shared.channels):
        expected_light = at_pixels(signal[0][:, channel], signal[1])
        ratio, light = _sum_ratio(block, values[2 * channel :], expected_light)
        ratio[several], light[several] = layered[:, channel], 1.0
        variate, variate_light = np.broadcast_to(0.0, ratio.shape), np.broadcast_to(np.float32(1.0), ratio.shape)
        if shared.control is not None:
            expected = shared.control.expected[block.pixels, channel]
            variate, variate_light = _sum_ratio(block, (seen[channel], kernel[channel]), expected_light, expected)
        keep(channel, Ratios(ratio, variate, light, variate_light))


def _sum_ratio(
    block: _Block, values: Sequence[Any], light: FloatArray, less: NDArray[np.floating] | float = 0.0
) -> tuple[FloatArray, NDArray[np.float32]]:
    """Ratio of the sums of two values, less ``less``, and the sum of the second over its expectation, [pixel].

    ``light`` is that expectation per ray.
    """
    signal, control = (block.sums(value) for value in values[:2])
    return _ratio(signal - less * control, control), _ratio(control, block.counts * light, 1.0).astype(np.float32)


def _ratio(signal: FloatArray, control: FloatArray, otherwise: float = 0.0) -> FloatArray:
    return np.divide(signal, control, out=np.full_like(signal, otherwise), where=control > 0)


def _layered(
    shared: _Pass, block: _Block, weighted: _Weighted, values: list[Any], chosen: NDArray[np.intp]
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

    index = mi.UInt32(lanes.astype(np.uint32).ravel())
    parts = [dr.gather(mi.Float, value, index) for value in values]
    dr.eval(parts)
    return [np.array(part, dtype=np.float64) for part in parts]


def _beyond(shared: _Pass, depth_px: FloatArray, lanes: NDArray[np.int64], weighted: _Weighted) -> FloatArray:
    """Control of some rays if they ended where the visible blur is ``depth_px``, [ray, channel]."""
    import drjit as dr
    import mitsuba as mi

    assert shared.blur is not None
    index = mi.UInt32(lanes.astype(np.uint32))
    _, rho, delta, tangent, first, ring, drawn = (dr.gather(type(value), value, index) for value in weighted)
    entries = _entries(shared, first, ring)
    at = mi.Float(depth_px.astype(np.float32))
    at -= shared.px_per_vergence * (entries[0][1] - shared.vergence) if shared.axial_colour else 0.0
    ratios = shared.blur.weights(-delta - rho * (at / 2), at, tangent, [entry[0] for entry in entries])
    lit = _lit(entries)
    light = [drawn * ratios[k] * lit[k] for k in range(HERO)]
    sums = [sum(entries[k][2 + channel] * light[k] for k in range(HERO)) for channel in range(shared.channels)]
    dr.eval(*sums)
    return np.stack([np.array(value, dtype=np.float64) for value in sums], axis=-1)


def _entries(shared: _Pass, first: Any, ring: Any) -> list[Any]:
    """Row of the table for each wavelength of a ray, at its pixel's fractional ring."""
    import drjit as dr
    import mitsuba as mi

    # With axial colour every wavelength has rays of its own; without, the wavelengths of a ray are spread evenly.
    spacing = 0.0 if shared.axial_colour else 1 / HERO
    shifted = [first + k * spacing for k in range(HERO)]
    return [shared.table.eval(mi.Point2f(at - dr.floor(at), (ring + 0.5) / shared.rings)) for at in shifted]


def _lit(entries: list[Any]) -> list[Any]:
    """Spectrum of the lights at the wavelengths of a ray."""
    return [entry[-1] for entry in entries]


def _aim(shared: _Pass, block: _Block, numbers: tuple[Any, Any, Any, Any]) -> _Rays:
    """Rays from their places on the lens through the film; ``numbers`` for lens, film, diffraction and wavelength."""
    import drjit as dr
    import mitsuba as mi

    lens, film, pattern, first = numbers
    place = film + block.corner
    film = shared.pinhole(place - shared.axis)
    tangent = film / shared.px_per_m
    entries, wavelengths = _entries(shared, first, block.ring), mi.Spectrum(0.0)
    for k in range(HERO):
        wavelengths[k] = entries[k][0]
    focus = entries[0][1] if shared.axial_colour else mi.Float(shared.vergence)

    rho, delta, drawn, expected, variate = mi.Point2f(0.0), mi.Point2f(0.0), mi.Float(1.0), None, None
    if shared.blur is not None:
        if shared.in_focus:
            sample = shared.blur.draw_in_focus(lens, pattern)
        else:
            expected = dr.gather(mi.Float, shared.middle, block.pixel)
            defocus = shared.px_per_vergence * (expected - focus)
            defocus *= field_angle.mean_scale(tangent)
            slope = shared.px_per_vergence * dr.gather(mi.Point2f, shared.slope, block.pixel)
            sample = shared.blur.draw(lens, pattern, defocus, slope, dr.opaque(mi.UInt32, block.seed))
        rho, drawn = sample.rho, sample.weight
        delta = field_angle.widened(sample.delta, tangent)
        if shared.control is not None:
            wider = dr.rcp(field_angle.mean_scale(tangent))
            w, per_density = sample.u * wider, sample.per_density * wider * wider
            variate = _variate(shared, shared.control, (block.pixel, place, w), per_density, first)
    elif shared.draw_pupil is not None:
        rho = shared.draw_pupil(lens)
        delta = shared.aberration(rho, tangent) if shared.aberration is not None else delta
    on_lens = mi.Point2f(0.0) if shared.in_focus else rho * shared.radius_m
    aim = film + delta
    origin = mi.Point3f(on_lens.x, on_lens.y, 0.0)
    # Through the film position and its conjugate point in focus; beyond infinity that is behind the camera.
    slope = aim / shared.px_per_m - on_lens * focus
    ray = mi.RayDifferential3f(mi.Ray3f(origin, dr.normalize(mi.Vector3f(slope.x, slope.y, 1.0))))
    ray.wavelengths = wavelengths
    return _Rays(ray, film, tangent, focus, first, entries, rho, delta, expected, drawn, variate)


def _variate(
    shared: _Pass, control: Control, at: tuple[Any, Any, Any], per_density: Any, first: Any
) -> tuple[list[Any], list[Any]]:
    """C s and C of the control variate for each channel; ``at`` are the arguments of :meth:`Control.at`."""
    import drjit as dr
    import mitsuba as mi

    assert isinstance(shared.blur, RadialBlur)
    seen, blur_px, reach_px = control.at(*at)
    length = dr.norm(at[2])
    entries = _entries(shared, first, mi.Float(shared.middle_ring))
    weight = []
    for entry in entries:
        own = blur_px
        if shared.axial_colour and not shared.in_focus:
            own -= shared.px_per_vergence * (entry[1] - shared.vergence)
        h = shared.blur.kernel(length, shared.blur.outer * dr.abs(own), entry[0])
        weight.append(dr.select(length <= reach_px, h * per_density * entry[-1], 0.0))
    light = [sum(entries[k][2 + channel] * weight[k] for k in range(HERO)) for channel in range(shared.channels)]
    return [c * s for c, s in zip(light, seen, strict=True)], light


def _wave_weights(shared: _Pass, blur: wave.Blur, rays: _Rays, si: Any) -> tuple[list[Any], list[Any], Any]:
    """Weights of wave over geometric optics where the rays end.

    Returns those of each wavelength; their sum, and the part of it at the pixel's depth; the signed visible blur there.
    """
    import drjit as dr
    import mitsuba as mi

    point = dr.select(si.is_valid(), si.p, rays.ray(1e4))
    u = rays.film - mi.Point2f(point.x, point.y) / point.z * shared.px_per_m
    wavelengths = [entry[0] for entry in rays.entries]
    ratios = blur.weights(u, shared.px_per_vergence * (1 / point.z - rays.focus), rays.tangent, wavelengths)
    weight = [rays.drawn * ratio for ratio in ratios]
    seen, middle = (shared.px_per_vergence * (at - shared.vergence) for at in (1 / point.z, rays.expected))
    near = dr.abs(seen - middle) <= layers.SAME_BLUR_PX + layers.SAME_BLUR_SHARE * dr.abs(middle)
    total = sum(weight)
    return weight, [total, dr.select(near, total, 0.0)], seen
