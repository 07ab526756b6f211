"""The all-in-focus picture (sec. 5.4): each blur level deconvolved with a sparse-gradient prior, eq. (15)-(17).

The picture is processed in tiles. Each level is deconvolved where it occurs in a tile, with a margin of pixels that the
result depends on (:mod:`recon.sharp.layers`). Neighbouring tiles are blended, and quantities common to all pixels of a
level, such as the prior, are measured in the whole frame, so that tiles leave no seams.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.sharp import deconvolution, guide, layers
from recon.sharp.layers import Part

Phases = Sequence[tuple[int, int] | None]

CLIPPED_NEAR_PX = 3.0
STATISTICS_ROWS = 256  # of the frame at a time
SUFFICIENT_PX = 2000.0  # pixels of a level at which its own gradients and the frame's mean have equal weight
LINEAR_REACH_PX = 96  # of the filters of :func:`linear`, in every direction
DRAFT_PRIOR = 2.0  # factor on the measured beta of the draft
# The same for :func:`linear`, chosen on ``tune`` and photographs; the networks were trained with 0.25.
LINEAR_PRIOR = 0.12
INTERPOLATED_WEIGHT = 0.25  # weight of the data without phases, where one pixel in four is a sample
COLOURS, INFRARED = slice(0, 3), slice(3, 4)
Passes = Sequence[tuple[slice, slice | None]]  # channels of a pass, and channels of its guide
PLAIN_PASSES: Passes = ((COLOURS, None),)
PASSES: Passes = ((INFRARED, None), (COLOURS, INFRARED), (COLOURS, COLOURS))


class Statistics(NamedTuple):
    """Statistics of the gradients of each level's pixels, [node, channel]."""

    kappa: Float32Array  # weight of the prior
    square: Float32Array  # mean square along x plus that along y, in units of the noise


@dataclass(frozen=True)
class Frame:
    """A frame to deconvolve: its channels, the level of every pixel, and the blur of each level."""

    stack: Float32Array  # [channel, h, w] electrons
    draft: Float32Array  # [channel, h, w] first all-in-focus estimate
    noise: Float32Array  # [channel] standard deviation
    position: Float32Array  # [h, w] index of the level among the deconvolved ones, fractional


@dataclass(frozen=True)
class Pass:
    """One pass of the deconvolution: its channels and their prior."""

    channels: slice  # of the frame
    blur: layers.Blur  # of these channels at the deconvolved levels
    gradients: Statistics  # of these channels' draft
    strength: float  # weight of the data
    steps: int  # iterations of half-quadratic splitting
    guide: Float32Array | None  # [h, w] sharp picture whose gradients the prior expects
    guide_energy: float  # mean square gradient of the guide
    phases: Phases | None  # (row, column) of the channels' samples in the 2x2 block; None if a channel has others


def sharpen(
    stack: Float32Array,
    level: Float32Array,
    kernels: NDArray,
    noise_e: NDArray,
    phases: Phases | None = None,
    *,
    steps: int,
    strength: float,
    passes: Passes = PASSES,
    focus: int = 0,
    tile_px: int = layers.TILE_PX,
) -> Float32Array:
    """All-in-focus channels without infrared, [4, h, w] electrons.

    Each pixel is interpolated between the two nearest deconvolved levels, eq. (17).

    Deviations from the paper: infrared is removed first, since the kernel of a mixed channel holds for one reflectance
    only. The level map is the regularised one with fractions instead of the raw one, which avoids seams. Pixels at
    other levels are replaced beforehand by a draft blurred to the layer's level, because each deconvolution assumes
    uniform blur. With a guide, the prior of the colours expects the gradients of the sharp infrared picture, scaled to
    each colour, and in a last pass those of the mean of the sharp colours.

    Args:
        stack: linear R, G, B without infrared, and IR, [4, h, w] electrons.
        level: level of every pixel, [h, w], fractional index into the kernels.
        kernels: kernels of these channels (:func:`visible_kernels`), [level, channel, size, size].
        noise_e: standard deviation of the noise, [channel] electrons.
        phases: positions (row, column) of each channel's samples in the 2x2 block of the mosaic, None for a channel
            with others. Only samples count as data; the pixels between them have interpolation errors.
        steps: iterations of half-quadratic splitting.
        strength: weight of the data in eq. (15); 1 is that of the noise.
        passes: channels of each pass, and channels of the guide whose gradients its prior expects. Channels of no pass
            are 0.
        focus: index of the kernels in focus; those before it are behind the focus.
        tile_px: largest side of a tile.
    """
    nodes = layers.levels_of_nodes(len(kernels), focus)
    position = np.interp(level, nodes, np.arange(len(nodes))).astype(np.float32)
    parts = layers.parts(position, tile_px)
    noise = _positive(noise_e)
    draft = _draft(stack, position, parts, layers.blur(kernels, nodes), noise, DRAFT_PRIOR)
    frame = Frame(stack, draft, noise, position)
    # Computed before the result is allocated, because they temporarily need as much memory.
    gradients = [_statistics(frame.draft[own], noise[own], position, len(nodes)) for own, _ in passes]
    sharp = np.zeros_like(stack)
    for (own, of_guide), statistics in zip(passes, gradients, strict=True):
        sharp_guide = None if of_guide is None else (sharp[of_guide] / noise[of_guide, None, None]).mean(axis=0)
        energy = 0.0 if sharp_guide is None else guide.energy(sharp_guide)
        own_phases = None if phases is None or None in phases[own] else phases[own]
        blur = layers.blur(kernels[:, own], nodes)
        task = Pass(own, blur, statistics, strength, steps, sharp_guide, energy, own_phases)
        layers.by_parts(sharp[own], parts, partial(_deconvolved, frame, task))
        np.maximum(sharp[own], 0, out=sharp[own])
    return sharp


def linear(
    stack: Float32Array,
    level: Float32Array,
    kernels: NDArray,
    noise_e: NDArray,
    *,
    focus: int = 0,
    tile_px: int = layers.TILE_PX,
) -> Float32Array:
    """All-in-focus channels by the quadratic prior of eq. (10) alone, in closed form, [4, h, w] electrons, at least 0.

    It takes a fifth of the time of :func:`sharpen`, where its arguments are described. A raised cosine limits each
    level's filter to ``LINEAR_REACH_PX``, so that tiles leave no seams. The result is linear in the picture, so pixels
    of other levels cause ringing at depth discontinuities.
    """
    nodes = layers.levels_of_nodes(len(kernels), focus)
    position = np.interp(level, nodes, np.arange(len(nodes))).astype(np.float32)
    blur, beta = layers.blur(kernels, nodes), quadratic_prior(stack, noise_e, LINEAR_PRIOR)

    @cache
    def filters(node: int) -> Float32Array:
        return compact_filters(blur, node, beta, LINEAR_REACH_PX)

    def work(part: Part) -> Float32Array:
        picture = fourier.cut_blended(stack, part.box, part.shape)
        response = fourier.transfer(filters(part.node), part.shape).astype(np.complex64, copy=False)
        sharp = fourier.inverse(fourier.forward(picture, 1) * response, part.shape, 1)
        return part.share(position) * sharp[:, *part.inner]

    result = np.empty(stack.shape, np.float32)
    layers.by_parts(result, layers.parts(position, tile_px, LINEAR_REACH_PX, strip_px=0), work)
    return np.maximum(result, 0, out=result)


def compact_filters(blur: layers.Blur, node: int, beta: NDArray, reach_px: int) -> Float32Array:
    """The filters of eq. (10) for a level, which end at ``reach_px``, with unit sum, [channel, size, size]."""
    shape = (4 * reach_px, 4 * reach_px)
    whole = deconvolution.quadratic(np.ones((), np.complex64), blur.transfer(node, shape), beta, shape)
    offset = np.arange(-reach_px, reach_px + 1)
    distance = np.minimum(np.hypot(offset[:, None], offset) / reach_px, 1)
    found = whole[:, offset[:, None], offset] * (0.5 + 0.5 * np.cos(np.pi * distance)).astype(np.float32)
    return np.asarray(found / found.sum(axis=(1, 2), keepdims=True), np.float32)


def _positive(noise_e: NDArray) -> Float32Array:
    return np.maximum(np.asarray(noise_e, np.float32), np.float32(1e-3))


def visible_kernels(kernels: NDArray, signature: NDArray, separation: NDArray) -> Float32Array:
    """Kernels of R, G, B after eq. (7) and of IR, [level, 4, size, size], from the measured ones of the same shape.

    The image of a white point in channel j is ``signature[j]`` h_j; ``separation`` [3, 4] mixes these over j. With
    eq. (7), the result signature_i h_i - alpha_i signature_IR h_IR is, up to a factor, the same for all colours, and so
    independent of the scene.
    """
    clean = np.maximum(np.einsum("ij,ljyx->liyx", separation * signature, kernels), 0)
    clean = clean / clean.sum(axis=(-1, -2), keepdims=True)
    return np.concatenate([clean, kernels[:, 3:]], axis=1).astype(np.float32)


def visible_noise(noise_e: NDArray, separation: NDArray) -> NDArray:
    """Standard deviation of the noise of R, G, B after eq. (7) and of IR, from that before separation, [4]."""
    return np.append(np.sqrt(separation**2 @ noise_e**2), noise_e[3])


def ramp_around(mask: NDArray) -> Float32Array:
    """0 within ``CLIPPED_NEAR_PX`` of a mask [h, w], rising to 1 over the same distance.

    It excludes clipped pixels, which no linear deconvolution describes.
    """
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.clip(distance / CLIPPED_NEAR_PX - 1, 0, 1).astype(np.float32)


def _draft(
    stack: Float32Array,
    position: Float32Array,
    parts: list[Part],
    blur: layers.Blur,
    noise: Float32Array,
    prior: float,
) -> Float32Array:
    """All-in-focus estimate with the quadratic prior of eq. (10), in closed form, [channel, h, w]."""
    beta = quadratic_prior(stack, noise, prior)

    def work(part: Part) -> Float32Array:
        spectrum = fourier.forward(fourier.cut_blended(stack, part.box, part.shape), 1)
        sharp = deconvolution.quadratic(spectrum, blur.transfer(part.node, part.shape), beta, part.shape)
        return part.share(position) * sharp[:, *part.inner]

    draft = np.empty(stack.shape, np.float32)
    layers.by_parts(draft, parts, work)
    return np.maximum(draft, 0, out=draft)


def quadratic_prior(stack: Float32Array, noise_e: NDArray, factor: float) -> NDArray:
    """The weight beta of eq. (10), measured from gradients and noise, times a factor, [channel]."""
    noise = _positive(noise_e)
    steps = 0.5 * (np.mean(np.diff(stack, axis=1) ** 2, (1, 2)) + np.mean(np.diff(stack, axis=2) ** 2, (1, 2)))
    return np.asarray(factor * noise**2 / np.maximum(steps, 1e-3 * noise**2))


def _statistics(draft: Float32Array, noise: Float32Array, position: Float32Array, nodes: int) -> Statistics:
    """The prior's weight kappa from E |g|^a = 1 / (a kappa) for the density exp(-kappa |g|^a), and the mean of g^2.

    g are the gradients of the draft in units of the noise, over the pixels of a level. The frame's mean has the weight
    of ``SUFFICIENT_PX`` pixels in each level's mean.
    """
    power = deconvolution.PRIOR_POWER
    height, width = position.shape
    count, sums = np.zeros(nodes), np.zeros((2, len(draft), nodes))  # of |g|^a / 2 and of g^2, along x and y together
    for top in range(0, height, STATISTICS_ROWS):  # large frames have no memory to spare
        rows = slice(top, top + STATISTICS_ROWS)
        nearest = np.rint(position[rows]).astype(np.intp).ravel()
        count += np.bincount(nearest, minlength=nodes)
        for channel, (plane, unit) in enumerate(zip(draft, noise, strict=True)):
            here, below = plane[rows] / unit, plane[top + 1 : rows.stop + 1] / unit
            along_x, along_y = np.zeros_like(here), np.zeros_like(here)
            np.subtract(here[:, 1:], here[:, :-1], out=along_x[:, :-1])
            np.subtract(below, here[: len(below)], out=along_y[: len(below)])
            square = along_x**2 + along_y**2
            steps = sum(np.abs(step) ** np.float32(power) for step in (along_x, along_y))
            for total, values in zip(sums[:, channel], (np.asarray(steps) / 2, square), strict=True):
                total += np.bincount(nearest, values.ravel(), nodes)
    means = sums + SUFFICIENT_PX * sums.sum(axis=-1, keepdims=True) / (height * width)
    steps, square = (means / (count + SUFFICIENT_PX)).swapaxes(1, 2).astype(np.float32)
    return Statistics(np.asarray(1 / (power * np.maximum(steps, 1e-6)), np.float32), square)


def _deconvolved(frame: Frame, task: Pass, part: Part) -> Float32Array:
    """The deconvolution of a part, weighted by its share of the picture, [channel, h, w]."""
    own, node, shape = task.channels, part.node, part.shape
    unit = frame.noise[own, None, None]
    picture, draft = (fourier.cut_blended(image[own], part.box, shape) / unit for image in (frame.stack, frame.draft))
    transfer = task.blur.transfer(node, shape)
    near = layers.own_share(frame.position, part, task.blur.reach_px[node])
    blurred_draft = fourier.inverse(fourier.forward(draft, 1) * transfer, shape, 1)
    uniform = _uniform(picture, blurred_draft, near)
    expected = None
    if task.guide is not None:
        sharp_guide = fourier.cut_blended(task.guide, part.box, shape)
        blurred = fourier.inverse(fourier.forward(sharp_guide, 1) * transfer.mean(axis=0), shape, 1)
        energy = task.guide_energy * task.blur.energy[node]
        expected = guide.expected_gradients(uniform, sharp_guide, blurred, energy)
    prior = deconvolution.Prior(task.gradients.kappa[node] / task.strength, expected)
    doubt = deconvolution.Doubt(task.blur.doubt(node, shape), task.gradients.square[node])
    phases = None if task.phases is None else _phases_in_box(task.phases, part.box)
    sharp = _deconvolve_level(uniform, transfer, prior, task.steps, phases, doubt)
    return part.share(frame.position) * sharp[:, *part.inner] * unit


def _uniform(picture: Float32Array, blurred_draft: Float32Array, near: Float32Array) -> Float32Array:
    """The captured picture, replaced by the blurred draft at pixels of other levels, [channel, h, w].

    Deconvolution with the kernel of one level then sees a picture of that level everywhere. ``near`` [h, w] is the
    weight of the captured picture, 0..1.
    """
    return blurred_draft + near * (picture - blurred_draft)


def _deconvolve_level(
    picture: Float32Array,
    transfer: Complex64Array,
    prior: deconvolution.Prior,
    steps: int,
    phases: list[tuple[int, int]] | None,
    doubt: deconvolution.Doubt,
) -> Float32Array:
    """The deconvolution of one level, [channel, h, w]: from the samples at ``phases``, or from all pixels without."""
    if phases is None:
        weaker = prior._replace(kappa=prior.kappa / INTERPOLATED_WEIGHT)
        return deconvolution.half_quadratic(picture, transfer, weaker, steps, doubt)
    return deconvolution.half_quadratic_samples(picture, phases, transfer, prior, steps, doubt)


def _phases_in_box(phases: Phases, box: tuple[slice, slice]) -> list[tuple[int, int]]:
    """Positions (row, column) of each channel's first sample in a box, from those in the frame."""
    return [((p[0] - box[0].start) % 2, (p[1] - box[1].start) % 2) for p in phases if p is not None]
