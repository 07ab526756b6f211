"""Maximum likelihood on simulated patches: whether the bound is attainable, or depths are confused with one another.

The Cramer-Rao bound describes the neighbourhood of the true blur only. Here patches are sampled from the model itself,
spectra of a natural texture through the channels' transfer functions with noise, and the blur of the largest likelihood
is searched among all blurs; the powers of texture and noise are known. In the notation of
:mod:`validation.studies.criteria`, for a candidate blur c and the spectra y of the planes,

    ln L(c) = sum over frequencies of p q |s^H m y|^2 - ln(1 + p a).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.bounds import cramer_rao, pupils
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.typing import FloatArray
from validation.studies import criteria
from validation.studies.criteria import PLANES, SPACING_PX, TexturePatch

SHAPE = (16, 16)  # samples 2 px apart: the paper's patch of 31 px
STEP_PX = 0.1  # of visible blur, between candidates
BEYOND_PX = 8.0  # candidates extend this much beyond the largest true blur
PATCHES = 100  # per blur
CELLS = 48  # of transforms across the lens: changes the bound by 1 %


def likelihood_errors(
    camera: Camera, blur_px: FloatArray, *, light: str = "D65", level_lux: float = 5000.0, patches: int = PATCHES
) -> tuple[FloatArray, FloatArray]:
    """Root mean square error of the visible blur by maximum likelihood, and its bound, in px, [blur] each.

    True blurs ``blur_px`` are rounded to the nearest candidate. ``patches`` are simulated at each.
    """
    patch = criteria.texture_patch(camera, light, level_lux)
    index = [sensors.channels(camera.sensor).index(name) for name in PLANES]
    candidates = np.arange(STEP_PX, float(np.max(blur_px)) + BEYOND_PX, STEP_PX)
    transfer, _ = pupils.stop_transfers(camera, candidates, light, SHAPE, spacing_px=SPACING_PX, fine_cells=CELLS)
    s = (patch.gain[:, None, None] * transfer[:, index]).reshape(len(candidates), len(PLANES), -1)
    power = _power(patch)
    true = np.rint(blur_px / STEP_PX).astype(int) - 1
    errors = _simulated_errors(s, power.ravel(), patch.noise, candidates, true, patches)
    transfers, slope = pupils.camera_transfers(
        camera, candidates[true], light, SHAPE, spacing_px=SPACING_PX, fine_cells=CELLS
    )
    bound = cramer_rao.blur_deviation(
        transfers[:, index], slope[:, index], power, patch.noise, width=SHAPE[1], gain=patch.gain, texture="known"
    )
    return errors, bound


def _simulated_errors(
    s: NDArray, power: FloatArray, noise: FloatArray, candidates: FloatArray, true: NDArray[np.int_], patches: int
) -> FloatArray:
    """Root mean square error at the candidates of index ``true``, [blur]; ``s`` is [candidate, plane, frequency]."""
    multiplicity = (np.ones((SHAPE[0], 1)) * cramer_rao.multiplicity(SHAPE[1])).ravel()
    m = 1 / noise[:, None]
    snr = power * (m * np.abs(s) ** 2).sum(axis=1)
    share, penalty = power / (1 + snr) * multiplicity, (np.log1p(snr) * multiplicity).sum(axis=-1)
    random = np.random.default_rng(0)
    errors = []
    for number in true:
        texture, white = _normal(random, (patches, 1, power.size)), _normal(random, (patches, *s.shape[1:]))
        y = np.sqrt(power) * texture * s[number] + np.sqrt(noise)[:, None] * white
        matched = sum((m[plane] * y[:, plane])[:, None] * np.conj(s[None, :, plane]) for plane in range(s.shape[1]))
        likelihood = (np.abs(matched) ** 2 * share).sum(axis=-1) - penalty
        errors.append(np.sqrt(np.mean((candidates[likelihood.argmax(axis=1)] - candidates[number]) ** 2)))
    return np.array(errors)


def _power(patch: TexturePatch) -> FloatArray:
    """Power of the texture of ``patch`` on the grid of ``SHAPE``; it does not depend on the number of samples."""
    unit = cramer_rao.natural_power(criteria.SHAPE, spacing_px=SPACING_PX)
    contrast = np.sqrt(patch.power[0, 4] / unit[0, 4])
    return cramer_rao.natural_power(SHAPE, spacing_px=SPACING_PX, contrast=0.1 * float(contrast))


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.complex128]:
    """Circular complex normal numbers of variance 1, like the spectrum of a patch but for its few real frequencies."""
    parts = random.normal(size=(2, *shape)) / np.sqrt(2)
    return np.asarray(parts[0] + 1j * parts[1])
