"""Spectra of windows of raw pictures for any mosaic, the input of the estimator that all designs share.

Each site of the 2 x 2 block is a separate plane with a pitch of two pixels. A window is a Gaussian with the variance of
a box of ``WINDOW_PX``. Its samples, relative to their mean and multiplied by the square root of the window, are folded
to ``FOLDED`` samples per side. Their discrete Fourier transform is that of the whole window at every second frequency;
the frequencies in between would hardly be independent.

Tested in tests/validation/rivals/test_likelihood.py and tests/validation/rivals/test_broken_designs.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera.specification import Camera
from dasim.typing import BoolArray, ComplexArray, FloatArray
from dasim.values import Capture
from recon.picture import mosaic

WINDOW_PX = 31.0
SPACING_PX = 2  # of a plane's samples
SAMPLES, FOLDED = 32, 16  # of a window, per side
STEP = 8  # samples from one window to the next
LEAST_E = 1.0  # mean electrons below which a plane has no picture
MOST_CLIPPED = 0.02  # share of saturated pixels in a window that counts


class Site(NamedTuple):
    """A pixel of the mosaic's block in one of a design's pictures."""

    picture: int
    y: int
    x: int
    channel: str


class Spectra(NamedTuple):
    """Windows of a design's pictures.

    Attributes:
        value: discrete Fourier transforms of contrast, [window, frequency, plane]
        noise: noise power of each, [window, plane]
        usable: windows with light and without clipping, [window]
    """

    value: ComplexArray
    noise: FloatArray
    usable: BoolArray


def sites(cameras: Sequence[Camera]) -> list[Site]:
    """The planes of a design, whose mosaics have blocks of 2 x 2."""
    return [
        Site(picture, y, x, channel)
        for picture, camera in enumerate(cameras)
        for y, row in enumerate(camera.sensor.mosaic)
        for x, channel in enumerate(row)
    ]


def taper() -> FloatArray:
    """Root of the window at the samples of a plane, [SAMPLES, SAMPLES], whose squares add up to
    FOLDED^2.

    White noise of variance n in the samples then has the power n in the folded transform over ``FOLDED``.
    """
    place = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) * SPACING_PX
    along = np.exp(-(place**2) * 12 / WINDOW_PX**2 / 4)  # root of a Gaussian with a variance of WINDOW_PX^2 / 12
    whole = along[:, None] * along
    return whole * (FOLDED / np.sqrt((whole**2).sum()))


def half_plane() -> tuple[NDArray[np.intp], FloatArray]:
    """Indices into the flattened folded transform without frequency 0, one of each conjugate pair, and how often each
    counts: twice, or once where it is its own conjugate.
    """
    index = np.arange(FOLDED)
    y, x = (axis.ravel() for axis in np.meshgrid(index, index, indexing="ij"))
    conjugate = (-y % FOLDED) * FOLDED + (-x % FOLDED)
    own = y * FOLDED + x
    kept = np.flatnonzero((own <= conjugate) & (own > 0))
    return kept, np.where(own == conjugate, 1.0, 2.0)[kept]


def spectra(captures: Sequence[Capture]) -> Spectra:
    """Spectra of the windows of a design's pictures, row by row."""
    window = taper()
    density = window**2 / (window**2).sum()
    kept, _ = half_plane()
    values, noises, usable = [], [], []
    for capture in captures:
        raw_e, clipped = mosaic.linearise(capture)
        for y, row in enumerate(capture.camera.sensor.mosaic):
            for x, channel in enumerate(row):
                plane, bad = (_patches(image[y::SPACING_PX, x::SPACING_PX]) for image in (raw_e, clipped))
                mean = np.einsum("nyx,yx->n", plane, density)
                lit = np.maximum(mean, LEAST_E)
                contrast = (plane - mean[:, None, None]) / lit[:, None, None]
                values.append(transform(contrast * window)[:, kept])
                noises.append(mosaic.noise_variance(capture, channel).at(lit) / lit**2)
                usable.append((mean > LEAST_E) & (bad.mean(axis=(1, 2)) <= MOST_CLIPPED))
    return Spectra(np.stack(values, -1), np.stack(noises, -1), np.all(usable, axis=0))


def transform(patches: FloatArray) -> ComplexArray:
    """Folded discrete Fourier transform of tapered patches [n, SAMPLES, SAMPLES], [n, FOLDED^2], over ``FOLDED``."""
    times = SAMPLES // FOLDED
    folded = patches.reshape(-1, times, FOLDED, times, FOLDED).sum(axis=(1, 3))
    return np.asarray(np.fft.fft2(folded) / FOLDED).reshape(len(patches), -1)


def corners(shape_px: tuple[int, int]) -> NDArray[np.intp]:
    """First row and column, in pixels, of each window of pictures of [height, width] pixels, [window, 2]."""
    down, along = (np.arange(0, size // SPACING_PX - SAMPLES + 1, STEP) * SPACING_PX for size in shape_px)
    return np.stack([axis.ravel() for axis in np.meshgrid(down, along, indexing="ij")], -1)


def _patches(plane: NDArray) -> FloatArray:
    view = np.lib.stride_tricks.sliding_window_view(plane, (SAMPLES, SAMPLES))[::STEP, ::STEP]
    return np.asarray(view.reshape(-1, SAMPLES, SAMPLES), np.float64)
