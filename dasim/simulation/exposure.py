"""From the light on a sensor to a capture and its ground truth, any number of times per rendering.

The light is stored as a rate per second, rounded to ``SIGNIFICANT_BITS``. The ``mean_e`` of a capture is that rate
times the exposure time in single precision, with an error of less than half a step of the rate, so that the rate can be
recovered exactly from a saved capture. The result of :func:`expose` is therefore byte for byte that of a new rendering
with the other exposure time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError, kind_of
from dasim.base.loading import function_name
from dasim.base.toml import parse
from dasim.camera import noise as sensor_noise
from dasim.camera import sensor as sensors
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.noise import Exposure, NoiseModel
from dasim.camera.specification import Camera
from dasim.files.captures import load_capture, load_truth
from dasim.scene.lights import LUX_RANGE
from dasim.simulation import checks, rendering, rendering_noise
from dasim.simulation.notes import frame_notes
from dasim.typing import Float32Array
from dasim.values import Capture, Truth

# A rate of 22 bits has steps of at least 2^-22 of it; a product in single precision, of 24 bits, is known to 2^-24.
SIGNIFICANT_BITS = 22
STRIP_ROWS = 256  # rows rounded at a time
SCALE_RANGE = (1e-9, 1e9)  # of a factor on the light level
OF_A_FRAME = (  # entries of the provenance that the exposure decides
    *("rendering_noise_share", "rendering_noise_share_reached"),
    *("noise", "exposure", "saturated_pixels", "notes"),
)
SHARED_NOISE = (
    "mean_e was rendered with samples of its own, and the samples of raw.png are not stored: the new raw.png repeats "
    "the rendering noise of mean_e"
)


@dataclass(frozen=True)
class Shot:
    """A simulated capture and its ground truth."""

    capture: Capture
    truth: Truth


@dataclass(frozen=True)
class SensorLight:
    """The light that reaches the sensor of a camera, and what is known of it: all that an exposure needs."""

    camera: Camera
    rate: Float32Array  # [h, w, channel] mean electrons per second, of ``SIGNIFICANT_BITS``
    variance: Float32Array | None  # [h, w, channel] of ``rate`` by rendering noise; None: unknown
    truth: Truth  # of one second
    illuminant: str | None
    origin: dict[str, Any]  # provenance, except for ``OF_A_FRAME``
    notes: list[str]  # on the scene


def expose(
    shot: Shot | str | Path,
    *,
    lux: float | None = None,
    scale: float = 1.0,
    exposure: Exposure | None = None,
    seed: int | None = None,
    noise: NoiseModel | None = None,
) -> Shot:
    """Expose a saved shot again, without rendering: with another light level, exposure, noise seed or noise model.

    The result is byte for byte that of ``simulate`` with the same exposure, noise seed and number of samples. With
    another light level, it is the same to within the renderer's single precision, because rounding then applies to
    other numbers. Sample counts that ``spp = "auto"`` chose are kept: a brighter exposure shows more of their rendering
    noise relative to the sensor noise, which the provenance and a note report. For a shot with ``independent_mean``,
    the new raw picture repeats the noise of ``mean_e``.

    Args:
        shot: a shot, or the folder of a capture
        lux: total illuminance of all lights of the scene in lux; all are scaled by the same factor; unchanged by
            default
        scale: instead of ``lux``, the factor on all lights, including those of a Mitsuba scene
        exposure: exposure time and gain; by default those of the capture, with an automatic time computed again
        seed: seed of the sensor's temporal noise, 0 or above; that of the capture by default. The fixed pattern belongs
            to the camera and does not change
        noise: the noise model; the bundled one by default

    Raises InputError for a capture without ground truth, or with the ground truth of only a part of its frame, and for
    values that are not allowed.
    """
    (result,) = expose_series(shot, [exposure], lux=lux, scale=scale, seed=seed, noise=noise)
    return result


def expose_series(
    shot: Shot | str | Path,
    exposures: Sequence[Exposure | None],
    *,
    frames: int = 1,
    lux: float | None = None,
    scale: float = 1.0,
    seed: int | None = None,
    noise: NoiseModel | None = None,
) -> Iterator[Shot]:
    """Expose a saved shot several times: a bracket, with a burst at each of its exposures; see :func:`expose`.

    Args:
        shot: a shot, or the folder of a capture
        exposures: exposures of the bracket; None for that of the capture
        frames: frames of each burst, with independent noise and the same fixed pattern
        lux: total illuminance of all lights in lux, or ``scale``: the factor on them
        scale: see ``lux``
        seed: seed of the noise of the first frame; the seeds of other frames follow from it and their index in the
            series
        noise: the noise model; the bundled one by default
    """
    where = "capture" if isinstance(shot, Shot) else f"capture {shot}"
    if not isinstance(shot, Shot):
        shot = Shot(load_capture(Path(shot)), load_truth(Path(shot)))
    seed = shot.capture.seed if seed is None else seed
    checks.check_seed(seed)
    for exposure in exposures:
        checks.check_exposure(exposure)
    for name, number in (("lux", lux), ("scale", scale)):
        if number is not None and not isinstance(number, (int, float, np.number)):
            raise InputError(f"{name}: must be a number, not {kind_of(number)}")
    if not isinstance(frames, (int, np.integer)) or frames < 1:
        raise InputError(f"frames is {frames!r}; it must be a whole number from 1")
    shot.truth.require("mean_e")
    with _own_provenance(where):
        light = _relit(sensor_light_of(shot, where), lux, scale, where)
    model = noise or _noise_model(shot.capture, where)
    last: Shot | None = None
    for number in range(len(exposures) * frames):
        exposure = exposures[number // frames] or exposure_of(shot.capture)
        result = photograph(light, exposure, frame_seed(seed, number), model)
        if last is not None and last.capture.exposure_s == result.capture.exposure_s:
            result = replace(result, truth=last.truth)  # a burst has one truth
        yield result
        last = result


def photograph(light: SensorLight, exposure: Exposure, seed: int, noise: NoiseModel) -> Shot:
    """A capture of the light through the mosaic, with the sensor noise of ``seed``, and its ground truth."""
    camera, rate = light.camera, light.rate.astype(np.float64)
    time_s = rendering.exposure_time_s(rate, camera, exposure)
    collected_e = electronic_crosstalk(sensor_noise.mosaic(rate * time_s, camera), camera)
    raw_dn, saturated = sensor_noise.apply(noise, collected_e, camera.sensor, time_s, seed, exposure.gain)
    shares = _noise_shares(light, Exposure(time_s=time_s, gain=exposure.gain))
    provenance = {
        **light.origin,
        **shares,
        "noise": function_name(noise),
        "exposure": exposure.model_dump(mode="json"),
        "saturated_pixels": saturated,
        "notes": light.notes + frame_notes(light.origin | shares, saturated / raw_dn.size),
    }
    capture = Capture(raw_dn, camera, time_s, exposure.gain, seed, light.illuminant, provenance)
    return Shot(capture, light.truth.scaled(time_s))


def frame_seed(seed: int, number: int) -> int:
    """Noise seed of frame ``number`` of a series: ``seed`` itself for frame 0, independent ones for the others."""
    return seed if number == 0 else int(np.random.SeedSequence(seed, spawn_key=(number,)).generate_state(1)[0])


def bracketed(light: SensorLight, exposure: Exposure, factor: float) -> Exposure:
    """The exposure with ``factor`` times its exposure time, which is that of the light where it is automatic."""
    if factor == 1.0:
        return exposure
    time_s = rendering.exposure_time_s(light.rate.astype(np.float64), light.camera, exposure)
    return parse(Exposure, exposure.model_dump() | {"time_s": factor * time_s}, "exposure of a bracket")


def exposure_of(capture: Capture) -> Exposure:
    """The exposure of a capture, automatic or not; that of a capture without provenance is its time and gain."""
    data = capture.provenance.get("exposure", {"time_s": capture.exposure_s, "gain": capture.gain})
    return parse(Exposure, data, "exposure in meta.json")


# --- the light of a kept capture -----------------------------------------------------------------


def to_precision(values: NDArray[np.floating]) -> Float32Array:
    """Values of a picture, [h, w, ...], rounded to ``SIGNIFICANT_BITS``, of which single precision has more."""
    result = np.empty(values.shape, np.float32)
    for start in range(0, len(values), STRIP_ROWS):  # limits the memory for large frames
        fraction, exponent = np.frexp(values[start : start + STRIP_ROWS])
        rounded = np.rint(np.ldexp(fraction, SIGNIFICANT_BITS))
        result[start : start + STRIP_ROWS] = np.ldexp(rounded, exponent - SIGNIFICANT_BITS)
    return result


def sensor_light_of(shot: Shot, where: str) -> SensorLight:
    """The light that reached the sensor in a kept shot; ``where`` begins the message of an InputError."""
    capture, truth = shot.capture, shot.truth
    names, size = sensors.channels(capture.camera.sensor), capture.raw_dn.shape
    if truth.mean_e.shape != (*size, len(names)):
        height, width, count = truth.mean_e.shape
        raise InputError(
            f"{where}: mean_e is {width} x {height} pixels of {count} channels, raw.png {size[1]} x {size[0]} of "
            f"{len(names)}; give the truth of the whole frame"
        )
    origin = {key: value for key, value in capture.provenance.items() if key not in OF_A_FRAME}
    origin.setdefault("rendering_seed", capture.seed)
    own = frame_notes(capture.provenance, capture.provenance.get("saturated_pixels", 0) / capture.raw_dn.size)
    notes = [note for note in capture.provenance.get("notes", []) if note not in own]
    if origin.get("independent_mean"):
        origin["independent_mean"] = False
        notes.append(SHARED_NOISE)
    one_second = times(truth, 1 / capture.exposure_s)
    rate, variance = one_second.mean_e, one_second.mean_e_variance
    return SensorLight(capture.camera, rate, variance, one_second, capture.illuminant, origin, notes)


def times(truth: Truth, factor: float) -> Truth:
    """The truth with ``factor`` times the electrons, in the parts that it has, rounded to ``SIGNIFICANT_BITS``."""
    return truth.scaled(factor, to_precision)


@contextmanager
def _own_provenance(where: str) -> Iterator[None]:
    """Convert the exceptions that an edited ``meta.json`` causes to an InputError."""
    try:
        yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, ZeroDivisionError) as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(
            f"{where}/meta.json: its provenance is not as dasim wrote it ({what}); render it again"
        ) from None


def _relit(light: SensorLight, lux: float | None, scale: float, where: str) -> SensorLight:
    """The light of a kept shot at another level: ``lux`` of all lights together, or ``scale`` times as much."""
    scene = light.origin.get("scene", {})
    lights = scene.get("lights", [])
    if lux is not None:
        if scale != 1.0:
            raise InputError("lux and scale: give one of them")
        if not lux > 0:
            raise InputError(f"lux is {lux:g}; it must be a number above 0")
        if not lights:
            raise InputError(f"{where}: its lights have no level in lux; give a factor, scale")
        scale = lux / sum(item["lux"] for item in lights)
    if not SCALE_RANGE[0] <= scale <= SCALE_RANGE[1]:
        raise InputError(f"the factor on the light is {scale:g}; {SCALE_RANGE[0]:g} to {SCALE_RANGE[1]:g} is allowed")
    levels = [item["lux"] * scale for item in lights]
    if levels and not LUX_RANGE[0] <= min(levels) <= max(levels) <= LUX_RANGE[1]:
        allowed = f"{LUX_RANGE[0]:g} to {LUX_RANGE[1]:g}"
        raise InputError(f"the lights would have {min(levels):g} to {max(levels):g} lux; {allowed} is allowed")
    if scale == 1.0:
        return light
    if lights:
        relit = [item | {"lux": level} for item, level in zip(lights, levels, strict=True)]
        origin = light.origin | {"scene": scene | {"lights": relit}}
    else:
        origin = light.origin | {"light_scale": light.origin.get("light_scale", 1.0) * scale}
    truth = times(light.truth, scale)
    return replace(light, rate=truth.mean_e, variance=truth.mean_e_variance, truth=truth, origin=origin)


def _noise_model(capture: Capture, where: str) -> NoiseModel:
    """The bundled noise model, if it is that of the capture."""
    bundled = function_name(sensor_noise.expose)
    name = capture.provenance.get("noise", bundled)
    if name != bundled:
        raise InputError(f"{where}: has the noise model '{name}'; give it again, or the bundled one, {bundled}")
    return sensor_noise.expose


# --- provenance ----------------------------------------------------------------------------------


def _noise_shares(light: SensorLight, exposure: Exposure) -> dict[str, Any]:
    """Rendering noise over the sensor's of this exposure, for the provenance; empty where it is unknown."""
    if light.variance is None or "spp" not in light.origin:
        return {}
    names = sensors.channels(light.camera.sensor)
    at = list(rendering_noise.PERCENTILES)
    if "rendering_noise_share_wanted" in light.origin:
        at.append(light.origin["rendering_noise_at"])
    by_percentile: list[dict[str, float]] = [{} for _ in at]
    for channel, name in enumerate(names):  # apart: of all, large frames take gigabytes
        rate, variance = (image[..., [channel]].astype(float) for image in (light.rate, light.variance))
        ratio = rendering_noise.share(variance, rendering.sensor_variance(rate, light.camera, exposure))
        for row, value in zip(by_percentile, rendering_noise.shares_at(ratio, at), strict=True):
            row[name] = float(value[0])
    count = len(rendering_noise.PERCENTILES)
    stated = zip((f"{percentile:g}" for percentile in at), by_percentile[:count], strict=False)
    shares: dict[str, Any] = {"rendering_noise_share": dict(stated)}
    if len(at) > count:
        shares["rendering_noise_share_reached"] = by_percentile[-1]
    return shares
