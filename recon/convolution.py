"""Layers of small convolutional networks on images [h, w, channel], in numpy alone.

A network is a dictionary of float32 arrays by name: ``NAME`` holds the weights of a layer, ``NAME_bias`` its bias.
Prediction needs no other library; :mod:`validation.training` fits the weights.

Images are processed in strips of rows, one per CPU core at a time. Matrix products within a strip use one thread: BLAS
threads busy-wait for each other, which took up to six times the CPU time when other processes shared the cores.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from importlib.resources import files
from threading import Lock
from typing import Any

import numpy as np
from threadpoolctl import ThreadpoolController

from dasim.typing import Float32Array

Net = Mapping[str, Float32Array]

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
    result = np.empty((*image.shape[:2], net[name].shape[-1]), np.float32)

    def work(rows: slice) -> None:
        result[rows] = _convolved(_around(image, rows, dilation), net, name, dilation)

    by_strips(work, image.shape)
    return result


def residual(image: Float32Array, net: Net, first: str, second: str, dilation: int = 1) -> Float32Array:
    """The residual block h + B relu(A * relu(h) + a) + b with the convolution ``first`` and the map ``second``."""
    result = np.empty_like(image)

    def work(rows: slice) -> None:
        inner = _convolved(relu(_around(image, rows, dilation)), net, first, dilation)
        np.add(image[rows], _mapped(relu(inner), net, second), out=result[rows])

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
    with _ONE_BLAS_THREAD, ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(work, [slice(top, min(top + size, shape[0])) for top in range(0, shape[0], size)]))


def _around(image: Float32Array, rows: slice, dilation: int) -> Float32Array:
    """Rows of an image with ``dilation`` pixels on all sides, [row, column, channel]."""
    part = np.take(image, range(rows.start - dilation, rows.stop + dilation), axis=0, mode="clip")
    return np.pad(part, ((0, 0), (dilation, dilation), (0, 0)), mode="edge")


def _convolved(part: Float32Array, net: Net, name: str, dilation: int) -> Float32Array:
    """The convolution of rows from :func:`_around`."""
    height, width, channels = part.shape[0] - 2 * dilation, part.shape[1] - 2 * dilation, part.shape[2]
    kernels = net[name].reshape(3, 3 * channels, -1)
    beside = np.concatenate([part[:, i * dilation : i * dilation + width] for i in range(3)], axis=-1)
    flat = beside.reshape(-1, 3 * channels)
    sums = np.empty((height * width, kernels.shape[-1]), np.float32)
    sums[:] = net[f"{name}_bias"]
    for row, kernel in enumerate(kernels):
        first = row * dilation * width
        sums += flat[first : first + len(sums)] @ kernel
    return sums.reshape(height, width, -1)


def _mapped(part: Float32Array, net: Net, name: str) -> Float32Array:
    """:func:`linear` of a few rows."""
    height, width, channels = part.shape
    result = part.reshape(-1, channels) @ net[name]  # one product is faster than one per row
    result += net[f"{name}_bias"]
    return np.asarray(result, np.float32).reshape(height, width, -1)


def gathered(image: Float32Array) -> Float32Array:
    """The four pixels of each 2 x 2 block as channels: half as high and wide."""
    height, width, channels = image.shape
    blocks = image.reshape(height // 2, 2, width // 2, 2, channels).transpose(0, 2, 4, 1, 3)
    return blocks.reshape(height // 2, width // 2, 4 * channels)


def spread(image: Float32Array) -> Float32Array:
    """Inverse of :func:`gathered`."""
    height, width, channels = image.shape
    blocks = image.reshape(height, width, channels // 4, 2, 2).transpose(0, 3, 1, 4, 2)
    return blocks.reshape(2 * height, 2 * width, channels // 4)
