"""The Cramer-Rao bound of blur and depth: what no unbiased estimator beats on a patch, without any rendering.

The sharp picture of a patch is unknown: a Gaussian random texture of power spectrum B P(w), seen by every channel i
with a gain g_i, a transfer function H_i(w) and noise n_i. Its covariance at a frequency is

    C_ij = B P g_i g_j rho_ij H_i conj(H_j) + n_i delta_ij,

rho the coherence of the channels' textures (1: the same texture), and the Fisher information of theta = (blur, ln B,
ln g_2, ln g_3 ...), strength and gains being nuisances as the picture itself is,

    I_ab = 1/2 sum over w of tr(C^-1 dC/da C^-1 dC/db),

the Slepian-Bangs formula for the independent frequencies of a patch (Kay, Fundamentals of Statistical Signal
Processing: Estimation Theory, sec. 3.9 and 15.9; Whittle's approximation: a patch is taken for periodic). No unbiased
estimate of blur has a variance below [I^-1]_00.

Spectra are given on the half-plane [h, w/2 + 1] of a real picture [h, w] whose samples lie ``spacing_px`` apart. A
power spectrum is the mean of |DFT|^2 / (h w): white noise of variance v has the power v everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import j0

from dasim.camera import geometry, pointspread
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.spectra import illuminants
from dasim.typing import FloatArray

ComplexArray = NDArray[np.complex128]

SLOPE_STEP_PX = 0.05  # of visible blur, either way: at 0.5 cycles/px a transfer function turns by 0.16 rad
RADIAL_STEP_PX = 0.2  # of profiles before the pixel, which hold no frequency above 1 / (lambda N) = 1.2 cycles/px
RADIAL_FREQUENCIES = 160  # from 0 to the corner of the pixels' own band
TAIL_PX = 40.0  # beyond the geometric blur: where the wave's rings end
BLUR, STRENGTH = 0, 1  # places among the parameters; the gains follow


# --- textures and patches ------------------------------------------------------------------------


def natural_power(
    shape: tuple[int, int], *, spacing_px: float = 1.0, contrast: float = 0.1, exponent: float = 2.0
) -> FloatArray:
    """Power spectrum of a natural texture, P ~ 1 / f^exponent, [h, w/2 + 1]; 0 for the mean, which tells nothing.

    ``contrast`` is the standard deviation, in the unit of the picture, of what lies within the octave from 0.125 to
    0.25 cycles/px (within every octave, for the natural exponent 2: Field, J. Opt. Soc. Am. A 4, 1987). The density
    does not depend on the grid: samples ``spacing_px`` apart see 1 / spacing^2 of it each.
    """
    radius = _radius(shape, spacing_px)
    low, high = 0.125, 0.25
    octave = np.log(high / low) if exponent == 2 else (high ** (2 - exponent) - low ** (2 - exponent)) / (2 - exponent)
    density = contrast**2 / (2 * np.pi * octave)
    power = np.zeros(radius.shape)
    power[radius > 0] = density * radius[radius > 0] ** -exponent / spacing_px**2
    return power


def picture_power(picture: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Power spectrum of a known texture on the grid of a patch, [h, w/2 + 1]: Welch's mean over patches.

    Patches of ``shape`` that overlap by half, less their mean, under Hann windows; the mean, and with it what the
    window makes of it, is set to 0.
    """
    window = np.hanning(shape[0] + 2)[1:-1, None] * np.hanning(shape[1] + 2)[None, 1:-1]
    view = np.lib.stride_tricks.sliding_window_view(picture, shape)
    patches = view[:: max(shape[0] // 2, 1), :: max(shape[1] // 2, 1)].astype(np.float64)
    patches = patches - patches.mean(axis=(-1, -2), keepdims=True)
    power = (np.abs(np.fft.rfft2(patches * window)) ** 2).mean(axis=(0, 1)) / (window**2).sum()
    power[0, 0] = 0.0
    return np.asarray(power)


def window_area_px(window_px: float, window: Literal["gaussian", "box"] = "gaussian") -> float:
    """Area of the box that tells as much as a patch of a side ``window_px``.

    Estimates from weighted samples have the variance of (sum w)^2 / sum w^2 equal ones: a Gaussian of the box's
    variance counts for 4 pi sigma^2 = pi/3 window^2.
    """
    return window_px**2 * (np.pi / 3 if window == "gaussian" else 1.0)


# --- transfer functions and how they change with blur --------------------------------------------


def camera_transfers(
    camera: Camera,
    blur_px: ArrayLike,
    light: str | Sequence[str],
    shape: tuple[int, int],
    *,
    spacing_px: float = 1.0,
    diffraction: str = "wave",
) -> tuple[FloatArray, FloatArray]:
    """Transfer functions H of a camera's channels and dH/dc, c the visible blur in px: [blur, channel, h, w/2 + 1].

    For several lights [light, blur, channel, h, w/2 + 1], in little more time than for one.
    Hankel transform of the camera's own kernels under an illuminant (:mod:`dasim.camera.pointspread`), times the
    pixel's sinc; the change by differences of 0.05 px to either side. For stops that are centred discs and rings.
    """
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    both = np.concatenate([blurs - SLOPE_STEP_PX, blurs + SLOPE_STEP_PX])
    names = [light] if isinstance(light, str) else light
    spectrum = np.stack([illuminants.illuminant(name) for name in names])
    full, _ = round_transfers(camera, both, spectrum, shape, spacing_px=spacing_px, diffraction=diffraction)
    below, above = np.split(full, 2, axis=1)
    if isinstance(light, str):
        below, above = below[0], above[0]
    return np.asarray((below + above) / 2), np.asarray((above - below) / (2 * SLOPE_STEP_PX))


def round_transfers(
    camera: Camera,
    blur_px: FloatArray,
    spectrum: FloatArray,
    shape: tuple[int, int],
    *,
    spacing_px: float = 1.0,
    diffraction: str = "wave",
    stops: Sequence[Stop] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """H through discs and rings about the axis, all of the camera's or ``stops``, [..., blur, channel, h, w/2 + 1].

    Under light of ``spectrum`` [..., wavelength]; also the electrons of each channel through them, relative,
    [..., channel].
    """
    radius = np.arange(RADIAL_STEP_PX / 2, np.abs(blur_px).max() / 2 + TAIL_PX, RADIAL_STEP_PX)
    profiles, electrons = pointspread.radial_profiles(camera, blur_px, spectrum, radius, diffraction, stops)
    ring = profiles * (2 * np.pi * radius * RADIAL_STEP_PX)
    whole = ring.sum(axis=-1, keepdims=True)
    ring = np.divide(ring, whole, out=np.zeros_like(ring), where=whole > 0)
    wanted = _radius(shape, spacing_px)
    known = np.linspace(0, float(wanted.max()), RADIAL_FREQUENCIES)
    along = ring @ j0(2 * np.pi * np.outer(radius, known))
    fy, fx = frequencies(shape, spacing_px)
    full = CubicSpline(known, along, axis=-1)(wanted.ravel()).reshape(*along.shape[:-1], *wanted.shape)
    return np.asarray(full * (np.sinc(fy) * np.sinc(fx))), electrons


def kernel_transfers(
    kernels: NDArray, blur_px: ArrayLike, shape: tuple[int, int], *, spacing_px: float = 1.0
) -> tuple[ComplexArray, ComplexArray]:
    """H and dH/dc of any kernels [blur, channel, y, x] of odd size, as of a bank's light: [blur, channel, h, w/2 + 1].

    The change with blur is that of a cubic spline through the blurs, at least two. Where blur steps by s px, it is
    right below about 0.4 / s cycles/px and too small beyond: the bound is then too careful.
    """
    fy, fx = frequencies(shape, spacing_px)
    rows, columns = (np.arange(n) - n // 2 for n in kernels.shape[-2:])
    right = np.exp(-2j * np.pi * np.outer(columns, fx[0]))
    down = np.exp(-2j * np.pi * np.outer(fy[:, 0], rows))
    transfer = down @ kernels.astype(np.float64) @ right
    spline = CubicSpline(np.asarray(blur_px, np.float64), transfer, axis=0)
    return transfer, spline(np.asarray(blur_px, np.float64), 1)


# --- bounds --------------------------------------------------------------------------------------


def information(
    transfer: NDArray,
    slope: NDArray,
    power: NDArray,
    noise: ArrayLike,
    *,
    width: int,
    gain: ArrayLike = 1.0,
    coherence: ArrayLike = 1.0,
) -> FloatArray:
    """Fisher information of (blur, ln B, ln g_2, ...) in one periodic patch [h, width], [..., channels + 1, same].

    ``transfer`` and ``slope`` are [..., channel, h, w/2 + 1], ``power`` [h, w/2 + 1], ``noise`` variances
    [..., channel] in the picture's unit squared, ``gain`` [..., channel], ``coherence`` one number for all pairs of
    channels or a matrix [channel, channel]. The unit of the blur is that of the slope.
    """
    told = _by_frequency(transfer, slope, power, noise, gain, coherence)
    return np.asarray((told * multiplicity(width)).sum(axis=(-1, -2)))


def _by_frequency(
    transfer: NDArray, slope: NDArray, power: NDArray, noise: ArrayLike, gain: ArrayLike, coherence: ArrayLike
) -> FloatArray:
    """Information at each frequency of the whole plane, given on its half, [..., channels + 1, same, h, w/2 + 1]."""
    count = transfer.shape[-3]
    signal = np.asarray(gain, np.float64)[..., None, None] * transfer
    change = np.asarray(gain, np.float64)[..., None, None] * slope
    seen, moved = (np.moveaxis(part, -3, -1)[..., None] for part in (signal, change))  # [..., h, w, channel, 1]
    alike = np.broadcast_to(np.asarray(coherence, np.float64), (count, count)).copy()
    np.fill_diagonal(alike, 1.0)
    scaled = power[..., None, None] * alike
    own = scaled * (seen @ _adjoint(seen))
    half = scaled * (moved @ _adjoint(seen))
    noises = np.asarray(noise, np.float64)[..., None, None, :, None] * np.eye(count)
    inverse = np.linalg.inv(own + noises)
    changes = [half + _adjoint(half), own]
    for channel in range(1, count):
        only = np.zeros((count, count))
        only[channel, channel] = 1.0
        changes.append(only @ own + own @ only)
    parts = [inverse @ part for part in changes]
    found = np.empty((*own.shape[:-4], len(parts), len(parts), *own.shape[-4:-2]))
    for a, first in enumerate(parts):
        for b, second in enumerate(parts[: a + 1]):
            trace = 0.5 * np.einsum("...ij,...ji->...", first, second).real
            found[..., a, b, :, :] = found[..., b, a, :, :] = trace
    return found


def blur_deviation(
    transfer: NDArray,
    slope: NDArray,
    power: NDArray,
    noise: ArrayLike,
    *,
    width: int,
    area_px: float | None = None,
    spacing_px: float = 1.0,
    gain: ArrayLike = 1.0,
    coherence: ArrayLike = 1.0,
    texture: Literal["known", "spectrum", "free"] = "spectrum",
) -> FloatArray:
    """Least standard deviation of the blur that an unbiased estimate from one patch can have, [...], in its unit.

    Arguments as of :func:`information`; ``area_px`` is the patch's area (:func:`window_area_px`), by default that of
    the spectra's own grid: information grows in proportion. ``texture`` says what is known of it: its spectrum and
    also its strength and gains (``known``), the spectrum alone, or nothing (``free``): then its power in every ring
    of frequencies is a nuisance, and what is left is what the channels' difference of blur tells. Infinite where the
    blur tells nothing.
    """
    per_frequency = _by_frequency(transfer, slope, power, noise, gain, coherence) * multiplicity(width)
    whole = told = per_frequency[..., BLUR, BLUR, :, :].sum(axis=(-1, -2))
    if texture == "spectrum":
        told = _without(per_frequency.sum(axis=(-1, -2)))
    elif texture == "free":
        told = _without(_free_of_spectrum(per_frequency, power.shape, width))
    told = np.where(told > NOTHING * np.maximum(whole, np.finfo(float).tiny), told, 0.0)
    if area_px is not None:
        told = told * (area_px / (power.shape[-2] * width * spacing_px**2))
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.sqrt(told))


def _without(found: FloatArray) -> FloatArray:
    """Information of the first parameter when the others are unknown: the Schur complement, [...]."""
    rest, across = found[..., 1:, 1:], found[..., 1:, 0]
    # pinv: where a channel sees nothing, its gain is no parameter
    return np.asarray(found[..., 0, 0] - np.einsum("...i,...ij,...j->...", across, np.linalg.pinv(rest), across))


def _free_of_spectrum(per_frequency: FloatArray, shape: tuple[int, ...], width: int) -> FloatArray:
    """Information of (blur, gains) when the texture's power in every ring of frequencies is unknown."""
    ring = np.rint(_radius((shape[0], width), 1.0) * max(shape[0], width)).astype(int)
    kept = [BLUR, *range(STRENGTH + 1, per_frequency.shape[-3])]
    total = np.zeros((*per_frequency.shape[:-4], len(kept), len(kept)))
    for number in range(1, ring.max() + 1):
        one = (per_frequency * (ring == number)).sum(axis=(-1, -2))
        across, own = one[..., kept, STRENGTH], one[..., STRENGTH, STRENGTH][..., None, None]
        outer = across[..., :, None] * across[..., None, :]
        total += one[..., kept, :][..., kept] - np.divide(outer, own, out=np.zeros_like(outer), where=own > 0)
    return total


def depth_deviation_m(camera: Camera, depth_m: ArrayLike, blur_deviation_px: ArrayLike) -> FloatArray:
    """Standard deviation of depth for one of visible blur: d^2 p / (A s) for a pixel, from c = A s (1/d - 1/d_f)."""
    per_px = camera.sensor.pixel_pitch_um * 1e-6 / (geometry.aperture_m(camera) * geometry.image_distance_m(camera))
    return np.asarray(np.asarray(depth_m, np.float64) ** 2 * per_px * np.asarray(blur_deviation_px, np.float64))


def level_deviation(camera: Camera, blur_deviation_px: ArrayLike) -> FloatArray:
    """Standard deviation in blur levels of one of visible blur in px."""
    return np.asarray(np.asarray(blur_deviation_px, np.float64) / geometry.level_blur_px(camera)[1])


NOTHING = 1e-9  # of the information with all else known: what rounding leaves where the blur tells nothing


def _adjoint(matrix: NDArray) -> NDArray:
    return np.conj(np.swapaxes(matrix, -1, -2))


def multiplicity(width: int) -> FloatArray:
    """How often each column of the half-plane stands in the whole one, [w/2 + 1]."""
    twice = np.full(width // 2 + 1, 2.0)
    twice[0] = 1.0
    if width % 2 == 0:
        twice[-1] = 1.0
    return twice


def frequencies(shape: tuple[int, int], spacing_px: float) -> tuple[FloatArray, FloatArray]:
    """Frequencies of a patch in cycles/px down and along, [h, 1] and [1, w/2 + 1]."""
    down, along = np.fft.fftfreq(shape[0], spacing_px), np.fft.rfftfreq(shape[1], spacing_px)
    return np.asarray(down[:, None], np.float64), np.asarray(along[None, :], np.float64)


def _radius(shape: tuple[int, int], spacing_px: float) -> FloatArray:
    """Frequency in cycles/px, [h, w/2 + 1]."""
    return np.asarray(np.hypot(*frequencies(shape, spacing_px)))
