"""Raw levels of frames of any size, tile by tile, with the weights of the whole frame.

The scores of all levels of a 50-megapixel frame would need 3 GB. The weights of eq. (9) are measured once for the
frame. Each tile has a halo as wide as the reach of filters and windows.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from dasim.typing import Float32Array
from recon import fourier
from recon.depth import peak, scores
from recon.depth.channels import Also, Channel, Leak
from recon.depth.scores import Signals
from recon.settings import Settings

TILE = 1024  # samples per side, on a colour plane: a frame of up to 4 megapixels is one tile
BLEND = 16  # samples of the blended strip that makes a tile with its halo periodic
HALO = 128  # samples around a tile: reach of the kernels, of their inverses, and of the window


class Levels(NamedTuple):
    """The best level of every sample, its confidence, and signal-to-noise ratios, [h, w] each."""

    level: Float32Array
    confidence: Float32Array  # 0..1; 0 where the NCC is not positive
    snr: Float32Array  # of the sharper channel's gradients
    green_snr: Float32Array


class Tile(NamedTuple):
    """A tile of a frame, rows and columns."""

    core: tuple[slice, slice]  # the tile in the frame
    box: tuple[slice, slice]  # the tile with its halo in the frame
    inner: tuple[slice, slice]  # the tile in the box

    def finer(self, factor: int) -> Tile:
        """The tile on a grid with ``factor`` times as many rows and columns."""
        core, box, inner = (
            (slice(factor * rows.start, factor * rows.stop), slice(factor * columns.start, factor * columns.stop))
            for rows, columns in self
        )
        return Tile(core, box, inner)


def tiles(shape: tuple[int, ...], size: int = TILE, halo: int = HALO) -> Iterator[Tile]:
    """Tiles of about equal size, at most ``size`` samples per side, that cover a frame [h, w] once."""
    spans = []
    for length in shape[:2]:
        edges = np.linspace(0, length, -(-length // size) + 1).astype(int)
        spans.append([slice(int(a), int(b)) for a, b in itertools.pairwise(edges)])
    for rows in spans[0]:
        for columns in spans[1]:
            core = (rows, columns)
            top, left = (max(s.start - halo, 0) for s in core)
            box = (slice(top, min(rows.stop + halo, shape[0])), slice(left, min(columns.stop + halo, shape[1])))
            inner = (slice(rows.start - top, rows.stop - top), slice(columns.start - left, columns.stop - left))
            yield Tile(core, box, inner)


def best_levels(
    sharper: Channel,
    green: Channel,
    settings: Settings,
    leak: Leak | None = None,
    also: Also = (),
    *,
    size: int = TILE,
    halo: int = HALO,
) -> Levels:
    """The level of the best score at every sample (:func:`recon.depth.peak.best_level`), in tiles.

    ``size`` and ``halo`` are in samples. Only the score ``bands`` uses ``leak`` and ``also``.
    """
    frame = sharper.variance.shape
    parts = list(tiles(frame, size, halo if max(frame) > size else 0))
    channels = (sharper, green, *(channel for channel, _ in also))
    if len(parts) > 1:
        channels = tuple(_padded(channel) for channel in channels)
    cut = partial(_cut, halo=halo) if len(parts) > 1 else lambda channel, part: channel
    brightest = float(sharper.plane.max()), float(green.plane.max())
    signal = Signals(*np.empty((3, *frame), np.float32))
    for part in parts:
        in_tile = scores.signals(cut(channels[0], part), cut(channels[1], part), settings, brightest=brightest)
        for image, tile_image in zip(signal, in_tile, strict=True):
            image[part.core] = tile_image[part.inner]
    frame_weights = scores.frame_weights(signal, sharper.kernels, green.kernels, settings)
    level, confidence = np.empty((2, *frame), np.float32)
    of_likelihood = settings.score != "ncc"
    for part in parts:
        classes = [(weights, where[part.box]) for weights, where in frame_weights.classes]
        first, second, *others = (cut(channel, part) for channel in channels)
        further = [(channel, its_leak) for channel, (_, its_leak) in zip(others, also, strict=True)]
        score, ncc = scores.scores(first, second, classes, settings, leak=leak, also=further)
        best, trust = peak.best_level(score, ncc, frame_weights.offset, settings.window_px, is_likelihood=of_likelihood)
        trust = trust if ncc is None else trust * (ncc > 0)
        level[part.core], confidence[part.core] = best[part.inner], trust[part.inner]
    return Levels(level, confidence, signal.snr, signal.green_snr)


def _padded(channel: Channel) -> Channel:
    """A channel whose plane is padded to a periodic one."""
    return channel._replace(plane=fourier.pad_blended(channel.plane, scores.padded_shape(channel)))


def _cut(channel: Channel, part: Tile, halo: int) -> Channel:
    """A channel in a tile's box; its plane includes the halo of the periodic frame."""
    variance = np.ascontiguousarray(channel.variance[part.box])
    return channel._replace(plane=_around(channel.plane, part, halo), variance=variance)


def _around(plane: Float32Array, part: Tile, halo: int) -> Float32Array:
    """A tile of a periodic plane with ``halo`` samples on each side, padded to a size of fast transforms.

    The tile's box starts at the origin; samples above and to the left of it wrap around to the end.
    """
    places, before = [], []
    for core, box, length in zip(part.core, part.box, plane.shape, strict=True):
        places.append(np.arange(core.start - halo, core.stop + halo) % length)
        before.append(box.start - (core.start - halo))
    wide = plane[np.ix_(*places)]
    wide = fourier.pad_blended(wide, fourier.fast_shape(wide.shape, BLEND))
    return np.ascontiguousarray(np.roll(wide, (-before[0], -before[1]), axis=(0, 1)))
