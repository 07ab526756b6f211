"""Radial profile of a round stop's kernel: least-squares fit to pixels at known distances from the centre.

Tested in tests/recon/calibration/test_psf_bank.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from dasim.typing import FloatArray

RING_SNR = 4.0  # ratio of a ring's mean to its standard error; the tail is modelled from the first ring below it
MIN_TAIL_START_PX = 3.0
RING_PX = 1.0
FINE_PX = 4.0  # radius within which the knots are closer, for kernels in focus
SUBPIXELS = 5  # per pixel and axis, for integrals over the pixel
NORMAL_REGULARISATION = 1e-6  # relative ridge, for knots that no pixel resolves
ROUNDING = 1e-12  # the same with smoothness, which determines those knots
ROUND_MISFIT = 0.15  # largest relative residual of the round model; above it the kernel is not round


class RoundFit(NamedTuple):
    """A round kernel that was fitted to pixels."""

    knots: FloatArray  # radii, pixels
    density: FloatArray  # at the knots, electrons per square pixel
    model: FloatArray  # electrons of the pixels without the background, [pixel]


def round_fit(
    radius: FloatArray, value: FloatArray, sigma: FloatArray, rings: int, smoothness: float = 0.0
) -> RoundFit | None:
    """The round kernel of a picture; None if the picture is not round.

    Args:
        radius: distances of the subpixels of every pixel from the centre, [pixel, point] (:func:`subpixel_radius`).
        value: electrons, [pixel].
        sigma: their standard deviation, [pixel].
        rings: number of rings of one pixel's width, the largest radius.
        smoothness: weight of the second differences of the density against the pixels' noise.
    """
    start = _tail_start(value, sigma, np.floor(radius.mean(axis=-1)).astype(int), rings)
    knots = knots_to(start)
    basis = sparse.hstack([basis_of(radius, knots), np.ones((len(radius), 1))], format="csr")
    weighted = basis.copy()
    weighted.data /= np.repeat(sigma, np.diff(basis.indptr))
    normal = (weighted.T @ weighted).toarray()
    if smoothness:
        order = np.argsort(radius.min(axis=-1))
        envelope = np.maximum.accumulate(value[order][::-1])[::-1]
        at_knots = envelope[np.minimum(np.searchsorted(radius.min(axis=-1)[order], knots[1:-1]), len(order) - 1)]
        second = np.diff(np.eye(len(knots), len(normal)), 2, axis=0) / np.maximum(at_knots, sigma.min())[:, None]
        normal += smoothness * (second.T @ second)
    normal[np.diag_indices_from(normal)] *= 1 + (ROUNDING if smoothness else NORMAL_REGULARISATION)
    lift = np.zeros(len(normal))  # the densities are not negative; the background, of which noise is left, may be
    lift[-1] = sigma.max()
    profile = _non_negative(normal, weighted.T @ (value / sigma) + normal @ lift) - lift
    model = basis @ profile
    residual = np.sum((model - value) ** 2) - np.sum(sigma**2)
    if residual < ROUND_MISFIT**2 * np.sum((value - profile[-1]) ** 2):
        return RoundFit(knots, profile[:-1], model - profile[-1])
    return None


def knots_to(start: float) -> FloatArray:
    """Radii in pixels of the profile's knots, up to the start of the tail."""
    fine = np.arange(0, min(FINE_PX, start), FINE_PX / 8)
    return np.concatenate([fine, np.arange(FINE_PX, start, RING_PX / 2), [start]])


def subpixel_radius(shape: tuple[int, ...], centre: FloatArray) -> FloatArray:
    """Distance of the ``SUBPIXELS``^2 points of every pixel from the centre (y, x), [pixel, point], pixels."""
    fine = [(np.arange(n * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5 - c for n, c in zip(shape, centre, strict=True)]
    radius = np.hypot(fine[0][:, None], fine[1][None, :])
    blocks = radius.reshape(shape[0], SUBPIXELS, shape[1], SUBPIXELS).swapaxes(1, 2)
    return blocks.reshape(shape[0] * shape[1], SUBPIXELS**2)


def basis_of(radius: FloatArray, knots: FloatArray) -> sparse.csr_array:
    """Integral over each pixel of every knot's hat function, [pixel, knot]; the last one continues as r^-3."""
    pixels, points = radius.shape
    inside = np.minimum(radius, knots[-1])
    upper = np.clip(np.searchsorted(knots, inside, side="right"), 1, len(knots) - 1)
    share = (inside - knots[upper - 1]) / (knots[upper] - knots[upper - 1])
    falloff = _falloff(radius, knots[-1]) / points
    parts = np.concatenate([(1 - share) * falloff, share * falloff], axis=1)
    index = np.concatenate([upper - 1, upper], axis=1)
    rows = np.arange(pixels + 1) * (2 * points)
    basis = sparse.csr_array((parts.ravel(), index.ravel(), rows), shape=(pixels, len(knots)))
    basis.sum_duplicates()
    return basis


def over_pixels(radius: FloatArray, fit: RoundFit) -> FloatArray:
    """Integral of a fitted kernel over each pixel, [pixel], electrons; ``radius`` is as for :func:`round_fit`."""
    density = np.interp(radius, fit.knots, fit.density) * _falloff(radius, fit.knots[-1])
    return np.asarray(density.mean(axis=-1))


def _falloff(radius: FloatArray, last: float) -> FloatArray:
    """r^-3 beyond the last knot, 1 within."""
    inverse = last / np.maximum(radius, last)
    return inverse * inverse * inverse


def _tail_start(value: FloatArray, sigma: FloatArray, ring: NDArray[np.int_], rings: int) -> float:
    """Radius in pixels of the first ring whose mean is below ``RING_SNR`` standard errors."""
    count = np.bincount(ring, minlength=rings)[:rings]
    mean = np.bincount(ring, value, minlength=rings)[:rings] / np.maximum(count, 1)
    error = np.bincount(ring, sigma, minlength=rings)[:rings] / np.maximum(count, 1) ** 1.5
    dark = np.flatnonzero((mean <= RING_SNR * error) & (count > 0))
    return float(np.clip(dark[0] if dark.size else rings, MIN_TAIL_START_PX, rings - 1))


def _non_negative(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Non-negative least squares from the normal equations, by their Cholesky factor."""
    from scipy.optimize import nnls  # takes a third of a second to import

    factor = np.linalg.cholesky(normal)
    return nnls(factor.T, np.linalg.solve(factor, right))[0]
