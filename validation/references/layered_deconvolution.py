"""Baseline all-in-focus pictures by library functions: a Wiener filter at each blur level, and noise reduction alone.

Both start from the captured linear colours of a reconstruction. Their parameters were tuned in steps of a factor of two
to three on two captures of photographs blurred by the lens's kernels, in seven steps from 0 to 22 px and on a slanted
surface from 0 to 30 px (``tests.support.recon_scenes``), by the mean gain in PSNR over intervals of blur. On these
captures, Richardson-Lucy with 12 steps gains 0.3 to 0.5 dB more than the Wiener filter over all pixels, and loses 2 to
5 dB more below 1 px.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from skimage import restoration

from dasim.typing import Float32Array
from dasim.values import PsfBank, Reconstruction
from recon.picture import field, infrared
from recon.settings import Settings
from recon.sharp import layers, sharpen

Picture = Callable[[Reconstruction, PsfBank], Float32Array]

BALANCE = 0.3  # weight of the squared Laplacian against the data
TOTAL_VARIATION = 0.006  # weight of the total variation, of a picture whose bright parts are 1
BRIGHT_PERCENTILE = 99.9  # of a channel: what is 1 to the library's functions


def layered_wiener(result: Reconstruction, bank: PsfBank) -> Float32Array:
    """Each blur level deconvolved by a Wiener filter with a Laplacian prior, [h, w, 3] electrons.

    The whole captured picture, mirrored at its borders, is deconvolved with the visible kernel of each level in
    ``layers.levels_of_nodes``; each pixel is that of the level nearest to the estimated one. Levels behind the focus
    have the kernels of those in front of it.

    Source: ``skimage.restoration.wiener``, after Orieux, Giovannelli and Rodet 2010, J. Opt. Soc. Am. A 27, 1593.
    """
    bank = field.with_infrared_of_axis(bank)
    light = bank.lights.index(result.light)
    separation = infrared.separation(result.camera, result.light, Settings(**result.settings))
    kernels = sharpen.visible_kernels(bank.kernel[light], bank.signature[light], separation)[:, :3]
    return by_level(result.linear_e, np.abs(result.level), kernels)


def by_level(captured_e: NDArray, level: NDArray, kernels: NDArray) -> Float32Array:
    """A picture [h, w, 3] deconvolved level by level, see :func:`layered_wiener`.

    ``level`` [h, w] is a fractional index into ``kernels`` [level, 3, size, size].
    """
    nodes = layers.levels_of_nodes(len(kernels))
    nearest = np.rint(np.interp(level, nodes, np.arange(len(nodes)))).astype(int)
    height, width = level.shape
    bright = _bright(captured_e)
    sharp_e = np.empty(captured_e.shape, np.float32)
    for index in np.unique(nearest):
        where, kernel = nearest == index, layers.cut(kernels[nodes[index]])
        reach = kernel.shape[-1]
        padded = np.pad(captured_e, ((reach, reach), (reach, reach), (0, 0)), "symmetric") / bright
        for channel in range(3):
            plane = restoration.wiener(padded[..., channel], kernel[channel], BALANCE, clip=False)
            inner = plane[reach : reach + height, reach : reach + width]
            sharp_e[where, channel] = inner[where] * bright[channel]
    return sharp_e


def denoised(result: Reconstruction, bank: PsfBank | None = None) -> Float32Array:
    """The captured picture with less total variation, and as blurred as it was, [h, w, 3] electrons.

    Source: ``skimage.restoration.denoise_tv_chambolle``, after Chambolle 2004, J. Math. Imaging Vis. 20, 89.
    """
    bright = _bright(result.linear_e)
    smooth = restoration.denoise_tv_chambolle(result.linear_e / bright, TOTAL_VARIATION, channel_axis=-1)
    return np.asarray(smooth * bright, np.float32)


def _bright(picture_e: NDArray) -> NDArray:
    """Electrons of the bright parts of each channel, [3]."""
    return np.maximum(np.percentile(picture_e, BRIGHT_PERCENTILE, axis=(0, 1)), 1e-6).astype(np.float32)
