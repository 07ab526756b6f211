"""Log likelihood of each blur level from the cross-spectra of all channels together (a Wishart law).

At each level, the texture covariance Sigma and the free powers q_b of :mod:`recon.depth.cross_spectra` are fitted to a
window. C_b is the fitted matrix, and n_b the number of independent values in the window, reduced (tempered) because
neighbouring windows overlap. The divergence of band b is

    D_b = n_b / 2 (log |C_b| + tr C_b^-1 S_b - log |S_b| - d),

and the score is

    - sum over b of nu log(1 + D_b / nu) - q^T L q / 2 - log det(1 + H / L) / 2

with the precision L of the prior of q and the curvature H of the data at the fitted q (Laplace's approximation of the
integral over q). The logarithm limits the influence of bands that no plane explains (two depths in the window, a
texture with another spectrum). Compare the generalised likelihood of Trouve et
al. (Applied Optics 52, 2013) for a lens with axial colour, which assumes one texture for all channels.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from dasim.typing import Float32Array, FloatArray
from recon.depth.cross_spectra import EDGES, Spectra

TEMPER = 0.3  # of the number of independent values
NU = 2.0  # divergence of a band beyond which it counts by its logarithm
# Prior of q_b, standard deviations: a common factor, a slope over log f, and each band's own. The second and the third
# are those of random scenes of the training (:mod:`validation.training.traced`), windows of 10 and 28 px.
POWER_SD, SLOPE_SD, BAND_SD = 2.0, 1.0, 0.4
MOST_CORRELATION = 0.95  # of the textures of two channels
SLACK = 0.02  # of the model's diagonal: errors of kernels and of noise
ITERATIONS = 4


def log_likelihood(spectra: Spectra, table: FloatArray, nu: float = NU, *, reweighted: bool = True) -> Float32Array:
    """Score of each level, [h, w, level].

    Args:
        spectra: of the windows.
        table: :func:`cross_spectra.expected`, [level, band, d, d].
        nu: divergence of a band beyond which it counts by its logarithm.
        reweighted: whether bands that fit badly count less in the fit as well, not in the score alone.
    """
    height, width, bands, count = spectra.energy.shape
    d = table.shape[-1]
    energy = spectra.energy.reshape(-1, bands, count).astype(np.float64)
    noise = spectra.noise.reshape(-1, bands, count).astype(np.float64)
    result = np.empty((len(energy), len(table)), np.float32)
    number = TEMPER * spectra.number.astype(np.float64)
    covariance = power_covariance()
    precision, prior_det = np.linalg.inv(covariance), float(np.linalg.slogdet(covariance)[1])
    _fit(
        energy,
        noise,
        number,
        np.ascontiguousarray(table),
        tuple(range(d)),
        nu,
        reweighted,
        precision,
        prior_det,
        result,
    )
    return result.reshape(height, width, -1)


def power_covariance() -> FloatArray:
    """Covariance of the prior of q, [band, band]."""
    slope = np.log(EDGES[1:] * EDGES[:-1]) / 2
    slope -= slope.mean()
    return np.asarray(POWER_SD**2 + SLOPE_SD**2 * np.outer(slope, slope) + BAND_SD**2 * np.eye(len(slope)))


@njit(fastmath=True, cache=True)
def _cholesky(c: FloatArray, lower: FloatArray, d: int) -> float:  # pragma: no cover - compiled
    """Factor of a matrix in place in ``lower``; log determinant."""
    log_det = 0.0
    for i in range(d):
        for j in range(i + 1):
            t = c[i, j]
            for k in range(j):
                t -= lower[i, k] * lower[j, k]
            if i == j:
                t = max(t, 1e-4 * c[i, i])
                lower[i, i] = np.sqrt(t)
                log_det += np.log(t)
            else:
                lower[i, j] = t / lower[j, j]
    return log_det


@njit(fastmath=True, cache=True)
def _invert_lower(lower: FloatArray, inverse: FloatArray, d: int) -> None:  # pragma: no cover - compiled
    """Inverse of a lower triangular matrix."""
    for j in range(d):
        for i in range(j):
            inverse[i, j] = 0.0
        inverse[j, j] = 1 / lower[j, j]
        for i in range(j + 1, d):
            t = 0.0
            for k in range(j, i):
                t -= lower[i, k] * inverse[k, j]
            inverse[i, j] = t / lower[i, i]


@njit(fastmath=True, cache=True)
def _solve(lower: FloatArray, vector: FloatArray, d: int) -> None:  # pragma: no cover - compiled
    """Solution x of lower lower^T x = vector, in place."""
    for i in range(d):
        for k in range(i):
            vector[i] -= lower[i, k] * vector[k]
        vector[i] /= lower[i, i]
    for i in range(d - 1, -1, -1):
        for k in range(i + 1, d):
            vector[i] -= lower[k, i] * vector[k]
        vector[i] /= lower[i, i]


@njit(fastmath=True, cache=True, parallel=True)
def _fit(  # pragma: no cover - compiled
    energy: FloatArray,
    noise: FloatArray,
    number: FloatArray,
    table: FloatArray,
    channels: tuple[int, ...],
    nu: float,
    reweighted: bool,
    precision: FloatArray,
    prior_det: float,
    result: Float32Array,
) -> None:
    """:func:`log_likelihood` of each window; ``result`` is [window, level].

    The length of the tuple ``channels`` is known to the compiler, which unrolls the loops over channels: with two of
    them twice as fast as a number.
    """
    windows, bands, _ = energy.shape
    levels = table.shape[0]
    for p in prange(windows):
        d = len(channels)
        s = np.empty((bands, d, d))
        n = np.empty((bands, d, d))
        log_det = np.empty(bands)
        c = np.empty((d, d))
        lower = np.zeros((d, d))
        inverse = np.zeros((d, d))
        g = np.empty((d, d))
        sigma = np.empty((d, d))
        q = np.empty(bands)
        power = np.empty(bands)  # e^q
        own = np.empty((bands, d))
        trust = np.empty(bands)  # weight of a band in the next fit
        pull = np.empty(bands)
        curvature = np.empty((bands, bands))
        root = np.zeros((bands, bands))
        for b in range(bands):
            index = 0
            for i in range(d):
                for j in range(i, d):
                    s[b, i, j] = s[b, j, i] = energy[p, b, index]
                    n[b, i, j] = n[b, j, i] = noise[p, b, index]
                    index += 1
            for i in range(d):
                for j in range(d):
                    c[i, j] = s[b, i, j] * (1 + SLACK * (i == j))
            log_det[b] = _cholesky(c, lower, d)
        for a in range(levels):
            total = 0.0
            for b in range(bands):
                q[b], power[b], trust[b] = 0.0, 1.0, 1.0
                for i in range(d):
                    own[b, i] = max(s[b, i, i], n[b, i, i])
            for step in range(ITERATIONS):
                is_last = step == ITERATIONS - 1
                for i in range(d):
                    for j in range(i, d):
                        top, bottom = 0.0, 1e-30
                        for b in range(bands):
                            e = power[b] * table[a, b, i, j]
                            weight = trust[b] * number[b] / (own[b, i] * own[b, j] + 1e-20)
                            top += weight * e * (s[b, i, j] - n[b, i, j])
                            bottom += weight * e * e
                        sigma[i, j] = sigma[j, i] = top / bottom
                for i in range(d):
                    sigma[i, i] = max(sigma[i, i], 1e-9)
                for i in range(d):
                    for j in range(d):
                        if i != j:
                            most = MOST_CORRELATION * np.sqrt(sigma[i, i] * sigma[j, j])
                            sigma[i, j] = min(max(sigma[i, j], -most), most)
                for b in range(bands):
                    for i in range(d):
                        for j in range(d):
                            g[i, j] = power[b] * sigma[i, j] * table[a, b, i, j]
                            c[i, j] = g[i, j] + n[b, i, j]
                        own[b, i] = c[i, i]
                        c[i, i] *= 1 + SLACK
                    det = _cholesky(c, lower, d)
                    _invert_lower(lower, inverse, d)
                    trace, slope, curve, cross = 0.0, 0.0, 0.0, 0.0
                    for i in range(d):
                        for j in range(i + 1):
                            white, model = 0.0, 0.0
                            for k in range(i + 1):
                                for m in range(j + 1):
                                    y = inverse[i, k] * inverse[j, m]
                                    white += y * s[b, k, m]
                                    model += y * g[k, m]
                            if i == j:
                                trace += white
                                slope += model
                            times = 1.0 if i == j else 2.0
                            curve += times * model * model
                            cross += times * model * white
                    divergence = max(0.5 * number[b] * (det + trace - log_det[b] - d), 0.0)
                    if is_last:
                        total -= nu * np.log(1 + divergence / nu)
                    if reweighted:
                        trust[b] = nu / (nu + divergence)
                    pull[b] = 0.5 * trust[b] * number[b] * (cross - slope)
                    for k in range(bands):
                        pull[b] -= precision[b, k] * q[k]
                        curvature[b, k] = precision[b, k]
                    curvature[b, b] += 0.5 * trust[b] * number[b] * curve
                det = _cholesky(curvature, root, bands)
                if not is_last:
                    _solve(root, pull, bands)
                    for b in range(bands):
                        q[b] += min(max(pull[b], -1.0), 1.0)
                        power[b] = np.exp(q[b])
                else:
                    for b in range(bands):
                        for k in range(bands):
                            total -= 0.5 * q[b] * precision[b, k] * q[k]
            result[p, a] = total - 0.5 * (det + prior_det)
