"""Diffusion of electrons between neighbouring pixels, before a pixel collects them.

A photodiode depletes its silicon to the depth ``depletion_um``. An electron from there is collected by its own pixel.
One from below, down to the thickness of the silicon, diffuses, and some reach a neighbour. The longer the wavelength,
the deeper light is absorbed, and the more electrons leave: at a pitch of 1.7 um, 0.2 % at 450 nm, 5 % at 550 nm, 8 % at
650 nm and 10 % at 730 nm, of which each edge neighbour gets a fifth and each corner neighbour a twentieth.

The law is that of Seib (IEEE Trans. Electron Devices 21, 210-217, 1974) for a layer of finite thickness (Stevens and
Lavine, IEEE Trans. Electron Devices 41, 1753-1760, 1994) without recombination: electrons that are generated h below
the depleted layer, in a layer of thickness w with a reflecting floor, arrive with the transfer function
cosh(q (w - h)) / cosh(q w), q = 2 pi f. The microlens is assumed to send all light through the middle of the pixel.
Thickness (3 um) and depth (2 um) are inferred for a front-illuminated pixel of 1.7 um. Measured crosstalk also contains
light that enters the wrong pixel (Agranov et al., IEEE Trans. Electron Devices 50, 4-11, 2003; Blockstein and
Yadid-Pecht, Appl. Opt. 49, 4483-4488, 2010), which is left out here.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import silicon
from dasim.spectra import grid
from dasim.typing import FloatArray

LARGEST_EDGE_SHARE = 0.1  # of a pixel's electrons, for each edge neighbour; from 1/8 on it cannot be undone
UNDONE = 1e-5  # of the largest electrons, error of the inverse
_MOST_STEPS = 100  # 52 are needed at the largest share
_SUBPIXELS = 8  # per pixel and axis
_WINDOW_PX = 32
_NODES_NM = np.arange(400.0, 831.0, 10.0)  # the shares vary slowly with wavelength


class Shares(NamedTuple):
    """Share of a pixel's electrons that each of its four edge neighbours and four corner neighbours receives."""

    edge: FloatArray
    corner: FloatArray


@lru_cache(maxsize=32)
def by_depth(pitch_um: float, thickness_um: float, depletion_um: float) -> Shares:
    """Shares of the electrons that light of each wavelength generates, [wavelength], by diffusion from their depth.

    Args:
        pitch_um: of the pixels
        thickness_um: of the silicon
        depletion_um: of the layer from which a pixel loses no electrons

    Electrons that diffuse farther than the eight neighbours are added to these in proportion to their shares.
    """
    if thickness_um <= depletion_um:
        return Shares(*np.zeros((2, len(grid.WAVELENGTH_NM))))
    frequency = np.fft.fftfreq(_WINDOW_PX * _SUBPIXELS, pitch_um / _SUBPIXELS)
    q = 2 * np.pi * np.hypot(frequency[:, None], frequency[None, :])
    pixel = np.outer(np.sinc(frequency * pitch_um), np.sinc(frequency * pitch_um)) * _SUBPIXELS**2
    edge, corner = np.empty((2, len(_NODES_NM)))
    alphas = np.interp(_NODES_NM, grid.WAVELENGTH_NM, silicon.absorption_per_um())
    for index, alpha in enumerate(alphas):
        diffused = np.fft.ifft2(transfer_below(q, float(alpha), thickness_um, depletion_um) * pixel).real
        own, near, diagonal = (diffused[_SUBPIXELS * y, _SUBPIXELS * x] for y, x in ((0, 0), (0, 1), (1, 1)))
        leaving = diffused[::_SUBPIXELS, ::_SUBPIXELS].sum() - own
        scale = leaving / (4 * (near + diagonal))
        edge[index], corner[index] = scale * near, scale * diagonal
    return Shares(*(np.interp(grid.WAVELENGTH_NM, _NODES_NM, shares) for shares in (edge, corner)))


def transfer_below(q: FloatArray, alpha: float, thickness_um: float, depletion_um: float) -> FloatArray:
    """Transfer function at q = 2 pi f per um of the electrons from below the depleted layer; at q = 0, their share.

    The integral of alpha exp(-alpha z) cosh(q (w - h)) / cosh(q w) over the depth z = d + h from d to d + w, over the
    electrons of the whole thickness, 1 - exp(-alpha (d + w)); alpha is the absorption per um.
    """
    w = thickness_um - depletion_um
    q = np.where(np.abs(q - alpha) < 1e-5 * alpha, (1 + 1e-5) * alpha, q)  # a removable singularity
    inverse_cosh = 1 / np.cosh(np.minimum(q * w, 300.0))
    generated = alpha - q * np.tanh(q * w) - alpha * np.exp(-alpha * w) * inverse_cosh
    share = alpha * np.exp(-alpha * depletion_um) * generated / (alpha**2 - q**2)
    return np.asarray(share / -np.expm1(-alpha * thickness_um))


def spread(electrons: FloatArray, edge: FloatArray, corner: FloatArray) -> FloatArray:
    """Electrons after diffusion between pixels: [h, w] -> [h, w], same sum and precision.

    ``edge`` and ``corner`` [h, w] are the shares of each pixel's electrons that go to an edge and to a corner
    neighbour. Nothing crosses the border of the frame: a pixel there keeps what would leave it.
    """
    result = electrons.copy()
    height, width = electrons.shape
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            share = edge if dy * dx == 0 else corner
            if dy == dx == 0 or not share.any():
                continue
            source = np.s_[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
            target = np.s_[max(0, dy) : height - max(0, -dy), max(0, dx) : width - max(0, -dx)]
            moved = share[source] * electrons[source]
            result[source] -= moved
            result[target] += moved
    return result


def undone(electrons: FloatArray, edge: FloatArray, corner: FloatArray) -> FloatArray:
    """The inverse of :func:`spread`: electrons before diffusion, [h, w], by Jacobi's iteration.

    Electrons that spread from the result differ from the given ones by at most 1e-5 of the largest. An error of the
    finest checkerboard falls by 8 e with each step, e the edge share: 7 steps where 10 % of the electrons leave a
    pixel, and no convergence from e = 1/8 on, where :func:`spread` has no inverse.
    """
    result, enough = electrons, UNDONE * float(np.abs(electrons).max(initial=0.0))
    for _ in range(_MOST_STEPS):
        missing = electrons - spread(result, edge, corner)
        result = result + missing
        if float(np.abs(missing).max(initial=0.0)) <= enough:
            break
    return result


def collected_evenly(generated: FloatArray, mosaic: NDArray[np.integer], shares: Shares) -> FloatArray:
    """Electrons that a pixel of each channel collects under even light, [channel, ...].

    They are the electrons generated in its own silicon, minus those that it loses, plus those that it gains from its
    neighbours. For a channel with several positions in the mosaic, the mean is returned.

    Args:
        generated: electrons that are generated in a pixel, [channel, ...], by wavelength for example
        mosaic: channel of each pixel of a period of the mosaic, [row, column]
        shares: of the pixels of each channel, broadcast to ``generated``
    """
    edge, corner = (np.broadcast_to(share, generated.shape) for share in shares)
    collected = ((1 - 4 * edge - 4 * corner) * generated)[mosaic]
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if (dy, dx) != (0, 0):
                moved = (edge if dy * dx == 0 else corner) * generated
                collected += np.roll(moved[mosaic], (dy, dx), axis=(0, 1))
    return np.stack([collected[mosaic == channel].mean(axis=0) for channel in range(len(generated))])
