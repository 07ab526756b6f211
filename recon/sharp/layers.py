"""Parts of the picture: where each blur level occurs in a tile, and its transfer functions on the padded box.

Tested in tests/recon/sharp/test_sharpen.py and tests/recon/sharp/test_refocus.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.base.threads import mapped
from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.fourier import Box
from recon.sharp import deconvolution

Shape = tuple[int, int]

TILE_PX = 512
# Around a tile: an overlap that is blended with the neighbours, a margin, and a strip as wide as the margin that makes
# the box periodic. Deconvolution depends on pixels beyond its kernels' reach of up to 27 px.
BLEND_PX, MARGIN_PX = 24, 48
STEP_PX = 4  # boxes begin and end at multiples of this: of the mosaic's block and of the blocks of gradients
KERNEL_SHARE = 0.98  # of a kernel's energy within its reach; the rest is mostly noise of the calibration
DENSE_LEVELS, SPARSE_STEP = 6, 2  # every level up to here is deconvolved, then every second one
LEVEL_DEVIATION = 0.6  # standard deviation of the level map, including the rounding to deconvolved levels
SPREAD_LEVELS = np.sqrt(3.0) * LEVEL_DEVIATION  # outer nodes of the Gauss-Hermite rule
CACHED_TRANSFERS = 4  # parts come level by level
FEATHER_LEVELS = 1.0  # levels, beyond a layer's own, over which the captured picture fades into the blurred draft
BORDER_SHARE = 0.2  # width of the frame's rim that fades into the draft, relative to the kernel's reach


@dataclass(frozen=True)
class Part:
    """Region of a tile in which one level occurs, and the padded box that its deconvolution processes."""

    node: int  # index into the list of deconvolved levels
    core: Box  # where the level occurs in the tile and in the strips that blend it with its neighbours
    box: Box  # with the margin; may lie outside of the frame, which is continued with its mirror image
    inner: Box  # the core within the box
    shape: Shape  # of the box and a blended strip, which makes it periodic; multiples of 4 for a mosaic
    weights: tuple[Float32Array, Float32Array]  # of the core's rows and columns: the tile's share, 0..1

    def share(self, position: Float32Array) -> Float32Array:
        """Weight of the part at each pixel of its core, [h, w]; those of all parts have the sum 1.

        It is linear between neighbouring levels, whose fractional index ``position`` [h, w] gives for the frame.
        """
        rows, columns = self.weights
        level = np.maximum(1 - np.abs(position[self.core] - self.node), 0)
        return np.asarray(level * rows[:, None] * columns, np.float32)


def levels_of_nodes(levels: int, focus: int = 0) -> list[int]:
    """Indices of the levels of a bank that are deconvolved; fewer far from the ``focus``, where relative steps are
    small. The outermost level of each side is among them.
    """

    def steps(last: int) -> list[int]:
        away = [*range(min(DENSE_LEVELS, last + 1)), *range(DENSE_LEVELS, last + 1, SPARSE_STEP)]
        return away if away[-1] == last else [*away, last]

    return [focus - step for step in reversed(steps(focus)[1:])] + [focus + step for step in steps(levels - 1 - focus)]


def parts(
    position: Float32Array,
    tile_px: int = TILE_PX,
    margin_px: int | Sequence[int] = MARGIN_PX,
    strip_px: int = MARGIN_PX,
) -> list[Part]:
    """The parts of a frame, in tiles of at most ``tile_px`` per side; neighbouring tiles overlap and are blended.

    Those with the same transfer functions follow each other.

    Args:
        position: fractional index of every pixel's level, [h, w].
        tile_px: largest side of a tile.
        margin_px: width of the margin around a tile, for all levels or for each deconvolved one.
        strip_px: least width of the strip after the margin that makes the box periodic; 0 is enough for filters that do
            not reach beyond the margin.
    """
    least_px = 4 * BLEND_PX  # so that a tile of half this side has its two strips
    rows, columns = (_overlapping(length, max(tile_px, least_px)) for length in position.shape)
    found = []
    for across, along in itertools.product(rows, columns):
        tile = position[across.span, along.span]
        for node in range(int(tile.min()), int(np.ceil(tile.max())) + 1):
            there = np.abs(tile - node) < 1
            if there.any():
                occurs = np.flatnonzero(there.any(axis=1)), np.flatnonzero(there.any(axis=0))
                sides = _trimmed(across, occurs[0]), _trimmed(along, occurs[1])
                margin = margin_px if isinstance(margin_px, int) else margin_px[node]
                found.append(_part(node, sides, margin, strip_px))
    return sorted(found, key=lambda part: (part.node, part.shape))


class _Side(NamedTuple):
    """Rows or columns of a tile, and their weights in the blend with the neighbouring tiles."""

    span: slice
    weight: Float32Array


def _overlapping(length: int, tile_px: int) -> list[_Side]:
    """Sides of tiles of about equal size; at joints, weights are a raised cosine 2 ``BLEND_PX`` wide, with sum 1."""
    result = []
    edges = np.linspace(0, length, -(-length // tile_px) + 1).astype(int)
    for start, stop in itertools.pairwise(edges):
        index = np.arange(max(start - BLEND_PX, 0), min(stop + BLEND_PX, length))
        weight = np.ones(len(index))
        if start > 0:
            weight *= _rise((index + 0.5 - start) / BLEND_PX)
        if stop < length:
            weight *= _rise((stop - index - 0.5) / BLEND_PX)
        result.append(_Side(slice(int(index[0]), int(index[-1]) + 1), weight.astype(np.float32)))
    return result


def _rise(place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Raised cosine from 0 at -1 to 1 at 1."""
    return np.asarray(0.5 + 0.5 * np.sin(np.pi / 2 * np.clip(place, -1, 1)))


def _trimmed(side: _Side, index: NDArray[np.intp]) -> _Side:
    """A side from the first to the last of ascending indices."""
    kept = slice(int(index[0]), int(index[-1]) + 1)
    return _Side(slice(side.span.start + kept.start, side.span.start + kept.stop), side.weight[kept])


def _part(node: int, sides: Sequence[_Side], margin_px: int, strip_px: int) -> Part:
    boxes, inner = [], []
    for span, _ in sides:
        start = (span.start - margin_px) // STEP_PX * STEP_PX
        stop = -(-(span.stop + margin_px) // STEP_PX) * STEP_PX
        boxes.append(slice(start, stop))
        inner.append(slice(span.start - start, span.stop - start))
    shape = fourier.fast_shape(tuple(box.stop - box.start for box in boxes), strip_px, STEP_PX)
    (rows, columns), box = sides, (boxes[0], boxes[1])
    return Part(node, (rows.span, columns.span), box, (inner[0], inner[1]), shape, (rows.weight, columns.weight))


def by_parts(result: Float32Array, parts: Sequence[Part], work: Callable[[Part], Float32Array]) -> None:
    """Fill a picture [channel, h, w] with the sum of what ``work`` gives for its parts."""
    result[:] = 0
    for part, found in zip(parts, mapped(work, parts, fourier.WORKERS), strict=True):
        result[:, *part.core] += found


def own_share(position: Float32Array, part: Part, reach_px: int) -> Float32Array:
    """Weight of the captured picture against the blurred draft at a part's level, 0..1, in its padded box [h, w].

    It falls to 0 at other levels, and towards the frame's border: there, the blur mixes in light from outside the
    frame, which no continuation contains. ``position`` [h, w] is that of the frame, ``reach_px`` half the side of the
    level's kernel.
    """
    away = np.abs(fourier.cut_blended(position, part.box, part.shape) - np.float32(part.node))
    near = np.clip((1 + FEATHER_LEVELS - away) / np.float32(FEATHER_LEVELS), 0, 1)
    ramp_px = max(BORDER_SHARE * reach_px, 0.5)
    rows, columns = (
        _inside(box, length, size, ramp_px)
        for box, length, size in zip(part.box, part.shape, position.shape, strict=True)
    )
    return np.asarray(near * rows[:, None] * columns, np.float32)


def _inside(box: slice, length: int, size: int, ramp_px: float) -> Float32Array:
    """1 inside a frame of a ``size``, falling to 0 over ``ramp_px`` towards its border, in a padded box, [length]."""
    start = min(box.start, 0) - length  # from far enough outside for what the padding contains
    index = np.arange(start, max(box.stop, size) + length)
    inside = np.clip((np.minimum(index, size - 1 - index) + 0.5) / ramp_px, 0, 1).astype(np.float32)
    return fourier.continued(inside, slice(box.start - start, box.stop - start), length)


@dataclass(frozen=True)
class Blur:
    """The blur of the deconvolved levels, of all channels or of some."""

    transfer: Callable[[int, Shape], Complex64Array]  # H of a node on a padded box, [channel, h, w/2 + 1]
    doubt: Callable[[int, Shape], Float32Array]  # of an uncertain level, :func:`deconvolution.doubt_of`, [h, w/2 + 1]
    reach_px: list[int]  # half the side of each node's kernel
    energy: list[float]  # of the gradients of a blurred picture, relative to those of a sharp one


def blur(kernels: NDArray, nodes: list[int]) -> Blur:
    """The blur of the nodes, from kernels [level, channel, size, size].

    The doubt has the variance E|H' - H|^2 of the channels' mean kernel at levels with the standard deviation
    ``LEVEL_DEVIATION``, by the three-point Gauss-Hermite rule with weights 1/6, 2/3 and 1/6. H is that of the level
    itself, not the mean, which would be blurred in focus, where there is no lower level. The energy takes the spectrum
    of gradients as white.
    """
    cropped = [cut(kernels[level]).astype(np.float32) for level in nodes]

    @lru_cache(maxsize=CACHED_TRANSFERS)
    def transfer(node: int, shape: Shape) -> Complex64Array:
        return _transfer(cropped[node], shape)

    @cache
    def sides(node: int) -> list[Float32Array]:
        return [_between(kernels, nodes[node] + side).mean(axis=0) for side in (-SPREAD_LEVELS, SPREAD_LEVELS)]

    @lru_cache(maxsize=CACHED_TRANSFERS)
    def doubt(node: int, shape: Shape) -> Float32Array:
        here = transfer(node, shape).mean(axis=0)
        away = [_transfer(side, shape) - here for side in sides(node)]
        variance = sum((h.real**2 + h.imag**2 for h in away), np.float32(0)) / 6
        return deconvolution.doubt_of(np.asarray(variance, np.float32), shape)

    energy = [float(np.square(kernel.mean(axis=0)).sum()) for kernel in cropped]
    return Blur(transfer, doubt, [kernel.shape[-1] // 2 for kernel in cropped], energy)


def cut(kernels: NDArray, energy: float = KERNEL_SHARE) -> NDArray:
    """Kernels [channel, size, size] cropped to the smallest square that holds the share ``energy`` of each, with unit
    sum.
    """
    middle = reach = kernels.shape[-1] // 2
    for reach in range(min(1, middle), middle + 1):
        square = kernels[:, middle - reach : middle + reach + 1, middle - reach : middle + reach + 1]
        if square.sum(axis=(1, 2)).min() >= energy:
            break
    return square / square.sum(axis=(1, 2), keepdims=True)


def _between(kernels: NDArray, level: float) -> NDArray:
    """Kernels of a fractional level, interpolated linearly and cropped by :func:`cut`."""
    low, share = divmod(min(max(level, 0.0), len(kernels) - 1.0), 1)
    high = min(int(low) + 1, len(kernels) - 1)
    return cut((1 - share) * kernels[int(low)] + share * kernels[high]).astype(np.float32)


def _transfer(kernels: NDArray, shape: Shape) -> Complex64Array:
    """Transfer function from the scene averaged over pixels to the picture, [channel, h, w/2 + 1].

    Measured kernels include the average over the pixel's area, as the sharp picture does, so it is divided out once.
    """
    return np.asarray(fourier.transfer(kernels, shape) * _without_pixel(shape), np.complex64)


@lru_cache(maxsize=CACHED_TRANSFERS)
def _without_pixel(shape: Shape) -> Float32Array:
    """Inverse of the pixel's transfer function, [h, w/2 + 1]."""
    fy, fx = fourier.frequencies(shape)
    return np.asarray(1 / (np.sinc(fy) * np.sinc(fx)), np.float32)
