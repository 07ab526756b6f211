"""Point-spread functions of the camera: wave optics per stop and wavelength, then the pixel.

A kernel is built from radial profiles (every stop is a centred disc), one a wavelength, weighted with
the spectrum that the channel sees through the stop, and integrated over square pixels. Three models:

``wave``  |FT of the defocused pupil|^2, the true kernel (Goodman, Introduction to Fourier Optics, ch. 6)
``airy``  the geometric disc convolved with the in-focus Airy pattern, an approximation
``off``   the geometric disc
"""

from __future__ import annotations

from functools import cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, j1

from dasim import camera as cameras
from dasim import spectra
from dasim.camera import Camera
from dasim.errors import InputError

FloatArray = NDArray[np.float64]
Diffraction = Literal["wave", "airy", "off"]
DIFFRACTION_MODELS: tuple[str, ...] = get_args(Diffraction)

BAND_NM = 10.0  # profiles change slowly with wavelength: one each 10 nm
RADIAL_STEP_PX = 0.05
SUBPIXELS = 10  # per pixel and axis, for the integral over the pixel
PUPIL_NODES = 400  # Gauss-Legendre nodes over the pupil's radius: enough for 100 rings and 20 waves
MIN_DISC_PX = 0.3  # a geometric disc smaller than this has no effect on a pixel's integral


def wave_profile(radius: FloatArray, waves: FloatArray) -> FloatArray:
    """Intensity of a defocused disc pupil, [waves, radius], of unit integral over the plane.

    ``radius`` is in units of lambda N (N the working f-number), ``waves`` the defocus W20 at the pupil's
    edge. h = pi/4 |U|^2 with U = 2 int_0^1 exp(2 pi i W20 rho^2) J0(pi radius rho) rho d rho.
    """
    rho, weight = _unit_nodes()
    pupil = np.exp(2j * np.pi * np.outer(waves, rho**2)) * (2 * rho * weight)
    bessel = j0(np.pi * np.outer(rho, radius))
    # two real products instead of a complex one with a real matrix
    return np.pi / 4 * ((pupil.real @ bessel) ** 2 + (pupil.imag @ bessel) ** 2)


def airy_disc_profile(radius_px: FloatArray, blur_px: FloatArray, scale_px: float) -> FloatArray:
    """Disc of diameter ``blur_px`` convolved with the Airy pattern, [blur, radius], of unit integral.

    ``scale_px`` is lambda N in pixels. Computed from the product of the two transfer functions, which
    ends at the diffraction limit of 1 / scale_px cycles a pixel.
    """
    v, weight = _unit_nodes()
    frequency, weight = v / scale_px, weight / scale_px
    transfer = disc_mtf(v) * _jinc(np.outer(blur_px, frequency))
    return (transfer * (2 * np.pi * frequency * weight)) @ j0(2 * np.pi * np.outer(frequency, radius_px))


@cache
def _unit_nodes() -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on 0..1."""
    nodes, weights = np.polynomial.legendre.leggauss(PUPIL_NODES)
    return (nodes + 1) / 2, weights / 2


def disc_mtf(v: FloatArray) -> FloatArray:
    """In-focus incoherent MTF of a disc pupil at v = lambda N f, 0 beyond v = 1."""
    v = np.clip(v, 0.0, 1.0)
    return 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2))


def _jinc(x: FloatArray) -> FloatArray:
    """Transfer function of a disc, 2 J1(pi x) / (pi x) with x = diameter * frequency."""
    safe = np.where(np.abs(x) < 1e-9, 1.0, x)
    return np.where(np.abs(x) < 1e-9, 1.0, 2 * j1(np.pi * safe) / (np.pi * safe))


def _disc_profile(radius_px: FloatArray, blur_px: FloatArray) -> FloatArray:
    """A disc with an edge one sub-pixel wide, so that its sampled integral over the plane stays 1."""
    half = np.maximum(np.abs(blur_px), MIN_DISC_PX)[:, None] / 2
    edge = 1.0 / SUBPIXELS
    inside = np.clip((half - radius_px[None, :]) / edge + 0.5, 0.0, 1.0)
    return inside / (np.pi * (half**2 + edge**2 / 12))


def working_f_number(camera: Camera, radius_ratio: float) -> float:
    """N = s / A of a stop, with A its diameter."""
    return cameras.image_distance_m(camera) / (radius_ratio * cameras.aperture_m(camera))


def radial_profiles(
    camera: Camera, blur_px: FloatArray, spectrum: FloatArray, radius_px: FloatArray, diffraction: str = "wave"
) -> tuple[FloatArray, FloatArray]:
    """Radial density of the kernels, [..., blur, channel, radius] per square pixel, before the pixel.

    ``blur_px`` are visible blur diameters, ``spectrum`` the spectral power of one light or several on the
    wavelength grid, [..., wavelength]. Each density integrates to 1 over the plane. Also returns the electrons
    of each channel, relative, [..., channel].
    """
    if diffraction not in DIFFRACTION_MODELS:
        raise InputError(f"diffraction '{diffraction}' is unknown; allowed are {', '.join(DIFFRACTION_MODELS)}")
    pitch_m = camera.sensor.pixel_pitch_um * 1e-6
    lead = spectrum.shape[:-1]
    total = np.zeros((*lead, len(blur_px), len(spectra.CHANNELS), len(radius_px)))
    signal = np.zeros((*lead, len(spectra.CHANNELS)))
    for stop in camera.stops:
        weights = cameras.stop_response(camera, stop) * spectrum[..., None, :]
        own_blur = stop.radius_ratio * np.asarray(blur_px)
        signal += spectra.integrate(weights)
        if diffraction == "off":
            disc = _disc_profile(radius_px, own_blur)
            total += spectra.integrate(weights)[..., None, :, None] * disc[:, None, :]
            continue
        f_number = working_f_number(camera, stop.radius_ratio)
        for wavelength_nm, weight in bands(weights):
            scale_px = wavelength_nm * 1e-9 * f_number / pitch_m
            if diffraction == "wave":
                profile = wave_profile(radius_px / scale_px, own_blur / (8 * scale_px)) / scale_px**2
            else:
                profile = airy_disc_profile(radius_px, own_blur, scale_px)
            total += weight[..., None, :, None] * profile[:, None, :]
    return total / signal[..., None, :, None], signal


def bands(weights: FloatArray) -> list[tuple[float, FloatArray]]:
    """Integrals of [..., wavelength] weights over bands of ``BAND_NM``, each with its mean wavelength."""
    step = spectra.WAVELENGTH_STEP_NM * np.ones_like(spectra.WAVELENGTH_NM)
    step[[0, -1]] /= 2  # the trapezoid rule, so that the bands add up to spectra.integrate
    index = np.minimum((spectra.WAVELENGTH_NM - 400.0) // BAND_NM, (830.0 - 400.0) // BAND_NM - 1).astype(int)
    bands = []
    for band in range(index[-1] + 1):
        inside = index == band
        weight = (weights[..., inside] * step[inside]).sum(axis=-1)
        if weight.max() > 1e-6 * spectra.integrate(weights).max():
            bands.append((float(spectra.WAVELENGTH_NM[inside].mean()), weight))
    return bands


def pixel_kernels(
    profiles: FloatArray, radius_px: FloatArray, size: int, offset_px: tuple[float, float] = (0.0, 0.0)
) -> FloatArray:
    """Integrate radial profiles [..., radius] over the pixels of a ``size`` x ``size`` frame (odd).

    The point's image lies at ``offset_px`` (y, x) from the centre of the middle pixel.
    """
    fine = (np.arange(size * SUBPIXELS) + 0.5) / SUBPIXELS - size / 2
    distance = np.hypot(fine[:, None] - offset_px[0], fine[None, :] - offset_px[1]).ravel()
    flat = profiles.reshape(-1, profiles.shape[-1])
    kernels = np.empty((len(flat), size, size))
    for row, profile in enumerate(flat):
        value = np.interp(distance, radius_px, profile, right=0.0)
        kernels[row] = value.reshape(size, SUBPIXELS, size, SUBPIXELS).mean(axis=(1, 3))
    return kernels.reshape(*profiles.shape[:-1], size, size)


def kernel_size_px(camera: Camera, blur_px: float) -> int:
    """Odd frame size that holds a kernel of a visible blur with its diffraction tail."""
    widest = max(working_f_number(camera, stop.radius_ratio) for stop in camera.stops)
    tail_px = 3 * 0.7e-6 * widest / (camera.sensor.pixel_pitch_um * 1e-6)  # three rings at 700 nm
    return 2 * int(np.ceil(abs(blur_px) / 2 + tail_px)) + 1


def psf(
    camera: Camera,
    depth_m: float,
    channel: str,
    illuminant: str,
    *,
    offset_px: tuple[float, float] = (0.0, 0.0),
    size: int | None = None,
    diffraction: str = "wave",
) -> FloatArray:
    """Kernel of a channel for a white point on the axis at ``depth_m``, [size, size] (odd), y down, x right.

    Values are the shares of the point's light in each pixel; their sum falls short of 1 by what lands
    outside the frame. ``offset_px`` (y, x) moves the point's image from the centre of the middle pixel.
    """
    if channel not in spectra.CHANNELS:
        raise InputError(f"channel '{channel}' is unknown; allowed are {', '.join(spectra.CHANNELS)}")
    if not depth_m > 0:
        raise InputError(f"depth_m is {depth_m!r}; a distance above 0 is needed")
    blur = float(cameras.blur_px(camera, depth_m))
    size = size or kernel_size_px(camera, blur)
    radius = np.arange(0, size * 0.75 + 2, RADIAL_STEP_PX)
    profiles, _ = radial_profiles(camera, np.array([blur]), spectra.illuminant(illuminant), radius, diffraction)
    return pixel_kernels(profiles[0, spectra.CHANNELS.index(channel)], radius, size, offset_px)
