"""The all-in-focus picture by a convolutional network, from the captured picture and its deconvolution.

Deconvolution with the kernel of an estimated level is right only where the level is right, and it amplifies noise. The
inputs of the network are the captured channels (including infrared, which is sharper where blur is large), their linear
deconvolution (:func:`recon.sharp.sharpen.linear`), the level and its standard deviation, and the noise. Its output is a
correction of the deconvolution, which treats noise, wrong levels, depth discontinuities and demosaicing errors
together. It was trained on layered renderings of random rooms and on path-traced random scenes with seeds and pictures
of their own (:mod:`validation.training`), with levels as estimated by the preset ``best``. It needs no library
for networks.

It has the shape of a U-Net (Ronneberger, Fischer, Brox, MICCAI 2015) of four resolutions, 2, 4, 8 and 16 pixels, of
residual blocks h <- h + B relu(A * relu(h) + a) + b with 3 x 3 convolutions A. Electrons x enter and leave it
compressed, asinh(10 x / x_1) / 3, with x_1 those of a bright white surface. Networks trained from different initial
weights make different errors, so the corrections by the networks of ``FILES`` are averaged.

Deviation from the paper: sec. 5.4 ends with the deconvolution.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Float32Array
from recon import convolution
from recon.convolution import Net, by_strips, convolved, gathered, linear, relu, residual, spread
from recon.depth.tiles import tiles

FILES = "restoration_0.npz", "restoration_1.npz"  # by the seed of the training; the second has more channels
# Residual blocks on the way down and up.
BLOCKS = {"fine": 1, "middle": 2, "coarse": 3, "deep": 3, "coarse_up": 1, "middle_up": 2, "fine_up": 1}
COMPRESSION, RANGE = np.float32(10), np.float32(3)
BRIGHT_PERCENTILE = 99.0
LARGEST = np.float32(2.5)  # compressed value, about 90 times white; keeps the exponential finite
LEAST_SD, LARGEST_SD = 0.05, 30.0  # levels
# Inputs: the four pixels of a block of each channel of the stack, then of the draft; means over the block of the level
# and of its standard deviation, as logarithms; and values that are constant over the frame.
OF_PICTURES, DRAFT_COLOURS, OF_LEVELS = 32, slice(16, 28), 2
MULTIPLE_PX = 16  # that the network's coarsest pixels span
TILE_PX = 2048  # largest side of what is restored at a time
# Around a tile. A pixel depends on its block of 16 x 16 pixels and on 104 pixels around it: 3 x 3 convolutions reach
# 2 pixels four times, 4 four times, 8 four times and 16 three times.
HALO_PX = 128


class Picture(NamedTuple):
    """What the network sees of a frame, whose block begins with green, red on its right or (4x4) infrared."""

    stack: Float32Array  # linear R, G, B without infrared, and IR, [4, h, w] electrons
    draft: Float32Array  # their deconvolution, [4, h, w]
    level: Float32Array  # [h, w]
    sd: Float32Array  # standard deviation of the level, [h, w]
    noise_e: NDArray  # standard deviation of the noise of the channels, [4] electrons
    unit_e: Float32Array  # electrons of bright white, [4]
    sparse: bool  # whether the mosaic is the 4x4 block


MAPS = ("stack", "draft", "level", "sd")  # of a picture, [..., h, w]


@cache
def networks() -> tuple[Net, ...]:
    """Arrays of each network by name; ``about`` of its file says what they were trained with."""
    return tuple(convolution.load("recon.sharp", file) for file in FILES)


def units(stack: Float32Array, white: NDArray) -> Float32Array:
    """Electrons of bright white in a picture [channel, h, w], [channel]; ``white`` [channel] has any brightness."""
    balanced = stack[:3, ::2, ::2] / np.asarray(white[:3], np.float32)[:, None, None]
    bright = float(np.percentile(balanced.mean(axis=0), BRIGHT_PERCENTILE))
    return np.asarray(white * max(bright, 1e-6), np.float32)


def restored(
    picture: Picture, phases: dict[str, tuple[int, int]], tile_px: int = TILE_PX, count: int = len(FILES)
) -> Float32Array:
    """All-in-focus colours without infrared, [h, w, 3] electrons, by the first ``count`` networks.

    Frames larger than ``tile_px`` per side are restored in tiles, with a halo of all that the networks see. ``phases``
    are the positions (row, column) of green, of red or infrared, and so on in the 2x2 block of the mosaic, as
    :func:`recon.picture.mosaic.phases` gives them.
    """
    height, width = picture.level.shape
    result = np.empty((height, width, 3), np.float32)
    cells = (-(-height // MULTIPLE_PX), -(-width // MULTIPLE_PX))
    for of_cells in tiles(cells, tile_px // MULTIPLE_PX, HALO_PX // MULTIPLE_PX):
        tile = of_cells.finer(MULTIPLE_PX)
        result[tile.core] = _tile(_changed(picture, partial(_cut, box=tile.box)), phases, count)[tile.inner]
    return result


def _cut(image: Float32Array, box: tuple[slice, slice]) -> Float32Array:
    return image[..., *box]


def _tile(picture: Picture, phases: dict[str, tuple[int, int]], count: int) -> Float32Array:
    """:func:`restored` for the whole of a picture."""
    top, left = phases["G"]
    after = phases["IR" if picture.sparse else "R"]
    turned = ((after[0] - top) % 2, (after[1] - left) % 2) == (1, 0)
    height, width = picture.level.shape
    rows, columns = -(-(height + top) // 2) * 2, -(-(width + left) // 2) * 2

    def there(image: Float32Array) -> Float32Array:
        rim = ((top, rows - height - top), (left, columns - width - left))
        wide = np.pad(image, (*[(0, 0)] * (image.ndim - 2), *rim), mode="reflect")
        return wide.swapaxes(-2, -1) if turned else wide

    sharp = _aligned(_changed(picture, there), count)
    if turned:
        sharp = sharp.swapaxes(0, 1)
    return np.ascontiguousarray(sharp[top : top + height, left : left + width])


def _changed(picture: Picture, change: Callable[[Float32Array], Float32Array]) -> Picture:
    """A picture with its ``MAPS`` changed."""
    stack, draft, level, sd = (change(image) for image in (picture.stack, picture.draft, picture.level, picture.sd))
    return picture._replace(stack=stack, draft=draft, level=level, sd=sd)


def _aligned(picture: Picture, count: int) -> Float32Array:
    """:func:`restored` for a picture that begins with green and, on its right, red or (4x4) infrared."""
    height, width = picture.level.shape
    inputs = inputs_of(picture)
    base = inputs[..., DRAFT_COLOURS].copy()
    across, down = (-(-n // MULTIPLE_PX) * MULTIPLE_PX - n for n in (width, height))
    if across or down:
        inputs = np.pad(inputs, ((0, down // 2), (0, across // 2), (0, 0)), mode="edge")
    for net in networks()[:count]:
        base += _network(inputs, net)[: height // 2, : width // 2] / np.float32(count)
    result = np.empty((height, width, 3), np.float32)

    def work(rows: slice) -> None:
        sharp = expanded(np.minimum(spread(base[rows]), LARGEST))
        result[_pixels(rows)] = np.maximum(sharp, 0) * picture.unit_e[:3]

    by_strips(work, base.shape)
    return result


def _pixels(rows: slice) -> slice:
    """Rows of pixels of rows of 2x2 blocks."""
    return slice(2 * rows.start, 2 * rows.stop)


def inputs_of(picture: Picture) -> Float32Array:
    """What the network sees per 2x2 block, [h/2, w/2, input]."""
    unit = picture.unit_e[:, None, None]
    frame = np.append(np.log(picture.noise_e / picture.unit_e), float(picture.sparse)).astype(np.float32)
    height, width = (size // 2 for size in picture.level.shape)
    result = np.empty((height, width, OF_PICTURES + OF_LEVELS + len(frame)), np.float32)

    def work(rows: slice) -> None:
        there = _pixels(rows)
        stack, draft = (compressed(np.moveaxis(e[:, there] / unit, 0, -1)) for e in (picture.stack, picture.draft))
        sd = np.clip(picture.sd[there], 0, LARGEST_SD)
        maps = np.stack([np.log1p(np.abs(picture.level[there])), np.log(LEAST_SD + sd)], axis=-1).astype(np.float32)
        of_blocks = gathered(maps).reshape(-1, width, OF_LEVELS, 4).mean(axis=-1)
        constant = np.broadcast_to(frame, (*of_blocks.shape[:2], len(frame)))
        np.concatenate([gathered(stack), gathered(draft), of_blocks, constant], axis=-1, out=result[rows])

    by_strips(work, result.shape)
    return result


def compressed(relative: Float32Array) -> Float32Array:
    """asinh(10 x) / 3 of electrons relative to bright white: linear in the dark, logarithmic in the bright."""
    # As a logarithm, of which NumPy computes several at a time: five times as fast as its asinh.
    scaled = COMPRESSION * relative
    size = np.abs(scaled)
    size += np.sqrt(size * size + np.float32(1))
    return np.asarray(np.copysign(np.log(size, out=size), scaled) / RANGE, np.float32)


def expanded(values: Float32Array) -> Float32Array:
    """Inverse of :func:`compressed`."""
    return np.asarray(np.sinh(RANGE * values) / COMPRESSION, np.float32)


def _network(inputs: Float32Array, net: Net) -> Float32Array:
    """What a network adds to the compressed draft, per block [h, w, 12], from inputs [h, w, input]."""
    scaled = inputs - net["mean"]
    scaled /= net["sd"]
    fine = _blocks(convolved(scaled, net, "in"), net, "fine")
    del scaled
    middle = _blocks(linear(gathered(np.maximum(fine, 0)), net, "down1"), net, "middle")
    coarse = _blocks(linear(gathered(np.maximum(middle, 0)), net, "down2"), net, "coarse")
    deep = _blocks(linear(gathered(np.maximum(coarse, 0)), net, "down3"), net, "deep")
    coarse += spread(linear(relu(deep), net, "up3"))
    coarse = _blocks(coarse, net, "coarse_up")
    middle += spread(linear(relu(coarse), net, "up2"))
    middle = _blocks(middle, net, "middle_up")
    fine += spread(linear(relu(middle), net, "up1"))
    fine = _blocks(fine, net, "fine_up")
    return convolved(relu(fine), net, "out")


def _blocks(image: Float32Array, net: Net, name: str) -> Float32Array:
    """The residual blocks of one resolution."""
    for index in range(BLOCKS[name]):
        image = residual(image, net, f"{name}{index}_a", f"{name}{index}_b")
    return image
