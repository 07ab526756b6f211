"""Data-consistency step: add to an all-in-focus picture the detail of the captured picture that it does not explain.

Networks omit ambiguous detail, and more of it in photographs than in the textures that they were trained on. Their
picture f, blurred again by the kernel h, therefore leaves a residual I - h * f of the captured picture I. The residual
is deconvolved with the quadratic prior of eq. (10) and added to f. This is one step of a proximal method that
alternates between the data and a denoiser (plug-and-play priors; Venkatakrishnan, Bouman, Wohlberg, GlobalSIP 2013). A
deconvolution of I itself would ring beside depth discontinuities; the part of I that f explains cannot ring here.

Tested in tests/recon/sharp/test_consistency.py.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from dasim.typing import Float32Array
from recon import fourier
from recon.sharp import layers, sharpen
from recon.sharp.layers import Part

# All chosen on ``tune`` and on photographs.
PRIOR = 6.0  # factor on the measured beta of eq. (10), for the detail that networks omit
REACH_PX = 32  # of the filters, in every direction
WHOLE_LEVEL = 2.0  # level from which on all of it is added; in focus there is nothing to deconvolve
LEAST_SHARE = 0.02  # parts of a tile without a larger share are skipped
SURE_SD, SURE_LEVELS = 0.25, 4.0  # sd at level 0 that halves the share; it grows by SURE_SD every SURE_LEVELS levels


def add_unexplained(
    sharp_e: Float32Array,
    stack: Float32Array,
    level: Float32Array,
    share: Float32Array,
    kernels: NDArray,
    noise_e: NDArray,
    *,
    focus: int = 0,
    tile_px: int = layers.TILE_PX,
) -> None:
    """Add the detail of the captured picture that all-in-focus colours [h, w, 3] electrons do not explain, in place.

    Args:
        sharp_e: the all-in-focus picture.
        stack: captured R, G, B without infrared, and IR, [4, h, w] electrons.
        level: level of every pixel, [h, w], negative behind the focus.
        share: of the unexplained detail that is added, 0..1, [h, w]; see :func:`share_of`.
        kernels: of the channels of ``stack``, [level, channel, size, size].
        noise_e: standard deviation of the noise, [channel] electrons.
        focus: index of the kernels in focus; those before it are behind the focus.
        tile_px: largest side of a tile.
    """
    own, nodes = sharpen.COLOURS, layers.levels_of_nodes(len(kernels), focus)
    position = np.interp(level + np.float32(focus), nodes, np.arange(len(nodes))).astype(np.float32)
    blur, beta = layers.blur(kernels[:, own], nodes), sharpen.quadratic_prior(stack[own], noise_e[own], PRIOR)
    sharp = np.moveaxis(sharp_e, -1, 0)

    @cache
    def filters(node: int) -> Float32Array:
        return sharpen.compact_filters(blur, node, beta, REACH_PX)

    def work(part: Part) -> Float32Array:
        captured, explained = (fourier.cut_blended(image, part.box, part.shape) for image in (stack[own], sharp))
        transfer = blur.transfer(part.node, part.shape)
        left = captured - fourier.inverse(fourier.forward(explained, 1) * transfer, part.shape, 1)
        left *= layers.own_share(position, part, blur.reach_px[part.node])
        response = fourier.transfer(filters(part.node), part.shape).astype(np.complex64, copy=False)
        more = fourier.inverse(fourier.forward(left, 1) * response, part.shape, 1)
        return part.share(position) * more[:, *part.inner]

    margins_px = [REACH_PX + reach_px for reach_px in blur.reach_px]
    parts = layers.parts(position, tile_px, margins_px, strip_px=0)
    unexplained = np.empty_like(stack[own])
    worth = [part for part in parts if nodes[part.node] != focus and share[part.core].max() > LEAST_SHARE]
    layers.by_parts(unexplained, worth, work)
    for channel, more in enumerate(unexplained):
        sharp_e[..., channel] += share * more
    np.maximum(sharp_e, 0, out=sharp_e)


def share_of(level: Float32Array, sd: NDArray) -> Float32Array:
    """Share 0..1 of the unexplained detail that is added, from the level and its standard deviation, [h, w].

    Both are in the levels of the networks' training (:mod:`recon.sharp.all_in_focus`).
    """
    away = np.abs(level)
    doubt = sd / (SURE_SD * (1 + away / SURE_LEVELS))
    return np.asarray(np.minimum(away / WHOLE_LEVEL, 1) / (1 + doubt**2), np.float32)
