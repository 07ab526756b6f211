"""Rendering passes: one per stop, each with a plain pupil and the wavelengths that its stop passes.

The camera is linear, so its picture is the sum of its stops' pictures. In the JIT variants a pass is a loop of
our own over rays, for every shape of stop; ``scalar_spectral`` has the stock plugins (``stock``). Both return mean
electrons a second for every channel, E = pi L (r/s)^2 cos^4 summed over the spectrum.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dasim.camera import geometry, radiometry
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import irradiance, pupil, stock, transport, wave
from dasim.render.irradiance import Field
from dasim.render.plugin import tensor
from dasim.render.sobol import Sobol
from dasim.spectra import grid
from dasim.typing import FloatArray, ShareDone

LANES = 1 << 21  # rays in flight: bounds the memory, and is fixed, since it decides the random numbers
WAVE_BLUR_PX = 150.0  # visible blur up to which weights are tabulated; beyond, blur is that of the drawn rays
SAME_BLUR_PX, SAME_BLUR_SHARE = 0.5, 0.05  # how far the blur on one surface goes, slanted ones included
ONE_DEPTH_SHARE = 0.97  # of the weights of a pixel that sees one depth: diffraction's tails reach others everywhere
DRAW_NODES = 4096  # of the table that turns a uniform number into a wavelength
HERO = 4  # wavelengths a ray
EVEN_SHARE = 0.1  # of the wavelengths are drawn as for an even light
MOST_MARGIN_PX = 300.0


@dataclass(frozen=True)
class Sampling:
    """How a pass is sampled: samples a pixel, seed, and what is told of the progress."""

    spp: int
    seed: int
    progress: ShareDone = lambda share: None


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
) -> FloatArray:
    """Mean electrons a second through one stop, [h, w, channel].

    ``max_blur_px`` is the largest visible blur in the scene, for the wave tables; ``illuminant`` weights the
    in-focus kernel of ``airy``; ``field`` is the irradiance where it is known (see :func:`irradiance_field`).
    """
    import mitsuba as mi

    if mi.variant().startswith("scalar"):
        stock.check(camera)
        rate = stock.stop_pass(mitsuba_scene, camera, stop, sampling.spp, _seeds(sampling, stop), sampling.progress)
        if diffraction == "airy":
            rate = stock.in_focus_diffraction(rate, camera, stop, illuminant)
    else:
        waves = max_blur_px if diffraction == "wave" else None
        response = radiometry.stop_response(camera, stop)
        rate = _ray_loop(mitsuba_scene, camera, stop, sampling, waves, field, response)
    return rate * radiometry.relative_illumination(camera)[..., None]


def sample_count(spp: int) -> int:
    """Samples a pixel that a pass really takes: the sampler of ``scalar_spectral`` rounds up to a grid."""
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
        px_per_m=_px_per_m(camera),
        margin_px=min(max_blur_px, MOST_MARGIN_PX) / 2 + irradiance.STRIDE_PX,
        spectrum=spectrum,
        spp=spp,
        seed=seed,
    )


def pinhole_pass(
    mitsuba_scene: Any,
    camera: Camera,
    sampling: Sampling,
    field: Field | None = None,
    response: FloatArray | None = None,
) -> FloatArray:
    """Mean electrons a second with every stop shrunk to a point at unchanged light, [h, w, channel].

    Through a point all stops see the same rays, so one pass serves them all. ``response`` [channel, wavelength] is the
    camera's own if None.
    """
    import mitsuba as mi

    response = radiometry.response(camera) if response is None else response
    if mi.variant().startswith("scalar"):
        seeds = _seeds(sampling, None)
        rate = stock.pinhole_pass(mitsuba_scene, camera, response, sampling.spp, seeds, sampling.progress)
    else:
        rate = _ray_loop(mitsuba_scene, camera, None, sampling, None, field, response)
    return rate * radiometry.relative_illumination(camera)[..., None]


def draw_density(whole: FloatArray, response: FloatArray, light: FloatArray | None = None) -> FloatArray:
    """Density of drawn wavelengths: a stop's signals under a light, each channel relative to its ``whole`` signal.

    A channel that a stop barely reaches gets few samples there, because it needs few. ``light`` is a spectrum on the
    grid, an even one if None.
    """
    light = np.ones_like(grid.WAVELENGTH_NM) if light is None else light
    total = grid.integrate(whole * light)
    share = response / np.where(total > 0, total, 1.0)[:, None]
    density = np.sum(share * light, axis=0)
    # What the lights' own spectrum hardly has may still come from another source.
    even = np.sum(share, axis=0) * light.mean()
    density = (1 - EVEN_SHARE) * density + EVEN_SHARE * even
    density[density < 1e-4 * density.max()] = 0.0
    return density


def _draw_table(camera: Camera, response: FloatArray, light: FloatArray, density: FloatArray) -> FloatArray:
    """What belongs to a drawn wavelength, at equal steps of probability, [DRAW_NODES, ...].

    Columns are the wavelength, its focus vergence, response / density of each channel, and the light's spectrum. The
    mean of response x light is its integral, so that an even surface is exact.
    """
    fine = np.linspace(grid.WAVELENGTH_NM[0], grid.WAVELENGTH_NM[-1], 20_001)
    step = fine[1] - fine[0]
    pdf = np.interp(fine, grid.WAVELENGTH_NM, density)
    cdf = np.concatenate([[0.0], np.cumsum((pdf[1:] + pdf[:-1]) / 2 * step)])
    total = cdf[-1]
    nodes = (np.arange(DRAW_NODES) + 0.5) / DRAW_NODES
    wavelength = np.interp(nodes, cdf / total, fine)
    at = np.interp(wavelength, grid.WAVELENGTH_NM, density)
    lit = np.interp(wavelength, grid.WAVELENGTH_NM, light)
    columns = [wavelength, np.interp(wavelength, grid.WAVELENGTH_NM, geometry.focus_vergence(camera))]
    for row in response:
        ratio = np.interp(wavelength, grid.WAVELENGTH_NM, row) * total / at
        mean = (ratio * lit).mean()
        columns.append(ratio * (grid.integrate(row * light) / mean if mean > 0 else 0.0))
    return np.stack([*columns, lit], axis=-1)


def _ray_loop(
    scene: Any,
    camera: Camera,
    stop: Stop | None,
    sampling: Sampling,
    max_blur_px: float | None,
    field: Field | None,
    response: FloatArray,
) -> FloatArray:
    """A pass of our own through a stop, or through a point; ``max_blur_px`` is None for geometric optics."""
    import drjit as dr
    import mitsuba as mi

    width, height = camera.sensor.width_px, camera.sensor.height_px
    rows_at_once = max(1, LANES // (sampling.spp * width))
    # Numbers that change from picture to picture are opaque: a kernel is compiled once, and found again.
    each, columns = dr.opaque(mi.UInt32, sampling.spp), dr.opaque(mi.UInt32, width)
    middle = mi.Point2f(dr.opaque(mi.Float, width / 2), dr.opaque(mi.Float, height / 2))
    px_per_m = dr.opaque(mi.Float, _px_per_m(camera))
    radius_m = dr.opaque(mi.Float, geometry.aperture_m(camera) / 2)
    per_vergence = 2 * radius_m * px_per_m  # pixels of visible blur
    vergence = dr.opaque(mi.Float, 1.0 / camera.lens.focus_distance_m)
    light = np.ones_like(grid.WAVELENGTH_NM) if field is None else field.light
    mean_signal = grid.integrate(response * light)
    rate = np.zeros((height, width, len(response)))
    if mean_signal.max() <= 0:
        return rate
    density = draw_density(radiometry.response(camera) if stop is not None else response, response, light)
    table = mi.Texture1f(tensor(_draw_table(camera, response, light, density)))
    draw_pupil = None if stop is None else pupil.drawer(stop)
    blur_range = 0.0 if max_blur_px is None else wave.blur_range_px(camera, max_blur_px, WAVE_BLUR_PX)
    blur = None if stop is None or max_blur_px is None else wave.weigher(camera, stop, density, blur_range)

    # With axial colour every wavelength has rays of its own; without, four share one.
    spacing = 0.0 if camera.lens.focal_shift_um else 1 / HERO
    integrator = transport.path_integrator()
    spp = sampling.spp
    sampler = mi.load_dict({"type": "independent", "sample_count": spp})  # deeper in the paths
    sampler.set_samples_per_wavefront(spp)
    seeds = _seeds(sampling, stop)
    for block, top in enumerate(range(0, height, rows_at_once)):
        rows = min(rows_at_once, height - top)
        lanes = rows * width * spp
        sampler.seed(dr.opaque(mi.UInt32, seeds(block)), lanes)
        pixel = dr.arange(mi.UInt32, lanes) // each
        row = pixel // columns
        corner = mi.Point2f(mi.Float(pixel - row * columns), mi.Float(row + dr.opaque(mi.UInt32, top)))
        numbers = Sobol(spp, dr.arange(mi.UInt32, lanes) % each, pixel + dr.opaque(mi.UInt32, seeds(block)))
        # The first dimensions are the most even: to what decides most.
        lens, film, light, direction = (numbers.next_2d() for _ in range(4))
        first, pattern, lobe = numbers.next_1d(), numbers.next_2d(), numbers.next_1d()
        film += corner - middle  # pixels from the axis
        entries, wavelengths = [], mi.Spectrum(0.0)
        for k in range(HERO):
            shifted = first + k * spacing
            entries.append(table.eval(mi.Point1f(shifted - dr.floor(shifted))))
            wavelengths[k] = entries[k][0]
        focus = entries[0][1] if spacing == 0 else mi.Float(vergence)

        on_lens, delta, drawn = mi.Point2f(0.0), mi.Point2f(0.0), mi.Float(1.0)
        if blur is not None:
            expected = dr.gather(mi.Float, _middle_vergence(scene, corner, spp, middle, px_per_m), pixel)
            defocus = per_vergence * (expected - focus)
            on_lens, delta, drawn = blur.draw(lens, pattern, defocus, dr.opaque(mi.UInt32, seeds(block)))
        elif draw_pupil is not None:
            on_lens = draw_pupil(lens)
        on_lens *= radius_m
        aim = film + delta
        origin = mi.Point3f(on_lens.x, on_lens.y, 0.0)
        # Through the film position and what lies in focus there; beyond infinity that is behind the camera.
        slope = aim / px_per_m - on_lens * focus
        ray = mi.RayDifferential3f(mi.Ray3f(origin, dr.normalize(mi.Vector3f(slope.x, slope.y, 1.0))))
        ray.wavelengths = wavelengths

        si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.All, coherent=True)
        weight, spread = [mi.Float(1.0)] * HERO, []
        if blur is not None:
            point = dr.select(si.is_valid(), si.p, ray(1e4))
            u = film - mi.Point2f(point.x, point.y) / point.z * px_per_m
            ratios = blur.weights(u, per_vergence * (1 / point.z - focus), [entry[0] for entry in entries])
            weight = [drawn * ratio for ratio in ratios]
            seen, middle_blur = (per_vergence * (at - vergence) for at in (1 / point.z, expected))
            near = dr.abs(seen - middle_blur) <= SAME_BLUR_PX + SAME_BLUR_SHARE * dr.abs(middle_blur)
            counted = sum(weight)
            spread = [counted, dr.select(near, counted, 0.0)]
        radiance = transport.radiance(scene, integrator, sampler, ray, si, (light, direction, lobe), field)

        sums, lit = list(spread), [entry[-1] for entry in entries]
        for channel in range(len(response)):
            share = [entries[k][2 + channel] * weight[k] for k in range(HERO)]
            sums += [sum(share[k] * radiance[k] for k in range(HERO)), sum(share[k] * lit[k] for k in range(HERO))]
        dr.eval(*sums)  # one kernel for all: summing first would trace the rays once a sum
        totals = [np.array(dr.block_sum(value, spp), dtype=np.float64) for value in sums]
        one_depth = totals[1] >= ONE_DEPTH_SHARE * totals[0] if spread else np.True_
        # The control variate: response x light x weight has a known mean where one depth is seen, and dividing by
        # what was drawn of it takes the noise of drawing wavelengths and weights out. Near a depth step the
        # weights' mean is not 1, so there the plain mean stays.
        for channel in range(len(response)):
            signal, control = totals[len(spread) + 2 * channel : len(spread) + 2 * channel + 2]
            expected = HERO * spp * mean_signal[channel]
            divisor = np.where(one_depth, control, expected)
            part = np.divide(signal, divisor, out=np.zeros_like(signal), where=divisor > 0)
            rate[top : top + rows, :, channel] = mean_signal[channel] * part.reshape(rows, width)
        sampling.progress((top + rows) / height)
    return rate


def _px_per_m(camera: Camera) -> float:
    """Pixels on the sensor of a metre at a distance of one metre."""
    return geometry.image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)


def _middle_vergence(scene: Any, corner: Any, spp: int, middle: Any, px_per_m: Any) -> Any:
    """Inverse depth of what the ray through the middle of each pixel and of the lens meets first, 1/m; 0 for nothing.

    ``corner`` are the pixels' corners, ``spp`` times each; ``middle`` is the frame's.
    """
    import drjit as dr
    import mitsuba as mi

    first = dr.arange(mi.UInt32, dr.width(corner) // spp) * spp
    at = dr.gather(mi.Point2f, corner, first) + 0.5 - middle
    towards = mi.Vector3f(at.x / px_per_m, at.y / px_per_m, 1.0)
    hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(0.0), towards), coherent=True)
    vergence = dr.select(hit.is_valid(), dr.rcp(hit.t), 0.0)  # the direction's z is 1, so t is depth
    dr.eval(vergence)
    return vergence


def _seeds(sampling: Sampling, stop: Stop | None) -> Callable[[int], int]:
    """Seed of a block of rows, of its own for each stop (told apart by its name)."""
    name = zlib.crc32(stop.name.encode()) if stop is not None else 0
    return lambda block: int(np.random.SeedSequence((sampling.seed, name, block)).generate_state(1)[0])
