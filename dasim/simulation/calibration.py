"""Calibration pictures: a point source in front of the camera, as sec. 5.1 of the paper takes them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from dasim.base.fingerprint import fingerprint
from dasim.camera import geometry, noise, pointspread
from dasim.camera.specification import Camera, as_camera
from dasim.spectra import illuminants
from dasim.typing import FloatArray
from dasim.values import PointPicture, PointPictures

FRAMES = 2  # per exposure
CALIBRATION_LIGHTS = ("D65", "D55", "A", illuminants.ENERGY_SAVING)
# Exposure times over the automatic one, which comes last. In a picture whose core is well exposed, the fixed pattern
# hides the tails of a kernel, and near-infrared under a lamp with little of it.
EXPOSURES = (256.0, 16.0, 1.0)
EXPOSURE_S = 0.01
_BACKGROUND_SHARE = 1e-3  # of the peak: stray light, which the calibration must remove


def levels(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Distances in metres from the lens at which to photograph a point source, and the visible blur there, px."""
    blurs = geometry.level_blur_px(camera)
    return np.asarray(geometry.depth_of_blur_m(camera, blurs)), blurs


def calibration_captures(
    camera: Camera | str | Path,
    lights: Sequence[str] = CALIBRATION_LIGHTS,
    *,
    frames: int = FRAMES,
    seed: int = 0,
    diffraction: str = "wave",
) -> PointPictures:
    """Pictures of a point source for each light, blur level, mosaic position and exposure.

    The kernels are the camera's own (a path-traced point source converges too slowly to calibrate with), at an unknown
    sub-pixel position for each light and level. They pass through the sensor model with automatic exposure to 85 % of
    full scale and with longer ones (``EXPOSURES``). ``shift_px`` covers one period of the mosaic. The pictures do not
    depend on the size of the camera's frame.

    Args:
        camera: a Camera, a bundled name or a path; its own focus is used
        lights: names of illuminants
        frames: number of frames of each picture
        seed: of the positions and of the sensor noise
        diffraction: ``wave``, ``airy`` or ``off``
    """
    camera = as_camera(camera)
    levels_count, positions = len(levels(camera)[0]), len(camera.sensor.mosaic) * len(camera.sensor.mosaic[0])
    description = camera.model_dump(mode="json")
    for size in ("width_px", "height_px"):
        del description["sensor"][size]
    decisive = json.dumps([description, list(lights), frames, seed, diffraction], sort_keys=True)
    return PointPictures(
        camera,
        tuple(lights),
        diffraction,
        count=len(lights) * levels_count * positions * len(EXPOSURES),
        fingerprint=fingerprint(_pictures, values=[decisive], given=("cameras", "scenes")),
        make=partial(_pictures, camera, tuple(lights), frames, seed, diffraction),
    )


def _pictures(
    camera: Camera, lights: Sequence[str], frames: int, seed: int, diffraction: str
) -> Iterator[PointPicture]:
    depths, blurs = levels(camera)
    rows, columns = len(camera.sensor.mosaic), len(camera.sensor.mosaic[0])
    kernel_size = pointspread.kernel_size_px(camera, float(blurs[-1]))
    side = (kernel_size + 2 * max(rows, columns) + 6) // (2 * rows * columns) * (2 * rows * columns)
    side += 2 * rows * columns
    local = camera.sensor.model_copy(update={"width_px": side, "height_px": side})
    frame_camera = camera.model_copy(update={"sensor": local})
    powers = np.stack([illuminants.illuminant(light) for light in lights])
    kernels_at = pointspread.kernels(camera, blurs, powers, side - 1, diffraction)
    for level, (blur, depth) in enumerate(zip(blurs, depths, strict=True)):
        for light_index, light in enumerate(lights):
            key = np.random.SeedSequence((seed, light_index, level))
            place = np.random.Generator(np.random.Philox(key)).uniform(-0.5, 0.5, 2)
            kernel, signal = kernels_at(level, (place[0], place[1]), light_index)
            flux = np.zeros((side, side, len(signal)))
            flux[: side - 1, : side - 1] = np.moveaxis(kernel * signal[:, None, None], 0, -1)
            flux += _BACKGROUND_SHARE * flux.max() * signal / signal.max()
            for dy in range(rows):
                for dx in range(columns):
                    moved = np.roll(flux, (dy, dx), axis=(0, 1))
                    # The strongest channel of any position sets the exposure, the same for all positions.
                    scale = noise.Exposure().auto_level * noise.saturation_e(local) / flux.max()
                    mean_e = scale * noise.mosaic(moved, frame_camera)
                    noise_seed = int(key.generate_state(1)[0])
                    for number, times in enumerate(EXPOSURES):
                        time_s = times * EXPOSURE_S
                        first = frames * ((dy * columns + dx) * len(EXPOSURES) + number)
                        collected_e = noise.electronic_crosstalk(times * mean_e, local)
                        shots = [
                            noise.expose(collected_e, local, time_s, noise_seed, frame=first + frame)[0]
                            for frame in range(frames)
                        ]
                        yield PointPicture(np.stack(shots), light, level, float(depth), float(blur), (dy, dx), time_s)
