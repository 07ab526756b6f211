"""The all-in-focus picture (sec. 5.4): each blur level deconvolved with a sparse-gradient prior, eq. (15)-(17).

The picture is processed in tiles of a fixed grid. A tile's margin follows from the kernels of the levels that occur in
it, and each level is deconvolved only in tiles where it occurs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.sharp import deconvolution, layers
from recon.sharp.layers import Tile

Phases = Sequence[tuple[int, int] | None]

GUIDE_WINDOW_PX = 5.0  # sigma of the window in which the guide's gradients are fitted to a channel's
GUIDE_FLOOR = 1e-3  # regularisation of that fit, relative to the mean gradient energy
CLIPPED_NEAR_PX = 3.0
SUFFICIENT_PX = 2000.0  # pixels of a level at which its own gradients and the frame's mean have equal weight
DRAFT_PRIOR = 2.0  # factor on the measured beta of the draft
INTERPOLATED_WEIGHT = 0.25  # weight of the data without phases, where one pixel in four is a sample
COLOURS, INFRARED = slice(0, 3), slice(3, 4)
Passes = Sequence[tuple[slice, slice | None]]  # channels of a pass, and channels of its guide
PLAIN_PASSES: Passes = ((COLOURS, None),)
PASSES: Passes = ((INFRARED, None), (COLOURS, INFRARED), (COLOURS, COLOURS))


@dataclass(frozen=True)
class Frame:
    """A frame to deconvolve: its channels, the level of every pixel, and the blur of each level."""

    stack: Float32Array  # [channel, h, w] electrons
    draft: Float32Array  # [channel, h, w] first all-in-focus estimate
    noise: Float32Array  # [channel] standard deviation
    position: Float32Array  # [h, w] index of the level among the deconvolved ones, fractional
    transfers: layers.Transfers
    reach_px: list[int]  # half the side of the kernel of each deconvolved level


@dataclass(frozen=True)
class Pass:
    """One pass of the deconvolution: its channels and their prior."""

    part: slice  # of the frame's channels
    kappa: Float32Array  # [node, channel] weight of the prior
    steps: int  # iterations of half-quadratic splitting
    guide: Float32Array | None  # [h, w] sharp picture whose gradients the prior expects
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
    """
    nodes = layers.levels_of_nodes(len(kernels), focus)
    transfers, reach_px = layers.transfers(kernels, nodes)
    position = np.interp(level, nodes, np.arange(len(nodes))).astype(np.float32)
    tiles = list(layers.tiles(position, reach_px))
    noise = np.maximum(np.asarray(noise_e, np.float32), np.float32(1e-3))
    frame = Frame(stack, _draft(stack, tiles, transfers, noise), noise, position, transfers, reach_px)
    # Before the result has memory: they need as much for a while.
    kappas = [_prior_weights(frame.draft[part], noise[part], position, len(nodes)) / strength for part, _ in passes]
    sharp = np.zeros_like(stack)
    for (part, guide_part), kappa in zip(passes, kappas, strict=True):
        guide = None if guide_part is None else (sharp[guide_part] / noise[guide_part, None, None]).mean(axis=0)
        part_phases = None if phases is None or None in phases[part] else phases[part]
        work = partial(_deconvolve_tile, frame, Pass(part, kappa, steps, guide, part_phases))
        layers.by_tiles(sharp[part], tiles, work)
    return sharp


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


def _draft(stack: Float32Array, tiles: list[Tile], transfers: layers.Transfers, noise: Float32Array) -> Float32Array:
    """All-in-focus estimate with the quadratic prior of eq. (10), in closed form, [channel, h, w]."""
    steps = 0.5 * (np.mean(np.diff(stack, axis=1) ** 2, (1, 2)) + np.mean(np.diff(stack, axis=2) ** 2, (1, 2)))
    beta = DRAFT_PRIOR * noise**2 / np.maximum(steps, 1e-3 * noise**2)

    def work(tile: Tile) -> Float32Array:
        spectrum = fourier.forward(fourier.pad_blended(stack[:, *tile.box], tile.shape), 1)
        total = np.zeros((len(stack), *tile.position.shape), np.float32)
        for index, node in enumerate(tile.nodes):
            transfer, _ = transfers(node, tile.shape)
            sharp = deconvolution.quadratic(spectrum, transfer, beta, tile.shape)
            total += tile.share(index) * sharp[:, *tile.inner]
        return total

    draft = np.empty(stack.shape, np.float32)
    layers.by_tiles(draft, tiles, work)
    return draft


def _prior_weights(draft: Float32Array, noise: Float32Array, position: Float32Array, nodes: int) -> Float32Array:
    """Weight kappa of the prior, [node, channel], from E |g|^a = 1 / (a kappa) for the density exp(-kappa |g|^a).

    g are the gradients of the draft in units of the noise, over the pixels of a level. The frame's mean has the weight
    of ``SUFFICIENT_PX`` pixels in each level's mean.
    """
    power = deconvolution.PRIOR_POWER
    nearest = np.rint(position).astype(np.intp).ravel()
    count = np.bincount(nearest, minlength=nodes)
    kappa = np.empty((nodes, len(draft)), np.float32)
    for index, (plane, unit) in enumerate(zip(draft, noise, strict=True)):
        steps = np.zeros_like(plane)
        for axis in (0, 1):
            gradient = np.diff(plane, axis=axis, append=np.take(plane, [-1], axis))
            gradient /= unit  # in place: large frames have no memory to spare
            np.abs(gradient, out=gradient)
            gradient **= power
            gradient /= 2
            steps += gradient
        del gradient
        spread = (np.bincount(nearest, steps.ravel(), nodes) + SUFFICIENT_PX * steps.mean()) / (count + SUFFICIENT_PX)
        kappa[:, index] = 1 / (power * np.maximum(spread, 1e-6))
    return kappa


def _deconvolve_tile(frame: Frame, task: Pass, tile: Tile) -> Float32Array:
    """A sharp tile, [channel, h, w]: the deconvolutions of its levels, weighted by each pixel's share of a level."""
    unit = frame.noise[task.part, None, None]
    picture, draft = (image[task.part, *tile.box] / unit for image in (frame.stack, frame.draft))
    gradients = np.asarray(sum(np.mean(np.diff(draft, axis=axis) ** 2, axis=(1, 2)) for axis in (1, 2)))
    spectrum = fourier.forward(fourier.pad_blended(draft, tile.shape), 1)
    guide = None if task.guide is None else fourier.pad_blended(task.guide[None, *tile.box], tile.shape)
    guide_spectrum = None if guide is None else fourier.forward(guide, 1)
    phases = None if task.phases is None else _phases_in_box(task.phases, tile.box)
    total = np.zeros((len(unit), *tile.position.shape), np.float32)
    for index, node in enumerate(tile.nodes):
        transfers, variances = frame.transfers(node, tile.shape)
        transfer, variance = transfers[task.part], variances[task.part]
        blurred_draft = fourier.inverse(spectrum * transfer, tile.shape, 1)
        own = layers.own_share(frame.position, tile, node, frame.reach_px[node])
        uniform = fourier.pad_blended(_uniform(picture, blurred_draft, own), tile.shape)
        expected = None
        if guide is not None and guide_spectrum is not None:
            expected = _expected_gradients(uniform, guide, fourier.inverse(guide_spectrum * transfer, tile.shape, 1))
        trust = deconvolution.data_trust(variance, gradients, tile.shape)
        prior = deconvolution.Prior(task.kappa[node], expected)
        sharp = _deconvolve_level(uniform, transfer, prior, task.steps, phases, trust)
        total += tile.share(index) * sharp[:, *tile.inner]
    return total * unit


def _uniform(picture: Float32Array, blurred_draft: Float32Array, near: Float32Array) -> Float32Array:
    """The captured picture of a tile, replaced by the blurred draft at pixels of other levels, [channel, h, w].

    Deconvolution with the kernel of one level then sees a picture of that level everywhere. ``near`` [h, w] is the
    weight of the captured picture, 0..1.
    """
    height, width = near.shape
    return near * picture + (1 - near) * blurred_draft[:, :height, :width]


def _deconvolve_level(
    picture: Float32Array,
    transfer: Complex64Array,
    prior: deconvolution.Prior,
    steps: int,
    phases: list[tuple[int, int]] | None,
    trust: Float32Array,
) -> Float32Array:
    """The deconvolution of one level, [channel, h, w]: from the samples at ``phases``, or from all pixels without."""
    if phases is None:
        weaker = prior._replace(kappa=prior.kappa / INTERPOLATED_WEIGHT)
        return deconvolution.half_quadratic(picture, transfer, weaker, steps, trust)
    return deconvolution.half_quadratic_samples(picture, phases, transfer, prior, steps, trust)


def _phases_in_box(phases: Phases, box: tuple[slice, slice]) -> list[tuple[int, int]]:
    """Positions (row, column) of each channel's first sample in a box, from those in the frame."""
    return [((p[0] - box[0].start) % 2, (p[1] - box[1].start) % 2) for p in phases if p is not None]


def _expected_gradients(
    picture: Float32Array, guide: Float32Array, blurred: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """Gradients (x, y) [channel, h, w] of the sharp guide [1, h, w], scaled to each channel of the blurred picture.

    The factor is a least-squares fit in a window around each pixel, of the gradients of the guide ``blurred`` by the
    picture's kernel [channel, h, w] to those of the picture: both then contain the same frequencies.
    """
    (gx, gy), (bx, by), (px, py) = _gradients(guide), _gradients(blurred), _gradients(picture)
    energy = _window(bx * bx + by * by)
    factor = _window(bx * px + by * py) / (energy + GUIDE_FLOOR * energy.mean(axis=(1, 2), keepdims=True) + 1e-12)
    return factor * gx, factor * gy


def _gradients(stack: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Periodic forward differences (x, y) of a stack [channel, h, w]."""
    return np.roll(stack, -1, 2) - stack, np.roll(stack, -1, 1) - stack


def _window(stack: Float32Array) -> Float32Array:
    """Gaussian mean around each pixel of every channel, [channel, h, w]."""
    size = (0, 0)
    return np.stack([cv2.GaussianBlur(p, size, GUIDE_WINDOW_PX, borderType=cv2.BORDER_REFLECT) for p in stack])
