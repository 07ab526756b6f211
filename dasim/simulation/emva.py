"""Frames of a camera's sensor as EMVA 1288 (release 4.0, linear model) measures one, for its reference analyser.

The public analyser (``emva1288`` on PyPI) reads the descriptor that is written here. The sensor is lit uniformly,
without a lens, by light of one wavelength; exposure time and light increase together (method 1 of the standard).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.camera import noise as sensors
from dasim.camera.sensor import SMALLEST_FRAME_PX, Sensor, channels, collected_efficiency, cutoff, quantum_efficiency
from dasim.camera.specification import Camera
from dasim.files.folders import new_folder, software_versions
from dasim.files.png import write_png16
from dasim.spectra import grid
from dasim.typing import FloatArray, Progress

KIND = "EMVA 1288 measurement"
SCHEMA = 1
# The standard requires 50 steps or more. The saturation capacity is a step of the ladder: a step of 1.3 % of the full
# well gives it to 0.7 %.
STEPS = 80
# Temporal noise that remains in the mean of a stack is subtracted; with 64 frames it is a tenth of the patterns.
STACK_FRAMES = 64
SIZE_PX = (256, 256)  # the variance of 65,536 pixels is known to 0.55 %

_LONGEST_S = 1.0  # long enough to measure the dark current of a cool sensor
_DARK_SHARE = 0.002  # largest share of dark electrons in a full well, so that they do not count as light there
_PAST_SATURATION = 3.0  # standard deviations: 99.9 % of the pixels are saturated in the last step
_LEAST_DARK_VARIANCE_DN2 = 0.24  # EMVA 1288: below, rounding hides the temporal dark noise


@dataclass(frozen=True)
class Plan:
    """The measurement of a channel: its light, and the steps of the ladder from dark to past saturation."""

    channel: str
    wavelength_nm: float
    quantum_efficiency: float  # electrons per photon on the pixel, crosstalk and the filter on the sensor included
    exposure_s: FloatArray  # [STEPS]
    mean_e: FloatArray  # [STEPS] photo-electrons per pixel
    stack_step: int  # the step nearest to half the saturation, for the spatial measurements


def plan(camera: Camera, channel: str = "G", gain: float = 1.0) -> Plan:
    """The measurement of one channel; EMVA 1288 characterises the planes of a mosaic one by one.

    The light has the wavelength of the channel's peak sensitivity. Raises InputError if the mosaic lacks the channel.
    """
    sensor = camera.sensor
    wavelength_nm, efficiency = _quantum_efficiency(sensor, channel)
    full_e = sensors.saturation_e(sensor, gain)
    dark_e_s = sensors.dark_rate_e_s(sensor)
    longest_s = min(_LONGEST_S, _DARK_SHARE * full_e / dark_e_s) if dark_e_s > 0 else _LONGEST_S
    spread_e = np.sqrt(sensors.variance(sensor, longest_s, gain).at(full_e))
    share = np.arange(1, STEPS + 1) / STEPS
    mean_e = share * (full_e + _PAST_SATURATION * spread_e)
    middle = int(np.argmin(np.abs(mean_e - full_e / 2)))
    return Plan(channel, wavelength_nm, efficiency, share * longest_s, mean_e, middle)


def _quantum_efficiency(sensor: Sensor, channel: str) -> tuple[float, float]:
    """Wavelength of the channel's peak, and the efficiency of its pixels there, crosstalk in the mosaic included."""
    names = channels(sensor)
    if channel not in names:
        raise InputError(f"--channel '{channel}' is not in the camera's mosaic, allowed are {', '.join(names)}")
    index = names.index(channel)
    peak = int(np.argmax((quantum_efficiency(sensor) * cutoff(sensor))[index]))
    efficiency = (collected_efficiency(sensor) * cutoff(sensor))[index, peak]
    return float(grid.WAVELENGTH_NM[peak]), float(efficiency)


def write_measurement(
    path: Path,
    camera: Camera,
    *,
    channel: str = "G",
    gain: float = 1.0,
    seed: int = 0,
    size_px: tuple[int, int] = SIZE_PX,
    progress: Progress = lambda stage, share: None,
) -> list[str]:
    """Write ``frames/*.png``, ``descriptor.txt`` and ``meta.json``; returns notes for the user.

    The frames are a bright and a dark pair for each exposure time, then bright and dark stacks near half the saturation
    for the spatial figures. ``size_px`` is [width, height] of the frames, which hold pixels of ``channel`` only. All
    frames share the fixed pattern of the camera; ``seed`` is that of the temporal noise.
    """
    _check_size(camera, size_px)
    measurement = plan(camera, channel, gain)
    with new_folder(path, KIND) as folder:
        lines, steps, dark_at_zero = _write_frames(folder, camera.sensor, measurement, gain, seed, size_px, progress)
        head = f"# {camera.name}, {channel} pixels, {measurement.wavelength_nm:g} nm, gain {gain:g}, seed {seed}"
        size = f"n {camera.sensor.adc_bits} {size_px[0]} {size_px[1]}"
        (folder / "descriptor.txt").write_text("\n".join([head, "v 4.0", size, *lines]) + "\n", encoding="utf-8")
        notes = _notes(camera.sensor, gain, dark_at_zero)
        meta = {
            "schema": SCHEMA,
            "camera": camera.model_dump(mode="json"),
            "channel": channel,
            "wavelength_nm": measurement.wavelength_nm,
            "quantum_efficiency": measurement.quantum_efficiency,
            "gain": gain,
            "seed": seed,
            "steps": steps,
            "notes": notes,
            "software": software_versions(),
        }
        (folder / "meta.json").write_text(json.dumps(meta, indent=1) + "\n", encoding="utf-8")
    return notes


def _write_frames(
    folder: Path,
    sensor: Sensor,
    measurement: Plan,
    gain: float,
    seed: int,
    size_px: tuple[int, int],
    progress: Progress,
) -> tuple[list[str], list[dict[str, Any]], float]:
    """Write all frames; returns the lines of the descriptor, a description of each step, and the share of dark pixels
    at 0 DN.
    """
    sets = [(step, 2) for step in range(STEPS)] + [(measurement.stack_step, STACK_FRAMES)]
    total, number = 2 * sum(count for _, count in sets), 0
    lines: list[str] = []
    steps: list[dict[str, Any]] = []
    dark_at_zero = 0
    (folder / "frames").mkdir()
    for step, count in sets:
        time_s, mean_e = float(measurement.exposure_s[step]), float(measurement.mean_e[step])
        photons = mean_e / measurement.quantum_efficiency
        saturated = 0
        for head, level_e in ((f"b {time_s * 1e9:.9g} {photons:.9g}", mean_e), (f"d {time_s * 1e9:.9g}", 0.0)):
            lines.append(head)
            for _ in range(count):
                flat = np.full((size_px[1], size_px[0]), level_e)
                raw_dn, full = sensors.expose(flat, sensor, time_s, seed, gain=gain, frame=number)
                lines.append(f"i frames/{head[0]}{number:04d}.png")
                write_png16(folder / lines[-1].removeprefix("i "), raw_dn)
                if level_e > 0:
                    saturated += full
                else:
                    dark_at_zero += int(np.count_nonzero(raw_dn == 0))
                number += 1
                progress("exposing", number / total)
        steps.append({"exposure_s": time_s, "photons": photons, "frames": count, "saturated_pixels": saturated})
    return lines, steps, dark_at_zero / (total / 2 * size_px[0] * size_px[1])


def _check_size(camera: Camera, size_px: tuple[int, int]) -> None:
    """Raise InputError for frames larger than the sensor or too small for statistics."""
    low, sensor = SMALLEST_FRAME_PX, camera.sensor
    if not (low <= size_px[0] <= sensor.width_px and low <= size_px[1] <= sensor.height_px):
        raise InputError(
            f"size {size_px[0]}x{size_px[1]} is not within {low}x{low} to {sensor.width_px}x{sensor.height_px}, "
            f"the sensor of camera '{camera.name}'"
        )


def _notes(sensor: Sensor, gain: float, dark_clipped: float) -> list[str]:
    """Notes on figures of the standard that will differ from the specification of the sensor."""
    per_dn = sensors.electrons_per_dn(sensor, gain)
    notes = []
    if sensors.temporal_variance(sensor, 0.0, gain).constant / per_dn**2 < _LEAST_DARK_VARIANCE_DN2:
        notes.append(
            f"read noise is {sensor.read_noise_e / per_dn:.2g} DN: rounding hides it, and the analyser "
            "reports its lower limit of 0.4 DN; a higher --gain shows it"
        )
    if dark_clipped > 0.001:
        notes.append(f"{dark_clipped:.1%} of the dark pixels are clipped at 0 DN; black_level_dn is too low")
    if sensors.full_scale_e(sensor, gain) < sensor.full_well_e:
        notes.append("the converter is full before the well: the saturation capacity will be the converter's")
    return notes
