"""Blur levels in tiles of the picture: which levels occur in each, and their transfer functions on its padded frame.

Tested in tests/recon/sharp/test_sharpen.py and tests/recon/sharp/test_refocus.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier

Shape = tuple[int, int]
Transfers = Callable[[int, Shape], tuple[Complex64Array, Float32Array]]

TILE_PX = 256
MARGIN_PX = 8  # beyond the kernels' reach: deconvolution rings out over some pixels more
STRIP_PX = 8  # beyond the reach: a longer strip would assume more about the surroundings of the picture
REACH_STEP_PX = 8  # reaches are rounded up to these, so that tiles share transfer functions
KERNEL_SHARE = 0.98  # of a kernel's energy within its reach; what lies beyond is mostly the calibration's noise
DENSE_LEVELS, SPARSE_STEP = 6, 2  # every level up to here is deconvolved, then each second one
RARE_SHARE = 0.02  # of a tile's pixels: pixels of a rarer level go to its neighbours
LEVEL_DEVIATION = 0.6  # standard deviation of the level map, and of what lies between two levels
SPREAD_LEVELS = np.sqrt(3.0) * LEVEL_DEVIATION  # outer places of Gauss and Hermite's rule
KEPT_TRANSFERS = 48


@dataclass(frozen=True)
class Tile:
    """A tile of the picture and the levels that occur in it."""

    core: tuple[slice, slice]  # the tile in the frame
    box: tuple[slice, slice]  # the tile with its margin
    inner: tuple[slice, slice]  # the tile within the box
    shape: Shape  # of the frame in the Fourier domain: the box and a strip that closes it, multiples of 4 for a mosaic
    nodes: tuple[int, ...]  # places in the list of deconvolved levels
    position: Float32Array  # of every pixel of the tile among ``nodes``, 0 .. len(nodes) - 1

    def share(self, index: int) -> Float32Array:
        """Weight of ``nodes[index]`` at each pixel of the tile: linear between neighbours, summing to 1."""
        return np.maximum(1 - np.abs(self.position - index), 0).astype(np.float32)


def levels_of_nodes(levels: int) -> list[int]:
    """Levels that are deconvolved, from 0: blur grows slowly relative to itself at large levels."""
    dense = list(range(min(DENSE_LEVELS, levels)))
    return dense + list(range(DENSE_LEVELS, levels, SPARSE_STEP))


def tiles(position: Float32Array, reach_px: list[int]) -> Iterator[Tile]:
    """The tiles of a frame whose pixels lie at ``position`` [h, w] among the nodes, which blur ``reach_px`` far."""
    height, width = position.shape
    for top in range(0, height, TILE_PX):
        for left in range(0, width, TILE_PX):
            core = (slice(top, min(top + TILE_PX, height)), slice(left, min(left + TILE_PX, width)))
            nodes = _occurring(position[core])
            reach = -(-max(reach_px[node] for node in nodes) // REACH_STEP_PX) * REACH_STEP_PX
            margin = reach + MARGIN_PX
            box = tuple(slice(max(s.start - margin, 0), min(s.stop + margin, n))
                        for s, n in zip(core, position.shape, strict=True))  # fmt: skip
            inner = tuple(slice(c.start - b.start, c.stop - b.start) for c, b in zip(core, box, strict=True))
            # The strip closes the frame; at the picture's border, where the box has no margin, it keeps sides apart
            shape = fourier.fast_shape(tuple(s.stop - s.start for s in box), reach + STRIP_PX, 4)
            among = np.interp(position[core], nodes, np.arange(len(nodes))).astype(np.float32)
            yield Tile(core, (box[0], box[1]), (inner[0], inner[1]), shape, nodes, among)


def _occurring(position: Float32Array) -> tuple[int, ...]:
    """Nodes that serve more than ``RARE_SHARE`` of the pixels; at least the most frequent one."""
    low = np.floor(position).astype(int)
    part = position - low
    weight = np.bincount(low.ravel(), 1 - part.ravel()) / position.size
    weight = (
        np.append(weight, 0.0) + np.bincount(low.ravel() + 1, part.ravel(), minlength=len(weight) + 1) / position.size
    )
    return tuple(int(node) for node in np.flatnonzero(weight >= min(RARE_SHARE, weight.max())))


def transfers(kernels: NDArray, nodes: list[int]) -> tuple[Transfers, list[int]]:
    """Transfer functions of the nodes' kernels [level, channel, size, size], as a function; and the kernels' reach.

    The function takes a node and a frame's shape and gives H [channel, h, w/2 + 1] and its uncertainty
    E|H - H_own|^2 where the level has ``LEVEL_DEVIATION``, by Gauss and Hermite's rule of three levels, of weights
    1/6, 2/3, 1/6. The kernel stays that of the level itself: in focus, where no level is below, the mean would be
    blurred.
    """
    own = [cut(kernels[level]) for level in nodes]

    @lru_cache(maxsize=KEPT_TRANSFERS)
    def at(node: int, shape: Shape) -> tuple[Complex64Array, Float32Array]:
        sides = [_between(kernels, nodes[node] + side) for side in (-SPREAD_LEVELS, SPREAD_LEVELS)]
        below, here, above = (_transfer(kernel, shape) for kernel in (sides[0], own[node], sides[1]))
        return here, ((np.abs(below - here) ** 2 + np.abs(above - here) ** 2) / 6).astype(np.float32)

    return at, [kernel.shape[-1] // 2 for kernel in own]


def cut(kernels: NDArray, energy: float = KERNEL_SHARE) -> NDArray:
    """Kernels [channel, size, size] cut to the square that holds a share of each one's energy, again of unit sum."""
    middle = reach = kernels.shape[-1] // 2
    for reach in range(1, middle + 1):
        square = kernels[:, middle - reach : middle + reach + 1, middle - reach : middle + reach + 1]
        if square.sum(axis=(1, 2)).min() >= energy:
            break
    return square / square.sum(axis=(1, 2), keepdims=True)


def _between(kernels: NDArray, level: float) -> NDArray:
    """Kernels of a level between two of the bank's, cut to their reach."""
    low, share = divmod(min(max(level, 0.0), len(kernels) - 1.0), 1)
    high = min(int(low) + 1, len(kernels) - 1)
    return cut((1 - share) * kernels[int(low)] + share * kernels[high])


def _transfer(kernels: NDArray, shape: Shape) -> Complex64Array:
    """From the scene as pixels see it to the picture, [channel, h, w/2 + 1].

    Measured kernels hold the pixel's area, and so does the sharp picture: it is divided out once.
    """
    fy, fx = fourier.frequencies(shape)
    return np.asarray(fourier.transfer(kernels, shape) / (np.sinc(fy) * np.sinc(fx)).astype(np.float32), np.complex64)
