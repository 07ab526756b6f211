"""What the best estimator makes of noisy patches: is the bound within reach, or does it take one depth for another?

The Cramer-Rao bound looks at the neighbourhood of the true blur alone. Here patches are drawn from the model itself,
spectra of a natural texture through the channels' transfer functions with noise, and the blur of the largest likelihood
is sought among all blurs; texture and noise are known by their powers. With s and p of
:mod:`validation.studies.criteria`,

    ln L(c) = sum over w of p q |s^H m y|^2 - ln(1 + p a).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.bounds import cramer_rao, pupils
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.typing import FloatArray
from validation.studies import criteria

SHAPE = (16, 16)  # samples 2 px apart: the paper's patch of 31 px
STEP_PX = 0.1  # of visible blur between the candidates
BEYOND_PX = 8.0  # candidates reach that much farther than the largest true blur
PATCHES = 100
CELLS = 48  # of the transforms across the lens: 1 % of the bound


def likelihood_errors(
    camera: Camera,
    blur_px: FloatArray,
    *,
    light: str = "D65",
    level_lux: float = 5000.0,
    planes: tuple[str, ...] = criteria.PLANES,
    patches: int = PATCHES,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Root mean square error of the visible blur by maximum likelihood, px, and its bound, [blur] each.

    True blurs are moved to the nearest candidate.
    """
    seen = criteria.sight(camera, light, level_lux, planes)
    index = [cameras.channels(camera.sensor).index(name) for name in planes]
    candidates = np.arange(STEP_PX, float(np.max(blur_px)) + BEYOND_PX, STEP_PX)
    transfer, _ = pupils.stop_transfers(
        camera, candidates, light, SHAPE, spacing_px=criteria.SPACING_PX, fine_cells=CELLS
    )
    s = (seen.gain[:, None, None] * transfer[:, index]).reshape(len(candidates), len(planes), -1)
    power = _power(seen).ravel()
    times = (np.ones((SHAPE[0], 1)) * cramer_rao.multiplicity(SHAPE[1])).ravel()
    m = 1 / seen.noise[:, None]
    gain = power * (m * np.abs(s) ** 2).sum(axis=1)
    share, depth = power / (1 + gain) * times, (np.log1p(gain) * times).sum(axis=-1)
    random = np.random.default_rng(seed)
    true = np.rint(blur_px / STEP_PX).astype(int) - 1
    errors = []
    for number in true:
        texture, noise = _normal(random, (patches, 1, power.size)), _normal(random, (patches, *s.shape[1:]))
        seen_now = np.sqrt(power) * texture * s[number] + np.sqrt(seen.noise)[:, None] * noise
        matched = sum(
            (m[plane] * seen_now[:, plane])[:, None] * np.conj(s[None, :, plane]) for plane in range(len(planes))
        )
        score = (np.abs(matched) ** 2 * share).sum(axis=-1) - depth
        errors.append(np.sqrt(np.mean((candidates[score.argmax(axis=1)] - candidates[number]) ** 2)))
    found, slope = pupils.camera_transfers(
        camera, candidates[true], light, SHAPE, spacing_px=criteria.SPACING_PX, fine_cells=CELLS
    )
    bound = cramer_rao.blur_deviation(
        found[:, index], slope[:, index], _power(seen), seen.noise, width=SHAPE[1], gain=seen.gain, texture="known"
    )
    return np.array(errors), bound


def _power(seen: criteria.Sight) -> FloatArray:
    """The texture of ``seen`` on this grid: its power does not depend on the number of samples."""
    contrast = np.sqrt(
        seen.power[0, 4] / cramer_rao.natural_power(criteria.SHAPE, spacing_px=criteria.SPACING_PX)[0, 4]
    )
    return cramer_rao.natural_power(SHAPE, spacing_px=criteria.SPACING_PX, contrast=0.1 * float(contrast))


def _normal(random: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.complex128]:
    """Complex normal numbers of variance 1: the frequencies of a real patch, but for the few that are real."""
    parts = random.normal(size=(2, *shape)) / np.sqrt(2)
    return np.asarray(parts[0] + 1j * parts[1])
