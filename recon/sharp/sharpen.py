"""The all-in-focus picture (sec. 5.4): each blur level deconvolved with a sparse-gradient prior, eq. (15)-(17).

All works in tiles of a fixed grid, each with a margin that the level's kernel asks for, so that a level costs only
where it occurs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import Complex64Array, Float32Array
from recon import fourier
from recon.settings import Settings
from recon.sharp import deconvolution, layers
from recon.sharp.layers import Tile

Phases = Sequence[tuple[int, int] | None]

FEATHER_LEVELS = 1.0  # beyond the levels a layer serves: there the picture itself fades into its replacement
GUIDE_WINDOW_PX = 5.0  # sigma, of the window in which infrared's gradients are fitted to a colour's
GUIDE_FLOOR = 1e-3  # of the mean gradient energy: below it infrared tells nothing
CLIPPED_NEAR_PX = 3.0
ENOUGH_PX = 2000.0  # pixels of a level that tell its own prior's weight
BORDER_SHARE = 0.2  # of the kernel's reach: width of the frame's rim that fades into the draft
DRAFT_PRIOR = 2.0  # factor on the draft's measured beta
INTERPOLATED_WEIGHT = 0.25  # of a pixel's data where most are interpolated, one in four is not
COLOURS, INFRARED = slice(0, 3), slice(3, 4)
PLAIN_PASSES = ((COLOURS, None),)
PASSES = ((INFRARED, None), (COLOURS, INFRARED), (COLOURS, COLOURS))  # what is deconvolved, and whose edges guide it


@dataclass(frozen=True)
class Frame:
    """A frame to deconvolve: its pictures, the level of every pixel, and the blur of each level."""

    stack: Float32Array  # [channel, h, w] electrons
    draft: Float32Array  # [channel, h, w] first all-in-focus estimate
    noise: Float32Array  # [channel] standard deviation
    position: Float32Array  # [h, w] place of the level among the deconvolved ones
    transfers: layers.Transfers
    reach_px: list[int]  # of the kernel of each deconvolved level


@dataclass(frozen=True)
class Pass:
    """One pass of the deconvolution: which channels, and what their prior expects."""

    part: slice  # of the frame's channels
    kappa: Float32Array  # [node, channel] weight of the prior
    steps: int  # iterations of half-quadratic splitting
    guide: Float32Array | None  # [h, w] sharp picture whose gradients the prior expects
    phases: Phases | None  # places of the channels' samples in the 2x2 block, where all have one


def sharpen(
    stack: Float32Array,
    level: Float32Array,
    kernels: NDArray,
    noise_e: NDArray,
    settings: Settings,
    phases: Phases | None = None,
) -> Float32Array:
    """All-in-focus colours [h, w, 3] from linear ones without infrared and infrared, [4, h, w], and their level map.

    ``kernels`` [level, channel, size, size] blur R, G, B without infrared (:func:`visible_kernels`) and IR,
    ``noise_e`` [channel] is the standard deviation of the noise. A pixel is interpolated between the two nearest
    levels, eq. (17). ``phases`` are the places (row, column) of each channel's samples in the 2x2 block of the
    mosaic, None for a channel with other places: only samples count as data, because the pixels between them are
    interpolated and carry interpolation errors.

    Deviations from the paper: infrared is removed first, since a mixed kernel is right for one reflectance only; the
    level map is the regularised one with fractions, not the raw one (no seams); pixels at other levels are replaced
    beforehand by a first estimate blurred to this level, because each layer's deconvolution assumes one blur
    everywhere; with ``sharpen_guide``, the prior of the colours expects the gradients of the sharp infrared picture,
    scaled to each colour, and in a second pass those of the mean of the sharp colours.
    """
    nodes = layers.levels_of_nodes(len(kernels))
    transfers, reach_px = layers.transfers(kernels, nodes)
    position = np.interp(level, nodes, np.arange(len(nodes))).astype(np.float32)
    tiles = list(layers.tiles(position, reach_px))
    noise = np.maximum(np.asarray(noise_e, np.float32), np.float32(1e-3))
    frame = Frame(stack, _draft(stack, tiles, transfers, noise), noise, position, transfers, reach_px)
    sharp = np.zeros_like(stack)
    for part, guided_by in PASSES if settings.sharpen_guide else PLAIN_PASSES:
        guide = None if guided_by is None else (sharp[guided_by] / noise[guided_by, None, None]).mean(axis=0)
        kappa = _prior_scale(frame.draft[part], noise[part], position, len(nodes)) / settings.sharpen_strength
        own = None if phases is None or None in phases[part] else phases[part]
        work = partial(_deconvolved, frame, Pass(part, kappa, settings.sharpen_steps, guide, own))
        sharp[part] = np.maximum(_collected(len(stack[part]), position.shape, tiles, work), 0)
    return np.ascontiguousarray(np.moveaxis(sharp[COLOURS], 0, -1))


def visible_kernels(kernels: NDArray, signature: NDArray, separation: NDArray) -> Float32Array:
    """Kernels [level, 4, size, size] of R, G, B after eq. (7) and of IR, from measured ones [level, 4, size, size].

    A white point gives channel j ``signature[j]`` h_j, and after ``separation`` [3, 4] the sum of these over j. With
    eq. (7), signature_i h_i - alpha_i signature_IR h_IR, any other colour gives the same kernel: it no longer depends
    on what is photographed.
    """
    clean = np.maximum(np.einsum("ij,ljyx->liyx", separation * signature, kernels), 0)
    clean = clean / clean.sum(axis=(-1, -2), keepdims=True)
    return np.concatenate([clean, kernels[:, 3:]], axis=1).astype(np.float32)


def visible_noise(noise_e: NDArray, separation: NDArray) -> NDArray:
    """Standard deviation of the noise of R, G, B after eq. (7) and of IR, from that before it, [4]."""
    return np.append(np.sqrt(separation**2 @ noise_e**2), noise_e[3])


def away_from(mask: NDArray) -> Float32Array:
    """0 within ``CLIPPED_NEAR_PX`` of a mask [h, w], rising to 1: clipped light has no linear deconvolution."""
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.clip(distance / CLIPPED_NEAR_PX - 1, 0, 1).astype(np.float32)


def _padded(stack: Float32Array, shape: layers.Shape) -> Float32Array:
    """A stack [channel, h, w] in a frame for the Fourier domain, without steps at its borders."""
    return np.stack([fourier.pad_blended(plane, shape) for plane in stack])


def _draft(stack: Float32Array, tiles: list[Tile], transfers: layers.Transfers, noise: Float32Array) -> Float32Array:
    """First all-in-focus estimate with the quadratic prior of eq. (10), in closed form."""
    steps = 0.5 * (np.mean(np.diff(stack, axis=1) ** 2, (1, 2)) + np.mean(np.diff(stack, axis=2) ** 2, (1, 2)))
    beta = DRAFT_PRIOR * noise**2 / np.maximum(steps, 1e-3 * noise**2)

    def work(tile: Tile) -> Float32Array:
        spectrum = fourier.forward(_padded(stack[:, *tile.box], tile.shape), 1)
        total = np.zeros((len(stack), *tile.position.shape), np.float32)
        for index, node in enumerate(tile.nodes):
            transfer, _ = transfers(node, tile.shape)
            found = deconvolution.quadratic(spectrum, transfer, beta, tile.shape)
            total += tile.share(index) * found[:, *tile.inner]
        return total

    return np.maximum(_collected(len(stack), stack.shape[1:], tiles, work), 0)


def _collected(
    channels: int, shape: tuple[int, ...], tiles: list[Tile], work: Callable[[Tile], Float32Array]
) -> Float32Array:
    """A picture [channel, h, w] made tile by tile, two at a time."""
    result = np.empty((channels, *shape), np.float32)
    with ThreadPoolExecutor(fourier.WORKERS) as pool:
        for tile, found in zip(tiles, pool.map(work, tiles), strict=True):
            result[:, *tile.core] = found
    return result


def _prior_scale(draft: Float32Array, noise: Float32Array, position: Float32Array, nodes: int) -> Float32Array:
    """Prior's weight kappa [node, channel], from E |g|^a = 1 / (a kappa) of exp(-kappa |g|^a).

    g are the draft's gradients in units of the noise, over the pixels that a node serves; a node with few of them
    takes from the whole frame's mean what it lacks.
    """
    power = deconvolution.PRIOR_POWER
    nearest = np.rint(position).astype(np.intp).ravel()
    count = np.bincount(nearest, minlength=nodes)
    kappa = np.empty((nodes, len(draft)), np.float32)
    for index, (plane, unit) in enumerate(zip(draft, noise, strict=True)):
        steps = np.zeros_like(plane)
        for axis in (0, 1):
            steps += np.abs(np.diff(plane, axis=axis, append=np.take(plane, [-1], axis)) / unit) ** power / 2
        spread = (np.bincount(nearest, steps.ravel(), nodes) + ENOUGH_PX * steps.mean()) / (count + ENOUGH_PX)
        kappa[:, index] = 1 / (power * np.maximum(spread, 1e-6))
    return kappa


def _deconvolved(frame: Frame, own: Pass, tile: Tile) -> Float32Array:
    """A tile, [channel, h, w]: the sum of its levels' deconvolutions, weighted by each pixel's share of a level."""
    unit = frame.noise[own.part, None, None]
    picture, draft = (image[own.part, *tile.box] / unit for image in (frame.stack, frame.draft))
    gradients = np.asarray(sum(np.mean(np.diff(draft, axis=axis) ** 2, axis=(1, 2)) for axis in (1, 2)))
    spectrum = fourier.forward(_padded(draft, tile.shape), 1)
    guide = None if own.guide is None else _padded(own.guide[None, *tile.box], tile.shape)
    guide_spectrum = None if guide is None else fourier.forward(guide, 1)
    phases = None if own.phases is None else _within(own.phases, tile.box)
    total = np.zeros((len(unit), *tile.position.shape), np.float32)
    for index, node in enumerate(tile.nodes):
        transfers, variances = frame.transfers(node, tile.shape)
        transfer, variance = transfers[own.part], variances[own.part]
        blurred_draft = fourier.inverse(spectrum * transfer, tile.shape, 1)
        one_level = _padded(_of_one_level(picture, blurred_draft, _near(frame, tile, node)), tile.shape)
        expected = None
        if guide is not None and guide_spectrum is not None:
            expected = _expected(one_level, guide, fourier.inverse(guide_spectrum * transfer, tile.shape, 1))
        trust = deconvolution.data_trust(variance, gradients, tile.shape)
        sharp = _solved(one_level, transfer, own.kappa[node], own.steps, phases, expected, trust)
        total += tile.share(index) * sharp[:, *tile.inner]
    return total * unit


def _near(frame: Frame, tile: Tile, node: int) -> Float32Array:
    """Share 0..1 of each pixel of a tile's box [h, w] that is used as captured at a level."""
    near = np.clip(1 - (np.abs(frame.position[tile.box] - node) - 1) / FEATHER_LEVELS, 0, 1).astype(np.float32)
    return near * _inside_frame(tile.box, frame.position.shape, BORDER_SHARE * frame.reach_px[node])


def _of_one_level(picture: Float32Array, blurred_draft: Float32Array, near: Float32Array) -> Float32Array:
    """A picture [channel, h, w] in which pixels of other levels are the draft blurred to this one."""
    height, width = near.shape
    return near * picture + (1 - near) * blurred_draft[:, :height, :width]


def _solved(
    picture: Float32Array,
    transfer: Complex64Array,
    kappa: Float32Array,
    steps: int,
    phases: list[tuple[int, int]] | None,
    expected: tuple[Float32Array, Float32Array] | None,
    trust: Float32Array,
) -> Float32Array:
    """The deconvolution of one level: from the samples at ``phases``, from all pixels without."""
    if phases is None:
        return deconvolution.half_quadratic(picture, transfer, kappa / INTERPOLATED_WEIGHT, steps, expected, trust)
    return deconvolution.half_quadratic_samples(picture, phases, transfer, kappa, steps, expected, trust)


def _within(phases: Phases, box: tuple[slice, slice]) -> list[tuple[int, int]]:
    """Places of each channel's first sample in a box, from those in the frame."""
    return [((p[0] - box[0].start) % 2, (p[1] - box[1].start) % 2) for p in phases if p is not None]


def _inside_frame(box: tuple[slice, slice], frame: tuple[int, ...], ramp_px: float) -> Float32Array:
    """1 in a box [h, w], falling to 0 over ``ramp_px`` towards the frame's border.

    What lies beyond it has mixed into the picture there, and no periodic continuation tells it.
    """
    sides = []
    for part, size in zip(box, frame, strict=True):
        place = np.arange(part.start, part.stop)
        sides.append(np.clip((np.minimum(place, size - 1 - place) + 0.5) / max(ramp_px, 0.5), 0, 1))
    return np.outer(*sides).astype(np.float32)


def _expected(picture: Float32Array, guide: Float32Array, blurred: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Gradients (x, y) [channel, h, w] of the sharp guide [1, h, w], scaled to each channel of the blurred picture.

    The factor is fitted by least squares in a window around each pixel, between the picture's gradients and
    those of the guide ``blurred`` as the picture is, [channel, h, w]: there both hold the same frequencies.
    """
    (gx, gy), (bx, by), (px, py) = _gradients(guide), _gradients(blurred), _gradients(picture)
    energy = _window(bx * bx + by * by)
    factor = _window(bx * px + by * py) / (energy + GUIDE_FLOOR * energy.mean(axis=(1, 2), keepdims=True) + 1e-12)
    return factor * gx, factor * gy


def _gradients(stack: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Forward differences along x and y, periodic."""
    return np.roll(stack, -1, 2) - stack, np.roll(stack, -1, 1) - stack


def _window(stack: Float32Array) -> Float32Array:
    """Weighted mean around each pixel of every channel."""
    size = (0, 0)
    return np.stack([cv2.GaussianBlur(p, size, GUIDE_WINDOW_PX, borderType=cv2.BORDER_REFLECT) for p in stack])
