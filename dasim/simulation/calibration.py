"""Calibration pictures: a point source in front of the camera, as sec. 5.1 of the paper takes them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.base.fingerprint import fingerprint
from dasim.camera import geometry, pointspread
from dasim.camera import noise as sensor_noise
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.noise import Exposure, NoiseModel
from dasim.camera.sensor import Sensor
from dasim.camera.specification import Camera, as_camera
from dasim.spectra import illuminants
from dasim.typing import FloatArray
from dasim.values import PointPicture, PointPictures

FRAMES = 2  # per exposure
CALIBRATION_LIGHTS = ("D65", "D55", "A", illuminants.ENERGY_SAVING)
# Exposure times relative to the automatic one, which comes last. In a picture whose core is well exposed, the fixed
# pattern hides the tails of the kernel, and the near-infrared signal under lamps that emit little of it.
EXPOSURES = (256.0, 16.0, 1.0)
EXPOSURE_S = 0.01
# The source is repositioned for each light and level: its image lies up to this many periods of the mosaic from its
# nominal field position, on different pixels each time.
_REACH = 32
_BACKGROUND_SHARE = 1e-3  # of the peak: stray light, which the calibration must remove


def levels(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Distances in metres from the lens at which to photograph a point source, and the visible blur there, px."""
    blurs = geometry.level_blur_px(camera)
    return np.asarray(geometry.depth_of_blur_m(camera, blurs)), blurs


def levels_behind(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """The same behind the focus, from it outwards, with negative blur; without axial colour, the focus alone."""
    blurs = geometry.behind_blur_px(camera)
    return np.asarray(geometry.depth_of_blur_m(camera, blurs)), blurs


def calibration_captures(
    camera: Camera | str | Path,
    lights: Sequence[str] = CALIBRATION_LIGHTS,
    *,
    frames: int = FRAMES,
    seed: int = 0,
    diffraction: str = "wave",
    noise: NoiseModel = sensor_noise.expose,
    field_px: tuple[float, float] | None = None,
) -> PointPictures:
    """Pictures of a point source for each light, blur level, mosaic position and exposure.

    If axial colour distinguishes the two sides of the focus, levels behind the focus follow, with negative numbers.

    The kernels are those of the camera model (a path-traced point source converges too slowly for calibration). For
    each light and level, the source is displaced at random from ``field_px`` by up to 32 periods of the mosaic, so that
    its image falls on other pixels, with another fixed pattern; a calibration is not told this position. Each picture
    is taken with the automatic exposure (85 % of full scale) and with multiples of its time
    (``dasim.simulation.calibration.EXPOSURES``). ``shift_px`` covers one period of the mosaic. The pictures do not
    depend on the camera's frame, except through ``field_px``.

    Args:
        camera: a Camera, a bundled name or a path; its own focus is used
        lights: names of illuminants
        frames: number of frames of each picture
        seed: seed of the positions and of the sensor noise
        diffraction: ``wave``, ``airy`` or ``off``
        noise: the noise model, see :data:`dasim.camera.noise.NoiseModel`; only banks with the bundled model are cached
        field_px: (x, y) of the source's image from the optical axis; by default the centre of the camera's frame
    """
    camera = as_camera(camera)
    if isinstance(lights, str) or not lights:
        raise InputError(f"lights: must be a list of one illuminant or more, such as ('D65',), not {lights!r}")
    for light in lights:
        illuminants.illuminant(light)
    if not isinstance(frames, (int, np.integer)) or frames < 1:
        raise InputError(f"frames is {frames!r}; it must be a whole number from 1")
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed is {seed!r}; it must be 0 or a positive whole number")
    field_px = geometry.frame_field_px(camera) if field_px is None else pointspread.pair("field_px", field_px)
    levels_count = len(levels(camera)[0]) + len(levels_behind(camera)[0]) - 1
    positions = len(camera.sensor.mosaic) * len(camera.sensor.mosaic[0])
    description = camera.model_dump(mode="json")
    for size in ("width_px", "height_px", "principal_point_px"):
        del description["sensor"][size]
    bundled = noise is sensor_noise.expose
    decisive = json.dumps([description, list(lights), frames, seed, diffraction, field_px], sort_keys=True)
    return PointPictures(
        camera,
        tuple(lights),
        diffraction,
        field_px,
        count=len(lights) * levels_count * positions * len(EXPOSURES),
        fingerprint=fingerprint(_pictures, values=[decisive], excluding=("cameras", "scenes")) if bundled else None,
        make=partial(_pictures, camera, tuple(lights), frames, seed, diffraction, field_px, noise),
    )


def _pictures(
    camera: Camera,
    lights: Sequence[str],
    frames: int,
    seed: int,
    diffraction: str,
    field_px: tuple[float, float],
    model: NoiseModel,
) -> Iterator[PointPicture]:
    """The pictures, by level, light, shift and exposure."""
    (near_m, near_px), (behind_m, behind_px) = levels(camera), levels_behind(camera)
    depths, blurs = np.append(near_m, behind_m[1:]), np.append(near_px, behind_px[1:])
    numbers = [*range(len(near_m)), *(-k for k in range(1, len(behind_m)))]
    side = _frame_side_px(camera, float(near_px[-1]), field_px)
    powers = np.stack([illuminants.illuminant(light) for light in lights])
    kernels_at = pointspread.kernels(camera, blurs, powers, side - 1, diffraction, field_px)
    shifts = list(np.ndindex(len(camera.sensor.mosaic), len(camera.sensor.mosaic[0])))
    for index, (level, blur, depth) in enumerate(zip(numbers, blurs, depths, strict=True)):
        for light_index, light in enumerate(lights):
            key = np.random.SeedSequence((seed, light_index, index))
            random = np.random.Generator(np.random.Philox(key))
            place = random.uniform(-0.5, 0.5, 2)
            flux = _flux(*kernels_at(index, (place[0], place[1]), light_index))
            noise_seed = int(key.generate_state(1)[0])
            window = camera.model_copy(update={"sensor": _window(camera.sensor, side, field_px, random)})
            moved = (np.roll(flux, shift, axis=(0, 1)) for shift in shifts)
            collected = [electronic_crosstalk(sensor_noise.mosaic(image, window), window) for image in moved]
            brightest = max(image.max() for image in collected)  # the exposure is the same for all shifts
            scale = Exposure().auto_level * sensor_noise.saturation_e(camera.sensor) / brightest
            for number, (shift, image) in enumerate(zip(shifts, collected, strict=True)):
                first = frames * number * len(EXPOSURES)
                for time_s, frames_dn in _exposures(scale * image, window.sensor, frames, noise_seed, first, model):
                    yield PointPicture(frames_dn, light, level, float(depth), float(blur), shift, time_s)


def _frame_side_px(camera: Camera, widest_blur_px: float, field_px: tuple[float, float]) -> int:
    """Side of a square frame that holds the widest kernel at every shift, in whole periods of the mosaic."""
    rows, columns = len(camera.sensor.mosaic), len(camera.sensor.mosaic[0])
    period = 2 * rows * columns
    needed = pointspread.kernel_size_px(camera, widest_blur_px, field_px) + 2 * max(rows, columns) + 6
    return needed // period * period + period


def _window(sensor: Sensor, side: int, field_px: tuple[float, float], random: np.random.Generator) -> Sensor:
    """A square of the sensor at a random place near one of the field, in whole periods of the mosaic from the axis."""
    periods = len(sensor.mosaic[0]), len(sensor.mosaic)
    offset = [
        period * (round(at / period) + int(random.integers(-_REACH, _REACH + 1)))
        for at, period in zip(field_px, periods, strict=True)
    ]
    axis_px = (side / 2 - offset[0], side / 2 - offset[1])
    return sensor.model_copy(update={"width_px": side, "height_px": side, "principal_point_px": axis_px})


def _flux(kernel: FloatArray, signal: FloatArray) -> FloatArray:
    """Relative flux of every channel on a frame of even side, [side, side, channel], with a little stray light."""
    side = kernel.shape[-1] + 1
    flux = np.zeros((side, side, len(signal)))
    flux[: side - 1, : side - 1] = np.moveaxis(kernel * signal[:, None, None], 0, -1)
    return flux + _BACKGROUND_SHARE * flux.max() * signal / signal.max()


def _exposures(
    collected_e: FloatArray, sensor: Sensor, frames: int, seed: int, first: int, model: NoiseModel
) -> Iterator[tuple[float, NDArray[np.uint16]]]:
    """Exposure time and frames [frame, h, w] of each of ``EXPOSURES``; their seeds are numbered from ``first``.

    ``collected_e`` [h, w] are the mean electrons of the shortest exposure.
    """
    for number, times in enumerate(EXPOSURES):
        time_s = times * EXPOSURE_S
        keys = [np.random.SeedSequence((seed, first + number * frames + frame)) for frame in range(frames)]
        seeds = [int(key.generate_state(1)[0]) for key in keys]
        shots = [sensor_noise.apply(model, times * collected_e, sensor, time_s, each, 1.0)[0] for each in seeds]
        yield time_s, np.stack(shots)
