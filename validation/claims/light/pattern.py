"""Claim on the fixed pattern: flats and darks of a camera, as on a bench."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import dasim
from dasim.camera import noise
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.sensor import Sensor, channels
from dasim.camera.specification import Camera, mosaic_channels
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.rendering import seeds_of

SIZE_PX = (192, 144)
FRAMES = 4  # of each stack
SPP = 4
OTHER_SENSOR = 1
WALL = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40), "material": "white-paper"}
FLAT_LUX = 10.0  # dim, so that the exposure is long enough for dark current and hot pixels to count
DARK_LUX = 1e-6  # the least that a scene may have
LEVEL = 0.5  # of full scale, of the brightest channel


@dataclass(frozen=True)
class Stack:
    """Frames of one camera, light and exposure time."""

    electrons: FloatArray  # [frame, h, w] of the raw numbers above black, dark current included
    light_e: FloatArray  # [frame, h, w] mean photo-electrons of the truth, with rendering noise
    time_s: float

    @property
    def mean(self) -> FloatArray:
        """Mean frame, [h, w]."""
        return np.asarray(self.electrons.mean(axis=0))


def fixed_pattern(progress: ShareDone, seed: int = 0) -> Evidence:
    """The fixed pattern belongs to the camera, the noise to the frame; flats and darks correct it as on a bench.

    Rationale: flat fields, dark frames and every study of them need a sensor that stays the same from one capture to
    the next. A pattern that is drawn anew with each capture cannot be corrected; noise that is shared between captures
    is not averaged away.

    Set-up: da-mobile, its middle 192 x 144 pixels, photographs a white wall under an even sky with `dasim.simulate`:
    two stacks of 4 flats to half of full scale, each frame with its own seed, 4 darks of the same exposure time, one
    more picture, and 4 flats with another `sensor_seed`. Residuals are relative to the light of the truth.

    Expectation: the covariance of the residuals of both stacks equals the closed-form variance of the pattern,
    PRNU^2 + (DSNU^2 + row^2 + column^2 + (spread x dark)^2) / x^2 for x electrons. Half the variance of the difference
    of two frames is x + dark + read^2 + 1 / (12 K^2), and two such differences of four frames are uncorrelated. In a
    picture corrected by darks and flats of N frames, the variance between pixels is this temporal variance times
    1 + 1/N; in the uncorrected picture, it is larger by the variance of the pattern. Residuals of another sensor are
    uncorrelated with those of the first. The rendering noise of the frames, known from the truth, counts as temporal.

    Limit: five standard errors over 27,648 pixels; hot pixels, which are outliers, are excluded except in the corrected
    picture.

    Source: EMVA 1288 release 4.0, sec. 4 and 8.
    """
    camera = dasim.cropped("da-mobile", *SIZE_PX)
    other = rendering.changed(camera, sensor={"sensor_seed": OTHER_SENSOR})
    exposure = dasim.Exposure(auto_level=LEVEL)
    first = dasim.simulate(_wall(FLAT_LUX), camera, seed, spp=SPP, diffraction="off", exposure=exposure)
    exposure = dasim.Exposure(time_s=first.capture.exposure_s)

    def stack(body: Camera, lux: float, number: int) -> Stack:
        seeds = seeds_of(seed, FRAMES, part=number + 1)
        shots = [dasim.simulate(_wall(lux), body, s, spp=SPP, diffraction="off", exposure=exposure) for s in seeds]
        progress((number + 1) / 4)
        return _stack(shots)

    flats, again, darks = (stack(camera, lux, n) for n, lux in enumerate((FLAT_LUX, FLAT_LUX, DARK_LUX)))
    others = stack(other, FLAT_LUX, 3)
    picture = _stack([first])
    hot = darks.mean - np.median(darks.mean) > 8 * np.sqrt(_dark_variance(camera.sensor, darks.time_s))
    dark_e = camera.sensor.dark_current_e_s * flats.time_s
    values = {
        "pattern": _pattern_error(flats, again, camera.sensor, ~hot),
        "temporal": _temporal_error(flats, camera.sensor, ~hot),
        "noise-correlation": abs(_correlation(*_differences(flats), ~hot)),
        "corrected": _spread_error(picture, flats, darks, camera),
        "uncorrected": _spread_error(picture, None, None, camera),
        "other-sensor": abs(_correlation(_residual(flats, dark_e), _residual(others, dark_e), ~hot)),
    }
    return Evidence([Figure(name, float(value), "1", _TEXT[name]) for name, value in values.items()])


_TEXT = {
    "pattern": "relative error of the covariance of two stacks of flats against the pattern's variance",
    "temporal": "relative error of the variance from frame to frame against photon, dark and read noise and rounding",
    "noise-correlation": "correlation of the differences of two pairs of frames",
    "corrected": "variance of a flat- and dark-corrected picture over that of its temporal noise, less 1",
    "uncorrected": "the same of the uncorrected picture",
    "other-sensor": "correlation of flats with those of another sensor",
}


def _wall(lux: float) -> dasim.Scene:
    sky = rendering.EVEN_LIGHT[0] | {"lux": lux}
    return rendering.make_scene([WALL], [sky, rendering.EVEN_LIGHT[1]])


def _stack(shots: list[dasim.Shot]) -> Stack:
    """The frames of shots and the light that their pixels collect by the truth."""
    captures = [shot.capture for shot in shots]
    sensor = captures[0].camera.sensor
    electrons = [noise.collected_e(capture.raw_dn.astype(np.float64), sensor, capture.gain) for capture in captures]
    camera = captures[0].camera
    mosaics = [noise.mosaic(shot.truth.mean_e.astype(np.float64), camera) for shot in shots]
    light = [electronic_crosstalk(mosaic, camera) for mosaic in mosaics]
    return Stack(np.array(electrons), np.array(light), captures[0].exposure_s)


def _dark_variance(sensor: Sensor, time_s: float) -> float:
    """Variance of a dark pixel from frame to frame, electrons^2."""
    step_e = sensor.full_well_e / (2**sensor.adc_bits - 1 - sensor.black_level_dn)
    return sensor.dark_current_e_s * time_s + sensor.read_noise_e**2 + step_e**2 / 12


def _residual(stack: Stack, dark_e: float) -> FloatArray:
    """Deviation of a stack's mean, less the mean dark signal, from the light of the truth, relative to it, [h, w]."""
    return (stack.mean - dark_e) / stack.light_e.mean(axis=0) - 1


def _correlation(a: FloatArray, b: FloatArray, used: NDArray) -> float:
    return float(np.corrcoef(a[used], b[used])[0, 1])


def _differences(stack: Stack) -> tuple[FloatArray, FloatArray]:
    """Differences of the first two and of the next two frames, in standard deviations of their photon noise."""
    scaled = stack.electrons / np.sqrt(stack.light_e.mean(axis=0))
    return scaled[0] - scaled[1], scaled[2] - scaled[3]


def _pattern_error(flats: Stack, again: Stack, sensor: Sensor, used: NDArray) -> float:
    """Relative error of the covariance of two stacks' residuals against the pattern in closed form."""
    mean = flats.light_e.mean(axis=0)[used]
    dark_e = sensor.dark_current_e_s * flats.time_s
    offsets = sensor.dsnu_e**2 + sensor.row_noise_e**2 + sensor.column_noise_e**2
    expected = sensor.prnu**2 + np.mean((offsets + (sensor.dark_current_spread * dark_e) ** 2) / mean**2)
    first, second = (_residual(stack, dark_e)[used] for stack in (flats, again))
    return float(np.mean(first * second)) / expected - 1


def _temporal_error(flats: Stack, sensor: Sensor, used: NDArray) -> float:
    """Relative error of the variance from frame to frame against the closed form, light's rendering noise taken out."""
    mean = flats.light_e.mean(axis=0)
    expected = mean + _dark_variance(sensor, flats.time_s)
    left = flats.electrons - flats.light_e
    return float(np.mean((left.var(axis=0, ddof=1) / expected)[used])) - 1


def _spread_error(picture: Stack, flats: Stack | None, darks: Stack | None, camera: Camera) -> float:
    """Variance from pixel to pixel of a picture of an even wall over that of its temporal noise, less 1.

    Corrected, each channel of (picture - dark) / (flat - dark) is scaled to the channel's mean signal. Uncorrected, the
    light's slow fall towards the edge is divided out by the truth.
    """
    signal, light = picture.electrons[0], picture.light_e[0]
    channel, rendering_e2 = mosaic_channels(camera), np.zeros_like(light)
    if flats is None or darks is None:
        flat, dark, stacks = light, np.zeros_like(light), 0.0
    else:
        flat, dark, stacks = flats.mean - darks.mean, darks.mean, 1 / FRAMES
        for index in range(len(channels(camera.sensor))):
            rendering_e2[channel == index] = flats.light_e.var(axis=0, ddof=1)[channel == index].mean()
    ratio = (signal - dark) / flat
    for index in range(len(channels(camera.sensor))):
        here = channel == index
        ratio[here] /= ratio[here].mean()
    temporal = (light + _dark_variance(camera.sensor, picture.time_s) + rendering_e2) * (1 + stacks)
    return float(np.mean((ratio - 1) ** 2 * light**2 / temporal)) - 1
