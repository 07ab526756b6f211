"""Layers of small convolutional networks on images [h, w, channel], in numpy alone.

A network is a dictionary of float32 arrays by name: ``NAME`` holds the weights of a layer, ``NAME_bias`` its bias.
Prediction needs no other library; :mod:`validation.training` fits the weights.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

import numpy as np

from dasim.typing import Float32Array

Net = Mapping[str, Float32Array]

STRIP = 2**16  # pixels that are convolved at a time: more take more memory and no less time


def load(package: str, file: str) -> Net:
    """Arrays of a network from a file beside the modules of ``package``; ``about`` of the file says how it was made."""
    with files(package).joinpath(file).open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
        return {name: stored[name].astype(np.float32) for name in stored.files if name != "about"}


def relu(image: Float32Array) -> Float32Array:
    """The larger of each value and 0, in place."""
    return np.maximum(image, 0, out=image)


def linear(image: Float32Array, net: Net, name: str) -> Float32Array:
    """A linear map of the channels of each pixel; weights are [input, output]."""
    height, width, channels = image.shape
    result = image.reshape(-1, channels) @ net[name]  # one product is faster than one per row
    result += net[f"{name}_bias"]
    return np.asarray(result, np.float32).reshape(height, width, -1)


def convolved(image: Float32Array, net: Net, name: str, dilation: int = 1) -> Float32Array:
    """A 3 x 3 convolution with weights [3, 3, input, output]; beyond the frame, its border is repeated."""
    height, width, channels = image.shape
    kernels = net[name].reshape(3, 3 * channels, -1)
    padded = np.pad(image, ((dilation, dilation), (dilation, dilation), (0, 0)), mode="edge")
    result = np.empty((height * width, kernels.shape[-1]), np.float32)
    rows = max(STRIP // width, 1)
    for top in range(0, height, rows):
        end = min(top + rows, height)
        part = padded[top : end + 2 * dilation]
        beside = np.concatenate([part[:, i * dilation : i * dilation + width] for i in range(3)], axis=-1)
        flat = beside.reshape(-1, 3 * channels)
        strip = result[top * width : end * width]
        strip[:] = net[f"{name}_bias"]
        for row, kernel in enumerate(kernels):
            first = row * dilation * width
            strip += flat[first : first + len(strip)] @ kernel
    return result.reshape(height, width, -1)


def refined(image: Float32Array, net: Net, name: str) -> Float32Array:
    """A residual convolution of an image that :func:`relu` has clipped, in place."""
    image += linear(relu(convolved(image, net, f"{name}_a")), net, f"{name}_b")
    return relu(image)


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
