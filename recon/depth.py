"""Depth from the blur of green relative to infrared (sec. 5.2), eq. (9)-(12).

All is done on the colour planes' own grid of half the resolution: a plane holds no frequency above
0.25 cycles a pixel, so nothing is lost against interpolated images, whose interpolation would differ
between channels. Each plane is moved to the middle of the 2x2 blocks by the shift theorem.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recon import fourier
from recon.mosaic import Phase
from recon.settings import Settings

Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]

Channel = tuple[Float32Array, Phase, Float32Array, NDArray]  # plane, phase, noise variance, kernels [level, y, x]

PLANE_SPACING_PX = 2.0
BLOCK_CENTRE_PX = 0.5  # of a 2x2 block, from the centre of its first pixel
ROLL_OFF = 0.4  # of the cutoff: width of the band's smooth edge
MIN_ENERGY_SHARE = 0.1  # of the measured energy: what is left at least when the noise's share is taken away
SMALLEST = float(np.finfo(np.float32).tiny)
OFFSET_GRID = 96
REFERENCE_ERROR = 1.0  # levels: an estimate with this standard error has a confidence of one half
INDEPENDENT_SHARE = 0.5  # of a window's samples, after the band-pass


def transform(plane: Float32Array, phase: Phase, shape: tuple[int, int]) -> Complex64Array:
    """Spectrum of a colour plane [h/2, w/2] in a frame of ``shape``, moved to the middle of the blocks."""
    fy, fx = fourier.frequencies(shape, PLANE_SPACING_PX)
    shift = fy * (BLOCK_CENTRE_PX - phase[0]) + fx * (BLOCK_CENTRE_PX - phase[1])
    moved = np.exp(2j * np.pi * shift).astype(np.complex64)
    return fourier.forward(fourier.pad_blended(plane, shape)) * moved


def derivatives(shape: tuple[int, int], settings: Settings) -> list[Complex64Array]:
    """Filters of eq. (11)'s gradients, limited to the common band: nabla_x + nabla_y, or both one by one.

    The band ends smoothly at ``cutoff_cycles_px`` (deviation: the paper does not limit it): towards the planes'
    own limit of 0.25 cycles a pixel, aliasing of green near focus grows.
    """
    fy, fx = fourier.frequencies(shape, PLANE_SPACING_PX)
    radius = np.hypot(fy, fx)
    edge = settings.cutoff_cycles_px
    rise = np.clip((edge - radius) / (ROLL_OFF * edge) + 0.5, 0, 1)
    band = 0.5 - 0.5 * np.cos(np.pi * rise)
    dx, dy = (2j * np.pi * PLANE_SPACING_PX * f * band for f in (fx, fy))
    filters = [dx + dy] if settings.gradient == "sum" else [dx + 0 * fy, dy + 0 * fx]
    return [f.astype(np.complex64) for f in filters]


def noise_gain(response: Complex64Array, width: int) -> float:
    """Variance of white noise of variance 1 after a filter given on the half-plane of frequencies."""
    power = np.abs(response) ** 2
    twice = np.full(power.shape[1], 2.0)
    twice[0] = 1.0
    if width % 2 == 0:
        twice[-1] = 1.0
    return float((power * twice).sum() / (power.shape[0] * width))


def prior_weight(energy: float, noise: float, gain: float) -> float:
    """Weight beta of eq. (9): noise variance over the power of the gradients, both measured in the picture."""
    return noise / max(energy - gain * noise, MIN_ENERGY_SHARE * energy, SMALLEST)


def reblur(infrared: Complex64Array, green: Complex64Array, beta: float, shape: tuple[int, int]) -> Complex64Array:
    """Filter that deblurs infrared and blurs it like green, eq. (9)-(10) in closed form.

    H_G conj(H_IR) / (|H_IR|^2 + beta (|D_x|^2 + |D_y|^2)), from the two transfer functions [h, w/2 + 1].
    """
    fy, fx = fourier.frequencies(shape)
    gradient = 4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2
    return green * np.conj(infrared) / (np.abs(infrared) ** 2 + np.float32(max(beta, 1e-9)) * gradient + 1e-12)


def window_mean(image: Float32Array, settings: Settings) -> Float32Array:
    """Mean over the patch of eq. (11) around each block: a box, or a Gaussian of the box's variance."""
    side = settings.window_px / PLANE_SPACING_PX
    border = cv2.BORDER_REFLECT
    if settings.window == "box":
        odd = 2 * int(side / 2) + 1
        return np.asarray(cv2.boxFilter(image, -1, (odd, odd), borderType=border), np.float32)
    sigma = side / np.sqrt(12)
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=border), np.float32)


def match(
    sharper: Channel, green: Channel, settings: Settings
) -> tuple[Float32Array, Float32Array, NDArray, Float32Array, Float32Array]:
    """NCC of every level and block, eq. (11), [level, h/2, w/2], and what :func:`best_level` needs of it.

    Then the plain NCC at each block's best level, the peak's offset at each level, and the gradients' signal
    over noise of both channels.

    Each channel comes as (plane, phase, noise variance map, kernels [level, size, size]). With
    ``noise_corrected`` the energies in the NCC's denominator lose what noise adds to them (deviation):
    deblurring amplifies noise least at large levels, which would draw weak texture there.
    """
    plane, phase, variance, kernels = sharper
    height, width = plane.shape
    margin = int(np.ceil(kernels.shape[-1] / PLANE_SPACING_PX))
    shape = fourier.fast_shape(plane.shape, margin)
    filters = derivatives(shape, settings)

    def filtered(spectrum: Complex64Array) -> list[Float32Array]:
        return [fourier.inverse(spectrum * f, shape)[:height, :width] for f in filters]

    def energy(images: list[Float32Array]) -> Float32Array:
        return window_mean(np.sum([image * image for image in images], axis=0), settings)

    gain = sum(noise_gain(f, shape[1]) for f in filters)
    spectrum = transform(plane, phase, shape)
    noise, green_noise = window_mean(variance, settings), window_mean(green[2], settings)
    observed = filtered(transform(green[0], green[1], shape))
    green_energy, own_energy = energy(observed), energy(filtered(spectrum))
    raw_green_energy = green_energy
    snr = own_energy / (gain * noise) - 1
    green_snr = green_energy / (gain * green_noise) - 1
    if settings.noise_corrected:
        green_energy = np.maximum(green_energy - gain * green_noise, MIN_ENERGY_SHARE * green_energy)
    beta = settings.prior_factor * prior_weight(float(own_energy.mean()), float(variance.mean()), gain)
    score = np.empty((len(kernels), height, width), np.float32)
    best, plain = np.full((2, height, width), -1, np.float32)
    for level, (kernel, green_kernel) in enumerate(zip(kernels, green[3], strict=True)):
        own = fourier.transfer(kernel, shape, PLANE_SPACING_PX)
        blur = reblur(own, fourier.transfer(green_kernel, shape, PLANE_SPACING_PX), beta, shape)
        predicted = filtered(spectrum * blur)
        power = raw_power = energy(predicted)
        if settings.noise_corrected:
            level_gain = sum(noise_gain(f * blur, shape[1]) for f in filters)
            power = np.maximum(power - level_gain * noise, MIN_ENERGY_SHARE * power)
        product = window_mean(np.sum([p * o for p, o in zip(predicted, observed, strict=True)], axis=0), settings)
        score[level] = product / np.sqrt(np.maximum(power * green_energy, SMALLEST))
        better = score[level] > best
        best[better] = score[level][better]
        scale = np.sqrt(np.maximum(raw_power * raw_green_energy, SMALLEST))
        plain[better] = (product / scale)[better]
    return score, plain, peak_offset(kernels, green[3], beta, settings), snr, green_snr


def peak_offset(kernels: NDArray, green_kernels: NDArray, beta: float, settings: Settings) -> NDArray[np.float64]:
    """How far the refined peak lies from each true level for a clean picture, [level], from the kernels alone.

    The NCC falls faster towards less blur than towards more, so the vertex of a parabola misses its maximum,
    and eq. (10) adds a little blur of its own: up to 0.3 levels together. Expected NCC of neighbouring levels for
    a texture of natural spectrum (power 1/f^2), on a small grid; deviation: the paper names no refinement.
    """
    shape = (OFFSET_GRID, OFFSET_GRID)
    fy, fx = fourier.frequencies(shape, PLANE_SPACING_PX)
    power = sum(np.abs(f) ** 2 for f in derivatives(shape, settings)) / np.maximum(fy**2 + fx**2, OFFSET_GRID**-2)
    power[:, 1:] *= 2  # the half-plane stands for both
    small = fourier.transfer(kernels, shape, PLANE_SPACING_PX)
    large = fourier.transfer(green_kernels, shape, PLANE_SPACING_PX)
    filters = [reblur(s, g, beta, shape) for s, g in zip(small, large, strict=True)]
    offset = np.zeros(len(kernels))
    for true in range(1, len(kernels) - 1):
        before, at, after = (
            (power * np.conj(large[true]) * predicted).sum().real / np.sqrt((power * np.abs(predicted) ** 2).sum())
            for predicted in (small[true] * filters[true + step] for step in (-1, 0, 1))
        )
        curvature = 2 * at - before - after
        offset[true] = np.clip(0.5 * (after - before) / curvature, -0.5, 0.5) if curvature > 0 else 0.0
    return offset


def best_level(
    score: Float32Array, plain: Float32Array, offset: NDArray, settings: Settings
) -> tuple[Float32Array, Float32Array]:
    """Level of the largest NCC, eq. (12), refined by a parabola through its neighbours; and a confidence 0..1.

    ``offset`` [level] is where the parabola's vertex lies for a true level (:func:`peak_offset`), undone here.

    The confidence is s^2 / (s^2 + e^2) with s one level and e the standard error of a least-squares fit:
    e^2 = (1 - n^2) / (N c n), n the ``plain`` NCC at its peak, -c its second derivative, N the window's independent
    samples. Zero where the NCC is not positive.
    """
    levels = len(score)
    peak = np.argmax(score, axis=0)
    middle = np.clip(peak, 1, levels - 2)
    before, at, after = (np.take_along_axis(score, (middle + d)[None], 0)[0] for d in (-1, 0, 1))
    curvature = 2 * at - before - after
    shift = 0.5 * (after - before) / np.where(curvature > 0, curvature, 1)
    inside = (peak == middle) & (curvature > 0)
    vertex = np.where(inside, middle + np.clip(shift, -0.5, 0.5), peak)
    seen = np.maximum.accumulate(np.arange(levels) + offset)
    level = np.interp(vertex, seen, np.arange(levels)).astype(np.float32)
    top = np.clip(plain, 0, 1)
    samples = INDEPENDENT_SHARE * (settings.window_px / PLANE_SPACING_PX) ** 2
    information = samples * np.maximum(curvature, 0) * top
    unexplained = np.maximum(1 - top**2, 1e-3)
    confidence = REFERENCE_ERROR**2 * information / (REFERENCE_ERROR**2 * information + unexplained)
    return level, np.nan_to_num(confidence).astype(np.float32)
