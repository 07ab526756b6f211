"""Radial intensity of the light behind discs and rings: wave optics, the geometric blur, and their approximation.

Tested in tests/dasim/camera/test_pointspread.py and tests/dasim/camera/test_zernike.py.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
from scipy import ndimage
from scipy.special import j0, j1, roots_legendre

from dasim.camera import stops, wavefront
from dasim.camera.wavefront import Phase
from dasim.typing import FloatArray

SUBPIXELS = 10  # per pixel and axis, for the integral over the pixel
PUPIL_NODES = 400  # Gauss-Legendre nodes over the pupil's radius, at least: enough for 100 rings and 20 waves
# The integrand has W20 periods of defocus, and R / 2 rings at a radius of R lambda N.
NODES_PER_WAVE, NODES_PER_RADIUS, SPARE_NODES, MOST_NODES = 6, 1.7, 60, 4000
AIRY_NODES = 800  # more, for mixtures of transfer functions with different cut-off frequencies
STEPS_PER_RING = 24  # of the table of a profile, which is interpolated by cubic splines
AT_ONCE = 1 << 22  # numbers of an array, which bounds the memory
MIN_DISC_PX = 0.3  # a geometric disc smaller than this has no effect on a pixel's integral


def wave_profile(
    radius: FloatArray, waves: FloatArray, inner: float = 0.0, phase: Phase | None = None, outer: float = 1.0
) -> FloatArray:
    """Intensity of a defocused disc or ring, [waves, radius], of unit integral over the plane.

    ``radius`` is in units of lambda N (N the working f-number of the outer rim), ``waves`` the defocus W20 there,
    ``inner`` the ring's inner radius over its outer, e.
    h = pi/4 |U|^2 / (1 - e^2) with U = 2 int_e^1 exp(2 pi i W20 rho^2) J0(pi radius rho) rho d rho.
    A ``phase`` of rotational symmetry multiplies the integrand; ``outer`` is the outer radius over that of the lens.
    """
    if phase is not None:
        return _aberrated_profile(radius, waves, inner, phase, outer)
    rho, weight = _pupil_nodes(radius, waves)
    rho, weight = inner + (1 - inner) * rho, (1 - inner) * weight
    pupil = np.exp(2j * np.pi * np.outer(waves, rho**2)) * (2 * rho * weight)
    profile = np.empty((len(waves), len(radius)))
    for part in np.array_split(np.arange(len(radius)), len(radius) * len(rho) // AT_ONCE + 1):
        bessel = j0(np.pi * np.outer(rho, radius[part]))
        # two real products instead of a complex one with a real matrix
        profile[:, part] = (pupil.real @ bessel) ** 2 + (pupil.imag @ bessel) ** 2
    return np.pi / 4 * profile / (1 - inner**2)


def wave_profiles(
    radius_px: FloatArray, scale_px: FloatArray, waves: FloatArray, inner: float = 0.0
) -> Iterator[FloatArray]:
    """:func:`wave_profile` at several wavelengths, [blur, radius] per square pixel for each.

    ``scale_px`` [wavelength] is lambda N in pixels, ``waves`` [wavelength, blur] the defocus. The profiles of many
    wavelengths are computed in units of lambda N at the same radii, since Bessel functions take most of the time, and
    interpolated from there.
    """
    most = radius_px.max(initial=0) / scale_px + 1  # the spline is less exact at the end of the table
    parts = min(len(scale_px), int(waves.size * STEPS_PER_RING * most.max(initial=0) / AT_ONCE) + 1)
    for part in np.array_split(np.arange(len(scale_px)), parts) if parts else ():
        table_radius = np.arange(int(np.ceil(STEPS_PER_RING * most[part].max())) + 1) / STEPS_PER_RING
        table = wave_profile(table_radius, waves[part].ravel(), inner).reshape(*waves[part].shape, -1)
        for own, scale in zip(table, scale_px[part], strict=True):
            place = (radius_px * (STEPS_PER_RING / scale))[None]
            # A profile is even in the radius, as is its mirror image.
            yield np.stack([ndimage.map_coordinates(row, place, order=3, mode="mirror") for row in own]) / scale**2


def _aberrated_profile(radius: FloatArray, waves: FloatArray, inner: float, phase: Phase, outer: float) -> FloatArray:
    """The same with a phase: amplitudes from inside and outside the opening, each by its own nodes."""
    opening = None if phase.opening is None else stops.ring(phase.opening)
    low, high = (inner, inner) if opening is None else np.clip(np.array(opening[:2]) / outer, inner, 1.0)
    parts = []
    for spans in (((inner, low), (high, 1.0)), ((low, high),)):
        amplitude = np.zeros((len(waves), len(radius)), dtype=complex)
        for start, end in spans:
            if end <= start:
                continue
            rho, weight = _pupil_nodes(radius, waves)
            rho, weight = start + (end - start) * rho, (end - start) * weight
            pupil = np.exp(2j * np.pi * np.outer(waves, rho**2)) * (2 * rho * weight)
            pupil = pupil * wavefront.factor(phase, 0.0, outer * rho)
            amplitude += pupil @ j0(np.pi * np.outer(rho, radius))
        parts.append(amplitude)
    return np.pi / 4 * wavefront.two_parts(phase, *parts) / (1 - inner**2)


def _pupil_nodes(radius: FloatArray, waves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights over the pupil's radius, as many as the fastest integrand needs."""
    most = NODES_PER_WAVE * np.abs(waves).max(initial=0) + NODES_PER_RADIUS * radius.max(initial=0) + SPARE_NODES
    return unit_nodes(int(np.clip(100 * np.ceil(most / 100), PUPIL_NODES, MOST_NODES)))


def airy_profile(radius_px: FloatArray, blur_px: FloatArray, scale_px: float, inner: float = 0.0) -> FloatArray:
    """Geometric blur of a disc or ring convolved with its in-focus pattern, [blur, radius], of unit integral.

    ``blur_px`` are diameters of the outer rim, ``scale_px`` is lambda N in pixels.
    """
    return mixed_airy_profile(radius_px, blur_px, [(scale_px, 1.0)], inner)


def mixed_airy_profile(
    radius_px: FloatArray, blur_px: FloatArray, scales: Sequence[tuple[float, float]], inner: float = 0.0
) -> FloatArray:
    """The same for light of several wavelengths: ``scales`` are pairs of lambda N in pixels and a share, of sum 1.

    Computed from the product of the two transfer functions, which ends at the diffraction limit of 1 / lambda N
    cycles a pixel.
    """
    nodes, weight = unit_nodes(AIRY_NODES)
    end = 1 / min(scale for scale, _ in scales)
    frequency, weight = nodes * end, weight * end
    focus = sum(share * ring_mtf(frequency * scale, inner) for scale, share in scales)
    geometric = _jinc(np.outer(blur_px, frequency)) - inner**2 * _jinc(inner * np.outer(blur_px, frequency))
    transfer = focus * geometric / (1 - inner**2)
    return (transfer * (2 * np.pi * frequency * weight)) @ j0(2 * np.pi * np.outer(frequency, radius_px))


@cache
def unit_nodes(count: int) -> tuple[FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights on 0..1."""
    nodes, weights = roots_legendre(count)
    return (nodes + 1) / 2, weights / 2


def ring_mtf(v: FloatArray, inner: float = 0.0) -> FloatArray:
    """In-focus incoherent MTF of a disc or ring at v = lambda N f, 0 beyond v = 1: the autocorrelation of the pupil.

    ``inner`` is the inner radius over the outer (O'Neill, J. Opt. Soc. Am. 46, 1956).
    """
    shift = 2 * np.clip(v, 0.0, 1.0)
    overlap = _overlap(1.0, 1.0, shift) - 2 * _overlap(1.0, inner, shift) + _overlap(inner, inner, shift)
    return overlap / (np.pi * (1 - inner**2))


def _overlap(a: float, b: float, distance: FloatArray) -> FloatArray:
    """Area of the intersection of two discs of radii a >= b, by the distance of their centres."""
    if b == 0:
        return np.zeros_like(distance)
    d = np.clip(distance, a - b + 1e-12, a + b)
    angle_a = np.arccos(np.clip((d**2 + a**2 - b**2) / (2 * d * a), -1, 1))
    angle_b = np.arccos(np.clip((d**2 + b**2 - a**2) / (2 * d * b), -1, 1))
    return a**2 * (angle_a - np.sin(2 * angle_a) / 2) + b**2 * (angle_b - np.sin(2 * angle_b) / 2)


def _jinc(x: FloatArray) -> FloatArray:
    """Transfer function of a disc, 2 J1(pi x) / (pi x) with x = diameter * frequency."""
    safe = np.where(np.abs(x) < 1e-9, 1.0, x)
    return np.where(np.abs(x) < 1e-9, 1.0, 2 * j1(np.pi * safe) / (np.pi * safe))


def geometric_profile(radius_px: FloatArray, blur_px: FloatArray, inner: float) -> FloatArray:
    """A disc or ring with edges one sub-pixel wide, so that its sampled integral over the plane stays 1."""
    outer = np.maximum(np.abs(blur_px), MIN_DISC_PX)[:, None] / 2
    edge = 1.0 / SUBPIXELS

    def inside(half: FloatArray) -> FloatArray:
        return np.clip((half - radius_px[None, :]) / edge + 0.5, 0.0, 1.0)

    def area(half: FloatArray) -> FloatArray:
        return np.pi * (half**2 + edge**2 / 12)

    if inner == 0:
        return inside(outer) / area(outer)
    return (inside(outer) - inside(inner * outer)) / (area(outer) - area(inner * outer))
