"""Rays of a block of pixels: from their places on the lens through the film, and their weights for wave optics.

Tested in tests/dasim/render/test_passes.py and tests/dasim/render/test_ray_loop.py.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from dasim.render import field_angle, layers, wave
from dasim.render.control_variate import Control
from dasim.render.radial_blur import RadialBlur
from dasim.render.ray_batches import Batch
from dasim.render.ray_pass import Pass, corner_of

HERO = 4  # wavelengths per ray
WAVELENGTH_STREAM = 255  # of random numbers by pixel; the others are dimensions of Sobol' points


class Lanes(NamedTuple):
    """The numbers of each ray of a block."""

    pixel: Any  # index of its pixel in the frame
    stream: Any  # key of the random numbers of its pixel
    sample: Any  # index of the ray in its pixel
    samples: Any  # number of samples of its pixel
    sampler: Any  # random numbers for the later vertices of the paths
    corner: Any  # corner of the pixel, from the corner of the frame
    ring: Any  # fractional ring of the pixel


class Rays(NamedTuple):
    """Rays of a block from the lens to the scene."""

    ray: Any
    place: Any  # on the sensor, pixels from the frame's corner
    cells: Any  # per pixel along each axis, see :mod:`dasim.render.splitting`
    film: Any  # place in a pinhole's picture, pixels from the axis
    tangent: Any  # of the field angle there, a vector
    focus: Any  # vergence in focus at the ray's wavelengths, 1/m
    first: Any  # uniform number that chose the wavelengths
    entries: list[Any]  # row of the table for each of the ray's wavelengths
    rho: Any  # place on the lens, in radii
    delta: Any  # offset by diffraction, pixels
    expected: Any  # inverse depth seen at the pixel centre, 1/m; None without wave optics
    drawn: Any  # importance weight of the sampled position on the lens and aim
    variate: tuple[list[Any], list[Any]] | None  # see :func:`_variate`


def lanes_of(shared: Pass, batch: Batch) -> Lanes:
    """The numbers of the rays of a block."""
    import drjit as dr
    import mitsuba as mi

    own = batch.lane // batch.chunk
    pixel = dr.gather(mi.UInt32, batch.pixel, own)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(batch.seed, dr.width(batch.lane))
    return Lanes(
        pixel=pixel,
        stream=pixel + batch.seed,
        sample=dr.gather(mi.UInt32, batch.first, own) + batch.lane % batch.chunk,
        samples=dr.gather(mi.Float, batch.samples, own),
        sampler=sampler,
        corner=corner_of(pixel, shared.columns),
        ring=dr.gather(mi.Float, shared.place, pixel),
    )


def aim(shared: Pass, batch: Batch, lanes: Lanes, numbers: tuple[Any, Any, Any, Any]) -> Rays:
    """Rays from their places on the lens through the film; ``numbers`` for lens, film, diffraction and wavelength."""
    import drjit as dr
    import mitsuba as mi

    lens, film, pattern, first = numbers
    place = film + lanes.corner
    film = shared.pinhole(place - shared.axis)
    tangent = film / shared.px_per_m
    entries, wavelengths = entries_of(shared, first, lanes.ring), mi.Spectrum(0.0)
    for k in range(HERO):
        wavelengths[k] = entries[k][0]
    focus = entries[0][1] if shared.axial_colour else mi.Float(shared.vergence)

    rho, delta, drawn, expected, variate = mi.Point2f(0.0), mi.Point2f(0.0), mi.Float(1.0), None, None
    if shared.blur is not None:
        if shared.in_focus:
            sample = shared.blur.draw_in_focus(lens, pattern)
        else:
            expected = dr.gather(mi.Float, shared.middle, lanes.pixel)
            defocus = shared.px_per_vergence * (expected - focus)
            defocus *= field_angle.mean_scale(tangent)
            slope = shared.px_per_vergence * dr.gather(mi.Point2f, shared.slope, lanes.pixel)
            sample = shared.blur.draw(lens, pattern, defocus, slope, batch.seed)
        rho, drawn = sample.rho, sample.weight
        delta = field_angle.widened(sample.delta, tangent)
        if shared.control is not None:
            wider = dr.rcp(field_angle.mean_scale(tangent))
            w, per_density = sample.u * wider, sample.per_density * wider * wider
            variate = _variate(shared, shared.control, (lanes.pixel, place, w), per_density, first)
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
    cells = shared.cells if shared.control is None else shared.control.cells_at(lanes.pixel)
    return Rays(ray, place, cells, film, tangent, focus, first, entries, rho, delta, expected, drawn, variate)


def _variate(
    shared: Pass, control: Control, at: tuple[Any, Any, Any], per_density: Any, first: Any
) -> tuple[list[Any], list[Any]]:
    """C s and C of the control variate for each channel; ``at`` are the arguments of :meth:`Control.at`."""
    import drjit as dr

    assert isinstance(shared.blur, RadialBlur)
    bands, blur_px, reach_px = control.at(*at)
    length = dr.norm(at[2])
    entries = entries_at(shared, first, shared.middle_ring)
    weight, seen = [], []
    for entry, place in zip(entries, _places(shared, first), strict=True):
        own = blur_px
        if shared.axial_colour and not shared.in_focus:
            own -= shared.px_per_vergence * (entry[1] - shared.vergence)
        h = shared.blur.kernel(length, shared.blur.outer * dr.abs(own), entry[0])
        weight.append(dr.select(length <= reach_px, h * per_density * entry[-1], 0.0))
        along = place * (len(bands) - 1)  # as in wavelengths.tents
        seen.append(sum(dr.maximum(1 - dr.abs(along - number), 0.0) * s for number, s in enumerate(bands)))
    light = [[entries[k][2 + channel] * weight[k] for k in range(HERO)] for channel in range(shared.channels)]
    return [sum(c * s for c, s in zip(of, seen, strict=True)) for of in light], [sum(of) for of in light]


def wave_weights(shared: Pass, blur: wave.Blur, rays: Rays, si: Any) -> tuple[list[Any], list[Any], Any]:
    """Weights of wave optics relative to geometric optics at the end points of the rays.

    Returns the weight at each wavelength; the sum of the weights, and the part of it at the pixel's depth; the signed
    visible blur at the end point.
    """
    import drjit as dr
    import mitsuba as mi

    # What no surface hides is at infinity.
    at = dr.select(si.is_valid(), mi.Vector3f(si.p), rays.ray.d)
    vergence = dr.select(si.is_valid(), 1 / si.p.z, 0.0)
    u = rays.film - mi.Point2f(at.x, at.y) / at.z * shared.px_per_m
    wavelengths = [entry[0] for entry in rays.entries]
    ratios = blur.weights(u, shared.px_per_vergence * (vergence - rays.focus), rays.tangent, wavelengths)
    weight = [rays.drawn * ratio for ratio in ratios]
    seen, middle = (shared.px_per_vergence * (at - shared.vergence) for at in (vergence, rays.expected))
    near = dr.abs(seen - middle) <= layers.SAME_BLUR_PX + layers.SAME_BLUR_SHARE * dr.abs(middle)
    total = sum(weight)
    return weight, [total, dr.select(near, total, 0.0)], seen


def wavelength_places(shared: Pass, lanes: Lanes, stratum: Any) -> Any:
    """Uniform number that chooses the wavelengths of each ray, see :func:`entries_of`.

    Each stratum of a pixel holds one number, at the same random position in all even strata and at the mirrored
    position in the odd ones. The errors of neighbouring strata cancel, so that the error for smooth spectra falls as
    N^-2 with the number N of strata, and not as N^-3/2 as with independent positions (antithetic variates: Owen, Monte
    Carlo theory, methods and examples, section 8.2). ``stratum`` is the index of each ray's stratum in its pixel. In
    the order of the samples, it adds a dimension to their Sobol' points, as in a Hammersley point set.
    """
    import drjit as dr
    import mitsuba as mi

    bits = mi.sample_tea_32(lanes.stream, WAVELENGTH_STREAM)[0]
    place = mi.Float(bits >> 8) * 2.0**-24
    place = dr.select((stratum & 1) == 0, place, 1 - place)
    wavelengths = 1 if shared.has_single_wavelengths else HERO
    return (mi.Float(stratum) + place) / (wavelengths * lanes.samples)


def entries_of(shared: Pass, first: Any, ring: Any) -> list[Any]:
    """Row of the table for each wavelength of a ray, at its pixel's fractional ring."""
    import drjit as dr

    low = dr.floor(ring)
    above = entries_at(shared, first, dr.minimum(low + 1, shared.rings - 1))
    pairs = zip(entries_at(shared, first, low), above, strict=True)
    return [[dr.lerp(a, b, ring - low) for a, b in zip(*pair, strict=True)] for pair in pairs]


def entries_at(shared: Pass, first: Any, ring: Any) -> list[Any]:
    """The same at a ring of the table, a whole number."""
    import mitsuba as mi

    row = (ring + 0.5) / shared.rings
    return [shared.table.eval(mi.Point2f(at, row)) for at in _places(shared, first)]


def _places(shared: Pass, first: Any) -> list[Any]:
    """Probability of a shorter wavelength than each of a ray's."""
    import drjit as dr

    # With axial colour every wavelength has rays of its own; without, the wavelengths of a ray are spread evenly.
    spacing = 0.0 if shared.has_single_wavelengths else 1 / HERO
    shifted = [first + k * spacing for k in range(HERO)]
    return [at - dr.floor(at) for at in shifted]


def lit_by(entries: list[Any]) -> list[Any]:
    """Spectrum of the lights at the wavelengths of a ray."""
    return [entry[-1] for entry in entries]
