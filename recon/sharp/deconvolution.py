"""Deconvolution with a sparse-gradient prior about a predicted gradient, eq. (15)-(16), by half-quadratic splitting.

Tested in tests/recon/sharp/test_sharpen.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier

Phase = tuple[int, int]

PRIOR_POWER = 0.8  # eq. (16)
BETA_FIRST, BETA_GROWTH = 0.03, 4.0  # coupling of the splitting; Krishnan and Fergus 2009, sec. 3, use 2 sqrt(2)
TABLE_LIMIT, TABLE_SIZE = 64.0, 8193
SMALLEST_GRADIENT = np.float32(1e-4)  # keeps 1 / |D|^2 finite at frequency 0, where every transfer function is 1
MEAN_GRADIENT = np.float32(1e-6)  # |D|^2 at frequency 0, where only the data determine the solution
SMALLEST_POWER = np.float32(1e-9)  # against division by zero


class Prior(NamedTuple):
    """The prior of eq. (16): kappa sum(|f_x - e_x|^0.8 + |f_y - e_y|^0.8) with expected gradients e."""

    kappa: NDArray  # [channel]
    expected: tuple[Float32Array, Float32Array] | None = None  # e (x, y), [channel, h, w] each; 0 without, as the paper


class Doubt(NamedTuple):
    """Uncertainty of the data at each frequency that is due to the uncertainty of the transfer function H.

    In addition to noise of unit spectral density, the data have an error of spectral density var(H) S, with the power
    spectrum S of a scene with white gradients. The data are therefore weighted by 1 / (1 + var(H) S).
    """

    spectrum: Float32Array  # var(H) S of gradients of unit mean square (:func:`doubt_of`), [h, w/2 + 1]
    steps: NDArray  # mean square gradient of the scene along x plus that along y, [channel]

    def weight(self, spectrum: Float32Array) -> Float32Array:
        """Weight of the data, [channel, ...], where ``spectrum`` [...] is the one above."""
        steps = np.asarray(self.steps, np.float32)[:, None, None]
        return np.asarray(1 / (1 + steps * spectrum), np.float32)


def half_quadratic(
    image: Float32Array, transfer: Complex64Array, prior: Prior, steps: int, doubt: Doubt | None = None
) -> Float32Array:
    """Minimise over f |h * f - I|^2 / 2 + kappa sum(|f_x - e_x|^0.8 + |f_y - e_y|^0.8), eq. (15)-(16), periodic.

    Half-quadratic splitting alternates between shrinking the gradients towards the expected ones and solving the
    quadratic problem for f with these gradients; the coupling beta increases in each iteration. The channels' gradients
    shrink together, each in its own unit, because edges of the colours coincide.

    Args:
        image: picture I with noise of standard deviation 1, [channel, h, w].
        transfer: transfer functions of the kernels h, [channel, h, w/2 + 1].
        prior: weights of the prior, and the gradients that it expects.
        steps: number of iterations.
        doubt: how uncertain the transfer functions are.
    """
    shape = (image.shape[-2], image.shape[-1])
    gradient = gradient_power(shape)
    weighted = np.conj(transfer) if doubt is None else doubt.weight(doubt.spectrum) * np.conj(transfer)
    data, power = weighted * fourier.forward(image, 1), np.abs(transfer * weighted)

    def solve(spectrum: Complex64Array, beta: Float32Array) -> Float32Array:
        coupled = beta[:, None, None]
        solution = (data + coupled * spectrum) / (power + coupled * gradient + SMALLEST_POWER)
        return fourier.inverse(solution, shape, 1)

    return _alternate(image, prior, steps, solve)


def _alternate(
    image: Float32Array,
    prior: Prior,
    steps: int,
    solve: Callable[[Complex64Array, Float32Array], Float32Array],
) -> Float32Array:
    """Alternate between shrinkage and the quadratic problem; returns f, [channel, h, w].

    ``solve`` returns f from the transform of D^T w [channel, h, w/2 + 1] and the coupling beta [channel].
    """
    zero = np.zeros((image.shape[0], 1, 1), np.float32)
    expected_x, expected_y = prior.expected or (zero, zero)
    result, divergence, factor = image, np.empty_like(image), BETA_FIRST
    for _ in range(steps):
        scale = _scale(prior.kappa, factor).astype(np.float32)
        _shrunk_divergence(result, expected_x, expected_y, shrink_table(), scale, np.float32(TABLE_LIMIT), divergence)
        result = solve(fourier.forward(divergence, 1), (factor * np.asarray(prior.kappa)).astype(np.float32))
        factor *= BETA_GROWTH
    return result


def quadratic(
    spectrum: Complex64Array, transfer: Complex64Array, beta: NDArray, shape: tuple[int, int]
) -> Float32Array:
    """Minimise over f |h * f - I|^2 + beta (|f_x|^2 + |f_y|^2), eq. (9)-(10), in closed form.

    ``spectrum`` is the transform of I, ``transfer`` that of the kernels, [channel, h, w/2 + 1]; ``beta`` is [channel],
    ``shape`` [h, w].
    """
    weight = np.asarray(beta, np.float32)[:, None, None] * gradient_power(shape)
    spectrum = np.conj(transfer) * spectrum
    return fourier.inverse(spectrum / (np.abs(transfer) ** 2 + weight + SMALLEST_POWER), shape, 1)


def half_quadratic_samples(
    image: Float32Array,
    phases: Sequence[Phase],
    transfer: Complex64Array,
    prior: Prior,
    steps: int,
    doubt: Doubt | None = None,
) -> Float32Array:
    """:func:`half_quadratic` with the samples of a mosaic as data: every second pixel in every second row.

    Blur and subsampling are inverted together; the prior resolves the aliasing. The quadratic problem couples only four
    frequencies at a time and so has a closed form (Zhao et al. 2016, Fast single image super-resolution, theorem 1,
    with the image's differences instead of the image). ``phases`` are the positions (row, column) of each channel's
    first sample; height and width are multiples of 4. For the other parameters see :func:`half_quadratic`.
    """
    shape = (image.shape[-2], image.shape[-1])
    inverse_gradient = _inverse_gradient(shape)
    # The phasors need a name: NumPy would multiply them in place, with other last digits, if another thread's cache
    # dropped them meanwhile.
    phasors = _phase_factors(tuple(phases), shape)
    sampling = transfer * phasors
    data = fourier.forward(np.stack([plane[y::2, x::2] for plane, (y, x) in zip(image, phases, strict=True)]), 1)
    power = np.empty(data.shape, np.float32)
    _fold((sampling.real**2 + sampling.imag**2) * inverse_gradient, power)
    weight: Float32Array = np.ones_like(power)
    if doubt is not None:
        folded = np.empty((1, *power.shape[1:]), np.float32)
        _fold(doubt.spectrum[None], folded)
        weight = doubt.weight(folded[0])

    def solve(spectrum: Complex64Array, beta: Float32Array) -> Float32Array:
        _solve(spectrum, sampling, inverse_gradient, data, weight, power, beta, np.empty_like(data))
        return fourier.inverse(spectrum, shape, 1)

    return _alternate(image, prior, steps, solve)


@njit(cache=True, nogil=True)
def _fold(power: Float32Array, out: Float32Array) -> None:  # pragma: no cover - compiled
    """Mean of power spectra over the four frequencies that alias, [c, h, w/2 + 1] -> [c, h/2, w/4 + 1].

    The power is the same at opposite frequencies.
    """
    channels, height, width = out.shape
    last = power.shape[2] - 1
    for c in range(channels):
        for y in range(height):
            mirror = (height - y) % height
            for x in range(width):
                near = power[c, y, x] + power[c, y + height, x]
                out[c, y, x] = (near + power[c, mirror, last - x] + power[c, mirror + height, last - x]) / 4


@njit(cache=True, nogil=True)
def _solve(  # pragma: no cover - compiled
    spectrum: Complex64Array,
    sampling: Complex64Array,
    inverse_gradient: Float32Array,
    data: Complex64Array,
    weight: Float32Array,
    power: Float32Array,
    beta: Float32Array,
    misfit: Complex64Array,
) -> None:
    """Solve the quadratic problem in place: from the transform of D^T w to that of f, [c, h, w/2 + 1].

    f = p + conj(S) / |D|^2 A^T q with p = D^T w / |D|^2 and q = (data - A S p) / (beta / weight + A |S|^2 / |D|^2).
    S (``sampling``) blurs and shifts to the samples; A averages the four frequencies that alias. ``power`` is
    A |S|^2 / |D|^2, and ``misfit`` a buffer for q, [c, h/2, w/4 + 1].
    """
    channels, half, width = data.shape
    height, last = 2 * half, spectrum.shape[2] - 1
    for c in range(channels):
        here, blur = spectrum[c], sampling[c]
        for y in range(height):
            for x in range(last + 1):
                here[y, x] *= inverse_gradient[y, x]
        here[0, 0] = 0
        for y in range(half):
            mirror = (half - y) % half
            for x in range(width):
                far = last - x
                near = here[y, x] * blur[y, x] + here[y + half, x] * blur[y + half, x]
                other = here[mirror, far] * blur[mirror, far]
                other += here[mirror + half, far] * blur[mirror + half, far]
                rest = data[c, y, x] - (near + np.conj(other)) * np.float32(0.25)
                misfit[c, y, x] = rest * (weight[c, y, x] / (beta[c] + weight[c, y, x] * power[c, y, x]))
        for y in range(height):
            row = y % half
            mirror = (half - row) % half
            for x in range(width):
                here[y, x] += np.conj(blur[y, x]) * misfit[c, row, x] * inverse_gradient[y, x]
            for x in range(width, last + 1):
                here[y, x] += np.conj(blur[y, x] * misfit[c, mirror, last - x]) * inverse_gradient[y, x]


def _scale(kappa: NDArray, factor: float) -> NDArray:
    """Unit of each channel's differences in the shrinkage, [channel]: their expected size for the weight kappa."""
    return factor ** (-1 / (2 - PRIOR_POWER)) * (np.mean(kappa) / np.asarray(kappa)) ** (1 / PRIOR_POWER)


@lru_cache(maxsize=16)
def _phase_factors(phases: tuple[Phase, ...], shape: tuple[int, int]) -> Complex64Array:
    """Phasors [channel, h, w/2 + 1] that shift each channel's first sample to the origin."""
    fy, fx = fourier.frequencies(shape)
    rows, columns = ([np.exp(2j * np.pi * f * n).astype(np.complex64) for n in (0, 1)] for f in (fy, fx))
    return np.stack([rows[y] * columns[x] for y, x in phases])


@lru_cache(maxsize=16)
def _inverse_gradient(shape: tuple[int, int]) -> Float32Array:
    """1 / (|D_x|^2 + |D_y|^2), finite at frequency 0, [h, w/2 + 1]."""
    gradient = gradient_power(shape).copy()
    gradient[0, 0] = MEAN_GRADIENT
    return np.asarray(1 / gradient, np.float32)


def doubt_of(variance: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """:attr:`Doubt.spectrum` of the variance of a transfer function, both [h, w/2 + 1]; ``shape`` is [h, w]."""
    return variance / (gradient_power(shape) + SMALLEST_GRADIENT)


@lru_cache(maxsize=16)
def gradient_power(shape: tuple[int, int]) -> Float32Array:
    """|D_x|^2 + |D_y|^2 of forward differences, [h, w/2 + 1]."""
    fy, fx = fourier.frequencies(shape)
    return (4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2).astype(np.float32)


@lru_cache(maxsize=1)
def shrink_table() -> Float32Array:
    """Minimum over u of |u|^0.8 + (u - v)^2 / 2 for v from 0 to ``TABLE_LIMIT``, [TABLE_SIZE].

    Newton's iteration from v gives the positive minimum, which is used where its cost is below that of u = 0.
    """
    v = np.linspace(0, TABLE_LIMIT, TABLE_SIZE)
    a = PRIOR_POWER
    u = v.copy()
    for _ in range(30):
        safe = np.maximum(u, 1e-6)
        u = np.clip(safe - (a * safe ** (a - 1) + safe - v) / (a * (a - 1) * safe ** (a - 2) + 1), 1e-6, v + 1e-6)
    cost = u**a + (u - v) ** 2 / 2
    return np.where((cost < v**2 / 2) & (v > 0), u, 0).astype(np.float32)


@njit(cache=True, nogil=True)
def _shrinkage(  # pragma: no cover - compiled
    energy: Float32Array, table: Float32Array, limit: np.float32, out: Float32Array
) -> None:
    """Factor by which shrinkage multiplies a difference, [w].

    ``energy`` is the mean square over the channels, each in units of its scale; ``table`` is :func:`shrink_table`.
    """
    per_step = np.float32((table.size - 1) / limit)
    last = np.float32(table.size - 2)
    for x in range(energy.size):
        size = np.sqrt(energy[x]) + np.float32(1e-6)
        place = size * per_step
        low = np.int32(min(place, last))
        value = (table[low] + (place - np.float32(low)) * (table[low + 1] - table[low])) / size
        out[x] = value if place < last else np.float32(1)


@njit(cache=True, nogil=True)
def _shrunk_divergence(  # pragma: no cover - compiled
    image: Float32Array,
    expected_x: Float32Array,
    expected_y: Float32Array,
    table: Float32Array,
    scale: Float32Array,
    limit: np.float32,
    out: Float32Array,
) -> None:
    """D_x^T w_x + D_y^T w_y of forward differences of an image that are shrunk towards the expected ones, periodic.

    ``image`` and ``out`` are [channel, h, w]; ``expected_x`` and ``expected_y`` as well, or [channel, 1, 1] for 0. The
    channels shrink together, by their root mean square in units of each channel's ``scale``. All is one function with
    loops over a row, which the compiler vectorises: cut in two, it takes 1.4 to 1.9 times as long. The row above the
    first is the last one.
    """
    channels, height, width = image.shape
    guided = expected_x.shape[1] == height and expected_x.shape[2] == width
    zero = np.zeros(width, np.float32)
    energy, factor = np.empty((2, width), np.float32)
    along_x, along_y, above = np.empty((3, channels, width), np.float32)
    for row in range(-1, height):
        y = row if row >= 0 else height - 1
        down = y + 1 if y + 1 < height else 0
        energy[:] = 0
        for c in range(channels):
            here, below, expected = image[c, y], image[c, down], expected_y[c, y] if guided else zero
            step, per_unit = along_y[c], 1 / (scale[c] * scale[c] * channels)
            for x in range(width):
                step[x] = below[x] - here[x] - expected[x]
                energy[x] += step[x] * step[x] * per_unit
        _shrinkage(energy, table, limit, factor)
        for c in range(channels):
            step, expected = along_y[c], expected_y[c, y] if guided else zero
            for x in range(width):
                step[x] = factor[x] * step[x] + expected[x]
        if row >= 0:
            energy[:] = 0
            for c in range(channels):
                here, expected = image[c, y], expected_x[c, y] if guided else zero
                step, per_unit = along_x[c], 1 / (scale[c] * scale[c] * channels)
                for x in range(width - 1):
                    step[x] = here[x + 1] - here[x] - expected[x]
                step[width - 1] = here[0] - here[width - 1] - expected[width - 1]
                for x in range(width):
                    energy[x] += step[x] * step[x] * per_unit
            _shrinkage(energy, table, limit, factor)
            for c in range(channels):
                step, expected = along_x[c], expected_x[c, y] if guided else zero
                for x in range(width):
                    step[x] = factor[x] * step[x] + expected[x]
                total, up, left = out[c, y], above[c], along_y[c]
                total[0] = step[width - 1] - step[0] + up[0] - left[0]
                for x in range(1, width):
                    total[x] = step[x - 1] - step[x] + up[x] - left[x]
        above[:] = along_y
