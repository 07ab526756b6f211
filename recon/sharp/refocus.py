"""Refocusing after the shot (Fig. 1(c, d), 11(d)): the all-in-focus picture blurred anew, layer by layer.

The blur acts on linear light with the measured kernels. Nearer surfaces occlude farther ones in proportion to their
blurred coverage, as through a lens.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from dasim.base.errors import InputError
from dasim.files.banks import bank_identity
from dasim.typing import Float32Array
from dasim.values import PsfBank, Reconstruction
from recon.calibration.fit import check_lens
from recon.levels import level_of
from recon.picture import field, infrared
from recon.settings import Settings
from recon.sharp import layers, sharpen

KERNEL_SHARE = 0.999  # share of a kernel's energy in its cropped form
DENSE_STEPS, SPARSE_STEP = 12, 2  # layers are one level of the bank apart up to here, then two
BEHIND_LEVELS = 2.0  # smallest difference in blur, in levels, of two surfaces with one behind the other: two layers
LARGEST_KERNEL_PX = 401
SAME_DEPTHS = 0.01  # relative difference between the depths of the levels of two banks
PAD_FACTOR = 2  # padding of a kernel for its division by the pixel's transfer function, relative to its size


def refocus(
    reconstruction: Reconstruction, bank: PsfBank, depth_m: float, f_number: float | None = None
) -> Float32Array:
    """The picture focused at ``depth_m`` through an aperture of ``f_number``, [h, w, 3].

    The result has linear camera colours without infrared, in electrons at the exposure of the capture: a smaller
    aperture does not darken the picture. The field of view is that of the capture; focus breathing is not simulated.

    Blur in levels is linear in dioptres, so that a point at level l has |l - l_0| levels of blur with the focus at l_0,
    and is proportional to 1/N. Sec. 5.4 gives no formula. The layers use the wave-optics kernels of the bank, whose
    diffraction is that of its own f-number N.

    Approximate are:

    - what a near surface hides: it is unknown, and continued with the colours at its rim;
    - two surfaces out of focus: the share of the aperture that the nearer one hides is the same for all light of the
      farther one, whatever point of the aperture it comes through. A point at the rim is up to a tenth of its light
      too bright with the focus between both, too dark with the focus beyond either; exact if either is in focus;
    - surfaces at most ``BEHIND_LEVELS`` of blur apart, which blend as one without hiding one another;
    - blur between two levels, a mixture of both kernels: below one level a point keeps a sharp core with a halo;
    - diffraction: what the all-in-focus picture still has of it acts twice where blur is added;
    - pixels that see both surfaces of a silhouette, which belong to one of them.

    Args:
        reconstruction: all-in-focus picture and level map.
        bank: the PSF bank of the reconstruction.
        depth_m: focus distance from the lens plane, metres.
        f_number: of the lens; that of the camera by default.
    """
    camera = reconstruction.camera
    _check(reconstruction, bank, depth_m, f_number)
    ratio = 1.0 if f_number is None else camera.lens.f_number / f_number
    kernels, behind = colour_kernels(reconstruction, bank)
    focus = level_of(depth_m, bank.depth_m, None if bank.behind is None else bank.behind.depth_m)
    steps = (reconstruction.level - float(focus)) * ratio
    return layered(reconstruction.sharp_e, steps, kernels, behind)


def colour_kernels(reconstruction: Reconstruction, bank: PsfBank) -> tuple[Float32Array, Float32Array]:
    """Kernels of R, G, B without infrared and without the pixel's area, [level, 3, size, size], in front of the focus
    and behind it; level 0 is a point. Where the bank has none behind the focus, they are those in front of it.
    """
    bank = field.with_infrared_of_axis(bank)
    light = bank.lights.index(reconstruction.light)
    separation = infrared.separation(reconstruction.camera, reconstruction.light, Settings(**reconstruction.settings))
    sides = [bank.kernel] if bank.behind is None else [bank.kernel, bank.behind.kernel]
    found = []
    for measured in sides:
        kernels = without_pixel(sharpen.visible_kernels(measured[light], bank.signature[light], separation)[:, :3])
        kernels[0] = 0
        kernels[0, :, kernels.shape[-2] // 2, kernels.shape[-1] // 2] = 1
        found.append(kernels)
    return found[0], found[-1]


def without_pixel(kernels: NDArray) -> Float32Array:
    """Measured kernels [..., size, size] without the average over the pixel's area; unit sum.

    The sharp picture already includes this average.
    """
    size = kernels.shape[-1]
    wide = fft.next_fast_len(PAD_FACTOR * size, real=True)
    fy, fx = fft.fftfreq(wide)[:, None], fft.rfftfreq(wide)[None, :]
    spectrum = fft.rfft2(kernels.astype(np.float64), (wide, wide)) / (np.sinc(fy) * np.sinc(fx))
    clean = np.maximum(fft.irfft2(spectrum, (wide, wide))[..., :size, :size], 0)
    return np.asarray(clean / clean.sum(axis=(-1, -2), keepdims=True), np.float32)


def layered(sharp_e: NDArray, steps: NDArray, kernels: NDArray, behind: NDArray | None = None) -> Float32Array:
    """A sharp picture [h, w, 3] blurred by ``steps`` [h, w] levels, positive nearer than the focus.

    Each pixel is split between the two nearest layers. The light and the coverage of each layer are blurred by its
    kernel, and the layers are composited from near to far, each into the part of the aperture that is still free.
    Coverages add instead of multiplying, because neighbouring layers mostly belong to one surface without gaps. The
    farther surface is continued behind the rim of every nearer one, with its colours at the rim. ``kernels`` and those
    of negative steps, ``behind``, are [level, 3, size, size]; by default they are the same.
    """
    far = kernels if behind is None else behind
    nodes = _nodes(float(steps.min()), float(steps.max()))
    index = np.interp(steps, nodes, np.arange(len(nodes))).astype(np.float32)
    first, last = int(index.min()), int(np.ceil(index.max()))
    layer_kernels = {
        node: _kernel(kernels if nodes[node] >= 0 else far, abs(nodes[node])) for node in range(first, last + 1)
    }
    reach = max(kernel.shape[-1] for kernel in layer_kernels.values()) // 2
    rim = ((reach, reach), (reach, reach))
    picture = np.pad(np.asarray(sharp_e, np.float32), (*rim, (0, 0)), "symmetric")
    position = np.pad(index, rim, "symmetric")
    hidden, hidden_position = _behind(picture, position, np.asarray(nodes), reach)
    free = np.ones((3, *position.shape), np.float32)
    light = np.zeros_like(free)
    for node in range(last, first - 1, -1):
        shares = _share(position, node), _share(hidden_position, node)
        cover = shares[0] + shares[1]
        if not cover.any():
            continue
        emitted = np.moveaxis(shares[0][..., None] * picture + shares[1][..., None] * hidden, -1, 0)
        box = _box(cover > 0, layer_kernels[node].shape[-1] // 2)
        blurred_cover = _blurred(np.broadcast_to(cover, emitted.shape)[:, *box], layer_kernels[node])
        visible = free[:, *box] / np.maximum(np.maximum(blurred_cover, free[:, *box]), np.float32(1e-6))
        light[:, *box] += visible * _blurred(emitted[:, *box], layer_kernels[node])
        free[:, *box] -= np.minimum(visible * blurred_cover, free[:, *box])
    whole = light / np.maximum(1 - free, np.float32(1e-3))
    return np.moveaxis(whole[:, reach : reach + steps.shape[0], reach : reach + steps.shape[1]], 0, -1).copy()


def _check(reconstruction: Reconstruction, bank: PsfBank, depth_m: float, f_number: float | None) -> None:
    """Raise InputError for an impossible depth or f-number, or a bank of another lens, other levels or lights."""
    camera = reconstruction.camera
    focal_m = camera.lens.focal_length_mm * 1e-3
    if not (np.isfinite(depth_m) and depth_m > focal_m):
        raise InputError(f"refocus: depth {depth_m:g} m is not allowed; give more than the focal length, {focal_m:g} m")
    if f_number is not None and not (np.isfinite(f_number) and f_number > 0):
        raise InputError(
            f"refocus: f-number {f_number:g} is not allowed; give more than 0, such as {camera.lens.f_number:g}"
        )
    own = "give the bank of the reconstruction"
    check_lens(bank, camera, "the reconstruction", own)
    if reconstruction.light not in bank.lights:
        raise InputError(
            f"refocus: the bank has no light '{reconstruction.light}', which the reconstruction has, only "
            f"{', '.join(bank.lights)}; {own}"
        )
    mine, its = (_levels(about) for about in (reconstruction.bank, bank_identity(bank)))
    if mine and (mine[0] != its[0] or not np.allclose(mine[1:], its[1:], rtol=SAME_DEPTHS)):
        text = ("{} levels from {:.4g} to {:.4g} m".format(*levels) for levels in (its, mine))
        raise InputError(f"refocus: the bank has {next(text)}, the reconstruction {next(text)}; {own}")


def _levels(about: dict[str, Any]) -> tuple[float, ...]:
    """Number of levels, nearest and farthest depth in metres of a bank's identity; nothing where it has none."""
    return (about["levels"], *about["depths_m"]) if {"levels", "depths_m"} <= about.keys() else ()


def _nodes(low: float, high: float) -> list[float]:
    """Blur of the layers in levels, from ``low`` to ``high``; wider steps far from focus, where blur is large."""
    side = [float(step) for step in range(1, DENSE_STEPS + 1)]
    while (side or [0.0])[-1] < max(-low, high):
        side.append((side or [0.0])[-1] + SPARSE_STEP)
    return [-step for step in reversed(side)] + [0.0, *side]


def _share(position: Float32Array, node: int) -> Float32Array:
    """Weight of a layer at each pixel, [h, w]: linear between neighbouring layers; 0 where ``position`` is NaN."""
    return np.nan_to_num(np.maximum(1 - np.abs(position - node), 0)).astype(np.float32)


def _kernel(kernels: NDArray, step: float) -> Float32Array:
    """The kernel [3, size, size] of a blur in levels, cropped; beyond the bank, its last kernel magnified."""
    last = len(kernels) - 1
    if step <= last:
        return np.asarray(layers.cut(kernels[int(step)], KERNEL_SHARE), np.float32)
    widest = layers.cut(kernels[last], KERNEL_SHARE)
    size = int(widest.shape[-1] * step / max(last, 1)) // 2 * 2 + 1
    if size > LARGEST_KERNEL_PX:
        raise InputError(
            f"refocus: the blur would be {size} px wide, at most {LARGEST_KERNEL_PX} px are allowed; take a larger "
            "f-number or a depth nearer to the objects"
        )
    wide = np.stack([cv2.resize(k, (size, size), interpolation=cv2.INTER_LINEAR) for k in widest.astype(np.float32)])
    return np.asarray(wide / wide.sum(axis=(1, 2), keepdims=True), np.float32)


def _behind(
    picture: Float32Array, position: Float32Array, nodes: NDArray, reach: int
) -> tuple[Float32Array, Float32Array]:
    """Colour [h, w, 3] and position [h, w] of the surface behind each pixel; position NaN without one in reach.

    The surface is that of the closest pixel in the frame that is farther by more than ``BEHIND_LEVELS``, with the
    colour of that pixel. Mirrored colours would show what is bright beside a rim twice.
    """
    steps = np.interp(position, np.arange(len(nodes)), nodes)
    colour, behind = np.zeros_like(picture), np.full(position.shape, np.nan, np.float32)
    nearest = np.rint(position).astype(int)
    for node in range(len(nodes)):
        far = steps < nodes[node] - BEHIND_LEVELS
        front = nearest == node
        if not (front.any() and far.any()):
            continue
        distance, labels = cv2.distanceTransformWithLabels(
            (~far).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        source = np.zeros((int(labels.max()) + 1, 2), int)
        source[labels[far]] = np.argwhere(far)
        front &= (distance <= reach) & ~far
        y, x = source[labels[front]].T
        colour[front] = picture[y, x]
        behind[front] = position[y, x]
    return colour, behind


def _box(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """The bounding box of a mask [h, w] with a margin, within the frame."""
    sides = []
    for axis in (1, 0):
        index = np.flatnonzero(mask.any(axis=axis))
        sides.append(slice(max(int(index[0]) - margin, 0), int(index[-1]) + margin + 1))
    return sides[0], sides[1]


def _blurred(stack: Float32Array, kernel: Float32Array) -> Float32Array:
    """A stack [channel, h, w] convolved with each channel's kernel, 0 outside the frame."""
    if kernel.shape[-1] == 1:
        return np.asarray(stack * kernel, np.float32)
    from scipy import signal  # takes half a second to import

    return np.asarray(signal.fftconvolve(stack, kernel, "same", axes=(1, 2)), np.float32)
