"""Claim of the calibration: kernels measured from pictures of a point against those that the camera has."""

from __future__ import annotations

import numpy as np

import dasim
import recon
from dasim.camera import pointspread
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from dasim.values import PsfBank
from validation.gates.claim import Evidence
from validation.scores.figures import Figure

LEVELS = (0, 1, 2, 4, 8, 14, 20, 28)  # in focus, the strongest change of the pattern, and the largest


def bank(progress: ShareDone) -> Evidence:
    """Kernels measured from noisy pictures of a point are those of the camera.

    Rationale: all that is reconstructed rests on them, and ``recon`` knows them from pictures alone.

    Set-up: da-mobile at its own focus; calibration pictures through the sensor model under each of the four lights of
    sec. 5.1, mosaicked, with noise and fixed patterns, the point at a random place within a pixel. The camera's own
    kernels by wave optics, on the same pixels. Levels 0, 1, 2, 4, 8, 14, 20 and 28.

    Expectation: the share of the light within whole-pixel radii of the middle; its largest difference, over radii and
    levels, for every light and channel.

    Limit: 0.03.

    Source: sec. 5.1; the limit is the project's own.
    """
    camera = dasim.load_camera("da-mobile")
    measured = recon.calibrate(dasim.calibration_captures(camera), progress=lambda stage, share: progress(0.6 * share))
    error = energy_errors(measured)
    figures, rows = [], []
    for number, light in enumerate(measured.lights):
        for index, channel in enumerate(CHANNELS):
            worst = error[number, :, index]
            text = f"{light}, {channel}: largest error of encircled energy, at level {LEVELS[int(worst.argmax())]}"
            figures.append(Figure(f"{light}.{channel}", float(worst.max()), "1", text))
            rows.append([light, channel, *(f"{value:.4f}" for value in worst)])
    progress(1.0)
    return Evidence(figures, tables=[("error of encircled energy", ["light", "channel", *map(str, LEVELS)], rows)])


def energy_errors(measured: PsfBank) -> FloatArray:
    """Largest difference of encircled energy, [light, level of LEVELS, channel], to the camera's own kernels."""
    powers = np.stack([illuminants.illuminant(light) for light in measured.lights])
    size = measured.kernel.shape[-1]
    blurs = measured.blur_px[list(LEVELS)].astype(np.float64)
    kernels_at = pointspread.kernels(measured.camera, blurs, powers, size, measured.diffraction)
    error = np.empty((len(measured.lights), len(LEVELS), len(CHANNELS)))
    for number in range(len(measured.lights)):
        for place, level in enumerate(LEVELS):
            own, _ = kernels_at(place, (0.0, 0.0), number)
            true = own / own.sum(axis=(-1, -2), keepdims=True)
            found = measured.kernel[number, level].astype(np.float64)
            error[number, place] = np.abs(encircled(found) - encircled(true)).max(axis=-1)
    return error


def encircled(kernel: FloatArray) -> FloatArray:
    """Share of the light of kernels [..., size, size] within whole-pixel radii of the middle, [..., radius]."""
    half = kernel.shape[-1] // 2
    radius = np.hypot(*(np.indices(kernel.shape[-2:]) - half))
    return np.stack([(kernel * (radius <= r)).sum(axis=(-1, -2)) for r in range(1, half + 1)], axis=-1)
