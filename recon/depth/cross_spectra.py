"""Cross-spectra of the channels in frequency bands around each sample, measured and as expected at each level.

In a window, the channels' band-passed images y_i give the matrix S_b = <y_i y_j> of each band b. A plane at blur level
a, whose texture has the power P = 1/f^2.6 and the covariance Sigma between channels, has

    C_b = e^{q_b} Sigma o A_b(a) + N_b,    A_b,ij(a) = mean over band b of sum_k P(f_k) H_i(f_k) conj H_j(f_k) s_ij,k

with the transfer functions H of the kernels, the frequencies f_k that alias to f because the planes sample every second
pixel (the sign s_ij,k depends on the positions of both channels in the mosaic's block), and the noise N_b.

Infrared is subtracted from the visible channels, so N_b has cross terms: the noise of infrared times both alphas.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array, FloatArray
from recon import fourier
from recon.depth.grid import PLANE_SPACING_PX, gaussian_means, plane_mean, transform
from recon.picture.mosaic import Phase

EDGES = np.array([0.010, 0.022, 0.036, 0.055, 0.08, 0.11, 0.145, 0.19, 0.24])  # cycles per pixel, evenly in log f
LEAST_SPAN = 0.30  # least product of a window's standard deviation, pixels, and the width of a band
TABLE_SIDE = 96  # of the grid of planes on which A is summed
# Of the texture's power over frequency: the mean over random scenes of :mod:`validation.training.traced`.
TEXTURE_EXPONENT = 2.6
MARGIN = 48  # samples of padding
# With ``Window.even``, weights are 1 / (local energy + NOISE_FLOOR times the noise). The local energy is the
# mean of the first channel's over a Gaussian around the sample, whose standard deviation is LOCAL cycles of the band.
NOISE_FLOOR, LOCAL = 3.0, 0.35


class Spectra(NamedTuple):
    """Cross-spectra on a grid of windows; pairs (i, j) with i <= j, row by row."""

    energy: Float32Array  # S, [h, w, band, pair]
    noise: Float32Array  # N, [h, w, band, pair]
    number: Float32Array  # of independent values in a window, [band]


class Window(NamedTuple):
    """A Gaussian window, and where it is placed."""

    sigma_px: float  # raw pixels
    step: int  # between centres, samples of the planes
    even: bool = False  # strong texture has less weight, so that a few edges of other surfaces do not dominate


def pairs(channels: int) -> list[tuple[int, int]]:
    """Pairs of channels i <= j, row by row."""
    return [(i, j) for i in range(channels) for j in range(i, channels)]


def rings(radius: FloatArray) -> list[Float32Array]:
    """Band-pass filters at frequencies ``radius``: cosines in log f, whose squares sum to 1 inside the range."""
    edges = np.log(EDGES)
    x = np.log(np.maximum(radius, 1e-6))
    filters = []
    for band in range(len(edges) - 1):
        low, high = edges[band], edges[band + 1]
        middle = (low + high) / 2
        left = (edges[band - 1] + low) / 2 if band else middle - (high - low)
        right = (high + edges[band + 2]) / 2 if band + 2 < len(edges) else middle + (high - low)
        away = np.where(x < middle, (middle - x) / (middle - left), (x - middle) / (right - middle))
        filters.append(np.where(away < 1, np.cos(np.pi / 2 * np.minimum(away, 1)), 0).astype(np.float32))
    return filters


def measured(
    planes: Sequence[NDArray],
    phases: Sequence[Phase],
    variances: Sequence[Float32Array],
    alpha: Sequence[float],
    windows: Sequence[Window],
) -> list[Spectra]:
    """Cross-spectra of planes [h, w] in Gaussian windows of several sizes.

    Args:
        planes: visible channels, then infrared, electrons.
        phases: positions of their samples in the mosaic's block.
        variances: of their noise, [h, w] each.
        alpha: share of infrared in each visible channel, which is subtracted.
        windows: sizes of the windows.
    """
    height, width = planes[0].shape
    shape = fourier.fast_shape((height, width), MARGIN)
    spectra = [
        transform(np.ascontiguousarray(plane, np.float32), phase, shape)
        for plane, phase in zip(planes, phases, strict=True)
    ]
    clean = [s - np.complex64(a) * spectra[-1] for s, a in zip(spectra[:-1], alpha, strict=True)] + [spectra[-1]]
    noise_images = _noise(variances, alpha)
    which = pairs(len(clean))
    parts: list[list[tuple[Float32Array, Float32Array, float]]] = [[] for _ in windows]
    noise: dict[tuple[float, int], Float32Array] = {}
    for band, ring in enumerate(rings(np.hypot(*fourier.frequencies(shape, PLANE_SPACING_PX)))):
        share = plane_mean(ring**2, shape[1])
        images = [fourier.inverse(np.asarray(s * ring, np.complex64), shape)[:height, :width] for s in clean]
        products = [images[i] * images[j] / np.float32(share) for i, j in which]
        for part, window in zip(parts, windows, strict=True):
            sigma = max(window.sigma_px, LEAST_SPAN / (EDGES[band + 1] - EDGES[band])) / PLANE_SPACING_PX
            if window.even:
                weight = _evening(products[0], noise_images[0], band)
                total = _means([weight], sigma, window.step)
                energy, of_noise = (
                    _means([weight * image for image in some], sigma, window.step) / total
                    for some in (products, noise_images)
                )
            else:
                if (sigma, window.step) not in noise:  # most bands have the same window
                    noise[sigma, window.step] = _means(noise_images, sigma, window.step)
                energy, of_noise = _means(products, sigma, window.step), noise[sigma, window.step]
            part.append((energy, of_noise, 4 * np.pi * sigma**2 * share))
    return [
        Spectra(np.stack(energies, axis=-2), np.stack(noises, axis=-2), np.array(number, np.float32))
        for energies, noises, number in (zip(*part, strict=True) for part in parts)
    ]


def _evening(energy: Float32Array, noise: Float32Array, band: int) -> Float32Array:
    """Weights of samples that reduce the influence of strong texture, [h, w].

    All channels and the noise have the same weights, so that the matrices of a plane keep their form. ``energy`` and
    ``noise`` [h, w] are those of one channel in a band.
    """
    sigma = LOCAL / np.sqrt(EDGES[band] * EDGES[band + 1]) / PLANE_SPACING_PX
    around = np.maximum(cv2.GaussianBlur(energy, (0, 0), sigma, borderType=cv2.BORDER_REFLECT), 0)
    return np.asarray(1 / (around + NOISE_FLOOR * noise + np.float32(1e-12)), np.float32)


def _noise(variances: Sequence[Float32Array], alpha: Sequence[float]) -> list[Float32Array]:
    """Noise covariance of each pair of channels without infrared; infrared's noise is in all of them."""
    own = [*alpha, -1.0]  # channel i is plane i - own_i times infrared, and infrared is the plane 0 + 1 times infrared
    last = len(variances) - 1
    return [
        np.float32(own[i] * own[j]) * variances[last] + (variances[i] if i == j < last else np.float32(0))
        for i, j in pairs(len(variances))
    ]


def _means(images: Sequence[Float32Array], sigma: float, step: int) -> Float32Array:
    """Means of images [h, w] over windows of ``sigma`` samples, at the nodes, [row, column, image]."""
    means = gaussian_means(images, sigma, nodes(images[0].shape, step))
    return np.ascontiguousarray(np.moveaxis(means, 0, -1))


def nodes(shape: Sequence[int], step: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the windows' centres, in the middle of blocks of ``step`` samples; the last may be cut."""
    rows, columns = (np.minimum(np.arange(-(-length // step)) * step + step // 2, length - 1) for length in shape[:2])
    return rows, columns


def expected(kernels: Float32Array, phases: Sequence[Phase], exponent: float = TEXTURE_EXPONENT) -> FloatArray:
    """A of each level of kernels [level, channel, y, x], the mean over a band, [level, band, channel, channel].

    The kernels are of raw pixels; texture, of the power f^-``exponent``, is left out beyond 0.5 cycles per pixel.
    """
    side = TABLE_SIDE
    shape = (2 * side, 2 * side)
    fy, fx = np.meshgrid(np.fft.fftfreq(2 * side), np.fft.fftfreq(2 * side), indexing="ij")
    power = np.maximum(np.hypot(fy, fx), 0.4 / (2 * side)) ** -exponent
    base_y, base_x = np.meshgrid(np.fft.fftfreq(side, 2.0), np.fft.fftfreq(side, 2.0), indexing="ij")
    weights = np.stack([ring.astype(np.float64) ** 2 for ring in rings(np.hypot(base_y, base_x))])
    weights /= weights.sum(axis=(1, 2), keepdims=True)
    index = np.rint(np.fft.fftfreq(side, 2.0) * 2 * side).astype(int)
    # A frequency of the upper half folds to one half a cycle per pixel lower.
    folds = [(down, right) for down in (0, 1) for right in (0, 1)]
    places = [
        ((index + side * down)[:, None] % (2 * side), (index + side * right) % (2 * side)) for down, right in folds
    ]
    powers = [(weights * power[place]).reshape(len(weights), -1).T for place in places]
    signs = [np.array([(-1.0) ** (down * y + right * x) for y, x in phases])[:, None] for down, right in folds]
    channels = kernels.shape[1]
    table = np.zeros((len(kernels), len(weights), channels, channels))
    for level, own in enumerate(kernels):
        whole = _whole(fourier.transfer(own, shape), shape)
        for place, folded, sign in zip(places, powers, signs, strict=True):
            signed = whole[:, *place].reshape(channels, -1) * sign
            products = (signed[:, None] * signed[None].conj()).real.reshape(channels**2, -1)
            table[level] += (products @ folded).T.reshape(-1, channels, channels)
    return table


def _whole(half: Complex64Array, shape: tuple[int, int]) -> NDArray:
    """Spectrum [..., h, w] from its half-plane [..., h, w/2 + 1] of a real image."""
    width = shape[1]
    whole = np.empty((*half.shape[:-1], width), half.dtype)
    columns = half.shape[-1]
    whole[..., :columns] = half
    mirrored = np.conj(np.roll(half[..., ::-1, :], 1, axis=-2))
    whole[..., columns:] = mirrored[..., 1 : width - columns + 1][..., ::-1]
    return whole
