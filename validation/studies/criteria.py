"""Two criteria of a camera's stops, with their gradients: the bound of depth, and the error of the sharp picture.

Both describe the samples of two or more planes of a mosaic (by default green and infrared, the pair that sec. 5
compares), a natural texture that all of them record, and the sensor's noise. At one frequency, p is the power of the
texture, and plane i has the transfer function H_i, the gain g_i and the noise variance n_i. With s_i = g_i H_i,
m_i = 1 / n_i, a = sum m |s|^2 and q = 1 / (1 + p a), the covariance p s s^H + diag(n) has a closed-form inverse
(Sherman and Morrison). For parameters u and v, with du = ds/du, b_u = s^H m du and g_uv = du^H m dv, the Fisher
information of :mod:`dasim.bounds.cramer_rao` at this frequency is

    I_uv = p^2 Re[b_u b_v q^2 + a q (g_uv - p conj(b_u) b_v q)].

With the nuisance parameters r unknown, the information about the blur (parameter 0) is the Schur complement w^T I w,
w = (1, -I_rr^-1 I_r0). The quadratic form is stationary at this w, so the gradient of the Schur complement is that of
w^T I w at constant w.

The expected squared error of the sharp picture, with depth and powers known, is that of the Wiener filter of all
planes, sum of p q over sum of p. A part 1 - ``COHERENCE``^2 of the texture of the other planes is independent of the
first plane's and acts as noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dasim.base.errors import InputError
from dasim.bounds import cramer_rao, pupils
from dasim.camera import geometry
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.typing import ComplexArray, FloatArray
from validation.subjects import strips
from validation.subjects.texture import CONTRAST, MEAN_SHARE, noise_variance, white_electrons

Texture = Literal["known", "spectrum", "free"]

SHAPE = strips.BOUND_SHAPE
SPACING_PX = 2.0  # between samples of one channel in a 2x2 mosaic
PLANES = ("G", "IR")
NEAREST_BLUR_PX = 3.0  # visible blur; closer to the focus the bound diverges, and would dominate any mean over depths
ROUNDING = 1e-9  # relative, of distances
COHERENCE = 0.9  # between the near-infrared and the green texture, for the sharp picture


@dataclass(frozen=True)
class TexturePatch:
    """A patch of texture as the planes of a mosaic record it, in electrons."""

    power: FloatArray  # [h, w/2 + 1], of the texture in the first plane, before the lens
    noise: FloatArray  # [plane], variances
    gain: FloatArray  # [plane], of the texture, relative to the first plane
    area: float  # of the patch, relative to that of the grid of frequencies

    @property
    def multiplicity(self) -> FloatArray:
        """How often each frequency of the half-plane occurs in the patch, [w/2 + 1]."""
        return cramer_rao.multiplicity(SHAPE[1]) * self.area


def texture_patch(camera: Camera, light: str, level_lux: float, planes: tuple[str, ...] = PLANES) -> TexturePatch:
    """A patch of natural spectrum, mean 0.4 of white and contrast 15 % per octave, as in claim ``balance``.

    ``light`` is an illuminant's name, ``level_lux`` its illuminance, ``planes`` the channels, the first one with the
    sharp texture. Raises InputError for a channel that the camera lacks or that receives no light.
    """
    names = sensors.channels(camera.sensor)
    missing = [name for name in planes if name not in names]
    if missing:
        raise InputError(f"camera '{camera.name}' has no channel {', '.join(missing)}; it has {', '.join(names)}")
    index = [names.index(name) for name in planes]
    white, time_s = white_electrons(camera, light, level_lux)
    variance = noise_variance(camera, MEAN_SHARE * white, time_s)[index]
    mean = MEAN_SHARE * white[index]
    if mean.min() <= 0:
        dark = [name for name, value in zip(planes, mean, strict=True) if value <= 0]
        raise InputError(f"camera '{camera.name}': no light of {light} reaches {', '.join(dark)}")
    power = cramer_rao.natural_power(SHAPE, spacing_px=SPACING_PX, contrast=CONTRAST * mean[0])
    area = cramer_rao.window_area_px(strips.WINDOW_PX) / (SHAPE[0] * SHAPE[1] * SPACING_PX**2)
    return TexturePatch(power, variance, mean / mean[0], area)


def blur_variance(
    transfer: NDArray, slope: NDArray, patch: TexturePatch, texture: Texture = "free"
) -> tuple[FloatArray, tuple[ComplexArray, ComplexArray]]:
    """Least variance of the visible blur in px^2, [blur], and the gradients of its inverse by transfer and slope.

    ``transfer`` is H and ``slope`` dH/dc per px of visible blur c, [blur, plane, h, w/2 + 1]. Each gradient G has the
    shape of its argument and satisfies d(1 / variance) = Re sum conj(G) d. ``texture`` says what is known of the
    texture, as in :func:`dasim.bounds.cramer_rao.blur_deviation`, of which this is the closed form. The variance is
    infinite where the samples hold no information about the blur.
    """
    gain = patch.gain[:, None, None]
    signal = _Signal(gain * transfer, 1 / patch.noise[:, None, None], patch.power)
    s = signal.s
    derivatives = [gain * slope, s / 2]  # by the blur, and by the logarithm of the texture's power
    for plane in range(1, s.shape[1]):  # by the logarithm of each gain
        by_gain = np.zeros_like(s)
        by_gain[:, plane] = s[:, plane]
        derivatives.append(by_gain)
    information, direction = _marginalised(_fisher_information(signal, derivatives) * patch.multiplicity, texture)
    by_s, by_slope = _information_gradient(signal, derivatives, direction)
    weight = gain * patch.multiplicity
    with np.errstate(divide="ignore"):
        return 1 / information, (by_s * weight, by_slope * weight)


class _Signal:
    """Quantities of the closed form that do not depend on the parameters."""

    def __init__(self, s: ComplexArray, m: FloatArray, p: FloatArray) -> None:
        self.s, self.m, self.p = s, m, p
        self.a = (m * np.abs(s) ** 2).sum(axis=1)
        self.q = 1 / (1 + p * self.a)


def _fisher_information(signal: _Signal, derivatives: list[ComplexArray]) -> FloatArray:
    """Fisher information at each frequency of the half-plane, [parameter, parameter, blur, h, w/2 + 1]."""
    s, m, p, a, q = signal.s, signal.m, signal.p, signal.a, signal.q
    b = [(m * np.conj(s) * u).sum(axis=1) for u in derivatives]
    information = np.empty((len(b), len(b), *a.shape))
    for i, u in enumerate(derivatives):
        for j, v in enumerate(derivatives[: i + 1]):
            g = (m * np.conj(u) * v).sum(axis=1)
            one = (b[i] * b[j] * q**2 + a * q * (g - p * np.conj(b[i]) * b[j] * q)).real
            information[i, j] = information[j, i] = p**2 * one
    return information


def _information_gradient(
    signal: _Signal, derivatives: list[ComplexArray], direction: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Gradients of w^T I w by s and by ds/dc at each frequency, [blur, plane, h, w/2 + 1], w the ``direction``."""
    s, m, p, a, q = signal.s, signal.m, signal.p, signal.a, signal.q
    u = sum(w[:, None] * part for w, part in zip(direction, derivatives, strict=True))
    b = (m * np.conj(s) * u).sum(axis=1)
    g = (m * np.abs(u) ** 2).sum(axis=1)
    by_a = p**2 * (
        -2 * p * q**3 * (b**2).real + q**2 * (g - p * np.abs(b) ** 2 * q) + a * q * p**2 * q**2 * np.abs(b) ** 2
    )
    by_b = p**2 * (2 * q**2 * b - 2 * p * a * q**2 * np.conj(b))
    by_u = m * s * np.conj(by_b)[:, None] + 2 * m * u * (p**2 * a * q)[:, None]
    by_s = 2 * m * s * by_a[:, None] + m * u * by_b[:, None] + by_u * direction[1][:, None] / 2
    for plane in range(1, s.shape[1]):
        by_s[:, plane] += by_u[:, plane] * direction[plane + 1]
    return by_s, by_u * direction[0][:, None]


def _marginalised(information: FloatArray, texture: Texture) -> tuple[FloatArray, FloatArray]:
    """Information about the first parameter with the others unknown, [blur], and w, [parameter, blur, h, w/2 + 1].

    ``information`` is [parameter, parameter, blur, h, w/2 + 1]. What is below the rounding error is set to 0.
    """
    whole = information[0, 0].sum(axis=(-1, -2))
    direction = np.zeros((len(information), *information.shape[2:]))
    direction[0] = 1.0
    if texture == "known":
        return whole, direction
    if texture == "spectrum":
        total = information.sum(axis=(-1, -2))
        rest = _nuisance_direction(total, range(1, len(information)))
        direction[1:] = rest[..., None, None]
    else:
        rings = _rings()
        per_ring = information.reshape(*information.shape[:3], -1) @ rings.T  # [parameter, parameter, blur, ring]
        strength = per_ring[1, 1]
        ratio = np.divide(per_ring[1], strength, out=np.zeros_like(per_ring[1]), where=strength > 0)
        free = (per_ring - per_ring[:, 1, None] * ratio[None]).sum(axis=-1)
        rest = _nuisance_direction(free, range(2, len(information)))
        direction[2:] = rest[..., None, None]
        weights = np.concatenate([np.ones((1, len(whole))), np.zeros((1, len(whole))), rest])
        by_ring = -np.einsum("pbr,pb->br", ratio, weights)
        direction[1] = (by_ring @ rings).reshape(information.shape[2:])
    left = np.einsum("ibyx,ijbyx,jbyx->b", direction, information, direction)
    return np.where(left > cramer_rao.ROUNDING * np.maximum(whole, np.finfo(float).tiny), left, 0.0), direction


def _nuisance_direction(total: FloatArray, rest: range) -> FloatArray:
    """-I_rr^-1 I_r0 of the parameters ``rest``, [rest, blur]; ``total`` is [parameter, parameter, blur]."""
    inner = np.moveaxis(total[np.ix_(rest, rest)], -1, 0)
    across = np.moveaxis(total[list(rest), 0], -1, 0)
    return np.asarray(-np.einsum("bij,bj->ib", np.linalg.pinv(inner), across))


def _rings() -> FloatArray:
    """Membership of the half-plane's frequencies in each ring, 1 or 0, [ring, h (w/2 + 1)]; frequency 0 is in none."""
    fy, fx = cramer_rao.frequencies(SHAPE, 1.0)
    ring = np.rint(np.hypot(fy, fx) * max(SHAPE)).astype(int).ravel()
    return (ring == np.arange(1, ring.max() + 1)[:, None]).astype(np.float64)


def sharp_error(transfer: NDArray, patch: TexturePatch) -> tuple[FloatArray, ComplexArray]:
    """Expected squared error of the Wiener filter over the texture's power, [blur], and its gradient by ``transfer``.

    ``transfer`` is [blur, plane, h, w/2 + 1]; the gradient is of the same shape.
    """
    gain, p = patch.gain[:, None, None], patch.power
    shared = np.full((len(patch.gain), 1, 1), COHERENCE**2)
    shared[0] = 1.0
    s = gain * transfer
    light = np.abs(s) ** 2
    variance = patch.noise[:, None, None] + (1 - shared) * p * light
    a = (shared * light / variance).sum(axis=1)
    q = 1 / (1 + p * a)
    scale = patch.multiplicity / (p * patch.multiplicity).sum()
    error = (p * q * scale).sum(axis=(-1, -2))
    by_light = -(p**2 * q**2 * scale)[:, None] * shared * patch.noise[:, None, None] / variance**2
    return error, by_light * 2 * s * gain


def camera_bound(
    camera: Camera,
    blur_px: ArrayLike,
    *,
    light: str = "D65",
    level_lux: float = 5000.0,
    texture: Texture = "free",
    planes: tuple[str, ...] = PLANES,
) -> FloatArray:
    """Least standard deviation of the visible blur in px, [blur], for a camera with stops of any shape.

    ``blur_px`` are the visible blurs at which the bound is computed. Infinite where the samples hold no information
    about the blur.
    """
    patch = texture_patch(camera, light, level_lux, planes)
    index = [sensors.channels(camera.sensor).index(name) for name in planes]
    transfer, slope = pupils.camera_transfers(camera, blur_px, light, SHAPE, spacing_px=SPACING_PX)
    return np.asarray(np.sqrt(blur_variance(transfer[:, index], slope[:, index], patch, texture)[0]))


def dioptre_px(camera: Camera) -> float:
    """Visible blur of one dioptre in px, A s / p: aperture, image distance and pixel pitch."""
    return geometry.aperture_m(camera) * geometry.image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)


def farthest_m(camera: Camera) -> float:
    """The farthest distance on the near side of the focus with a bound, where the blur is ``NEAREST_BLUR_PX``."""
    return float(geometry.depth_of_blur_m(camera, NEAREST_BLUR_PX))


def blurs_between(camera: Camera, near_m: float, far_m: float, count: int) -> FloatArray:
    """Visible blurs in px, evenly spaced in dioptres, over a range of depths on the near side of the focus, [count].

    Raises InputError for a range that reaches beyond :func:`farthest_m`, or into the focal length.
    """
    last_m, first_m = farthest_m(camera), camera.lens.focal_length_mm / 1e3
    if not first_m < near_m < far_m or far_m > last_m * (1 + ROUNDING):
        raise InputError(
            f"depths {100 * near_m:g} to {100 * far_m:g} cm: must rise from above the focal length, "
            f"{100 * first_m:.3g} cm, and lie on the near side of the focus, "
            f"{100 * camera.lens.focus_distance_m:g} cm, up to {100 * last_m:.4g} cm, where the blur is "
            f"{NEAREST_BLUR_PX:g} px"
        )
    blurs = np.asarray(geometry.blur_px(camera, np.array([far_m, near_m])), np.float64)
    return np.linspace(float(blurs[0]), float(blurs[1]), count)
