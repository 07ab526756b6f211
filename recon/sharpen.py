"""The all-in-focus picture (sec. 5.4): each blur level deconvolved with a sparse-gradient prior, eq. (15)-(17).

All works in tiles of a fixed grid, each with a margin that the level's kernel asks for, so that a level costs only
where it occurs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from recon import deconvolution, fourier
from recon.settings import Settings

Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]
Phases = Sequence[tuple[int, int] | None]

TILE_PX = 256
MARGIN_PX = 16  # beyond the kernel's reach: deconvolution rings out over some pixels more
KERNEL_SHARE = 0.999  # of a kernel's energy within its reach
DENSE_LEVELS, SPARSE_STEP = 12, 2  # every level up to here is deconvolved, then each second one
FEATHER_LEVELS = 1.0  # beyond the levels a layer serves: there the picture itself fades into its replacement
GUIDE_WINDOW_PX = 5.0  # sigma, of the window in which infrared's gradients are fitted to a colour's
GUIDE_FLOOR = 1e-3  # of the mean gradient energy: below it infrared tells nothing
LEVEL_DEVIATION = 0.6  # standard deviation of the level map, and of what lies between two levels
SPREAD_LEVELS = np.sqrt(3.0) * LEVEL_DEVIATION  # outer places of Gauss and Hermite's rule
CLIPPED_NEAR_PX = 3.0
ENOUGH_PX = 2000.0  # pixels of a level that tell its own prior's weight
BORDER_SHARE = 0.2  # of the kernel's reach: width of the frame's rim that fades into the draft
DRAFT_PRIOR = 2.0  # factor on the draft's measured beta
INTERPOLATED_WEIGHT = 0.25  # of a pixel's data where most are interpolated, one in four is not
COLOURS, INFRARED = slice(0, 3), slice(3, 4)
PLAIN_PASSES = ((COLOURS, None),)
PASSES = ((INFRARED, None), (COLOURS, INFRARED), (COLOURS, COLOURS))  # what is deconvolved, and whose edges guide it


@dataclass(frozen=True)
class Layer:
    """A level in a tile: which pixels it serves, and what is deconvolved for them."""

    node: int  # place in the list of deconvolved levels
    core: tuple[slice, slice]  # the tile in the frame
    box: tuple[slice, slice]  # the tile with its margin
    inner: tuple[slice, slice]  # the tile within the box
    kernels: NDArray  # [channel, size, size], cut to their reach
    around: tuple[NDArray, NDArray]  # the same of the levels at either side of it, ``SPREAD_LEVELS`` apart


def sharpen(
    image: Float32Array,
    infrared: Float32Array,
    level: Float32Array,
    kernels: NDArray,
    noise_e: NDArray,
    settings: Settings,
    phases: Phases | None = None,
) -> Float32Array:
    """All-in-focus colours [h, w, 3] from linear ones without infrared, infrared, and their level map.

    ``kernels`` [level, channel, size, size] blur R, G, B without infrared (:func:`visible_kernels`) and IR,
    ``noise_e`` [channel] is the noise's standard deviation. A pixel takes its value between the two nearest
    levels, eq. (17). ``phases`` are the places (row, column) of each channel's samples in the 2x2 block of the
    mosaic, None for a channel with other places: only samples count as data, since what lies between them is
    interpolated, and holds the interpolation's errors.

    Deviations from the paper: infrared is taken out first, since a mixed kernel is right for one reflectance
    only; the regularised level map with fractions, not the raw one (no seams); what lies at other levels is
    replaced beforehand by a first estimate blurred to this level, because each layer's deconvolution
    assumes one blur everywhere; the prior of the colours expects the gradients of the sharp infrared
    picture, scaled to each colour, and then once more those of the sharp colours' own mean, where
    ``sharpen_guide`` says so.
    """
    nodes = _nodes(len(kernels))
    pairs = [(cut(kernels[node]), _around(kernels, node)) for node in nodes]
    position = np.interp(level, nodes, np.arange(len(nodes))).astype(np.float32)
    stack = np.ascontiguousarray(np.concatenate([np.moveaxis(image, -1, 0), infrared[None]]), np.float32)
    layers = list(_layers(position, pairs))
    noise = np.maximum(np.asarray(noise_e, np.float32), np.float32(1e-3))
    draft = _draft(stack, position, layers, noise)
    sharp = np.zeros_like(stack)
    for part, guided_by in PLAIN_PASSES if not settings.sharpen_guide else PASSES:
        guide = None if guided_by is None else (sharp[guided_by] / noise[guided_by, None, None]).mean(axis=0)
        kappa = _prior_scale(draft[part], noise[part], position, len(nodes)) / settings.sharpen_strength
        own = None if phases is None or None in phases[part] else phases[part]
        work = partial(_deconvolved, stack, draft, guide, position, part, noise, kappa, settings, own)
        sharp[part] = np.maximum(_collected(len(stack[part]), position, layers, work), 0)
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


def _nodes(levels: int) -> list[int]:
    """Levels that are deconvolved, from 0: blur grows slowly relative to itself at large levels."""
    dense = list(range(min(DENSE_LEVELS, levels)))
    return dense + list(range(DENSE_LEVELS, levels, SPARSE_STEP))


def _share(position: Float32Array, node: int) -> Float32Array:
    """Weight of a node at each pixel: linear between neighbouring nodes, summing to 1."""
    return np.maximum(1 - np.abs(position - node), 0).astype(np.float32)


def _layers(position: Float32Array, kernels: list[tuple[NDArray, tuple[NDArray, NDArray]]]) -> Iterator[Layer]:
    """Every node in every tile of the grid where it has a share; ``kernels`` of each node."""
    height, width = position.shape
    for top in range(0, height, TILE_PX):
        for left in range(0, width, TILE_PX):
            core = (slice(top, min(top + TILE_PX, height)), slice(left, min(left + TILE_PX, width)))
            inside = position[core]
            for node in range(int(inside.min()), int(np.ceil(inside.max())) + 1):
                if not _share(inside, node).any():
                    continue
                own, around = kernels[node]
                margin = own.shape[-1] // 2 + MARGIN_PX
                box = tuple(slice(max(s.start - margin, 0), min(s.stop + margin, n))
                            for s, n in zip(core, position.shape, strict=True))  # fmt: skip
                inner = tuple(slice(c.start - b.start, c.stop - b.start) for c, b in zip(core, box, strict=True))
                yield Layer(node, core, (box[0], box[1]), (inner[0], inner[1]), own, around)


def cut(kernels: NDArray) -> NDArray:
    """Kernels [channel, size, size] cut to the square that holds ``KERNEL_SHARE`` of each, again of unit sum."""
    middle = reach = kernels.shape[-1] // 2
    for reach in range(1, middle + 1):
        square = kernels[:, middle - reach : middle + reach + 1, middle - reach : middle + reach + 1]
        if square.sum(axis=(1, 2)).min() >= KERNEL_SHARE:
            break
    return square / square.sum(axis=(1, 2), keepdims=True)


def _around(kernels: NDArray, node: int) -> tuple[NDArray, NDArray]:
    """Kernels of the levels ``SPREAD_LEVELS`` below and above a node, interpolated, cut to their reach."""
    found = []
    for level in (node - SPREAD_LEVELS, node + SPREAD_LEVELS):
        low, share = divmod(min(max(level, 0.0), len(kernels) - 1.0), 1)
        high = min(int(low) + 1, len(kernels) - 1)
        found.append(cut((1 - share) * kernels[int(low)] + share * kernels[high]))
    return found[0], found[1]


def uncertain_transfer(layer: Layer, part: slice, shape: tuple[int, int]) -> tuple[Complex64Array, Float32Array]:
    """Transfer function and its uncertainty E|H - H_own|^2, [channel, h, w/2 + 1]; the level has ``LEVEL_DEVIATION``.

    By Gauss and Hermite's rule of three levels, of weights 1/6, 2/3, 1/6. The kernel stays that of the level itself:
    in focus, where no level is below, the mean would be blurred.
    """
    below, own, above = (_transfer(k[part], shape) for k in (layer.around[0], layer.kernels, layer.around[1]))
    return own, ((np.abs(below - own) ** 2 + np.abs(above - own) ** 2) / 6).astype(np.float32)


def _transfer(kernels: NDArray, shape: tuple[int, int]) -> Complex64Array:
    """From the scene as pixels see it to the picture, [channel, h, w/2 + 1].

    Measured kernels hold the pixel's area, and so does the sharp picture: it is taken out once.
    """
    fy, fx = fourier.frequencies(shape)
    return fourier.transfer(kernels, shape) / (np.sinc(fy) * np.sinc(fx)).astype(np.float32)


def _padded(stack: Float32Array, kernels: NDArray) -> tuple[Float32Array, tuple[int, int]]:
    """A stack [channel, h, w] in a frame for the Fourier domain, without steps at its borders; and that frame."""
    shape = _shape(stack, kernels)
    return np.stack([fourier.pad_blended(plane, shape) for plane in stack]), shape


def _shape(stack: Float32Array, kernels: NDArray) -> tuple[int, int]:
    """Frame for the Fourier domain, of multiples of 4: the samples of a mosaic have even sizes too."""
    margin = kernels.shape[-1] // 2 + MARGIN_PX
    height, width = (4 * fft.next_fast_len(-(-(n + margin) // 4), real=True) for n in stack.shape[1:])
    return height, width


def _draft(stack: Float32Array, position: Float32Array, layers: list[Layer], noise: Float32Array) -> Float32Array:
    """First all-in-focus estimate with the quadratic prior of eq. (10), in closed form."""
    steps = 0.5 * (np.mean(np.diff(stack, axis=1) ** 2, (1, 2)) + np.mean(np.diff(stack, axis=2) ** 2, (1, 2)))
    beta = DRAFT_PRIOR * noise**2 / np.maximum(steps, 1e-3 * noise**2)

    def work(layer: Layer) -> Float32Array:
        padded, shape = _padded(stack[:, *layer.box], layer.kernels)
        return deconvolution.quadratic(padded, _transfer(layer.kernels, shape), beta)

    return np.maximum(_collected(len(stack), position, layers, work), 0)


def _collected(
    channels: int, position: Float32Array, layers: list[Layer], work: Callable[[Layer], Float32Array]
) -> Float32Array:
    """Every layer's [channel, h, w] in one picture, each with its share; two layers at a time."""
    result = np.zeros((channels, *position.shape), np.float32)
    with ThreadPoolExecutor(fourier.WORKERS) as pool:
        for layer, found in zip(layers, pool.map(work, layers), strict=True):  # in order: sums do not depend on timing
            result[:, *layer.core] += _share(position[layer.core], layer.node) * found[:, *layer.inner]
    return result


def _prior_scale(draft: Float32Array, noise: Float32Array, position: Float32Array, nodes: int) -> Float32Array:
    """Prior's weight kappa [node, channel], from E |g|^a = 1 / (a kappa) of exp(-kappa |g|^a).

    g are the draft's gradients in units of the noise, over the pixels that a node serves; a node with few of them
    takes from the whole frame's mean what it lacks.
    """
    power = deconvolution.PRIOR_POWER
    unit = noise[:, None, None]
    steps = np.zeros_like(draft)
    for axis in (1, 2):
        steps += np.abs(np.diff(draft, axis=axis, append=np.take(draft, [-1], axis)) / unit) ** power / 2
    nearest = np.rint(position).astype(int).ravel()
    count = np.bincount(nearest, minlength=nodes)
    sums = np.stack([np.bincount(nearest, plane.ravel(), minlength=nodes) for plane in steps], axis=1)
    spread = (sums + ENOUGH_PX * steps.mean(axis=(1, 2))) / (count[:, None] + ENOUGH_PX)
    return (1 / (power * np.maximum(spread, 1e-6))).astype(np.float32)


def _deconvolved(
    stack: Float32Array,
    draft: Float32Array,
    guide: Float32Array | None,
    position: Float32Array,
    part: slice,
    noise: Float32Array,
    kappa: Float32Array,
    settings: Settings,
    phases: Phases | None,
    layer: Layer,
) -> Float32Array:
    """One level in one box, [channel, h, w]: what lies at other levels is the draft blurred to this one."""
    kernel, box = layer.kernels[part], layer.box
    picture = stack[part, *box]
    shape = _shape(picture, kernel)
    transfer, variance = uncertain_transfer(layer, part, shape)
    inner = (slice(None), slice(0, picture.shape[1]), slice(0, picture.shape[2]))
    near = np.clip(1 - (np.abs(position[box] - layer.node) - 1) / FEATHER_LEVELS, 0, 1).astype(np.float32)
    near *= _inside_frame(box, position.shape, BORDER_SHARE * (kernel.shape[-1] // 2))
    if near.min() < 1:
        spectrum = fourier.forward(_padded(draft[part, *box], kernel)[0], 1)
        picture = near * picture + (1 - near) * fourier.inverse(spectrum * transfer, shape, 1)[inner]
    unit = noise[part, None, None]
    padded = _padded(picture, kernel)[0] / unit
    expected = None
    if guide is not None:
        expected = _expected(padded, _padded(guide[None, *box], kernel)[0], transfer, shape)
    weight, steps = kappa[layer.node], settings.sharpen_steps
    steps_e2 = sum(np.mean(np.diff(draft[part, *box], axis=axis) ** 2, axis=(1, 2)) for axis in (1, 2))
    trust = deconvolution.data_trust(variance, steps_e2 / noise[part] ** 2, shape)
    if phases is None:
        weight = weight / INTERPOLATED_WEIGHT
        return deconvolution.half_quadratic(padded, transfer, weight, steps, expected, trust)[inner] * unit
    own = [((p[0] - box[0].start) % 2, (p[1] - box[1].start) % 2) for p in phases if p is not None]
    return deconvolution.half_quadratic_samples(padded, own, transfer, weight, steps, expected, trust)[inner] * unit


def _inside_frame(box: tuple[slice, slice], frame: tuple[int, ...], ramp_px: float) -> Float32Array:
    """1 in a box [h, w], falling to 0 over ``ramp_px`` towards the frame's border.

    What lies beyond it has mixed into the picture there, and no periodic continuation tells it.
    """
    sides = []
    for part, size in zip(box, frame, strict=True):
        place = np.arange(part.start, part.stop)
        sides.append(np.clip((np.minimum(place, size - 1 - place) + 0.5) / max(ramp_px, 0.5), 0, 1))
    return np.outer(*sides).astype(np.float32)


def _expected(
    picture: Float32Array, guide: Float32Array, transfer: Complex64Array, shape: tuple[int, int]
) -> tuple[Float32Array, Float32Array]:
    """Gradients (x, y) [channel, h, w] of the sharp guide [1, h, w], scaled to each channel of the blurred picture.

    The factor is fitted by least squares in a window around each pixel, between the picture's gradients and
    those of the guide blurred as the picture is: there both hold the same frequencies.
    """
    blurred = fourier.inverse(fourier.forward(guide, 1) * transfer, shape, 1)
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
