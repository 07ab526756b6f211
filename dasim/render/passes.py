"""Rendering passes: one per stop, each with a plain pupil and the wavelengths that its stop passes.

The camera is linear, so its picture is the sum of its stops' pictures. In the JIT variants a pass is a loop of
our own over rays; in ``scalar_spectral`` it is a stock ``thinlens`` with a ``specfilm``. Both return mean
electrons a second for every channel, E = pi L (r/s)^2 cos^4 summed over the spectrum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dasim import camera as cameras
from dasim import pointspread, spectra
from dasim.aperture import Stop
from dasim.camera import Camera
from dasim.render import truth, wave
from dasim.render.translate import MAX_PATH_DEPTH, spectrum_dict
from dasim.spectra import FloatArray

Progress = Callable[[float], None]

LANES = 1 << 22  # rays in flight: bounds the memory, and is fixed, since it decides the random numbers
WAVE_BLUR_PX = 150.0  # visible blur up to which weights are tabulated; beyond, blur is that of the drawn rays
SAME_BLUR_PX, SAME_BLUR_SHARE = 0.25, 0.02  # spread of the blur on one surface, slanted ones included
DRAW_NODES = 4096  # of the table that turns a uniform number into a wavelength
SCALAR_RAYS = 1 << 22  # a block in scalar_spectral: some seconds between two steps of the progress bar, or a Ctrl-C
PINHOLE_RATIO = 1e-4  # of the lens radius: the stock plugin needs a lens that is not a point


@dataclass(frozen=True)
class Sampling:
    """How a pass is sampled: samples a pixel (rounded up to a grid), seed, and what is told of the progress."""

    spp: int
    seed: int
    progress: Progress = lambda share: None


def stop_pass(
    mitsuba_scene: Any,
    camera: Camera,
    stop: Stop,
    sampling: Sampling,
    *,
    diffraction: str = "off",
    max_blur_px: float = 0.0,
    illuminant: str = "D65",
) -> FloatArray:
    """Mean electrons a second through one stop, [h, w, 4 (R, G, B, IR)].

    ``max_blur_px`` is the largest visible blur in the scene, for the wave tables; ``illuminant`` weights the
    in-focus kernel of ``airy``.
    """
    import mitsuba as mi

    response = cameras.stop_response(camera, stop)
    radius_m = stop.radius_ratio * cameras.aperture_m(camera) / 2
    if mi.variant().startswith("scalar"):
        rate = _stock_pass(mitsuba_scene, camera, radius_m, response, sampling)
        if diffraction == "airy":
            rate = _in_focus_diffraction(rate, camera, stop, response * spectra.illuminant(illuminant))
    else:
        wave_blur_px = stop.radius_ratio * min(max_blur_px, WAVE_BLUR_PX) if diffraction == "wave" else None
        rate = _ray_loop(mitsuba_scene, camera, radius_m, response, sampling, wave_blur_px)
    return rate * _cos4(camera)[..., None]


def sample_count(spp: int) -> int:
    """Samples a pixel that a pass really takes: the sampler rounds up to a grid."""
    import mitsuba as mi

    return int(mi.load_dict({"type": "multijitter", "sample_count": spp}).sample_count())


def pinhole_pass(mitsuba_scene: Any, camera: Camera, sampling: Sampling) -> FloatArray:
    """Mean electrons a second with every stop shrunk to a point at unchanged light, [h, w, 4].

    Through a point all stops see the same rays, so one pass serves them all.
    """
    import mitsuba as mi

    response = cameras.response(camera)
    if mi.variant().startswith("scalar"):
        point_m = PINHOLE_RATIO * cameras.aperture_m(camera) / 2
        rate = _stock_pass(mitsuba_scene, camera, point_m, response, sampling)
    else:
        rate = _ray_loop(mitsuba_scene, camera, 0.0, response, sampling, None)
    return rate * _cos4(camera)[..., None]


def _cos4(camera: Camera) -> FloatArray:
    """Natural vignetting, cos^4 of the chief ray's angle at the pixel's centre, [h, w]."""
    sensor = camera.sensor
    pitch_m = sensor.pixel_pitch_um * 1e-6
    x = (np.arange(sensor.width_px) + 0.5 - sensor.width_px / 2) * pitch_m
    y = (np.arange(sensor.height_px) + 0.5 - sensor.height_px / 2) * pitch_m
    s2 = cameras.image_distance_m(camera) ** 2
    return (s2 / (s2 + x[None, :] ** 2 + y[:, None] ** 2)) ** 2


# --- the ray loop of the JIT variants ------------------------------------------------------------


def draw_density(camera: Camera, response: FloatArray) -> FloatArray:
    """Density of drawn wavelengths: the stop's responses, each channel relative to its whole signal.

    A channel that a stop barely reaches gets few samples there, because it needs few.
    """
    whole = spectra.integrate(cameras.response(camera))
    density = np.sum(response / np.where(whole > 0, whole, 1.0)[:, None], axis=0)
    density[density < 1e-4 * density.max()] = 0.0
    return density


def _draw_table(response: FloatArray, density: FloatArray) -> FloatArray:
    """Wavelength and response / density per channel at equal steps of probability, [DRAW_NODES, 5].

    The mean of the response columns is the integral of the response, so that a flat light is exact.
    """
    fine = np.linspace(spectra.WAVELENGTH_NM[0], spectra.WAVELENGTH_NM[-1], 20_001)
    step = fine[1] - fine[0]
    pdf = np.interp(fine, spectra.WAVELENGTH_NM, density)
    cdf = np.concatenate([[0.0], np.cumsum((pdf[1:] + pdf[:-1]) / 2 * step)])
    total = cdf[-1]
    nodes = (np.arange(DRAW_NODES) + 0.5) / DRAW_NODES
    wavelength = np.interp(nodes, cdf / total, fine)
    at = np.interp(wavelength, spectra.WAVELENGTH_NM, density)
    columns = [wavelength]
    for row in response:
        ratio = np.interp(wavelength, spectra.WAVELENGTH_NM, row) * total / at
        mean = ratio.mean()
        columns.append(ratio * (spectra.integrate(row) / mean if mean > 0 else 0.0))
    return np.stack(columns, axis=-1)


def _ray_loop(
    scene: Any,
    camera: Camera,
    radius_m: float,
    response: FloatArray,
    sampling: Sampling,
    wave_blur_px: float | None,
) -> FloatArray:
    """A pass of our own: ``wave_blur_px`` is the largest blur of this stop, None for geometric optics."""
    import drjit as dr
    import mitsuba as mi

    width, height = camera.sensor.width_px, camera.sensor.height_px
    pitch_m = camera.sensor.pixel_pitch_um * 1e-6
    image_m, focus_m = cameras.image_distance_m(camera), camera.lens.focus_distance_m
    density = draw_density(camera, response)
    table = mi.Texture1f(mi.TensorXf(_draw_table(response, density).astype(np.float32)))
    mean_response = spectra.integrate(response)
    if wave_blur_px is not None:
        f_number = image_m / (2 * radius_m)
        info = wave.wave_tables(density, f_number, pitch_m * 1e6, wave_blur_px, wave.shortest_wavelength_nm(density))
        tables = {
            "density": mi.Texture2f(mi.TensorXf(info.density[..., None].astype(np.float32))),
            "wave": mi.Texture2f(mi.TensorXf(info.wave[..., None].astype(np.float32))),
            "offset": mi.Texture1f(mi.TensorXf(info.offset_px[:, None].astype(np.float32))),
        }
        scale_per_nm = f_number * 1e-9 / pitch_m

    integrator = mi.load_dict({"type": "path", "max_depth": MAX_PATH_DEPTH})
    sampler = mi.load_dict({"type": "multijitter", "sample_count": sampling.spp})
    spp = sampler.sample_count()  # rounded up to a grid
    sampler.set_samples_per_wavefront(spp)
    rows_at_once = max(1, LANES // (spp * width))
    rate = np.empty((height, width, len(spectra.CHANNELS)))
    for block, top in enumerate(range(0, height, rows_at_once)):
        rows = min(rows_at_once, height - top)
        lanes = rows * width * spp
        key = _block_seed(sampling.seed, radius_m, block)
        sampler.seed(dr.opaque(mi.UInt32, key), lanes)
        pixel = dr.arange(mi.UInt32, lanes) // spp
        row = pixel // width
        corner = mi.Point2f(mi.Float(pixel - row * width), mi.Float(row + dr.opaque(mi.UInt32, top)))
        film = corner + sampler.next_2d() - mi.Point2f(width / 2, height / 2)  # pixels from the axis
        pupil = radius_m * mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
        aim = film
        if wave_blur_px is not None:
            draw = sampler.next_2d()
            length = tables["offset"].eval(mi.Point1f((draw.x * (wave.OFFSET_NODES - 1) + 0.5) / wave.OFFSET_NODES))[0]
            aim = film + length * mi.Point2f(dr.cos(2 * dr.pi * draw.y), dr.sin(2 * dr.pi * draw.y))
        origin = mi.Point3f(pupil.x, pupil.y, 0.0)
        in_focus = mi.Point3f(aim.x * (pitch_m / image_m), aim.y * (pitch_m / image_m), 1.0) * focus_m
        ray = mi.RayDifferential3f(mi.Ray3f(origin, dr.normalize(in_focus - origin)))

        first = sampler.next_1d()
        response_at, wavelengths = [], mi.Spectrum(0.0)
        for k in range(4):
            shifted = first + k / 4
            entry = table.eval(mi.Point1f(shifted - dr.floor(shifted)))
            wavelengths[k] = entry[0]
            response_at.append(entry[1:])
        ray.wavelengths = wavelengths

        weight = mi.Spectrum(1.0)
        if wave_blur_px is not None:
            hit = scene.ray_intersect_preliminary(ray, coherent=True)
            point = ray(dr.select(hit.is_valid(), hit.t, 1e4))
            # The film position where the chief ray images the point, relative to where this sample counts.
            seen = mi.Point2f(point.x, point.y) / point.z * (image_m / pitch_m)
            u = dr.norm(seen - film)
            blur = 2 * radius_m / pitch_m * image_m * (1 / point.z - 1 / focus_m)
            scales = [wavelengths[k] * scale_per_nm for k in range(4)]
            for k, ratio in enumerate(wave.weights(tables, info, u, dr.abs(blur), scales)):
                weight[k] = ratio
        radiance, _, _ = integrator.sample(scene, sampler, ray)

        sums = [blur, blur * blur] if wave_blur_px is not None else []
        spread = len(sums)
        for channel in range(len(spectra.CHANNELS)):
            signal = sum(response_at[k][channel] * weight[k] * radiance[k] for k in range(4))
            control = sum(response_at[k][channel] * weight[k] for k in range(4))
            sums += [signal, control]
        dr.eval(*sums)  # one kernel for all: summing first would trace the rays once a sum
        sums = [dr.block_sum(value, spp) for value in sums]
        totals = [np.array(value, dtype=np.float64) for value in sums]
        one_depth = _one_depth(totals[0] / spp, totals[1] / spp) if spread else np.True_
        # The control variate: response * weight has a known mean where one depth is seen, and dividing by what
        # was drawn of it takes the noise of drawing wavelengths and weights out. Near a depth step the weights'
        # mean is not 1, so there the plain mean stays.
        for channel in range(len(spectra.CHANNELS)):
            signal, control = totals[spread + 2 * channel : spread + 2 * channel + 2]
            expected = 4 * spp * mean_response[channel]
            divisor = np.where(one_depth, control, expected)
            share = np.divide(signal, divisor, out=np.zeros_like(signal), where=divisor > 0)
            rate[top : top + rows, :, channel] = mean_response[channel] * share.reshape(rows, width)
        sampling.progress((top + rows) / height)
    return rate


def _one_depth(blur: FloatArray, blur_squared: FloatArray) -> np.ndarray:
    """Pixels whose rays all meet about the same blur, from the mean and mean square of the signed blur in pixels."""
    deviation = np.sqrt(np.maximum(blur_squared - blur**2, 0.0))
    return deviation <= SAME_BLUR_PX + SAME_BLUR_SHARE * np.abs(blur)


def _block_seed(seed: int, radius_m: float, block: int) -> int:
    """Seed of a block of rows, of its own for each stop (told apart by its radius)."""
    return int(np.random.SeedSequence((seed, round(radius_m * 1e9), block)).generate_state(1)[0])


# --- the stock plugins of scalar_spectral --------------------------------------------------------


def _stock_pass(scene: Any, camera: Camera, radius_m: float, response: FloatArray, sampling: Sampling) -> FloatArray:
    import mitsuba as mi

    width, height = camera.sensor.width_px, camera.sensor.height_px
    peaks = response.max(axis=1)
    names = [f"c{index}" for index in range(len(spectra.CHANNELS))]
    rate = np.zeros((height, width, len(names)))
    rows_at_once = max(1, SCALAR_RAYS // (sampling.spp * width))
    for block, top in enumerate(range(0, height, rows_at_once)):
        rows = min(rows_at_once, height - top)
        film: dict[str, Any] = {
            "type": "specfilm",
            "width": width,
            "height": height,
            "crop_offset_x": 0,
            "crop_offset_y": top,
            "crop_width": width,
            "crop_height": rows,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        }
        for name, row, peak in zip(names, response, peaks, strict=True):
            film[name] = spectrum_dict(row / peak if peak > 0 else row)
        sensor = mi.load_dict(
            {
                "type": "thinlens",
                "aperture_radius": radius_m,
                "focus_distance": camera.lens.focus_distance_m,
                "fov": truth.field_of_view_deg(camera),
                "fov_axis": "x",
                "near_clip": 1e-4,
                "far_clip": 1e5,
                "to_world": truth.camera_axes(),
                "film": film,
                "sampler": {"type": "multijitter", "sample_count": sampling.spp},
            }
        )
        integrator = mi.load_dict({"type": "path", "max_depth": MAX_PATH_DEPTH})
        key = _block_seed(sampling.seed, radius_m, block)
        image = mi.render(scene, sensor=sensor, integrator=integrator, spp=0, seed=key)
        rate[top : top + rows] = np.array(image, dtype=np.float64) * peaks
        sampling.progress((top + rows) / height)
    return rate


def _in_focus_diffraction(rate: FloatArray, camera: Camera, stop: Stop, weights: FloatArray) -> FloatArray:
    """Convolve with the stop's in-focus Airy patterns, by their transfer function; the frame's edges are mirrored.

    The product of blur disc and Airy pattern is not the true defocused kernel: an approximation.
    """
    from scipy import fft

    f_number = pointspread.working_f_number(camera, stop.radius_ratio)
    height, width = rate.shape[:2]
    # The cosine transform of a frame that is mirrored at its edges has frequencies k / (2 n) cycles a pixel.
    frequency = np.hypot(np.arange(height)[:, None] / (2 * height), np.arange(width)[None, :] / (2 * width))
    result = np.empty_like(rate)
    for channel in range(rate.shape[-1]):
        transfer, total = np.zeros_like(frequency), 0.0
        for wavelength_nm, weight in pointspread.bands(weights[channel : channel + 1]):
            scale_px = wavelength_nm * 1e-3 * f_number / camera.sensor.pixel_pitch_um
            transfer += weight[0] * pointspread.disc_mtf(frequency * scale_px)
            total += weight[0]
        if total > 0:
            blurred = fft.idctn(fft.dctn(rate[..., channel], type=2) * (transfer / total), type=2)
            result[..., channel] = np.maximum(blurred, 0.0)
        else:
            result[..., channel] = rate[..., channel]
    return result
