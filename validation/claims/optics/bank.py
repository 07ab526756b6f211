"""Claim on calibration: PSFs measured from pictures of a point source agree with the PSFs of the camera."""

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

LEVELS = (0, 1, 2, 4, 8, 14, 20, 28)  # in focus, the levels between which the PSF changes most, and the largest


def bank(progress: ShareDone) -> Evidence:
    """PSFs measured from noisy pictures of a point source agree with the PSFs that wave optics gives for the camera.

    Rationale: every step of the reconstruction uses the PSF bank, and ``recon`` obtains it from pictures alone.

    Set-up: da-mobile at its default focus distance. Calibration pictures pass through the sensor model (mosaic, noise,
    fixed patterns) under each of the four lights of sec. 5.1; the point source lies at a random position within a
    pixel. The reference is the camera's own PSF by wave optics, on the same pixel grid. Blur levels 0, 1, 2, 4, 8, 14,
    20 and 28.

    Expectation: both PSFs have the same encircled energy, which is the share of the light within a radius of a whole
    number of pixels about the centre. The figure for each light and channel is the largest difference over radii and
    levels.

    Limit: 0.03 of the light.

    Source: sec. 5.1; the limit is the project's own.
    """
    camera = dasim.load_camera("da-mobile")
    measured = recon.calibrate(dasim.calibration_captures(camera), progress=lambda stage, share: progress(0.6 * share))
    error = energy_errors(measured)
    figures, rows = [], []
    for number, light in enumerate(measured.lights):
        for index, channel in enumerate(CHANNELS):
            worst = error[number, :, index]
            text = f"{light}, {channel}: largest error of encircled energy (at level {LEVELS[int(worst.argmax())]})"
            figures.append(Figure(f"{light}.{channel}", float(worst.max()), "1", text))
            rows.append([light, channel, *(f"{value:.4f}" for value in worst)])
    progress(1.0)
    caption = "Largest error of encircled energy by blur level"
    return Evidence(figures, tables=[(caption, ["light", "channel", *map(str, LEVELS)], rows)])


def energy_errors(measured: PsfBank) -> FloatArray:
    """Largest difference in encircled energy between a measured bank and the camera's own PSFs.

    The result is [light, level of LEVELS, channel], as a share of the PSF's light.
    """
    powers = np.stack([illuminants.illuminant(light) for light in measured.lights])
    size = measured.kernel.shape[-1]
    blurs = measured.blur_px[list(LEVELS)].astype(np.float64)
    kernels_at = pointspread.kernels(measured.camera, blurs, powers, size, measured.diffraction)
    error = np.empty((len(measured.lights), len(LEVELS), len(CHANNELS)))
    for number in range(len(measured.lights)):
        for place, level in enumerate(LEVELS):
            reference, _ = kernels_at(place, (0.0, 0.0), number)
            true = reference / reference.sum(axis=(-1, -2), keepdims=True)
            estimate = measured.kernel[number, level].astype(np.float64)
            error[number, place] = np.abs(encircled(estimate) - encircled(true)).max(axis=-1)
    return error


def encircled(kernel: FloatArray) -> FloatArray:
    """Encircled energy of kernels [..., size, size] at radii of 1, 2, ... pixels about the centre, [..., radius]."""
    half = kernel.shape[-1] // 2
    radius = np.hypot(*(np.indices(kernel.shape[-2:]) - half))
    return np.stack([(kernel * (radius <= r)).sum(axis=(-1, -2)) for r in range(1, half + 1)], axis=-1)
