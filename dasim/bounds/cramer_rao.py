"""Cramer-Rao bounds of blur and depth: the least variance of an unbiased estimate from one patch.

The sharp picture of a patch is unknown: a Gaussian random texture of power spectrum B P(w), which channel i records
with a gain g_i, a transfer function H_i(w) and noise of power n_i. The covariance at a frequency is

    C_ij = B P g_i g_j H_i conj(H_j) + n_i delta_ij,

and the Fisher information of theta = (blur, ln B, ln g_2, ln g_3 ...), where all but the blur are nuisance parameters,
is

    I_ab = 1/2 sum over w of tr(C^-1 dC/da C^-1 dC/db),

the Slepian-Bangs formula for independent frequencies (Kay, Fundamentals of Statistical Signal Processing: Estimation
Theory, sec. 3.9 and 15.9), with Whittle's approximation, which treats a patch as periodic. No unbiased estimate of blur
has a variance below [I^-1]_00.

Spectra are given on the half-plane [h, w/2 + 1] of a real picture [h, w] with samples ``spacing_px`` apart. A power
spectrum is the mean of |DFT|^2 / (h w), so that white noise of variance v has the power v everywhere.
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
from dasim.spectra import illuminants
from dasim.typing import FloatArray

SLOPE_STEP_PX = 0.05  # of visible blur, to each side; the phase at 0.5 cycles/px changes by 0.16 rad
RADIAL_STEP_PX, STEPS_PER_RING = 0.2, 3.3  # of optical profiles: the smaller one, the second within lambda N at 400 nm
RADIAL_FREQUENCIES = 160  # from 0 to the corner of the patch's band, at least
FREQUENCIES_PER_PERIOD = 6  # of the transfer function of a blur
TAIL_PX = 40.0  # extent of the diffraction rings beyond the geometric blur
BLUR, STRENGTH = 0, 1  # indices of the parameters; the gains follow


# --- textures and patches ------------------------------------------------------------------------


def natural_power(shape: tuple[int, int], *, spacing_px: float = 1.0, contrast: float = 0.1) -> FloatArray:
    """Power spectrum of a natural texture, P ~ 1 / f^2 (Field, J. Opt. Soc. Am. A 4, 1987), [h, w/2 + 1]; 0 at f = 0.

    Args:
        shape: [h, w] of the patch.
        spacing_px: distance of the samples. The spectral density per px^-2 does not depend on it, so that the power
            per sample goes with 1 / spacing^2.
        contrast: standard deviation within any octave, in the unit of the picture.
    """
    radius = _radius(shape, spacing_px)
    density = contrast**2 / (2 * np.pi * np.log(2.0))
    power = np.zeros(radius.shape)
    power[radius > 0] = density * radius[radius > 0] ** -2.0 / spacing_px**2
    return power


def picture_power(picture: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Power spectrum of a known texture [y, x] on the grid of a patch, [h, w/2 + 1], by Welch's method.

    It is the mean over patches of ``shape`` that overlap by half, each with its mean removed, times a Hann window; the
    power at frequency 0 is set to 0.
    """
    window = np.hanning(shape[0] + 2)[1:-1, None] * np.hanning(shape[1] + 2)[None, 1:-1]
    view = np.lib.stride_tricks.sliding_window_view(picture, shape)
    patches = view[:: max(shape[0] // 2, 1), :: max(shape[1] // 2, 1)].astype(np.float64)
    patches = patches - patches.mean(axis=(-1, -2), keepdims=True)
    power = (np.abs(np.fft.rfft2(patches * window)) ** 2).mean(axis=(0, 1)) / (window**2).sum()
    power[0, 0] = 0.0
    return np.asarray(power)


def window_area_px(window_px: float) -> float:
    """Effective area in px^2 of a Gaussian window that has the variance of a box of side ``window_px``.

    The effective number of weighted samples is (sum w)^2 / sum w^2, which is 4 pi sigma^2 = pi/3 window^2 for a
    Gaussian with sigma^2 = window^2 / 12.
    """
    return window_px**2 * (np.pi / 3)


# --- transfer functions and their derivatives by blur --------------------------------------------


def camera_transfers(
    camera: Camera,
    blur_px: ArrayLike,
    light: str | Sequence[str],
    shape: tuple[int, int],
    *,
    spacing_px: float = 1.0,
) -> tuple[FloatArray, FloatArray]:
    """Transfer functions H of a camera's channels, and dH/dc by the visible blur c, both [blur, channel, h, w/2 + 1].

    H is the Hankel transform of the camera's wave-optical kernels (:mod:`dasim.camera.pointspread`) times the sinc of
    the pixel; dH/dc is a central difference over 0.05 px to each side. All stops must be discs or rings about the axis.

    Args:
        camera: the camera.
        blur_px: visible blurs in px, [blur] or a number.
        light: an illuminant; several give [light, blur, channel, h, w/2 + 1] in little more time than one.
        shape: [h, w] of the patch.
        spacing_px: distance of the samples.
    """
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    both = np.concatenate([blurs - SLOPE_STEP_PX, blurs + SLOPE_STEP_PX])
    names = [light] if isinstance(light, str) else light
    spectrum = np.stack([illuminants.illuminant(name) for name in names])
    full = round_transfers(camera, both, spectrum, shape, spacing_px=spacing_px)
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
) -> FloatArray:
    """Transfer functions through stops that are discs or rings about the axis, [..., blur, channel, h, w/2 + 1].

    Args:
        camera: the camera.
        blur_px: visible blurs in px, [blur].
        spectrum: power of the light, [..., wavelength].
        shape: [h, w] of the patch.
        spacing_px: distance of the samples.
    """
    step = min(RADIAL_STEP_PX, pointspread.finest_ring_px(camera) / STEPS_PER_RING)
    radius = np.arange(step / 2, np.abs(blur_px).max() / 2 + TAIL_PX, step)
    profiles, _ = pointspread.radial_profiles(camera, blur_px, spectrum, radius)
    ring = profiles * (2 * np.pi * radius * step)
    whole = ring.sum(axis=-1, keepdims=True)
    ring = np.divide(ring, whole, out=np.zeros_like(ring), where=whole > 0)
    frequency = _radius(shape, spacing_px)
    nodes = radial_frequencies(float(frequency.max()), float(np.abs(blur_px).max()))
    radial = ring @ j0(2 * np.pi * np.outer(radius, nodes))
    fy, fx = frequencies(shape, spacing_px)
    full = CubicSpline(nodes, radial, axis=-1)(frequency.ravel()).reshape(*radial.shape[:-1], *frequency.shape)
    return np.asarray(full * (np.sinc(fy) * np.sinc(fx)))


def radial_frequencies(last: float, blur_px: float, least: int = RADIAL_FREQUENCIES) -> FloatArray:
    """Evenly spaced frequencies from 0 to the ``last``, cycles per pixel, that resolve the transfer of a blur."""
    return np.linspace(0, last, max(least, int(np.ceil(FREQUENCIES_PER_PERIOD * blur_px * last))))


# --- bounds --------------------------------------------------------------------------------------


def _by_frequency(transfer: NDArray, slope: NDArray, power: NDArray, noise: ArrayLike, gain: ArrayLike) -> FloatArray:
    """Information of (blur, ln B, ln g_2, ...) at each frequency of the half-plane, [..., a, b, h, w/2 + 1]."""
    count = transfer.shape[-3]
    signal = np.asarray(gain, np.float64)[..., None, None] * transfer
    change = np.asarray(gain, np.float64)[..., None, None] * slope
    h, dh = (np.moveaxis(part, -3, -1)[..., None] for part in (signal, change))  # [..., h, w, channel, 1]
    texture = power[..., None, None]
    covariance = texture * (h @ _adjoint(h))  # of the signal alone
    half = texture * (dh @ _adjoint(h))
    noises = np.asarray(noise, np.float64)[..., None, None, :, None] * np.eye(count)
    inverse = np.linalg.inv(covariance + noises)
    derivatives = [half + _adjoint(half), covariance]
    for channel in range(1, count):
        selection = np.zeros((count, count))
        selection[channel, channel] = 1.0
        derivatives.append(selection @ covariance + covariance @ selection)
    parts = [inverse @ derivative for derivative in derivatives]
    information = np.empty((*covariance.shape[:-4], len(parts), len(parts), *covariance.shape[-4:-2]))
    for a, first in enumerate(parts):
        for b, second in enumerate(parts[: a + 1]):
            trace = 0.5 * np.einsum("...ij,...ji->...", first, second).real
            information[..., a, b, :, :] = information[..., b, a, :, :] = trace
    return information


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
    texture: Literal["known", "spectrum", "free"] = "spectrum",
) -> FloatArray:
    """Least standard deviation of an unbiased estimate of blur from one patch, [...], in the unit of the blur.

    Args:
        transfer: H, [..., channel, h, w/2 + 1].
        slope: dH/dc, of the same shape; the result has the unit of c.
        power: power spectrum of the texture, [h, w/2 + 1], in the picture's unit squared.
        noise: variance of each channel, [..., channel], in the picture's unit squared.
        width: w of the patch in samples.
        area_px: area of the patch in px^2 (:func:`window_area_px`), to which the information is proportional; by
            default that of the grid of the spectra.
        spacing_px: distance of the samples.
        gain: factor of each channel on the texture, [..., channel].
        texture: ``known``: spectrum, strength and gains are known. ``spectrum``: only the shape of the spectrum is
            known. ``free``: nothing is known; the power in every ring of frequencies is a nuisance parameter, so that
            only the difference in blur between the channels is informative.

    The result is infinite where the picture contains no information on the blur.
    """
    per_frequency = _by_frequency(transfer, slope, power, noise, gain) * multiplicity(width)
    whole = information = per_frequency[..., BLUR, BLUR, :, :].sum(axis=(-1, -2))
    if texture == "spectrum":
        information = _marginal(per_frequency.sum(axis=(-1, -2)))
    elif texture == "free":
        information = _marginal(_without_spectrum(per_frequency, power.shape, width))
    rounding = ROUNDING * np.maximum(whole, np.finfo(float).tiny)
    information = np.where(information > rounding, information, 0.0)
    if area_px is not None:
        information = information * (area_px / (power.shape[-2] * width * spacing_px**2))
    with np.errstate(divide="ignore"):
        return np.asarray(1 / np.sqrt(information))


def _marginal(information: FloatArray) -> FloatArray:
    """Information of the first parameter with the others marginalised: the Schur complement, [...]."""
    nuisance, cross = information[..., 1:, 1:], information[..., 1:, 0]
    inverse = np.linalg.pinv(nuisance)  # singular where a channel has no signal, whose gain is then no parameter
    return np.asarray(information[..., 0, 0] - np.einsum("...i,...ij,...j->...", cross, inverse, cross))


def _without_spectrum(per_frequency: FloatArray, shape: tuple[int, ...], width: int) -> FloatArray:
    """Information of (blur, gains) with the texture's power in every ring of frequencies marginalised, [..., a, b]."""
    ring = np.rint(_radius((shape[0], width), 1.0) * max(shape[0], width)).astype(int)
    others = [BLUR, *range(STRENGTH + 1, per_frequency.shape[-3])]
    total = np.zeros((*per_frequency.shape[:-4], len(others), len(others)))
    for number in range(1, ring.max() + 1):
        one = (per_frequency * (ring == number)).sum(axis=(-1, -2))
        cross, strength = one[..., others, STRENGTH], one[..., STRENGTH, STRENGTH][..., None, None]
        outer = cross[..., :, None] * cross[..., None, :]
        loss = np.divide(outer, strength, out=np.zeros_like(outer), where=strength > 0)
        total += one[..., others, :][..., others] - loss
    return total


def depth_deviation_m(camera: Camera, depth_m: ArrayLike, blur_deviation_px: ArrayLike) -> FloatArray:
    """Standard deviation of depth in metres, d^2 p / (A s) sigma_c, from c = A s (1/d - 1/d_f) / p.

    Args:
        camera: the camera, for aperture A, image distance s and pixel pitch p.
        depth_m: depth d.
        blur_deviation_px: standard deviation sigma_c of visible blur.
    """
    per_px = camera.sensor.pixel_pitch_um * 1e-6 / (geometry.aperture_m(camera) * geometry.image_distance_m(camera))
    return np.asarray(np.asarray(depth_m, np.float64) ** 2 * per_px * np.asarray(blur_deviation_px, np.float64))


def level_deviation(camera: Camera, blur_deviation_px: ArrayLike) -> FloatArray:
    """Standard deviation in blur levels from that of visible blur in px."""
    return np.asarray(np.asarray(blur_deviation_px, np.float64) / geometry.level_blur_px(camera)[1])


ROUNDING = 1e-9  # smaller shares of the information with everything else known are rounding errors


def _adjoint(matrix: NDArray) -> NDArray:
    return np.conj(np.swapaxes(matrix, -1, -2))


def multiplicity(width: int) -> FloatArray:
    """Number of columns of the whole plane that each column of the half-plane represents, [w/2 + 1]."""
    twice = np.full(width // 2 + 1, 2.0)
    twice[0] = 1.0
    if width % 2 == 0:
        twice[-1] = 1.0
    return twice


def frequencies(shape: tuple[int, int], spacing_px: float) -> tuple[FloatArray, FloatArray]:
    """Vertical and horizontal frequencies of a patch in cycles/px, [h, 1] and [1, w/2 + 1]."""
    down, along = np.fft.fftfreq(shape[0], spacing_px), np.fft.rfftfreq(shape[1], spacing_px)
    return np.asarray(down[:, None], np.float64), np.asarray(along[None, :], np.float64)


def _radius(shape: tuple[int, int], spacing_px: float) -> FloatArray:
    """Radial frequency in cycles/px, [h, w/2 + 1]."""
    return np.asarray(np.hypot(*frequencies(shape, spacing_px)))
