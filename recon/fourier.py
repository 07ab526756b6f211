"""Fourier transforms: frames padded to periodic ones, and the transfer functions of kernels."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from dasim.typing import Complex64Array, Float32Array

THREADS: int = numba.config.NUMBA_NUM_THREADS  # cores that this process may use, unless the environment says otherwise
WORKERS = min(2, THREADS)  # with more, transforms would need more memory

Box = tuple[slice, slice]  # rows and columns of a frame; they may lie outside of it


def fast_shape(shape: tuple[int, ...], margin: int, multiple: int = 1) -> tuple[int, int]:
    """Size [h, w] of a frame padded by at least ``margin`` pixels, fast to transform and a multiple of ``multiple``."""
    height, width = (multiple * fft.next_fast_len(-(-(n + margin) // multiple), real=True) for n in shape[:2])
    return height, width


def pad_blended(image: Float32Array, shape: tuple[int, int]) -> Float32Array:
    """Pad images [..., h, w] at the bottom and right to ``shape``, so that their periodic continuation has no step.

    The padding blends linearly from the mirror image at one edge to the mirror image at the opposite edge.
    """
    for axis in (-2, -1):
        size, strip = image.shape[axis], shape[axis] - image.shape[axis]
        if strip <= 0:
            continue
        index = np.arange(strip)
        after_end = np.take(image, mirrored(size + index, size), axis=axis)
        before_start = np.take(image, mirrored(index - strip, size), axis=axis)
        share = ((index + 1) / (strip + 1)).astype(np.float32)
        share = share[:, None] if axis == -2 else share
        image = np.concatenate([image, (1 - share) * after_end + share * before_start], axis=axis)
    return image.astype(np.float32, copy=False)


def cut_blended(image: Float32Array, box: Box, shape: tuple[int, int]) -> Float32Array:
    """A box of images [..., h, w], padded at the bottom and right to ``shape``, so that it is periodic without a step.

    The padding blends, by a raised cosine, from the pixels after the box to those before it. Pixels outside the images,
    also inside the box, are mirrored.
    """
    rows, columns = (_around(*at) for at in zip(box, shape, image.shape[-2:], strict=True))
    image = image[..., rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]  # before anything is copied
    image = _continued(image, rows - rows.min(), shape[0], -2)
    return np.ascontiguousarray(_continued(image, columns - columns.min(), shape[1], -1), np.float32)


def continued(values: Float32Array, part: slice, length: int) -> Float32Array:
    """:func:`cut_blended` of values along one axis, [length]."""
    return _continued(values, _around(part, length, len(values)), length, -1)


def _around(part: slice, length: int, size: int) -> NDArray[np.intp]:
    """Indices, mirrored into ``size`` samples, of a part and of its padding to ``length`` on either side."""
    strip = length - (part.stop - part.start)
    return mirrored(np.arange(part.start - strip, part.stop + strip), size)


def _continued(image: Float32Array, around: NDArray[np.intp], length: int, axis: int) -> Float32Array:
    """Samples at the indices ``around`` along an axis, cut to ``length`` with the end blended into the beginning."""
    if len(around) != image.shape[axis] or around[0] != 0 or around[-1] != len(around) - 1:
        image = np.take(image, around, axis=axis)
    strip = len(around) - length
    before, inside, after = (
        image[..., start:stop, :] if axis == -2 else image[..., start:stop]
        for start, stop in ((0, strip), (strip, length), (length, len(around)))
    )
    share = (0.5 - 0.5 * np.cos(np.pi * np.arange(1, strip + 1) / (strip + 1))).astype(np.float32)
    share = share[:, None] if axis == -2 else share
    return np.concatenate([inside, after + share * (before - after)], axis=axis)


def mirrored(index: NDArray, size: int) -> NDArray:
    """Index within ``size`` samples that a position outside maps to, half-sample symmetric."""
    folded = np.mod(index, 2 * size)
    return np.where(folded < size, folded, 2 * size - 1 - folded)


def forward(image: Float32Array, workers: int = WORKERS) -> Complex64Array:
    """Transform of a real image [..., h, w] along the last two axes, [..., h, w/2 + 1]."""
    return fft.rfft2(image, workers=workers)


def inverse(spectrum: Complex64Array, shape: tuple[int, int], workers: int = WORKERS) -> Float32Array:
    """Real image [..., h, w] of a spectrum [..., h, w/2 + 1]; ``shape`` is [h, w]."""
    return fft.irfft2(spectrum, shape, workers=workers)


def frequencies(shape: tuple[int, int], spacing_px: float = 1.0) -> tuple[NDArray, NDArray]:
    """Frequencies fy [h, 1] and fx [1, w/2 + 1] in cycles per pixel, of a grid with a spacing of ``spacing_px``."""
    return fft.fftfreq(shape[0], spacing_px)[:, None], fft.rfftfreq(shape[1], spacing_px)[None, :]


def transfer(kernel: NDArray, shape: tuple[int, int], spacing_px: float = 1.0) -> Complex64Array:
    """Transfer function [h, w/2 + 1] of a kernel [..., size, size] centred on its middle pixel.

    sum h(y, x) exp(-2 pi i (fy y + fx x)) at the frequencies of a grid with a spacing of ``spacing_px``, an integer.
    """
    step = round(spacing_px)
    if step != spacing_px:
        raise ValueError(f"a sample spacing of {spacing_px} pixels; it must be a whole number")
    # The transform on the pixel grid, restricted to the frequencies of the coarser grid, one axis at a time. A matrix
    # product would be shorter, but its idle threads occupy the other cores.
    half = (shape[0] + 1) // 2
    along_x = fft.rfft(_wrapped(kernel, shape[1] * step, -1), axis=-1)[..., : shape[1] // 2 + 1]
    both = fft.fft(_wrapped(along_x, shape[0] * step, -2), axis=-2)
    if step == 1:
        return both
    return np.concatenate([both[..., :half, :], both[..., both.shape[-2] - (shape[0] - half) :, :]], axis=-2)


def _wrapped(kernel: NDArray, length: int, axis: int) -> NDArray:
    """A kernel with its last axis, or the one before it, padded to ``length`` with its middle at index 0.

    Where it is longer, it is wrapped around.
    """
    size = kernel.shape[axis]
    shape = list(kernel.shape)
    shape[axis] = length
    padded = np.zeros(shape, np.result_type(kernel, np.float32))
    whole, source = (np.moveaxis(array, axis, 0) for array in (padded, kernel))
    if size <= length:
        half = size // 2
        whole[: size - half], whole[length - half :] = source[half:], source[:half]
    else:
        np.add.at(whole, (np.arange(size) - size // 2) % length, source)
    return padded
