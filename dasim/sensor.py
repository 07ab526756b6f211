"""From mean electrons to raw numbers: mosaic, exposure, noise, analogue-to-digital conversion."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dasim.camera import Camera, Sensor, mosaic_channels
from dasim.specification import Specification

FloatArray = NDArray[np.float64]

LONGEST_EXPOSURE_S = 3600.0

# Randomness is keyed by (seed, stage), so that no stage depends on how much another has drawn.
_STAGES = {"shot": 1, "dark": 2, "read": 3, "dsnu": 4, "prnu": 5}


class Exposure(Specification):
    """Exposure time and analogue gain; a time of None means automatic exposure."""

    time_s: float | None = Field(default=None, gt=0, le=LONGEST_EXPOSURE_S)
    gain: float = Field(default=1.0, ge=1.0 / 16, le=1024, description="analogue gain, 1: full well at full scale")
    auto_percentile: float = Field(default=99.5, gt=0, le=100)
    auto_level: float = Field(default=0.85, gt=0, le=1, description="share of full scale that the percentile reaches")


def auto_exposure_s(rate_e_s: FloatArray, camera: Camera, exposure: Exposure) -> float:
    """Exposure time that brings the first channel's percentile to its share of full scale.

    ``rate_e_s`` is [h, w, 4] mean electrons a second; each channel is judged at its own pixels of the mosaic,
    as a camera would. Scenes without light get 1 s.
    """
    channels = mosaic_channels(camera)
    brightest = max(
        float(np.percentile(rate_e_s[..., index][channels == index], exposure.auto_percentile))
        for index in np.unique(channels)
    )
    if brightest <= 0:
        return 1.0
    full_scale_e = camera.sensor.full_well_e * min(1.0, 1.0 / exposure.gain)
    return min(exposure.auto_level * full_scale_e / brightest, LONGEST_EXPOSURE_S)


def electrons_per_dn(sensor: Sensor, gain: float = 1.0) -> float:
    """Electrons one digital number stands for; at gain 1 the full well is at full scale."""
    return sensor.full_well_e / gain / (2**sensor.adc_bits - 1 - sensor.black_level_dn)


def mosaic(image: FloatArray, camera: Camera) -> FloatArray:
    """Pick each pixel's own channel: [h, w, 4] -> [h, w]."""
    return np.take_along_axis(image, mosaic_channels(camera)[..., None], axis=-1)[..., 0]


def expose(
    mean_e: FloatArray,
    sensor: Sensor,
    time_s: float,
    seed: int,
    *,
    gain: float = 1.0,
    frame: int = 0,
    noise: Literal["on", "off"] = "on",
) -> tuple[NDArray[np.uint16], int]:
    """Raw numbers of a frame, and how many of its pixels saturated (EMVA 1288 release 4.0, sec. 2).

    ``mean_e`` is [h, w] photo-electrons of the mosaic. Shot noise is Poisson; dark current doubles every
    ``dark_doubling_k``; DSNU (electrons) and PRNU (relative) are fixed patterns of the seed, the same in
    every ``frame``. With noise off the result is the rounded, clipped mean, without dark signal.
    """
    if noise == "off":
        well = np.minimum(mean_e, sensor.full_well_e)
        return _convert(well, sensor, gain, mean_e >= sensor.full_well_e)
    height_width = mean_e.shape
    prnu = 1.0 + sensor.prnu * _generator(seed, "prnu").standard_normal(height_width)
    dsnu = sensor.dsnu_e * _generator(seed, "dsnu").standard_normal(height_width)
    heat = 2.0 ** ((sensor.temperature_c - 25.0) / sensor.dark_doubling_k)
    dark = np.full(height_width, sensor.dark_current_e_s * heat * time_s)
    electrons = _generator(seed, "shot", frame).poisson(np.maximum(mean_e * prnu, 0.0)).astype(np.float64)
    electrons += _generator(seed, "dark", frame).poisson(dark)
    full = electrons >= sensor.full_well_e
    electrons = np.minimum(electrons, sensor.full_well_e)
    electrons += dsnu + sensor.read_noise_e * _generator(seed, "read", frame).standard_normal(height_width)
    return _convert(electrons, sensor, gain, full)


def _convert(
    electrons: FloatArray, sensor: Sensor, gain: float, full: NDArray[np.bool_]
) -> tuple[NDArray[np.uint16], int]:
    """Raw numbers, and how many pixels are saturated: their well is full or their number at its top."""
    top = 2**sensor.adc_bits - 1
    numbers = np.rint(electrons / electrons_per_dn(sensor, gain)) + sensor.black_level_dn
    return np.clip(numbers, 0, top).astype(np.uint16), int(np.count_nonzero((numbers >= top) | full))


def _generator(seed: int, stage: str, frame: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, _STAGES[stage], frame))))
