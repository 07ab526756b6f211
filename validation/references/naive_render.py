"""A naive renderer of a camera with several stops: one pass, independent samples, each ray tested against the stops.

It uses the same scene, lens geometry and responses as ``dasim.render.passes``, but none of its sampling, and serves as
the baseline for the cost of rendering. It models no diffraction.

Tested in tests/validation/claims/test_optics_checks.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.camera import geometry, radiometry
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.render.translate import MAX_PATH_DEPTH
from dasim.spectra import grid


def naive_picture(scene: Any, camera: Camera, stop_ratios: Sequence[float], spp: int, seed: int) -> NDArray[np.float64]:
    """Mean electrons per second, [h, w, channel], of a Mitsuba scene with ``spp`` samples per pixel; JIT variants only.

    Each ray starts at a random point of the open lens and carries four wavelengths spread evenly over 400 to 830 nm.
    The stop with the radius ratio rho, one of ``stop_ratios`` per stop, passes rays that start within rho times the
    lens's radius, weighted by its transmittance at each wavelength.
    """
    import drjit as dr
    import mitsuba as mi

    width, height = camera.sensor.width_px, camera.sensor.height_px
    pitch_m = camera.sensor.pixel_pitch_um * 1e-6
    image_m, focus_m = geometry.image_distance_m(camera), camera.lens.focus_distance_m
    radius_m = geometry.aperture_m(camera) / 2
    low, high = float(grid.WAVELENGTH_NM[0]), float(grid.WAVELENGTH_NM[-1])
    # The response of a stop includes the area of that stop, whereas a ray represents the area of the whole lens.
    curves = [
        mi.Texture1f(mi.TensorXf((radiometry.stop_response(camera, stop) / ratio**2).T.astype(np.float32)))
        for stop, ratio in zip(camera.stops, stop_ratios, strict=True)
    ]
    integrator = mi.load_dict({"type": "path", "max_depth": MAX_PATH_DEPTH})
    sampler = mi.load_dict({"type": "independent", "sample_count": spp})
    sampler.set_samples_per_wavefront(spp)
    sampler.seed(seed, width * height * spp)
    index = dr.arange(mi.UInt32, width * height * spp) // spp
    row = index // width
    film = mi.Point2f(mi.Float(index - row * width), mi.Float(row)) + sampler.next_2d()
    film -= mi.Point2f(*principal_point(camera.sensor))
    pupil = mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
    origin = mi.Point3f(radius_m * pupil.x, radius_m * pupil.y, 0.0)
    in_focus = mi.Point3f(film.x * (pitch_m / image_m), film.y * (pitch_m / image_m), 1.0) * focus_m
    ray = mi.RayDifferential3f(mi.Ray3f(origin, dr.normalize(in_focus - origin)))
    first, wavelengths = sampler.next_1d(), mi.Spectrum(0.0)
    for k in range(4):
        shifted = first + k / 4
        wavelengths[k] = low + (high - low) * (shifted - dr.floor(shifted))
    ray.wavelengths = wavelengths
    radiance, _, _ = integrator.sample(scene, sampler, ray)
    sums = [mi.Float(0.0) for _ in grid.CHANNELS]
    for k in range(4):
        nodes = len(grid.WAVELENGTH_NM)
        place = mi.Point1f(((wavelengths[k] - low) / (high - low) * (nodes - 1) + 0.5) / nodes)
        for curve, ratio in zip(curves, stop_ratios, strict=True):
            through = dr.select(dr.norm(pupil) <= ratio, radiance[k], 0.0)
            for channel, response in enumerate(curve.eval(place)):
                sums[channel] += response * through
    dr.eval(*sums)
    totals = [np.array(dr.block_sum(value, spp), dtype=np.float64).reshape(height, width) for value in sums]
    rate = np.stack(totals, axis=-1) * ((high - low) / (4 * spp))
    off_axis = pitch_m * np.hypot(
        np.arange(width)[None, :] + 0.5 - width / 2, np.arange(height)[:, None] + 0.5 - height / 2
    )
    return rate * (image_m**2 / (image_m**2 + off_axis**2))[..., None] ** 2
