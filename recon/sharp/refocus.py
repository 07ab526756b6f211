"""Refocusing after the shot (Fig. 1(c, d), 11(d)): the all-in-focus picture blurred anew, layer by layer.

Linear light, the measured kernels, and occlusion as through a lens: nearer surfaces hide farther ones, which show
through where the blur of the nearer one is thin.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.typing import Float32Array
from dasim.values import PsfBank, Reconstruction
from recon.levels import level_of
from recon.picture import infrared
from recon.settings import Settings
from recon.sharp import layers, sharpen

KERNEL_SHARE = 0.999  # of a kernel's energy that a layer keeps
DENSE_STEPS, SPARSE_STEP = 12, 2  # layers lie a level of the bank apart up to here, then two
BEHIND_LEVELS = 1.0  # from a pixel's own level to that of another surface behind it
LARGEST_KERNEL_PX = 401
PAD_FACTOR = 2  # of a kernel's size, for its division by the pixel's transfer function


def refocus(
    reconstruction: Reconstruction, bank: PsfBank, depth_m: float, f_number: float | None = None
) -> Float32Array:
    """The picture as if focused at ``depth_m`` through an aperture of ``f_number``, [h, w, 3].

    Linear camera colours without infrared, in electrons of the capture's own exposure: a smaller aperture does not
    darken the picture. The frame is the capture's: a real lens moves to focus and magnifies by s'/s (breathing), this
    one does not. By default the camera's own f-number.

    Blur in levels is linear in dioptres, so that a point at level l has |l - l_0| levels of blur with the focus at
    l_0; it is as 1/N. Sec. 5.4 has no formula for this; the layers follow the wave-optics kernels of the bank, whose
    diffraction stays that of its own f-number.
    """
    camera = reconstruction.camera
    _check(camera, bank, depth_m, f_number)
    ratio = 1.0 if f_number is None else camera.lens.f_number / f_number
    kernels = colour_kernels(reconstruction, bank)
    steps = (reconstruction.level - float(level_of(depth_m, bank.depth_m))) * ratio
    return layered(reconstruction.sharp_e, steps, kernels)


def colour_kernels(reconstruction: Reconstruction, bank: PsfBank) -> Float32Array:
    """Kernels [level, 3, size, size] that blur what pixels see of R, G, B without infrared; level 0 is a point."""
    light = bank.lights.index(reconstruction.light)
    separation = infrared.separation(reconstruction.camera, reconstruction.light, Settings(**reconstruction.settings))
    visible = sharpen.visible_kernels(bank.kernel[light], bank.signature[light], separation)[:, :3]
    kernels = without_pixel(visible)
    kernels[0] = 0
    kernels[0, :, kernels.shape[-2] // 2, kernels.shape[-1] // 2] = 1
    return kernels


def without_pixel(kernels: NDArray) -> Float32Array:
    """Measured kernels [..., size, size] without the pixel's area, which the sharp picture contains; unit sum."""
    size = kernels.shape[-1]
    wide = fft.next_fast_len(PAD_FACTOR * size, real=True)
    fy, fx = fft.fftfreq(wide)[:, None], fft.rfftfreq(wide)[None, :]
    spectrum = fft.rfft2(kernels.astype(np.float64), (wide, wide)) / (np.sinc(fy) * np.sinc(fx))
    clean = np.maximum(fft.irfft2(spectrum, (wide, wide))[..., :size, :size], 0)
    return np.asarray(clean / clean.sum(axis=(-1, -2), keepdims=True), np.float32)


def layered(sharp_e: NDArray, steps: NDArray, kernels: NDArray) -> Float32Array:
    """A sharp picture [h, w, 3] seen through blur of ``steps`` [h, w] levels, above 0 nearer than the focus.

    Pixels are shared between the two nearest layers. Each layer's light and coverage are blurred by its kernel;
    from the nearest on, a layer takes of the aperture what those before it left. Coverage adds up instead of
    multiplying, since neighbouring layers are mostly one surface, whose parts leave no gap. Behind the rim of
    every nearer surface the farther one goes on, mirrored at the rim, so that a gap shows what may lie there.
    """
    nodes = _nodes(float(steps.min()), float(steps.max()))
    place = np.interp(steps, nodes, np.arange(len(nodes))).astype(np.float32)
    first, last = int(place.min()), int(np.ceil(place.max()))
    found = {node: _kernel(kernels, abs(nodes[node])) for node in range(first, last + 1)}
    reach = max(kernel.shape[-1] for kernel in found.values()) // 2
    rim = ((reach, reach), (reach, reach))
    picture = np.pad(np.asarray(sharp_e, np.float32), (*rim, (0, 0)), "symmetric")
    position = np.pad(place, rim, "symmetric")
    behind, behind_position = _behind(picture, position, np.asarray(nodes), reach)
    left = np.ones((3, *position.shape), np.float32)
    light = np.zeros_like(left)
    for node in range(last, first - 1, -1):
        shares = _share(position, node), _share(behind_position, node)
        cover = shares[0] + shares[1]
        if not cover.any():
            continue
        emitted = np.moveaxis(shares[0][..., None] * picture + shares[1][..., None] * behind, -1, 0)
        box = _box(cover > 0, found[node].shape[-1] // 2)
        blurred_cover = _blurred(np.broadcast_to(cover, emitted.shape)[:, *box], found[node])
        taken = left[:, *box] / np.maximum(np.maximum(blurred_cover, left[:, *box]), np.float32(1e-6))
        light[:, *box] += taken * _blurred(emitted[:, *box], found[node])
        left[:, *box] -= np.minimum(taken * blurred_cover, left[:, *box])
    whole = light / np.maximum(1 - left, np.float32(1e-3))
    return np.moveaxis(whole[:, reach : reach + steps.shape[0], reach : reach + steps.shape[1]], 0, -1).copy()


def _check(camera: Camera, bank: PsfBank, depth_m: float, f_number: float | None) -> None:
    focal_m = camera.lens.focal_length_mm * 1e-3
    if not (np.isfinite(depth_m) and depth_m > focal_m):
        raise InputError(f"refocus: a depth of {depth_m:g} m; more than the focal length of {focal_m:g} m is allowed")
    if f_number is not None and not (np.isfinite(f_number) and f_number > 0):
        raise InputError(
            f"refocus: an f-number of {f_number:g}; more than 0 is allowed, such as {camera.lens.f_number:g}"
        )
    if bank.camera.lens != camera.lens:
        lens = bank.camera.lens
        raise InputError(
            f"refocus: the bank of camera '{bank.camera.name}' focused at {lens.focus_distance_m:g} m does not fit "
            "this reconstruction; give the bank that it was made with"
        )


def _nodes(low: float, high: float) -> list[float]:
    """Steps of blur that are layers, from ``low`` to ``high``: blur grows slowly relative to itself far from focus."""
    side = [float(step) for step in range(1, DENSE_STEPS + 1)]
    while (side or [0.0])[-1] < max(-low, high):
        side.append((side or [0.0])[-1] + SPARSE_STEP)
    return [-step for step in reversed(side)] + [0.0, *side]


def _share(position: Float32Array, node: int) -> Float32Array:
    """Weight of a layer at each pixel, linear between neighbouring layers; 0 where a position is NaN."""
    return np.nan_to_num(np.maximum(1 - np.abs(position - node), 0)).astype(np.float32)


def _kernel(kernels: NDArray, step: float) -> Float32Array:
    """The kernel [3, size, size] of a step, cut to its reach; beyond the bank's last level that one, enlarged."""
    last = len(kernels) - 1
    if step <= last:
        return np.asarray(layers.cut(kernels[int(step)], KERNEL_SHARE), np.float32)
    own = layers.cut(kernels[last], KERNEL_SHARE)
    size = min(int(own.shape[-1] * step / last) // 2 * 2 + 1, LARGEST_KERNEL_PX)
    wide = np.stack([cv2.resize(k, (size, size), interpolation=cv2.INTER_LINEAR) for k in own.astype(np.float32)])
    return np.asarray(wide / wide.sum(axis=(1, 2), keepdims=True), np.float32)


def _behind(
    picture: Float32Array, position: Float32Array, nodes: NDArray, reach: int
) -> tuple[Float32Array, Float32Array]:
    """Colour [h, w, 3] and position [h, w] of the surface behind each pixel; NaN positions where none is near.

    That of the nearest pixel that lies ``BEHIND_LEVELS`` farther, its colour mirrored at the rim where the mirror
    place is as far.
    """
    height, width = position.shape
    steps = np.interp(position, np.arange(len(nodes)), nodes)
    colour, place = np.zeros_like(picture), np.full(position.shape, np.nan, np.float32)
    rows, columns = np.mgrid[:height, :width]
    nearest = np.rint(position).astype(int)
    for node in range(len(nodes)):
        far = steps < nodes[node] - BEHIND_LEVELS
        own = nearest == node
        if not (own.any() and far.any()):
            continue
        distance, labels = cv2.distanceTransformWithLabels(
            (~far).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
        )
        source = np.zeros((int(labels.max()) + 1, 2), int)
        source[labels[far]] = np.argwhere(far)
        own &= (distance <= reach) & ~far
        y, x = source[labels[own]].T
        mirror_y = np.clip(2 * y - rows[own], 0, height - 1)
        mirror_x = np.clip(2 * x - columns[own], 0, width - 1)
        alike = np.abs(steps[mirror_y, mirror_x] - steps[y, x]) < BEHIND_LEVELS
        colour[own] = picture[np.where(alike, mirror_y, y), np.where(alike, mirror_x, x)]
        place[own] = position[y, x]
    return colour, place


def _box(mask: NDArray[np.bool_], margin: int) -> tuple[slice, slice]:
    """The rectangle around a mask, with a margin, within the frame."""
    sides = []
    for axis in (1, 0):
        used = np.flatnonzero(mask.any(axis=axis))
        sides.append(slice(max(int(used[0]) - margin, 0), int(used[-1]) + margin + 1))
    return sides[0], sides[1]


def _blurred(stack: Float32Array, kernel: Float32Array) -> Float32Array:
    """[channel, h, w] convolved with each channel's kernel, 0 beyond."""
    if kernel.shape[-1] == 1:
        return np.asarray(stack * kernel, np.float32)
    return np.asarray(signal.fftconvolve(stack, kernel, "same", axes=(1, 2)), np.float32)
