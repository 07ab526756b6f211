"""Layers of small convolutional networks on images [h, w, channel], in NumPy and Numba.

A network is a dictionary of float32 arrays by name: ``NAME`` holds the weights of a layer, ``NAME_bias`` its bias.
Prediction needs no library for networks; :mod:`validation.training` fits the weights.

Convolutions use Winograd's minimal filtering algorithm F(4, 3) along rows: four pixels of a row take 6 products for
each channel and each row of the kernel instead of 12. The rest are sums and products with small constants. (Lavin and
Gray, Fast algorithms for convolutional neural networks, CVPR 2016; transforms of sec. 4.3, in one dimension.) It
halves the time and changes results by rounding, 1e-5 of their size.

Images are processed in strips of rows, one per CPU core at a time. Matrix products within a strip use one thread: BLAS
threads busy-wait for each other, which took up to six times the CPU time when other processes shared the cores.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib.resources import files
from threading import Lock
from typing import Any

import numpy as np
from numba import njit
from threadpoolctl import ThreadpoolController

from dasim.base.threads import mapped
from dasim.typing import Float32Array
from recon import fourier

Net = Mapping[str, Float32Array]

# From the three kernel values of a row to the six factors of F(4, 3).
TRANSFORM = np.array(
    [
        [1 / 4, 0, 0],
        [-1 / 6, -1 / 6, -1 / 6],
        [-1 / 6, 1 / 6, -1 / 6],
        [1 / 24, 1 / 12, 1 / 6],
        [1 / 24, -1 / 12, 1 / 6],
        [0, 0, 1],
    ],
    np.float32,
)
STRIP = 2**13  # pixels that are convolved at a time: sums of 40 to 100 channels remain in a core's cache


def load(package: str, file: str) -> Net:
    """Arrays of a network from a file beside the modules of ``package``; ``about`` of the file says how it was made."""
    with files(package).joinpath(file).open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
        return {name: stored[name].astype(np.float32) for name in stored.files if name != "about"}


def relu(image: Float32Array) -> Float32Array:
    """The larger of each value and 0, in place."""
    return np.maximum(image, 0, out=image)


def linear(image: Float32Array, net: Net, name: str) -> Float32Array:
    """A linear map of the channels of each pixel; weights are [input, output]."""
    result = np.empty((*image.shape[:2], net[name].shape[-1]), np.float32)

    def work(rows: slice) -> None:
        result[rows] = _mapped(image[rows], net, name)

    by_strips(work, image.shape)
    return result


def convolved(image: Float32Array, net: Net, name: str, dilation: int = 1) -> Float32Array:
    """A 3 x 3 convolution with weights [3, 3, input, output]; beyond the frame, its border is repeated."""
    result, factors = np.empty((*image.shape[:2], net[name].shape[-1]), np.float32), _factors(net[name])

    def work(rows: slice) -> None:
        found = _convolved(_around(image, rows, dilation), factors, net[f"{name}_bias"], dilation)
        result[rows] = found[:, : image.shape[1]]

    by_strips(work, image.shape)
    return result


def residual(image: Float32Array, net: Net, first: str, second: str, dilation: int = 1) -> Float32Array:
    """The residual block h + B relu(A * relu(h) + a) + b with the convolution ``first`` and the map ``second``."""
    result, factors = np.empty_like(image), _factors(net[first])

    def work(rows: slice) -> None:
        inner = _convolved(relu(_around(image, rows, dilation)), factors, net[f"{first}_bias"], dilation)
        np.add(image[rows], _mapped(relu(inner), net, second)[:, : image.shape[1]], out=result[rows])

    by_strips(work, image.shape)
    return result


def refined(image: Float32Array, net: Net, name: str) -> Float32Array:
    """A residual block followed by :func:`relu`; ``image`` is an output of :func:`relu`."""
    return relu(residual(image, net, f"{name}_a", f"{name}_b"))


@cache
def _blas() -> ThreadpoolController:
    return ThreadpoolController().select(user_api="blas")


class _OneBlasThread:
    """Limits BLAS to one thread per matrix product while at least one thread is inside this context.

    The limit applies to the whole process: if each thread saved and restored it, one would restore another's limit.
    """

    def __init__(self) -> None:
        self._lock, self._inside = Lock(), 0
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._inside:
                self._limit = _blas().limit(limits=1)
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:
                self._limit.restore_original_limits()


_ONE_BLAS_THREAD = _OneBlasThread()


def by_strips(work: Callable[[slice], None], shape: tuple[int, ...]) -> None:
    """Call ``work`` for strips of rows of an image of a ``shape``, in threads."""
    size = max(STRIP // shape[1], 1)
    strips = [slice(top, min(top + size, shape[0])) for top in range(0, shape[0], size)]
    with _ONE_BLAS_THREAD:
        list(mapped(work, strips, fourier.THREADS))


def _around(image: Float32Array, rows: slice, dilation: int) -> Float32Array:
    """Rows of an image with ``dilation`` pixels on all sides, [row, column, channel].

    On the right are some columns more, so that a row is a whole number of groups of :func:`_convolved`.
    """
    part = np.take(image, range(rows.start - dilation, rows.stop + dilation), axis=0, mode="clip")
    right = dilation + -image.shape[1] % (4 * dilation)
    return np.pad(part, ((0, 0), (dilation, right), (0, 0)), mode="edge")


def _factors(kernel: Float32Array) -> Float32Array:
    """Factors of F(4, 3) of a kernel [3, 3, input, output], [factor, row, input, output]."""
    return np.ascontiguousarray(np.tensordot(TRANSFORM, kernel, (1, 1)))


def _convolved(part: Float32Array, factors: Float32Array, bias: Float32Array, dilation: int) -> Float32Array:
    """The convolution of rows from :func:`_around`, with their additional columns on the right.

    A group is four output pixels of a row, ``dilation`` pixels apart.
    """
    height, channels = part.shape[0] - 2 * dilation, part.shape[2]
    spaced = part.reshape(len(part), -1, dilation, channels)
    groups = (spaced.shape[1] - 2) // 4
    values = np.empty((6, len(part), groups, dilation, channels), np.float32)
    _to_values(spaced, values)
    size = height * groups * dilation
    products, product = np.empty((6, size, len(bias)), np.float32), np.empty((size, len(bias)), np.float32)
    for sums, of_rows, factor in zip(products, values.reshape(6, -1, channels), factors, strict=True):
        for row, weights in enumerate(factor):
            first = row * dilation * groups * dilation
            np.matmul(of_rows[first : first + size], weights, out=product if row else sums)
            if row:
                sums += product
    result = np.empty((height, 4 * groups, dilation, len(bias)), np.float32)
    _to_pixels(products.reshape(6, height, groups, dilation, -1), bias, result)
    return result.reshape(height, -1, len(bias))


@njit(cache=True, fastmath=True, nogil=True)
def _to_values(image: Float32Array, values: Float32Array) -> None:  # pragma: no cover - compiled
    """Values [6, row, group, phase, channel] of F(4, 3) of pixels [row, column, phase, channel]."""
    for y in range(values.shape[1]):
        for group in range(values.shape[2]):
            x = 4 * group
            for phase in range(values.shape[3]):
                for channel in range(values.shape[4]):
                    a, b, c = (
                        image[y, x, phase, channel],
                        image[y, x + 1, phase, channel],
                        image[y, x + 2, phase, channel],
                    )
                    d, e, f = (
                        image[y, x + 3, phase, channel],
                        image[y, x + 4, phase, channel],
                        image[y, x + 5, phase, channel],
                    )
                    near, far = e - np.float32(4) * c, d - np.float32(4) * b
                    even, odd = e - c, np.float32(2) * (d - b)
                    values[0, y, group, phase, channel] = np.float32(4) * a - np.float32(5) * c + e
                    values[1, y, group, phase, channel] = near + far
                    values[2, y, group, phase, channel] = near - far
                    values[3, y, group, phase, channel] = even + odd
                    values[4, y, group, phase, channel] = even - odd
                    values[5, y, group, phase, channel] = np.float32(4) * b - np.float32(5) * d + f


@njit(cache=True, fastmath=True, nogil=True)
def _to_pixels(products: Float32Array, bias: Float32Array, image: Float32Array) -> None:  # pragma: no cover - compiled
    """Pixels [row, column, phase, channel] from products [6, row, group, phase, channel] of F(4, 3)."""
    for y in range(products.shape[1]):
        for group in range(products.shape[2]):
            x = 4 * group
            for phase in range(products.shape[3]):
                for channel in range(products.shape[4]):
                    near = products[1, y, group, phase, channel] + products[2, y, group, phase, channel]
                    far = products[1, y, group, phase, channel] - products[2, y, group, phase, channel]
                    even = products[3, y, group, phase, channel] + products[4, y, group, phase, channel]
                    odd = products[3, y, group, phase, channel] - products[4, y, group, phase, channel]
                    own = bias[channel]
                    image[y, x, phase, channel] = products[0, y, group, phase, channel] + near + even + own
                    image[y, x + 1, phase, channel] = far + np.float32(2) * odd + own
                    image[y, x + 2, phase, channel] = near + np.float32(4) * even + own
                    image[y, x + 3, phase, channel] = (
                        far + np.float32(8) * odd + products[5, y, group, phase, channel] + own
                    )


def _mapped(part: Float32Array, net: Net, name: str) -> Float32Array:
    """:func:`linear` of a few rows."""
    height, width, channels = part.shape
    result = part.reshape(-1, channels) @ net[name]  # one product is faster than one per row
    result += net[f"{name}_bias"]
    return np.asarray(result, np.float32).reshape(height, width, -1)


def gathered(image: Float32Array) -> Float32Array:
    """The four pixels of each 2 x 2 block as channels: half as high and wide."""
    height, width, channels = image.shape
    result = np.empty((height // 2, width // 2, 4 * channels), image.dtype)

    def work(rows: slice) -> None:
        _gather(image[2 * rows.start : 2 * rows.stop], result[rows])

    by_strips(work, result.shape)
    return result


def spread(image: Float32Array) -> Float32Array:
    """Inverse of :func:`gathered`."""
    height, width, channels = image.shape
    result = np.empty((2 * height, 2 * width, channels // 4), image.dtype)

    def work(rows: slice) -> None:
        _spread(image[rows], result[2 * rows.start : 2 * rows.stop])

    by_strips(work, image.shape)
    return result


@njit(cache=True, nogil=True)
def _gather(image: Float32Array, blocks: Float32Array) -> None:  # pragma: no cover - compiled
    """Blocks [h, w, 4 channel] of the pixels of an image [2 h, 2 w, channel]."""
    for y in range(blocks.shape[0]):
        for x in range(blocks.shape[1]):
            for channel in range(image.shape[2]):
                for down in range(2):
                    for right in range(2):
                        blocks[y, x, 4 * channel + 2 * down + right] = image[2 * y + down, 2 * x + right, channel]


@njit(cache=True, nogil=True)
def _spread(blocks: Float32Array, image: Float32Array) -> None:  # pragma: no cover - compiled
    """Inverse of :func:`_gather`."""
    for y in range(blocks.shape[0]):
        for x in range(blocks.shape[1]):
            for channel in range(image.shape[2]):
                for down in range(2):
                    for right in range(2):
                        image[2 * y + down, 2 * x + right, channel] = blocks[y, x, 4 * channel + 2 * down + right]
