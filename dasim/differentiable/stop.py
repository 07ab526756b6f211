"""Transfer functions and point-spread functions of a stop as functions of its amplitude, with gradients.

The transfer function is the autocorrelation of the pupil p(r) exp(i phi(r)) by two fast Fourier transforms, as in
:mod:`dasim.bounds.pupils`, which also samples the pupil. PyTorch computes its gradient;
:func:`dasim.bounds.pupils.gradient` is the adjoint derived by hand.

Tested in tests/dasim/differentiable/test_stop.py.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from dasim.bounds import pupils
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop


class Band(NamedTuple):
    """Sampled pupil of a band of wavelengths; see :class:`dasim.bounds.pupils.Grid`."""

    weight: Tensor  # [channel], share of the channel's light through the stop
    average: Tensor  # [cell, mask cell]
    phase: Tensor  # [blur, cell, cell], complex
    factor: Tensor  # [blur, h, w/2 + 1]
    rows: Tensor
    columns: Tensor
    size: int  # of the transforms
    area: float  # of a cell of the pupil, in squared radii of the lens


class FreeStop(NamedTuple):
    """Quantities of a stop of any shape that do not depend on its amplitude."""

    bands: tuple[Band, ...]
    electrons: Tensor  # [channel], relative, per open fraction of the lens area
    shape: tuple[int, int]  # of the pictures


def free_stop(
    camera: Camera,
    stop: Stop,
    light: str,
    blur_px: ArrayLike,
    cells: int,
    side: int,
    *,
    fine_cells: int = pupils.FINE_CELLS,
    dtype: torch.dtype = torch.float32,
) -> FreeStop:
    """Sampled pupil of a stop of any shape; of ``stop``, only the spectral transmittance is used.

    Args:
        camera: the camera.
        stop: the stop.
        light: name of the illuminant.
        blur_px: visible blur diameters in pixels, [blur].
        cells: cells of the amplitude across the lens.
        side: pixels across the pictures, which are square.
        fine_cells: fewest cells of the sampled pupil across the lens.
        dtype: float32 or float64.
    """
    sampled = pupils.pupil(camera, stop, light, blur_px, cells, (side, side), fine_cells=fine_cells)
    rows = np.rint(np.fft.fftfreq(side) * side).astype(int)
    bands = tuple(
        Band(
            torch.as_tensor(grid.weight, dtype=dtype),
            torch.as_tensor(grid.average, dtype=dtype),
            torch.as_tensor(grid.phase, dtype=torch.complex128 if dtype == torch.float64 else torch.complex64),
            torch.as_tensor(grid.factor, dtype=dtype),
            torch.as_tensor(rows * grid.step % grid.size),
            torch.as_tensor(np.arange(side // 2 + 1) * grid.step),
            grid.size,
            grid.side**2,
        )
        for grid in sampled.grids
    )
    return FreeStop(bands, torch.as_tensor(sampled.electrons, dtype=dtype), (side, side))


def transfers(stop: FreeStop, amplitude: Tensor) -> Tensor:
    """Transfer functions H of all channels through the stop, complex [blur, channel, h, w/2 + 1].

    ``amplitude`` is 0..1 of each cell, [y, x] over the square around the lens; cells outside the lens must be 0. H is
    normalised to about 1 at frequency 0 for any amplitude; :func:`electrons` gives the amount of light.
    """
    energy = (amplitude**2).sum() * (2 / len(amplitude)) ** 2
    total: Tensor | float = 0.0
    for band in stop.bands:
        pupil = band.average @ amplitude @ band.average.T * band.phase
        field = torch.fft.fft2(pupil, (band.size, band.size))
        correlation = torch.fft.rfft2(field.real**2 + field.imag**2)
        one = correlation[:, band.rows[:, None], band.columns].conj() * band.factor * (band.area / band.size**2)
        total = total + band.weight[:, None, None] * one[:, None]
    assert isinstance(total, Tensor)
    return total / energy


def electrons(stop: FreeStop, amplitude: Tensor) -> Tensor:
    """Relative electrons of white through the stop, [channel], in proportion to the integral of squared amplitude."""
    return stop.electrons * (amplitude**2).sum() * (2 / len(amplitude)) ** 2 / torch.pi


def kernels(transfer: Tensor) -> Tensor:
    """Point-spread functions [..., side, side] of transfer functions [..., side, side/2 + 1], of an even side; the
    centre is at side/2.
    """
    side = transfer.shape[-2]
    return torch.fft.fftshift(torch.fft.irfft2(transfer, (side, side)), (-2, -1))


def fixed_stops(
    camera: Camera, light: str, blur_px: ArrayLike, side: int, *, dtype: torch.dtype = torch.float32
) -> tuple[Tensor, Tensor]:
    """Transfer functions of all stops of a camera together, [blur, channel, h, w/2 + 1], and electrons, [channel].

    They are constants; electrons have the unit of :func:`electrons`. For a camera with one free stop, give the camera
    without it: each channel sees the mean of both transfer functions weighted with their electrons.
    """
    transfer, signal = pupils.stop_transfers(camera, np.atleast_1d(np.asarray(blur_px, float)), light, (side, side))
    kind = torch.complex128 if dtype == torch.float64 else torch.complex64
    return torch.as_tensor(transfer, dtype=kind), torch.as_tensor(signal, dtype=dtype)
