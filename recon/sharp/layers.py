"""Tiles of the picture: the blur levels that occur in each, and their transfer functions on its padded frame.

Tested in tests/recon/sharp/test_sharpen.py and tests/recon/sharp/test_refocus.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier

Shape = tuple[int, int]
Transfers = Callable[[int, Shape], tuple[Complex64Array, Float32Array]]

TILE_PX = 256
MARGIN_PX = 8  # margin of a tile beyond the kernels' reach, for the ringing of the deconvolution
STRIP_PX = 8  # width of the blended strip beyond the reach; a longer strip would assume more about the surroundings
REACH_STEP_PX = 8  # reaches are rounded up to multiples of this, so that tiles share transfer functions
KERNEL_SHARE = 0.98  # of a kernel's energy within its reach; the rest is mostly noise of the calibration
DENSE_LEVELS, SPARSE_STEP = 6, 2  # every level up to here is deconvolved, then every second one
RARE_SHARE = 0.02  # share of a tile's pixels below which a level is not deconvolved; its neighbours replace it
LEVEL_DEVIATION = 0.6  # standard deviation of the level map, including the rounding to deconvolved levels
SPREAD_LEVELS = np.sqrt(3.0) * LEVEL_DEVIATION  # outer nodes of the Gauss-Hermite rule
CACHED_TRANSFERS = 48
FEATHER_LEVELS = 1.0  # levels, beyond a layer's own, over which the captured picture fades into the blurred draft
BORDER_SHARE = 0.2  # width of the frame's rim that fades into the draft, relative to the kernel's reach


@dataclass(frozen=True)
class Tile:
    """A tile of the picture and the levels that occur in it."""

    core: tuple[slice, slice]  # the tile in the frame
    box: tuple[slice, slice]  # the tile with its margin
    inner: tuple[slice, slice]  # the tile within the box
    shape: Shape  # of the padded frame, the box and a blended strip; multiples of 4 for a mosaic
    nodes: tuple[int, ...]  # indices into the list of deconvolved levels
    position: Float32Array  # [h, w] fractional index of every pixel's level into ``nodes``

    def share(self, index: int) -> Float32Array:
        """Weight of ``nodes[index]`` at each pixel of the tile, [h, w]: linear between neighbours, with sum 1."""
        return np.maximum(1 - np.abs(self.position - index), 0).astype(np.float32)


def levels_of_nodes(levels: int, focus: int = 0) -> list[int]:
    """Indices of the levels of a bank that are deconvolved; fewer far from the ``focus``, where relative steps are
    small.
    """
    dense = list(range(min(DENSE_LEVELS, levels)))
    away = dense + list(range(DENSE_LEVELS, levels, SPARSE_STEP))
    behind = [focus - step for step in reversed(away) if 0 < step <= focus]
    return behind + [focus + step for step in away if step < levels - focus]


def tiles(position: Float32Array, reach_px: list[int]) -> Iterator[Tile]:
    """The tiles of a frame.

    ``position`` [h, w] is the fractional index of every pixel's level, ``reach_px`` [node] half the kernels' side.
    """
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
            # The strip makes the frame periodic; at the picture's border it also separates opposite sides.
            shape = fourier.fast_shape(tuple(s.stop - s.start for s in box), reach + STRIP_PX, 4)
            among = np.interp(position[core], nodes, np.arange(len(nodes))).astype(np.float32)
            yield Tile(core, (box[0], box[1]), (inner[0], inner[1]), shape, nodes, among)


def _occurring(position: Float32Array) -> tuple[int, ...]:
    """Nodes of more than ``RARE_SHARE`` of the pixels; at least the most frequent one."""
    low = np.floor(position).astype(int)
    part = position - low
    weight = np.bincount(low.ravel(), 1 - part.ravel()) / position.size
    weight = (
        np.append(weight, 0.0) + np.bincount(low.ravel() + 1, part.ravel(), minlength=len(weight) + 1) / position.size
    )
    return tuple(int(node) for node in np.flatnonzero(weight >= min(RARE_SHARE, weight.max())))


def by_tiles(result: Float32Array, tiles: Sequence[Tile], work: Callable[[Tile], Float32Array]) -> None:
    """Fill a picture [channel, h, w] with what ``work`` gives for its tiles, at least 0; two tiles at a time."""

    def fill(tile: Tile) -> None:
        np.maximum(work(tile), 0, out=result[:, *tile.core])

    with ThreadPoolExecutor(fourier.WORKERS) as pool:
        list(pool.map(fill, tiles))


def own_share(position: Float32Array, tile: Tile, node: int, reach_px: int) -> Float32Array:
    """Weight of the captured picture against the blurred draft at a level, 0..1, in a tile's box [h, w].

    ``position`` [h, w] is that of the frame, ``reach_px`` half the side of the level's kernel.
    """
    near = np.clip(1 - (np.abs(position[tile.box] - node) - 1) / FEATHER_LEVELS, 0, 1).astype(np.float32)
    return near * _inside_frame(tile.box, position.shape, BORDER_SHARE * reach_px)


def _inside_frame(box: tuple[slice, slice], frame: tuple[int, ...], ramp_px: float) -> Float32Array:
    """1 in a box [h, w], falling to 0 over ``ramp_px`` towards the frame's border.

    Near the border, the blur mixes in light from outside the frame, which no periodic continuation contains.
    """
    sides = []
    for part, size in zip(box, frame, strict=True):
        index = np.arange(part.start, part.stop)
        sides.append(np.clip((np.minimum(index, size - 1 - index) + 0.5) / max(ramp_px, 0.5), 0, 1))
    return np.outer(*sides).astype(np.float32)


def transfers(kernels: NDArray, nodes: list[int]) -> tuple[Transfers, list[int]]:
    """Transfer functions of the nodes, as a function of node and shape, and the reach of the kernels in pixels, [node].

    The function returns the transfer function H of a node and the variance E|H' - H|^2 of an uncertain level with
    standard deviation ``LEVEL_DEVIATION``, both [channel, h, w/2 + 1]. The variance is that of the three-point
    Gauss-Hermite rule, with weights 1/6, 2/3 and 1/6. H is that of the level itself, not the mean, which would be
    blurred in focus, where there is no lower level. ``kernels`` is [level, channel, size, size].
    """
    cropped = [cut(kernels[level]) for level in nodes]

    @lru_cache(maxsize=CACHED_TRANSFERS)
    def at(node: int, shape: Shape) -> tuple[Complex64Array, Float32Array]:
        sides = [_between(kernels, nodes[node] + side) for side in (-SPREAD_LEVELS, SPREAD_LEVELS)]
        below, here, above = (_transfer(kernel, shape) for kernel in (sides[0], cropped[node], sides[1]))
        return here, ((np.abs(below - here) ** 2 + np.abs(above - here) ** 2) / 6).astype(np.float32)

    return at, [kernel.shape[-1] // 2 for kernel in cropped]


def cut(kernels: NDArray, energy: float = KERNEL_SHARE) -> NDArray:
    """Kernels [channel, size, size] cropped to the smallest square that holds the share ``energy`` of each, with unit
    sum.
    """
    middle = reach = kernels.shape[-1] // 2
    for reach in range(1, middle + 1):
        square = kernels[:, middle - reach : middle + reach + 1, middle - reach : middle + reach + 1]
        if square.sum(axis=(1, 2)).min() >= energy:
            break
    return square / square.sum(axis=(1, 2), keepdims=True)


def _between(kernels: NDArray, level: float) -> NDArray:
    """Kernels of a fractional level, interpolated linearly and cropped by :func:`cut`."""
    low, share = divmod(min(max(level, 0.0), len(kernels) - 1.0), 1)
    high = min(int(low) + 1, len(kernels) - 1)
    return cut((1 - share) * kernels[int(low)] + share * kernels[high])


def _transfer(kernels: NDArray, shape: Shape) -> Complex64Array:
    """Transfer function from the scene averaged over pixels to the picture, [channel, h, w/2 + 1].

    Measured kernels include the average over the pixel's area, as the sharp picture does, so it is divided out once.
    """
    fy, fx = fourier.frequencies(shape)
    return np.asarray(fourier.transfer(kernels, shape) / (np.sinc(fy) * np.sinc(fx)).astype(np.float32), np.complex64)
