"""The one noise model of a sensor: exposure, variance, and from mean electrons to raw numbers.

A pixel that collects a mean of x photo-electrons in a time t shows, in electrons, the variance

    temporal   x + dark(t) + read^2 + 1 / (12 K^2)     from frame to frame: shot noise, dark current, read-out, rounding
    fixed      DSNU^2 + row^2 + column^2           from pixel to pixel, the same in every frame of the camera
               + (spread dark(t))^2 + (PRNU x)^2

with 1 / K electrons per digital number (EMVA 1288 release 4.0, eqs. (15) and (16), and sec. 4.3). Code that weights
pixels by their noise uses these variances; :func:`expose` draws noise with them. Hot pixels are outliers, not part of
these variances.
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dasim.base.errors import InputError
from dasim.base.loading import function_name, locate_error
from dasim.base.toml import Specification
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.fixed_pattern import dark_heat, fixed_pattern
from dasim.camera.sensor import Sensor
from dasim.camera.specification import Camera, mosaic_channels
from dasim.typing import BoolArray, FloatArray

SHORTEST_EXPOSURE_S, LONGEST_EXPOSURE_S = 1e-9, 3600.0
_MOST_E = 1e15  # electrons of a Poisson draw: more than any full well, and within the range of the generator

Precision = TypeVar("Precision", bound=np.floating[Any])

# Randomness is keyed by (seed, stage): no stage depends on how many numbers another has drawn.
_STAGES = {"shot": 1, "dark": 2, "read": 3}


class NoiseModel(Protocol):
    """A noise model: ``model(mean_e, sensor, time_s, seed, gain)`` returns raw numbers and the count of saturated
    pixels.

    ``mean_e`` is [h, w] mean photo-electrons of the mosaic after electronic crosstalk, ``time_s`` the exposure time
    in seconds, ``gain`` the analogue gain. ``seed`` is the seed of the frame; ``sensor.sensor_seed`` is the seed of the
    fixed pattern, which all frames of a camera share, see :func:`dasim.camera.fixed_pattern.fixed_pattern`. The raw
    numbers are uint16 [h, w], including the black level, at most 2^``sensor.adc_bits`` - 1. The same arguments must
    give the same numbers. The bundled model is :func:`dasim.camera.noise.expose` (not :func:`dasim.expose`);
    ``examples/noise_model.py`` is another one.
    """

    def __call__(
        self, mean_e: FloatArray, sensor: Sensor, time_s: float, seed: int, gain: float, /
    ) -> tuple[NDArray[np.uint16], int]:
        """Raw numbers [h, w] and the count of saturated pixels."""
        ...


class Exposure(Specification):
    """Exposure time and analogue gain; a time of None means automatic exposure."""

    time_s: float | None = Field(default=None, ge=SHORTEST_EXPOSURE_S, le=LONGEST_EXPOSURE_S)
    gain: float = Field(default=1.0, ge=1.0 / 16, le=1024, description="analogue gain, a factor on the sensor's own")
    auto_percentile: float = Field(default=99.5, gt=0, le=100)
    auto_level: float = Field(default=0.85, gt=0, le=1, description="share of full scale that the percentile reaches")

    def __repr__(self) -> str:
        time = f"automatic to {self.auto_level:g} of full scale" if self.time_s is None else f"{self.time_s:g} s"
        return f"<Exposure {time}, gain {self.gain:g}>"

    __str__ = __repr__


class Variance(NamedTuple):
    """Variance in electrons^2 of a pixel whose mean is x electrons: constant + linear x + quadratic x^2."""

    constant: float
    linear: float
    quadratic: float

    def at(self, mean_e: NDArray | float) -> NDArray:
        """The variance at mean photo-electrons of any shape and precision; negative means count as 0."""
        x = np.maximum(mean_e, 0)
        return self.constant + self.linear * x + self.quadratic * x**2


def temporal_variance(sensor: Sensor, time_s: float, gain: float = 1.0) -> Variance:
    """Variance of one pixel from frame to frame: shot noise, dark current, read-out, rounding."""
    rounding = electrons_per_dn(sensor, gain) ** 2 / 12
    return Variance(sensor.read_noise_e**2 + dark_e(sensor, time_s) + rounding, 1.0, 0.0)


def fixed_variance(sensor: Sensor, time_s: float) -> Variance:
    """Variance of the fixed pattern from pixel to pixel, the same in every frame: offsets, dark current, PRNU."""
    offsets = sensor.dsnu_e**2 + sensor.row_noise_e**2 + sensor.column_noise_e**2
    dark = float(dark_pattern_e(sensor, np.array(time_s)))
    return Variance(offsets + dark**2, 0.0, sensor.prnu**2)


def dark_pattern_e(sensor: Sensor, time_s: NDArray) -> FloatArray:
    """Standard deviation of the pixels' mean dark electrons after exposures of any shape, without hot pixels."""
    return np.asarray(sensor.dark_current_spread * np.minimum(dark_rate_e_s(sensor) * time_s, _MOST_E))


def variance(sensor: Sensor, time_s: float, gain: float = 1.0) -> Variance:
    """Variance of the pixels of one frame, temporal noise and fixed patterns together."""
    parts = zip(temporal_variance(sensor, time_s, gain), fixed_variance(sensor, time_s), strict=True)
    return Variance(*(temporal + fixed for temporal, fixed in parts))


def full_scale_e(sensor: Sensor, gain: float = 1.0) -> float:
    """Electrons at the converter's highest number: at gain 1 the full well, unless ``dn_per_e`` is given."""
    if sensor.dn_per_e is None:
        return sensor.full_well_e / gain
    return (2**sensor.adc_bits - 1 - sensor.black_level_dn) / (sensor.dn_per_e * gain)


def saturation_e(sensor: Sensor, gain: float = 1.0) -> float:
    """Electrons at which a pixel saturates: the full well or the converter's full scale, whichever is smaller."""
    return min(sensor.full_well_e, full_scale_e(sensor, gain))


def electrons_per_dn(sensor: Sensor, gain: float = 1.0) -> float:
    """Electrons per digital number, 1 / K of EMVA 1288."""
    return full_scale_e(sensor, gain) / (2**sensor.adc_bits - 1 - sensor.black_level_dn)


def dark_rate_e_s(sensor: Sensor) -> float:
    """Mean dark electrons per second at the sensor's temperature; they double every ``dark_doubling_k`` from 25 C."""
    return sensor.dark_current_e_s * dark_heat(sensor)


def dark_e(sensor: Sensor, time_s: float) -> float:
    """Mean dark electrons of an exposure, which are also their variance from frame to frame."""
    return min(dark_rate_e_s(sensor) * time_s, _MOST_E)


def collected_e(raw_dn: NDArray, sensor: Sensor, gain: float = 1.0) -> NDArray:
    """Electrons of raw numbers, in the precision of ``raw_dn``: photo-electrons and dark electrons together."""
    return (raw_dn - sensor.black_level_dn) * electrons_per_dn(sensor, gain)


def auto_exposure_s(rate_e_s: NDArray[np.floating], camera: Camera, exposure: Exposure) -> float:
    """Exposure time that brings a percentile of the brightest channel to its share of full scale.

    ``rate_e_s`` is [h, w, channel] mean electrons per second; each channel is judged at its own pixels of the mosaic,
    as a camera would. Scenes without light get 1 s. Raises InputError for so much light that the time would be shorter
    than ``SHORTEST_EXPOSURE_S``.
    """
    channels = mosaic_channels(camera)
    collected = electronic_crosstalk(mosaic(rate_e_s, camera).astype(np.float64), camera)
    brightest = max(
        float(np.percentile(collected[channels == index], exposure.auto_percentile)) for index in np.unique(channels)
    )
    if brightest <= 0:
        return 1.0
    time_s = exposure.auto_level * saturation_e(camera.sensor, exposure.gain) / brightest
    if time_s < SHORTEST_EXPOSURE_S:
        raise InputError(
            f"exposure: the light needs an exposure time of {time_s:.2g} s, at least {SHORTEST_EXPOSURE_S:g} s is "
            "allowed; use less light or a smaller gain"
        )
    return min(time_s, LONGEST_EXPOSURE_S)


def mosaic(image: NDArray[Precision], camera: Camera) -> NDArray[Precision]:
    """Each pixel's own channel of an image: [h, w, channel] -> [h, w]."""
    return np.take_along_axis(image, mosaic_channels(camera)[..., None], axis=-1)[..., 0]


def expose(
    mean_e: FloatArray,
    sensor: Sensor,
    time_s: float,
    seed: int,
    gain: float = 1.0,
    *,
    frame: int = 0,
    noise: Literal["on", "off"] = "on",
) -> tuple[NDArray[np.uint16], int]:
    """Raw numbers of a frame, and how many of its pixels saturated (EMVA 1288 release 4.0, sec. 2).

    ``mean_e`` is [h, w] photo-electrons of the mosaic. Shot noise and dark current are Poisson, and differ in every
    ``frame`` and for every ``seed``. The fixed pattern (:func:`dasim.camera.fixed_pattern.fixed_pattern`) is that of
    the sensor, the same for all of them. With noise off the result is the rounded, clipped mean, without dark signal.
    """
    if noise == "off":
        well = np.minimum(mean_e, sensor.full_well_e)
        return _convert(well, sensor, gain, mean_e >= sensor.full_well_e)
    height_width = mean_e.shape
    pattern = fixed_pattern(sensor, height_width)
    light = np.clip(mean_e * pattern.sensitivity, 0.0, _MOST_E)
    electrons = _generator(seed, "shot", frame).poisson(light).astype(np.float64)
    electrons += _generator(seed, "dark", frame).poisson(np.minimum(pattern.dark_e_s * time_s, _MOST_E))
    full = electrons >= sensor.full_well_e
    electrons = np.minimum(electrons, sensor.full_well_e)
    electrons += pattern.offset_e + sensor.read_noise_e * _generator(seed, "read", frame).standard_normal(height_width)
    return _convert(electrons, sensor, gain, full)


def apply(
    model: NoiseModel, mean_e: FloatArray, sensor: Sensor, time_s: float, seed: int, gain: float
) -> tuple[NDArray[np.uint16], int]:
    """Expose with a noise model; InputError where a user's model raises or its result is not what a model returns."""
    if model is expose:
        return expose(mean_e, sensor, time_s, seed, gain)
    where = f"noise model '{function_name(model)}'"
    try:
        result: Any = model(mean_e, sensor, time_s, seed, gain)
    except (Exception, SystemExit) as error:  # whatever the user's function raises
        raise InputError(f"{where}: raised {locate_error(error)}") from error
    if not (isinstance(result, tuple) and len(result) == 2):
        kind = type(result).__name__
        raise InputError(f"{where}: must return raw numbers and the count of saturated pixels, not one {kind}")
    raw_dn, saturated = result
    if not isinstance(raw_dn, np.ndarray) or raw_dn.dtype != np.uint16 or raw_dn.shape != mean_e.shape:
        got = f"{raw_dn.dtype} {list(raw_dn.shape)}" if isinstance(raw_dn, np.ndarray) else type(raw_dn).__name__
        raise InputError(f"{where}: raw numbers must be an array of uint16 {list(mean_e.shape)}, not {got}")
    top = 2**sensor.adc_bits - 1
    if raw_dn.max() > top:
        raise InputError(f"{where}: a raw number is {raw_dn.max()}; the sensor has {sensor.adc_bits} bits, 0 to {top}")
    if not isinstance(saturated, int | np.integer) or not 0 <= saturated <= raw_dn.size:
        raise InputError(f"{where}: the count of saturated pixels must be 0 to {raw_dn.size}, not {saturated!r}")
    return raw_dn, int(saturated)


def _convert(electrons: FloatArray, sensor: Sensor, gain: float, full: BoolArray) -> tuple[NDArray[np.uint16], int]:
    """Raw numbers, and how many pixels are saturated: their well is full or their number is the highest."""
    top = 2**sensor.adc_bits - 1
    numbers = np.rint(electrons / electrons_per_dn(sensor, gain)) + sensor.black_level_dn
    return np.clip(numbers, 0, top).astype(np.uint16), int(np.count_nonzero((numbers >= top) | full))


def _generator(seed: int, stage: str, frame: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, _STAGES[stage], frame))))
