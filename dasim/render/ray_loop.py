"""A pass of the JIT variants: rays through a stop of any shape, or through a point, traced block by block of rows.

A block is set up (``_Pass``), its rays are aimed (``_aim``), weighted for wave optics (``_wave_weights``), traced and
summed per pixel (``_trace``), and the sums become electrons with a control variate. In pixels that see several depths,
the sums are made again for each layer in depth (``_layered``, :mod:`dasim.render.layers`).

Tested in tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import distortion, geometry
from dasim.camera.rings import at_pixels
from dasim.camera.specification import Camera, principal_point
from dasim.camera.stops import Stop
from dasim.render import field_angle, layers, pupil, transport, wave
from dasim.render.irradiance import Field
from dasim.render.plugin import tensor
from dasim.render.sobol import Sobol
from dasim.render.wavelengths import Responses, draw_table, frame_density
from dasim.spectra import grid
from dasim.typing import BoolArray, FloatArray, ShareDone

LANES = 1 << 21  # rays in flight: bounds the memory, and is fixed, because it decides the random numbers
WAVE_BLUR_PX = 150.0  # visible blur up to which weights are tabulated; beyond, blur is that of the drawn rays
ONE_DEPTH_SHARE = 0.97  # of the weights of a pixel that sees one depth: tails of diffraction reach others everywhere
HERO = 4  # wavelengths per ray


@dataclass(frozen=True)
class Sampling:
    """How a pass is sampled: samples per pixel, seed, and a callback for the share that is done."""

    spp: int
    seed: int
    progress: ShareDone = lambda share: None

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
    sampler: Any  # random numbers deeper in the paths
    spp: int
    width_px: int
    channels: int
    samples: Any  # opaque ``spp``
    columns: Any  # opaque ``width_px``
    axis: Any  # where it meets the sensor, pixels
    px_per_m: Any  # pixels on the sensor per metre at a distance of one metre
    pinhole: Callable[[Any], Any]  # from a place on the sensor to that in a pinhole's picture, pixels from the axis
    radius_m: Any  # of the lens
    px_per_vergence: Any  # pixels of visible blur per 1/m
    vergence: Any  # of the focus distance, 1/m
    table: Any  # see ``draw_table``
    rings: Any  # opaque number of rings in the table
    place: Any  # fractional ring of each pixel of the frame, row by row
    axial_colour: bool
    draw_pupil: pupil.Draw | None  # None for a pinhole
    blur: wave.Blur | None  # None for geometric optics
    aberration: Any | None  # geometric optics: the offset of a ray by its place on the lens, see :mod:`pupil`
    in_focus: bool  # whether every depth is, see :func:`render`


class _Rays(NamedTuple):
    """Rays of a block from the lens to the scene."""

    ray: Any
    film: Any  # place in a pinhole's picture, pixels from the axis
    tangent: Any  # of the field angle there, a vector
    focus: Any  # vergence in focus at the ray's wavelengths, 1/m
    first: Any  # uniform number that chose the wavelengths
    ring: Any  # fractional ring of the pixel
    entries: list[Any]  # row of the table for each of the ray's wavelengths
    rho: Any  # place on the lens, in radii
    delta: Any  # offset by diffraction, pixels
    expected: Any  # vergence that the middle of the pixel sees, 1/m; None without wave optics
    drawn: Any  # weight of having drawn place and aim so


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
) -> FloatArray:
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
    """
    width, height = camera.sensor.width_px, camera.sensor.height_px
    light = np.ones_like(grid.WAVELENGTH_NM) if field is None else field.light
    mean_signal = responses.mean_signal(light)
    rate = np.zeros((height, width, responses.channels))
    if mean_signal.max() <= 0:
        return rate
    shared = _prepare(scene, camera, stop, sampling.spp, max_blur_px, field, responses, light, in_focus)
    rows_at_once = max(1, LANES // (sampling.spp * width))
    seeds = sampling.block_seeds(stop)
    for block, top in enumerate(range(0, height, rows_at_once)):
        rows = min(rows_at_once, height - top)
        here = slice(top, top + rows)
        ratio = _trace(shared, top, rows, seeds(block)).reshape(rows, width, -1)
        rate[here] = ratio * at_pixels(mean_signal, responses.place[here])
        sampling.progress((top + rows) / height)
    return rate


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
    spp: int,
    max_blur_px: float | None,
    field: Field | None,
    responses: Responses,
    light: FloatArray,
    in_focus: bool,
) -> _Pass:
    """Tables and constants of a pass."""
    import drjit as dr
    import mitsuba as mi

    width = camera.sensor.width_px
    scale = dr.opaque(mi.Float, px_per_m(camera))
    radius_m = dr.opaque(mi.Float, geometry.aperture_m(camera) / 2)
    density = frame_density(responses, light)
    table = draw_table(camera, responses.of_pass, light, density)
    mean_nm = float(np.average(grid.WAVELENGTH_NM, weights=density))
    blur = None
    if stop is not None and max_blur_px is not None:
        blur = wave.blur(camera, stop, density, wave.blur_range_px(camera, max_blur_px, WAVE_BLUR_PX))
    sampler = mi.load_dict({"type": "independent", "sample_count": spp})
    sampler.set_samples_per_wavefront(spp)
    return _Pass(
        scene=scene,
        field=field,
        integrator=transport.path_integrator(),
        sampler=sampler,
        spp=spp,
        width_px=width,
        channels=responses.channels,
        samples=dr.opaque(mi.UInt32, spp),
        columns=dr.opaque(mi.UInt32, width),
        axis=mi.Point2f(*(dr.opaque(mi.Float, value) for value in principal_point(camera.sensor))),
        px_per_m=scale,
        pinhole=_to_pinhole(camera),
        radius_m=radius_m,
        px_per_vergence=2 * radius_m * scale,
        vergence=dr.opaque(mi.Float, 1.0 / camera.lens.focus_distance_m),
        table=mi.Texture2f(tensor(table)),
        rings=dr.opaque(mi.Float, len(table)),
        place=mi.Float(responses.place.astype(np.float32).ravel()),
        axial_colour=bool(camera.lens.focal_shift_um),
        draw_pupil=None if stop is None else pupil.drawer(stop),
        blur=blur,
        aberration=pupil.aberration(camera, mean_nm) if stop is not None and blur is None else None,
        in_focus=in_focus,
    )


def _trace(shared: _Pass, top: int, rows: int, seed: int) -> FloatArray:
    """Trace the rays of ``rows`` rows from ``top``; electrons over those of the lights' spectrum, [pixel, channel].

    The control variate: response x light x weight has a known mean, and dividing by its sampled mean takes out the
    noise of drawing wavelengths and weights.
    """
    import drjit as dr
    import mitsuba as mi

    lanes = rows * shared.width_px * shared.spp
    shared.sampler.seed(dr.opaque(mi.UInt32, seed), lanes)
    pixel = dr.arange(mi.UInt32, lanes) // shared.samples
    row = pixel // shared.columns
    corner = mi.Point2f(mi.Float(pixel - row * shared.columns), mi.Float(row + dr.opaque(mi.UInt32, top)))
    ring = dr.gather(mi.Float, shared.place, pixel + dr.opaque(mi.UInt32, top * shared.width_px))
    sample = dr.arange(mi.UInt32, lanes) % shared.samples
    numbers = Sobol(shared.spp, sample, pixel + dr.opaque(mi.UInt32, seed))
    # The first dimensions are the most even: they go to what matters most.
    lens, film, aim_at, direction = (numbers.next_2d() for _ in range(4))
    first, pattern, lobe = numbers.next_1d(), numbers.next_2d(), numbers.next_1d()

    rays = _aim(shared, pixel, corner, ring, (lens, film, pattern, first), seed)
    si = shared.scene.ray_intersect(rays.ray, ray_flags=mi.RayFlags.All, coherent=True)
    weight: list[Any] = [mi.Float(1.0)] * HERO
    depth_share: list[Any] = []
    weighted: _Weighted | None = None
    if shared.blur is not None and shared.in_focus:
        wavelengths = [entry[0] for entry in rays.entries]
        ratios = shared.blur.weights(-rays.delta, mi.Float(0.0), rays.tangent, wavelengths)
        weight = [rays.drawn * ratio for ratio in ratios]
    elif shared.blur is not None:
        weight, depth_share, blur_px = _wave_weights(shared, shared.blur, rays, si)
        weighted = _Weighted(blur_px, rays.rho, rays.delta, rays.tangent, rays.first, rays.ring, rays.drawn)
    radiance = transport.radiance(
        shared.scene, shared.integrator, shared.sampler, rays.ray, si, (aim_at, direction, lobe), shared.field
    )

    sums, lit = list(depth_share), _lit(rays.entries)
    for channel in range(shared.channels):
        share = [rays.entries[k][2 + channel] * weight[k] for k in range(HERO)]
        sums += [sum(share[k] * radiance[k] for k in range(HERO)), sum(share[k] * lit[k] for k in range(HERO))]
    dr.eval(*sums, *(weighted or ()))  # one kernel for all sums: summing first would trace the rays once per sum
    totals = [np.array(dr.block_sum(value, shared.spp), dtype=np.float64) for value in sums]
    channels = totals[len(depth_share) :]
    ratio = np.stack([_ratio(*pair) for pair in zip(channels[0::2], channels[1::2], strict=True)], axis=-1)
    if weighted is None:
        return ratio
    several = np.flatnonzero(totals[1] < ONE_DEPTH_SHARE * totals[0])
    if len(several):
        ratio[several] = _layered(shared, weighted, sums[len(depth_share) :], several)
    return ratio


def _ratio(signal: FloatArray, control: FloatArray) -> FloatArray:
    return np.divide(signal, control, out=np.zeros_like(signal), where=control > 0)


def _layered(shared: _Pass, weighted: _Weighted, sums: list[Any], chosen: NDArray[np.intp]) -> FloatArray:
    """The estimate for pixels that see several depths, [pixel, channel]; see :func:`layers.estimate`.

    Args:
        shared: what all blocks share.
        weighted: all rays of the block.
        sums: signal and control of all rays, alternating by channel.
        chosen: numbers of the pixels.
    """
    import drjit as dr
    import mitsuba as mi

    shape = len(chosen), shared.spp
    lanes = mi.UInt32((chosen[:, None] * shared.spp + np.arange(shared.spp)).astype(np.uint32).ravel())
    blur_px, rho, delta, tangent, first, ring, drawn = (dr.gather(type(value), value, lanes) for value in weighted)
    values = [np.array(dr.gather(mi.Float, value, lanes), dtype=np.float64).reshape(shape) for value in sums]
    entries = _entries(shared, first, ring)

    def beyond(depth_px: FloatArray, behind: BoolArray) -> list[FloatArray]:
        return _beyond(shared, depth_px, mi.Bool(behind.ravel()), entries, (rho, delta, tangent, drawn))

    return layers.estimate(values[0::2], values[1::2], np.array(blur_px, dtype=np.float64).reshape(shape), beyond)


def _beyond(
    shared: _Pass, depth_px: FloatArray, behind: Any, entries: list[Any], sampled: tuple[Any, Any, Any, Any]
) -> list[FloatArray]:
    """Control of the rays that end ``behind`` a layer if they ended in it, [channel][pixel].

    ``depth_px`` is the visible blur of the layer in each pixel; ``sampled`` is rho, delta, the field angle's tangent
    and the weight of rho and delta.
    """
    import drjit as dr
    import mitsuba as mi

    rho, delta, tangent, drawn = sampled
    assert shared.blur is not None
    at = dr.repeat(mi.Float(depth_px.astype(np.float32)), shared.spp)
    at -= shared.px_per_vergence * (entries[0][1] - shared.vergence) if shared.axial_colour else 0.0
    ratios = shared.blur.weights(-delta - rho * (at / 2), at, tangent, [entry[0] for entry in entries])
    lit = _lit(entries)
    light = [dr.select(behind, drawn * ratios[k] * lit[k], 0.0) for k in range(HERO)]
    sums = [sum(entries[k][2 + channel] * light[k] for k in range(HERO)) for channel in range(shared.channels)]
    dr.eval(*sums)
    return [np.array(dr.block_sum(value, shared.spp), dtype=np.float64) for value in sums]


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


def _aim(shared: _Pass, pixel: Any, corner: Any, ring: Any, numbers: tuple[Any, Any, Any, Any], seed: int) -> _Rays:
    """Rays from their places on the lens through the film; ``numbers`` for lens, film, diffraction and wavelength."""
    import drjit as dr
    import mitsuba as mi

    lens, film, pattern, first = numbers
    film = shared.pinhole(film + (corner - shared.axis))
    tangent = film / shared.px_per_m
    entries, wavelengths = _entries(shared, first, ring), mi.Spectrum(0.0)
    for k in range(HERO):
        wavelengths[k] = entries[k][0]
    focus = entries[0][1] if shared.axial_colour else mi.Float(shared.vergence)

    rho, delta, drawn, expected = mi.Point2f(0.0), mi.Point2f(0.0), mi.Float(1.0), None
    if shared.blur is not None and shared.in_focus:
        delta, drawn = shared.blur.draw_in_focus(lens, pattern)
        delta = field_angle.widened(delta, tangent)
    elif shared.blur is not None:
        expected = dr.gather(mi.Float, _middle_vergence(shared, corner), pixel)
        defocus = shared.px_per_vergence * (expected - focus)
        defocus *= field_angle.mean_scale(tangent)
        rho, delta, drawn = shared.blur.draw(lens, pattern, defocus, dr.opaque(mi.UInt32, seed))
        delta = field_angle.widened(delta, tangent)
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
    return _Rays(ray, film, tangent, focus, first, ring, entries, rho, delta, expected, drawn)


def _middle_vergence(shared: _Pass, corner: Any) -> Any:
    """Inverse depth that the ray through the middle of each pixel and of the lens meets first, 1/m; 0 for nothing.

    ``corner`` are the corners of the pixels, repeated for each sample.
    """
    import drjit as dr
    import mitsuba as mi

    first = dr.arange(mi.UInt32, dr.width(corner) // shared.spp) * shared.spp
    at = shared.pinhole(dr.gather(mi.Point2f, corner, first) + 0.5 - shared.axis)
    towards = mi.Vector3f(at.x / shared.px_per_m, at.y / shared.px_per_m, 1.0)
    hit = shared.scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(0.0), towards), coherent=True)
    vergence = dr.select(hit.is_valid(), dr.rcp(hit.t), 0.0)  # the direction's z is 1, so t is depth
    dr.eval(vergence)
    return vergence


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
