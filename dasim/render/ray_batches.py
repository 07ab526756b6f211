"""Which rays of a pass are traced together: samples per pixel, and the blocks of pixels whose rays form a batch.

Tested in tests/dasim/render/test_ray_loop.py.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera.stops import Stop
from dasim.render import backend
from dasim.render.plugin import aligned
from dasim.render.sobol import points
from dasim.typing import FloatArray, ShareDone

MOST_CHUNK = 16  # rays of a pixel that are summed at once
FEW_CHUNKS = 7  # most chunks per pixel that are summed column by column; NumPy's sums of so few are no more accurate

Pixels = NDArray[np.intp] | slice  # numbers in the frame, row by row; a slice where they are consecutive


@dataclass(frozen=True)
class Sampling:
    """How a pass is sampled: samples per pixel, seed, and a callback for the share that is done."""

    spp: int | NDArray[np.int64]  # of all pixels, or of each, [h, w]
    seed: int
    progress: ShareDone = lambda share: None
    # Fewest samples of a pixel whose layers are separated. Where one depth is seen, few rays would be taken for layers
    # if one of them meets another depth in the tail of the diffraction pattern: a bias of up to 0.1 %.
    layers_from: int = 1

    def block_seeds(self, stop: Stop | None) -> Callable[[int], int]:
        """Seed of each block of rows, independent between stops (by their names)."""
        name = zlib.crc32(stop.name.encode()) if stop is not None else 0
        return lambda block: int(np.random.SeedSequence((self.seed, name, block)).generate_state(1)[0])


@dataclass(frozen=True)
class Batch:
    """What the lanes of a block are made from, in the renderer's memory."""

    lane: Any  # number of each ray
    chunk: Any  # rays of a chunk, opaque
    pixel: Any  # number in the frame of each chunk's pixel
    first: Any  # number of each chunk's first ray in its pixel
    samples: Any  # of each chunk's pixel
    points: Any  # of the Sobol' sequence, as many as the largest number of samples
    seed: Any  # opaque


class Block(NamedTuple):
    """Rays that are traced together: those of each pixel are consecutive, in chunks of one size."""

    pixels: Pixels
    counts: NDArray[np.int64]  # samples of each
    chunk: int  # rays; divides all ``counts``
    batch: Batch

    def sums(self, values: Any) -> FloatArray:
        """Sums of the rays of each pixel, [pixel]."""
        import drjit as dr

        chunks = np.array(dr.block_sum(values, self.chunk), dtype=np.float64)
        each = self.counts[0] // self.chunk
        if len(chunks) != each * len(self.counts):
            return np.add.reduceat(chunks, self.starts() // self.chunk)
        by_pixel = chunks.reshape(-1, each)  # as many of every pixel
        if each > FEW_CHUNKS:
            return by_pixel.sum(axis=1)
        total = by_pixel[:, 0].copy()  # NumPy spends up to 200 ns per row on rows of few numbers
        for column in by_pixel.T[1:]:
            total += column
        return total

    def starts(self) -> NDArray[np.int64]:
        """Number of the first ray of each pixel."""
        return np.cumsum(self.counts) - self.counts


def blocks(size: int, sampling: Sampling, stop: Stop | None) -> Iterator[Block]:
    """The rays of a frame of ``size`` pixels, batch by batch."""
    seed, spp = sampling.block_seeds(stop), sampling.spp
    total, done = float(spp * size if isinstance(spp, int) else spp.sum(dtype=float)), 0
    for number, (pixels, counts) in enumerate(_parts(spp, size)):
        yield block_of(pixels, counts, seed(number))
        done += int(counts.sum())
        sampling.progress(done / total)


def _parts(spp: int | NDArray[np.int64], size: int) -> Iterator[tuple[NDArray[np.intp], NDArray[np.int64]]]:
    """Consecutive pixels, out of ``size``, whose rays are traced in one batch, and the sample count of each pixel.

    ``spp`` is the count of all pixels, or of each, [h, w]. A batch has at most :func:`backend.lanes` rays, or those of
    a single pixel.
    """
    most = backend.lanes()
    if isinstance(spp, int):
        step = max(1, most // spp)
        for first in range(0, size, step):
            pixels = np.arange(first, min(first + step, size))
            yield pixels, np.full(len(pixels), spp)
        return
    ends, first, done = np.cumsum(spp), 0, 0
    while done < ends[-1]:
        own, others = np.searchsorted(ends, (done, done + most), side="right")
        last = max(int(own) + 1, int(others))
        pixels = first + np.flatnonzero(spp.ravel()[first:last])
        yield pixels, spp.ravel()[pixels]
        first, done = last, int(ends[last - 1])


def block_of(pixels: NDArray[np.intp], counts: NDArray[np.int64], seed: int) -> Block:
    """Rays of some pixels of the frame, ``counts`` for each."""
    import drjit as dr
    import mitsuba as mi

    chunk = int(np.gcd.reduce(np.append(counts, MOST_CHUNK)))
    chunks = counts // chunk
    number = np.repeat(pixels, chunks).astype(np.uint32)
    first = (np.arange(len(number)) - np.repeat(np.cumsum(chunks) - chunks, chunks)) * chunk
    batch = Batch(
        lane=dr.arange(mi.UInt32, int(counts.sum())),
        chunk=dr.opaque(mi.UInt32, chunk),
        pixel=mi.UInt32(aligned(number)),
        first=mi.UInt32(aligned(first.astype(np.uint32))),
        samples=mi.Float(aligned(np.repeat(counts, chunks).astype(np.float32))),
        points=points(int(counts.max())),
        seed=dr.opaque(mi.UInt32, seed),
    )
    is_whole = pixels[-1] - pixels[0] + 1 == len(pixels)
    where = slice(int(pixels[0]), int(pixels[-1]) + 1) if is_whole else pixels
    return Block(where, counts, chunk, batch)
