"""Deconvolution with a sparse-gradient prior about a predicted gradient, eq. (15)-(16), by half-quadratic splitting.

Tested in tests/recon/sharp/test_sharpen.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier

Phase = tuple[int, int]

PRIOR_POWER = 0.8  # eq. (16)
BETA_FIRST, BETA_GROWTH = 0.03, 4.0  # of half-quadratic splitting (Krishnan and Fergus 2009, sec. 3, has 2 sqrt(2))
TABLE_LIMIT, TABLE_SIZE = 64.0, 8193
SMALLEST_GRADIENT = np.float32(1e-4)  # finite at frequency 0, where every kernel passes 1 and is certain
MEAN_GRADIENT = np.float32(1e-6)  # at frequency 0, which differences do not see: the data alone decide there
SMALLEST_POWER = np.float32(1e-9)  # keeps a division by zero out where neither kernel nor gradient passes anything


def half_quadratic(
    image: Float32Array,
    transfer: Complex64Array,
    kappa: NDArray,
    steps: int,
    expected: tuple[Float32Array, Float32Array] | None = None,
    trust: Float32Array | None = None,
) -> Float32Array:
    """Minimise over f |h * f - I|^2 / 2 + kappa sum(|f_x - e_x|^0.8 + |f_y - e_y|^0.8), eq. (15)-(16), periodic.

    ``image`` is [channel, h, w] with noise of standard deviation 1, ``transfer`` [channel, h, w/2 + 1], ``kappa``
    [channel], ``expected`` the gradients (x, y) [channel, h, w] that the prior expects; none: 0, as in the paper.
    ``trust`` [channel, h, w/2 + 1] weighs the data's frequencies (:func:`data_trust`).
    Half-quadratic splitting: in turns, gradients shrunk towards the expected ones and f from the quadratic problem
    with them, their coupling beta growing each step. The channels' differences shrink together, each in units of
    its own: edges of the three colours coincide.
    """
    shape = (image.shape[-2], image.shape[-1])
    gradient = gradient_power(shape)
    weighted = np.conj(transfer) if trust is None else trust * np.conj(transfer)
    data, power = weighted * fourier.forward(image, 1), np.abs(transfer * weighted)

    def solve(spectrum: Complex64Array, beta: Float32Array) -> Float32Array:
        coupled = beta[:, None, None]
        found = (data + coupled * spectrum) / (power + coupled * gradient + SMALLEST_POWER)
        return fourier.inverse(found, shape, 1)

    return _alternated(image, kappa, steps, expected, solve)


def _alternated(
    image: Float32Array,
    kappa: NDArray,
    steps: int,
    expected: tuple[Float32Array, Float32Array] | None,
    solve: Callable[[Complex64Array, Float32Array], Float32Array],
) -> Float32Array:
    """Shrinkage and the quadratic problem in turns.

    ``solve`` takes the transform of D^T w and the coupling beta [channel] and gives f.
    """
    none = np.zeros((image.shape[0], 1, 1), np.float32)
    wanted_x, wanted_y = expected or (none, none)
    result, pull, factor = image, np.empty_like(image), BETA_FIRST
    for _ in range(steps):
        scale = _scale(kappa, factor).astype(np.float32)
        _shrunk_divergence(result, wanted_x, wanted_y, shrink_table(), scale, np.float32(TABLE_LIMIT), pull)
        result = solve(fourier.forward(pull, 1), (factor * np.asarray(kappa)).astype(np.float32))
        factor *= BETA_GROWTH
    return result


def quadratic(
    spectrum: Complex64Array, transfer: Complex64Array, beta: NDArray, shape: tuple[int, int]
) -> Float32Array:
    """Minimise over f |h * f - I|^2 + beta (|f_x|^2 + |f_y|^2), eq. (9)-(10), in closed form.

    ``spectrum`` is the transform of I [channel, *shape]; the others as above.
    """
    weight = np.asarray(beta, np.float32)[:, None, None] * gradient_power(shape)
    spectrum = np.conj(transfer) * spectrum
    return fourier.inverse(spectrum / (np.abs(transfer) ** 2 + weight + SMALLEST_POWER), shape, 1)


def half_quadratic_samples(
    image: Float32Array,
    phases: Sequence[Phase],
    transfer: Complex64Array,
    kappa: NDArray,
    steps: int,
    expected: tuple[Float32Array, Float32Array] | None = None,
    trust: Float32Array | None = None,
) -> Float32Array:
    """:func:`half_quadratic` of what a mosaic samples: of each channel every second pixel in every second row counts.

    ``phases`` are the places (row, column) of each channel's first sample; height and width are multiples of 4.
    Blur and loss of samples are undone together: the prior resolves the aliasing. The quadratic problem
    couples four frequencies alone, hence its closed form (Zhao et al. 2016, Fast single image super-resolution,
    theorem 1, with the image's differences instead of the image).
    """
    shape = (image.shape[-2], image.shape[-1])
    whiten = _inverse_gradient(shape)
    seen = transfer * _phase_factors(tuple(phases), shape)
    data = fourier.forward(np.stack([plane[y::2, x::2] for plane, (y, x) in zip(image, phases, strict=True)]), 1)
    passed = np.empty(data.shape, np.float32)
    _fold((seen.real**2 + seen.imag**2) * whiten, passed)
    weight: Float32Array = np.ones_like(passed)
    if trust is not None:
        _fold(1 / trust - 1, weight)
        weight = np.asarray(1 / (1 + weight), np.float32)

    def solve(spectrum: Complex64Array, beta: Float32Array) -> Float32Array:
        _solve(spectrum, seen, whiten, data, weight, passed, beta, np.empty_like(data))
        return fourier.inverse(spectrum, shape, 1)

    return _alternated(image, kappa, steps, expected, solve)


@njit(cache=True, nogil=True)
def _fold(power: Float32Array, out: Float32Array) -> None:  # pragma: no cover - compiled
    """Mean over the four frequencies that alias on every second sample, [c, h, w/2 + 1] -> [c, h/2, w/4 + 1].

    Of powers, which are the same at opposite frequencies.
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
    seen: Complex64Array,
    whiten: Float32Array,
    data: Complex64Array,
    weight: Float32Array,
    passed: Float32Array,
    beta: Float32Array,
    misfit: Complex64Array,
) -> None:
    """The quadratic problem in place: from the transform of D^T w to that of f, [c, h, w/2 + 1].

    f = p + conj(S) / |D|^2 A^T q with p = D^T w / |D|^2, q = (data - A S p) / (beta / weight + A |S|^2 / |D|^2), where
    S blurs and shifts to the samples and A adds up the frequencies that alias there.
    """
    channels, half, width = data.shape
    height, last = 2 * half, spectrum.shape[2] - 1
    for c in range(channels):
        here, passing = spectrum[c], seen[c]
        for y in range(height):
            for x in range(last + 1):
                here[y, x] *= whiten[y, x]
        here[0, 0] = 0
        for y in range(half):
            mirror = (half - y) % half
            for x in range(width):
                far = last - x
                near = here[y, x] * passing[y, x] + here[y + half, x] * passing[y + half, x]
                other = here[mirror, far] * passing[mirror, far]
                other += here[mirror + half, far] * passing[mirror + half, far]
                found = data[c, y, x] - (near + np.conj(other)) * np.float32(0.25)
                misfit[c, y, x] = found * (weight[c, y, x] / (beta[c] + weight[c, y, x] * passed[c, y, x]))
        for y in range(height):
            row = y % half
            mirror = (half - row) % half
            for x in range(width):
                here[y, x] += np.conj(passing[y, x]) * misfit[c, row, x] * whiten[y, x]
            for x in range(width, last + 1):
                here[y, x] += np.conj(passing[y, x] * misfit[c, mirror, last - x]) * whiten[y, x]


def _scale(kappa: NDArray, factor: float) -> NDArray:
    """Unit of each channel's differences in the shrinkage: their expected size for the weight kappa."""
    return factor ** (-1 / (2 - PRIOR_POWER)) * (np.mean(kappa) / np.asarray(kappa)) ** (1 / PRIOR_POWER)


@lru_cache(maxsize=16)
def _phase_factors(phases: tuple[Phase, ...], shape: tuple[int, int]) -> Complex64Array:
    """Shift theorem's factors [channel, h, w/2 + 1] that bring each channel's first sample to the origin."""
    fy, fx = fourier.frequencies(shape)
    return np.stack([np.exp(2j * np.pi * (fy * y + fx * x)) for y, x in phases]).astype(np.complex64)


@lru_cache(maxsize=16)
def _inverse_gradient(shape: tuple[int, int]) -> Float32Array:
    """1 / (|D_x|^2 + |D_y|^2), finite at frequency 0."""
    gradient = gradient_power(shape).copy()
    gradient[0, 0] = MEAN_GRADIENT
    return np.asarray(1 / gradient, np.float32)


def data_trust(variance: Float32Array, steps: NDArray, shape: tuple[int, int]) -> Float32Array:
    """Weight 1 / (1 + var(H) S) of data whose transfer function is known up to ``variance`` [channel, h, w/2 + 1].

    Noise has unit density, and what an uncertain kernel adds has var(H) S, with the scene's spectrum S of white
    gradients whose mean squares along x and y add up to ``steps`` [channel].
    """
    scene = np.asarray(steps, np.float32)[:, None, None] / (gradient_power(shape) + SMALLEST_GRADIENT)
    return (1 / (1 + variance * scene)).astype(np.float32)


@lru_cache(maxsize=16)
def gradient_power(shape: tuple[int, int]) -> Float32Array:
    """|D_x|^2 + |D_y|^2 of differences on the half-plane of frequencies."""
    fy, fx = fourier.frequencies(shape)
    return (4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2).astype(np.float32)


@lru_cache(maxsize=1)
def shrink_table() -> Float32Array:
    """Minimise over u |u|^0.8 + (u - v)^2 / 2 for v from 0 to ``TABLE_LIMIT``, [TABLE_SIZE].

    The positive minimum from Newton's iteration started at v, used where its cost is below that of u = 0.
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
def _kept(  # pragma: no cover - compiled
    energy: Float32Array, table: Float32Array, limit: np.float32, out: Float32Array
) -> None:
    """Share of a difference that shrinkage leaves, from the mean square of its channels in units of their scale."""
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
    wanted_x: Float32Array,
    wanted_y: Float32Array,
    table: Float32Array,
    scale: Float32Array,
    limit: np.float32,
    out: Float32Array,
) -> None:
    """D_x^T w_x + D_y^T w_y of forward differences shrunk towards the wanted ones, periodic.

    The channels' differences shrink together, by their root mean square in units of each channel's ``scale``. Row by
    row, in loops that the compiler turns into vectors; the row above the first is the last one.
    """
    channels, height, width = image.shape
    own = wanted_x.shape[1] == height and wanted_x.shape[2] == width
    zero = np.zeros(width, np.float32)
    energy, share = np.empty((2, width), np.float32)
    along_x, along_y, above = np.empty((3, channels, width), np.float32)
    for row in range(-1, height):
        y = row if row >= 0 else height - 1
        down = y + 1 if y + 1 < height else 0
        energy[:] = 0
        for c in range(channels):
            here, below, expected = image[c, y], image[c, down], wanted_y[c, y] if own else zero
            step, per_unit = along_y[c], 1 / (scale[c] * scale[c] * channels)
            for x in range(width):
                step[x] = below[x] - here[x] - expected[x]
                energy[x] += step[x] * step[x] * per_unit
        _kept(energy, table, limit, share)
        for c in range(channels):
            step, expected = along_y[c], wanted_y[c, y] if own else zero
            for x in range(width):
                step[x] = share[x] * step[x] + expected[x]
        if row >= 0:
            energy[:] = 0
            for c in range(channels):
                here, expected = image[c, y], wanted_x[c, y] if own else zero
                step, per_unit = along_x[c], 1 / (scale[c] * scale[c] * channels)
                for x in range(width - 1):
                    step[x] = here[x + 1] - here[x] - expected[x]
                step[width - 1] = here[0] - here[width - 1] - expected[width - 1]
                for x in range(width):
                    energy[x] += step[x] * step[x] * per_unit
            _kept(energy, table, limit, share)
            for c in range(channels):
                step, expected = along_x[c], wanted_x[c, y] if own else zero
                for x in range(width):
                    step[x] = share[x] * step[x] + expected[x]
                found, up, left = out[c, y], above[c], along_y[c]
                found[0] = step[width - 1] - step[0] + up[0] - left[0]
                for x in range(1, width):
                    found[x] = step[x - 1] - step[x] + up[x] - left[x]
        above[:] = along_y
