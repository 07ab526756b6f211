"""Passes with the stock plugins of ``scalar_spectral``: a centred disc is a ``thinlens`` with a ``specfilm``.

Other shapes, axial colour and aberrations need the ray loop of a JIT variant.

Tested in tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dasim.base.errors import InputError
from dasim.camera import geometry, pointspread, radial_pattern, radiometry, stops, wavefront
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import truth
from dasim.render.plugin import spectrum_dict
from dasim.render.ray_batches import Sampling
from dasim.render.translate import MAX_PATH_DEPTH
from dasim.render.wavelengths import Responses
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray

RAYS = 1 << 22  # per block: progress and Ctrl-C every few seconds
PINHOLE_RATIO = 1e-4  # of the lens radius: the plugin needs a lens of some size


def check(camera: Camera) -> None:
    """Raise InputError if the camera has stops other than centred discs, axial colour, or phase in its pupil."""
    problems = [f"stop '{stop.name}' is not a centred disc" for stop in camera.stops if not stops.is_plain_disc(stop)]
    if any(value % 0.5 for value in principal_point(camera.sensor)):
        problems.append("sensor.principal_point_px is not a multiple of half a pixel")
    if camera.lens.focal_shift_um:
        problems.append("lens.focal_shift_um is set")
    if camera.lens.distortion_per_mm:
        problems.append("lens.distortion_per_mm is set")
    if not wavefront.is_perfect(camera):
        problems.append("wavefront_nm or lens.wavefront_by_field is set")
    problems += [f"stop '{stop.name}' has a phase_nm" for stop in camera.stops if stop.phase_nm]
    if problems:
        raise InputError(
            f"camera '{camera.name}': {'; '.join(problems)}; scalar_spectral cannot render that, a JIT variant can: "
            "install LLVM 17 or newer ('apt-get install libllvm19') for llvm_ad_spectral"
        )


def stop_pass(scene: Any, camera: Camera, stop: Stop, responses: Responses, sampling: Sampling) -> FloatArray:
    """Mean electrons per second through a centred disc, [h, w, channel], before the falloff of illumination."""
    assert isinstance(stop, stops.Disc)
    radius_m = stop.radius_ratio * geometry.aperture_m(camera) / 2
    return _render(scene, camera, radius_m, responses, sampling, stop)


def pinhole_pass(scene: Any, camera: Camera, responses: Responses, sampling: Sampling) -> FloatArray:
    """Mean electrons per second through a pinhole."""
    point_m = PINHOLE_RATIO * geometry.aperture_m(camera) / 2
    return _render(scene, camera, point_m, responses, sampling, None)


def _render(
    scene: Any, camera: Camera, radius_m: float, responses: Responses, sampling: Sampling, stop: Stop | None
) -> FloatArray:
    """Render blocks of rows; every ring that a block touches has film channels of its own."""
    import mitsuba as mi

    seeds = sampling.block_seeds(stop)
    width, height = camera.sensor.width_px, camera.sensor.height_px
    columns, lines = (_centred(*each) for each in zip((width, height), principal_point(camera.sensor), strict=True))
    rate = np.zeros((height, width, responses.channels))
    rows_at_once = max(1, RAYS // (int(sampling.spp) * width))
    for block, top in enumerate(range(0, height, rows_at_once)):
        rows = min(rows_at_once, height - top)
        film: dict[str, Any] = {
            "type": "specfilm",
            "width": columns.extent,
            "height": lines.extent,
            "crop_offset_x": columns.start,
            "crop_offset_y": lines.start + top,
            "crop_width": width,
            "crop_height": rows,
            "rfilter": {"type": "box"},
            "component_format": "float32",
        }
        place = responses.place[top : top + rows]
        first, last = int(place.min()), min(int(place.max()) + 1, len(responses.of_pass) - 1)
        curves = responses.of_pass[first : last + 1]
        peaks = curves.max(axis=-1)
        for number, (row, peak) in enumerate(zip(curves.reshape(-1, curves.shape[-1]), peaks.ravel(), strict=True)):
            film[f"c{number:04d}"] = spectrum_dict(row / peak if peak > 0 else np.ones_like(row))  # times 0
        sensor = mi.load_dict(
            {
                "type": "thinlens",
                "aperture_radius": radius_m,
                "focus_distance": camera.lens.focus_distance_m,
                "fov": truth.field_of_view_deg(camera, columns.extent),
                "fov_axis": "x",
                "near_clip": 1e-4,
                "far_clip": 1e5,
                "to_world": truth.camera_axes(),
                "film": film,
                "sampler": {"type": "multijitter", "sample_count": int(sampling.spp)},
            }
        )
        integrator = mi.load_dict({"type": "path", "max_depth": MAX_PATH_DEPTH})
        image = mi.render(scene, sensor=sensor, integrator=integrator, spp=0, seed=seeds(block))
        by_ring = np.array(image, dtype=np.float64).reshape(rows, width, *peaks.shape) * peaks
        for ring in range(first, last + 1):
            share = np.maximum(1 - np.abs(place - ring), 0.0)
            rate[top : top + rows] += share[..., None] * by_ring[:, :, ring - first]
        sampling.progress((top + rows) / height)
    return rate


class _Film(NamedTuple):
    """Extent of a film that is centred on the axis, and where the sensor's pixels begin on it."""

    extent: int
    start: int


def _centred(pixels: int, axis_px: float) -> _Film:
    """The smallest such film along x or y; the plugin's axis is in the middle of the film."""
    half = max(axis_px, pixels - axis_px)
    return _Film(round(2 * half), round(half - axis_px))


def in_focus_diffraction(rate: FloatArray, camera: Camera, stop: Stop, illuminant: str) -> FloatArray:
    """Convolve with the in-focus diffraction patterns of a disc by their transfer functions; edges are mirrored.

    An approximation: the convolution of blur disc and Airy pattern is not the kernel of wave optics out of focus.
    """
    from scipy import fft

    weights = radiometry.stop_response(camera, stop) * illuminants.illuminant(illuminant)
    f_number = pointspread.working_f_number(camera, stops.reach(stop))
    height, width = rate.shape[:2]
    # The cosine transform of a frame that is mirrored at its edges has frequencies k / (2 n) cycles per pixel.
    frequency = np.hypot(np.arange(height)[:, None] / (2 * height), np.arange(width)[None, :] / (2 * width))
    result = np.empty_like(rate)
    for channel in range(rate.shape[-1]):
        transfer, total = np.zeros_like(frequency), 0.0
        for wavelength_nm, weight in grid.bands(weights[channel : channel + 1]):
            scale_px = wavelength_nm * 1e-3 * f_number / camera.sensor.pixel_pitch_um
            transfer += weight[0] * radial_pattern.ring_mtf(frequency * scale_px)
            total += weight[0]
        if total > 0:
            blurred = fft.idctn(fft.dctn(rate[..., channel], type=2) * (transfer / total), type=2)
            result[..., channel] = np.maximum(blurred, 0.0)
        else:
            result[..., channel] = rate[..., channel]
    return result
