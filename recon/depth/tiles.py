"""Raw levels of frames of any size: compared tile by tile, with the weights of the whole frame.

The scores of all levels of a frame of 50 Mpx would fill 3 GB. Weights of eq. (9) and thresholds are measured once for
the frame; a tile has a halo as wide as its filters and windows reach.
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

TILE = 1024  # samples of a colour plane: a frame of 4 Mpx and less is one tile
BLEND = 16  # samples between the two ends of a tile, beyond the halo
HALO = 128  # samples around a tile: kernels, the tails of their inverse, and the window


class Levels(NamedTuple):
    """The best level of every sample [h, w], and the figures that decide whether to trust it."""

    level: Float32Array
    confidence: Float32Array  # 0 where the NCC is not positive
    snr: Float32Array
    green_snr: Float32Array


class Tile(NamedTuple):
    """A part of a frame [h, w]: where it lies, with its halo, and where in that."""

    core: tuple[slice, slice]
    box: tuple[slice, slice]
    inner: tuple[slice, slice]


def tiles(shape: tuple[int, ...], size: int = TILE, halo: int = HALO) -> Iterator[Tile]:
    """Tiles that cover a frame once, none much smaller than the others."""
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
    """:func:`recon.depth.scores.match` and :func:`recon.depth.peak.best_level` in tiles of ``size`` samples."""
    frame = sharper[2].shape
    parts = list(tiles(frame, size, halo if max(frame) > size else 0))
    channels = (sharper, green, *(channel for channel, _ in also))
    if len(parts) > 1:
        channels = tuple(_padded(channel) for channel in channels)
    cut = partial(_cut, halo=halo) if len(parts) > 1 else lambda channel, part: channel
    brightest = float(sharper[0].max()), float(green[0].max())
    measured = Signals(*np.empty((3, *frame), np.float32))
    for part in parts:
        found = scores.signals(cut(channels[0], part), cut(channels[1], part), settings, brightest=brightest)
        for image, own in zip(measured, found, strict=True):
            image[part.core] = own[part.inner]
    typical = scores.typical(measured, sharper[3], green[3], settings)
    level, confidence = np.empty((2, *frame), np.float32)
    for part in parts:
        classes = [(weights, where[part.box]) for weights, where in typical.classes]
        first, second, *others = (cut(channel, part) for channel in channels)
        further = [(channel, own) for channel, (_, own) in zip(others, also, strict=True)]
        score, plain = scores.scores(first, second, classes, settings, leak=leak, also=further)
        best, trust = peak.best_level(score, plain, typical.offset, settings)
        level[part.core], confidence[part.core] = best[part.inner], (trust * (plain > 0))[part.inner]
    return Levels(level, confidence, measured.snr, measured.green_snr)


def _padded(channel: Channel) -> Channel:
    """A channel whose plane is the whole frame's as it is taken for periodic."""
    plane, phase, variance, kernels = channel
    return fourier.pad_blended(plane, scores.padded_shape(channel)), phase, variance, kernels


def _cut(channel: Channel, part: Tile, halo: int) -> Channel:
    """A channel in a tile's box, its plane going on around it as the periodic frame does."""
    plane, phase, variance, kernels = channel
    return _around(plane, part, halo), phase, np.ascontiguousarray(variance[part.box]), kernels


def _around(plane: Float32Array, part: Tile, halo: int) -> Float32Array:
    """A tile of a periodic plane with ``halo`` samples all around, in a size of fast transforms.

    The box is at its origin, what lies before it comes last.
    """
    places, before = [], []
    for core, box, length in zip(part.core, part.box, plane.shape, strict=True):
        places.append(np.arange(core.start - halo, core.stop + halo) % length)
        before.append(box.start - (core.start - halo))
    wide = plane[np.ix_(*places)]
    wide = fourier.pad_blended(wide, fourier.fast_shape(wide.shape, BLEND))
    return np.ascontiguousarray(np.roll(wide, (-before[0], -before[1]), axis=(0, 1)))
