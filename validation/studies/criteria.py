"""What a near-infrared stop is good for, as one number with its gradient: the bound of depth, and the sharp picture.

Both for the samples of a mosaic's planes (by default green and infrared, the pair that sec. 5 compares), a natural
texture that both show, and the sensor's noise. With m_i = 1 / n_i, s_i = g_i H_i, a = sum m |s|^2 and q = 1 / (1 + p a)
the covariance p s s^H + diag(n) has its inverse in closed form (Sherman and Morrison), and with u = ds/dtheta,
b_u = s^H m u and g_uv = u^H m v the Fisher information of :mod:`dasim.bounds.cramer_rao` at one frequency is

    I_uv = p^2 Re[b_u b_v q^2 + a q (g_uv - p conj(b_u) b_v q)].

What nuisances leave of the blur's information is w^T I w, with w = (1, -I_rr^-1 I_r0) the direction of the Schur
complement, which is stationary there: so its change is that of the information along a w that is kept.

The sharp picture's expected squared error, depth and powers known, is that of the Wiener filter of all planes,
sum of p q over sum of p; ``coherence`` below 1 makes part of the other planes' texture their own, which is noise here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dasim.base.errors import InputError
from dasim.bounds import cramer_rao, pupils
from dasim.camera import geometry, noise, stops
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.spectra import grid
from dasim.typing import FloatArray
from validation.subjects import strips
from validation.subjects.texture import CONTRAST, MEAN_SHARE, white_electrons

ComplexArray = NDArray[np.complex128]
Texture = Literal["known", "spectrum", "free"]
Objective = Literal["depth", "all-in-focus"]

SHAPE = strips.BOUND_SHAPE
SPACING_PX = 2.0  # of the samples of one colour in a 2x2 mosaic
PLANES = ("G", "IR")
NEAREST_BLUR_PX = 3.0  # visible: closer to the focus no blur tells depth, and the mean would be that of one point
COHERENCE = 0.9  # of near-infrared and green texture, for the sharp picture


@dataclass(frozen=True)
class Sight:
    """What the planes see of a patch: texture, gains and noise, in electrons."""

    power: FloatArray  # [h, w/2 + 1]
    noise: FloatArray  # [plane], variances
    gain: FloatArray  # [plane], of the texture, first plane 1
    area: float  # of the patch that is looked at, over the grid's own

    @property
    def times(self) -> FloatArray:
        """How often each frequency of the half-plane stands in the patch that is looked at, [w/2 + 1]."""
        return cramer_rao.multiplicity(SHAPE[1]) * self.area


def sight(camera: Camera, light: str, level_lux: float, planes: tuple[str, ...] = PLANES) -> Sight:
    """A texture of natural spectrum, mean 0.4 of white, 15 % an octave, as claim ``balance`` sets it up."""
    names = cameras.channels(camera.sensor)
    missing = [name for name in planes if name not in names]
    if missing:
        raise InputError(f"camera '{camera.name}' has no channel {', '.join(missing)}; it has {', '.join(names)}")
    index = [names.index(name) for name in planes]
    white, time_s = white_electrons(camera, light, level_lux)
    mean = MEAN_SHARE * white[index]
    if mean.min() <= 0:
        dark = [name for name, value in zip(planes, mean, strict=True) if value <= 0]
        raise InputError(f"camera '{camera.name}': no light of {light} reaches {', '.join(dark)}")
    power = cramer_rao.natural_power(SHAPE, spacing_px=SPACING_PX, contrast=CONTRAST * mean[0])
    area = cramer_rao.window_area_px(strips.WINDOW_PX) / (SHAPE[0] * SHAPE[1] * SPACING_PX**2)
    return Sight(power, noise.variance(camera.sensor, time_s).at(mean), mean / mean[0], area)


def blur_variance(
    transfer: NDArray, slope: NDArray, seen: Sight, texture: Texture = "free"
) -> tuple[FloatArray, tuple[ComplexArray, ComplexArray]]:
    """Least variance of the visible blur in px^2, [blur], and the gradients of its inverse by transfer and slope.

    ``transfer`` and ``slope`` [blur, plane, h, w/2 + 1]; each gradient G gives d(1 / variance) = Re sum conj(G) d.
    As :func:`dasim.bounds.cramer_rao.blur_deviation`, by the closed form above.
    """
    gain, m, p = seen.gain[:, None, None], 1 / seen.noise[:, None, None], seen.power
    s, moved = gain * transfer, gain * slope
    count = s.shape[1]
    parts = [moved, s / 2]
    for plane in range(1, count):
        own = np.zeros_like(s)
        own[:, plane] = s[:, plane]
        parts.append(own)
    a = (m * np.abs(s) ** 2).sum(axis=1)
    q = 1 / (1 + p * a)
    b = [(m * np.conj(s) * u).sum(axis=1) for u in parts]
    found = np.empty((len(b), len(b), *a.shape))
    for i, u in enumerate(parts):
        for j, v in enumerate(parts[: i + 1]):
            both = (m * np.conj(u) * v).sum(axis=1)
            one = (b[i] * b[j] * q**2 + a * q * (both - p * np.conj(b[i]) * b[j] * q)).real
            found[i, j] = found[j, i] = p**2 * one * seen.times
    told, along = _reduced(found, texture)
    u = sum(one[:, None] * part for one, part in zip(along, parts, strict=True))
    bu = (m * np.conj(s) * u).sum(axis=1)
    g = (m * np.abs(u) ** 2).sum(axis=1)
    by_a = p**2 * (
        -2 * p * q**3 * (bu**2).real + q**2 * (g - p * np.abs(bu) ** 2 * q) + a * q * p**2 * q**2 * np.abs(bu) ** 2
    )
    by_b = p**2 * (2 * q**2 * bu - 2 * p * a * q**2 * np.conj(bu))
    by_u = m * s * np.conj(by_b)[:, None] + 2 * m * u * (p**2 * a * q)[:, None]
    by_s = 2 * m * s * by_a[:, None] + m * u * by_b[:, None] + by_u * along[1][:, None] / 2
    for plane in range(1, count):
        by_s[:, plane] += by_u[:, plane] * along[plane + 1]
    weight = gain * seen.times
    with np.errstate(divide="ignore"):
        return 1 / told, (by_s * weight, by_u * along[0][:, None] * weight)


def _reduced(found: FloatArray, texture: Texture) -> tuple[FloatArray, FloatArray]:
    """Information of the first parameter with the others unknown, [blur], and its direction, [parameter, blur, h, w].

    ``found`` is [parameter, same, blur, h, w]. Where nothing is left, the information is 0.
    """
    whole = found[0, 0].sum(axis=(-1, -2))
    along = np.zeros((len(found), *found.shape[2:]))
    along[0] = 1.0
    if texture == "known":
        return whole, along
    if texture == "spectrum":
        total = found.sum(axis=(-1, -2))
        rest = _direction(total, range(1, len(found)))
        along[1:] = rest[..., None, None]
    else:
        rings = _rings()
        flat = found.reshape(*found.shape[:3], -1)
        per_ring = flat @ rings.T  # [parameter, same, blur, ring]
        own = per_ring[1, 1]
        ratio = np.divide(per_ring[1], own, out=np.zeros_like(per_ring[1]), where=own > 0)
        free = (per_ring - per_ring[:, 1, None] * ratio[None]).sum(axis=-1)
        gains = range(2, len(found))
        rest = _direction(free, gains)
        along[2:] = rest[..., None, None]
        weights = np.concatenate([np.ones((1, len(whole))), np.zeros((1, len(whole))), rest])
        strength = -np.einsum("pbr,pb->br", ratio, weights)
        along[1] = (strength @ rings).reshape(found.shape[2:])
    told = np.einsum("ibyx,ijbyx,jbyx->b", along, found, along)
    return np.where(told > cramer_rao.NOTHING * np.maximum(whole, np.finfo(float).tiny), told, 0.0), along


def _direction(total: FloatArray, rest: range) -> FloatArray:
    """-I_rr^-1 I_r0 of [parameter, same, blur], [rest, blur]."""
    inner = np.moveaxis(total[np.ix_(rest, rest)], -1, 0)
    across = np.moveaxis(total[list(rest), 0], -1, 0)
    return np.asarray(-np.einsum("bij,bj->ib", np.linalg.pinv(inner), across))


def _rings() -> FloatArray:
    """Which frequencies of the half-plane lie in which ring, [ring, h w], without the mean."""
    fy, fx = cramer_rao.frequencies(SHAPE, 1.0)
    ring = np.rint(np.hypot(fy, fx) * max(SHAPE)).astype(int).ravel()
    return (ring == np.arange(1, ring.max() + 1)[:, None]).astype(np.float64)


def sharp_error(transfer: NDArray, seen: Sight, coherence: float = COHERENCE) -> tuple[FloatArray, ComplexArray]:
    """Expected squared error of the Wiener filter over the texture's power, [blur], and its gradient by transfer."""
    gain, p = seen.gain[:, None, None], seen.power
    shared = np.full((len(seen.gain), 1, 1), coherence**2)
    shared[0] = 1.0
    s = gain * transfer
    light = np.abs(s) ** 2
    noise = seen.noise[:, None, None] + (1 - shared) * p * light
    a = (shared * light / noise).sum(axis=1)
    q = 1 / (1 + p * a)
    scale = seen.times / (p * seen.times).sum()
    value = (p * q * scale).sum(axis=(-1, -2))
    by_light = -(p**2 * q**2 * scale)[:, None] * shared * seen.noise[:, None, None] / noise**2
    return value, by_light * 2 * s * gain


def camera_bound(
    camera: Camera,
    blur_px: ArrayLike,
    *,
    light: str = "D65",
    level_lux: float = 5000.0,
    texture: Texture = "free",
    planes: tuple[str, ...] = PLANES,
) -> FloatArray:
    """Least standard deviation of the visible blur of any camera, px, [blur]; infinite where nothing tells it."""
    seen = sight(camera, light, level_lux, planes)
    index = [cameras.channels(camera.sensor).index(name) for name in planes]
    transfer, slope = pupils.camera_transfers(camera, blur_px, light, SHAPE, spacing_px=SPACING_PX)
    return np.asarray(np.sqrt(blur_variance(transfer[:, index], slope[:, index], seen, texture)[0]))


# --- the camera's near-infrared stop -----------------------------------------------------------


@dataclass(frozen=True)
class Bench:
    """A camera whose near-infrared stop is free: all that its shape does not change, for one light budget."""

    camera: Camera
    stop: Stop
    made: pupils.Pupil
    others: ComplexArray  # [step of blur, plane, h, w/2 + 1], what comes through the other stops, times its share
    share: FloatArray  # [plane], of the light that comes through the free stop
    seen: Sight
    blur_px: FloatArray
    planes: tuple[int, ...]
    objective: Objective
    texture: Texture
    coherence: float

    @property
    def dioptre_px(self) -> float:
        """Visible blur of one dioptre."""
        return dioptre_px(self.camera)


def dioptre_px(camera: Camera) -> float:
    """Visible blur of one dioptre, A s / p."""
    return geometry.aperture_m(camera) * geometry.image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)


def infrared_stop(camera: Camera) -> Stop:
    """The stop that a mask would replace: of those that pass 730 nm, the one with the smallest area."""
    found = [stop for stop in camera.stops if np.interp(730.0, grid.WAVELENGTH_NM, stops.transmittance(stop)) > 0.5]
    if not found:
        raise InputError(
            f"camera '{camera.name}' has no stop that passes 730 nm; there is no infrared aperture to shape"
        )
    return min(found, key=stops.open_area)


def blurs_between(camera: Camera, near_m: float, far_m: float, count: int) -> FloatArray:
    """Visible blurs, evenly spaced in dioptres, over a depth range on the near side of the focus."""
    blurs = np.asarray(geometry.blur_px(camera, np.array([far_m, near_m])), np.float64)
    if not 0 < near_m < far_m or blurs[1] <= NEAREST_BLUR_PX:
        raise InputError(
            f"depths {near_m:g} to {far_m:g} m: must rise and lie on the near side of the focus, "
            f"{camera.lens.focus_distance_m:g} m, with {NEAREST_BLUR_PX:g} px of blur or more"
        )
    return np.linspace(max(float(blurs[0]), NEAREST_BLUR_PX), float(blurs[1]), count)


def bench(
    camera: Camera,
    blur_px: ArrayLike,
    cells: int,
    *,
    budget: float,
    light: str = "D65",
    level_lux: float = 5000.0,
    objective: Objective = "depth",
    texture: Texture = "free",
    coherence: float = COHERENCE,
    planes: tuple[str, ...] = PLANES,
    fine_cells: int = pupils.FINE_CELLS,
) -> Bench:
    """A bench for masks of ``cells`` across whose open area is ``budget`` of the lens's."""
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    stop = infrared_stop(camera)
    holed = with_stop(camera, stops.Disc(name=stop.name, radius_ratio=float(np.sqrt(budget)),
                                            passes_nm=stop.passes_nm, edge_width_nm=stop.edge_width_nm))  # fmt: skip
    both = np.concatenate([blurs - cramer_rao.SLOPE_STEP_PX, blurs + cramer_rao.SLOPE_STEP_PX])
    made = pupils.pupil(camera, stop, light, both, cells, SHAPE, spacing_px=SPACING_PX, fine_cells=fine_cells)
    others = [one for one in camera.stops if one.name != stop.name]
    own = made.electrons * budget
    rest: ComplexArray = np.zeros((len(both), len(own), SHAPE[0], SHAPE[1] // 2 + 1), complex)
    signal = np.zeros_like(own)
    if others:
        left = camera.model_copy(update={"stops": tuple(others)})
        rest, signal = pupils.stop_transfers(left, both, light, SHAPE, spacing_px=SPACING_PX)
    total = own + signal
    index = tuple(cameras.channels(camera.sensor).index(name) for name in planes)
    part = (signal / total)[:, None, None] * rest
    seen = sight(holed, light, level_lux, planes)
    return Bench(camera, stop, made, part[:, index], (own / total)[list(index)], seen, blurs, index, objective,
                 texture, coherence)  # fmt: skip


def with_stop(camera: Camera, stop: Stop) -> Camera:
    """The camera with its stop of that name exchanged."""
    return camera.model_copy(update={"stops": tuple(stop if one.name == stop.name else one for one in camera.stops)})


def per_blur(at: Bench, amplitude: FloatArray) -> FloatArray:
    """Standard deviation of depth in dioptres, or the sharp picture's error relative to its contrast, [blur]."""
    transfer, slope = _planes(at, amplitude)
    if at.objective == "depth":
        return np.asarray(np.sqrt(blur_variance(transfer, slope, at.seen, at.texture)[0]) / at.dioptre_px)
    return np.asarray(np.sqrt(sharp_error(transfer, at.seen, at.coherence)[0]))


def value(at: Bench, amplitude: FloatArray) -> float:
    """Root mean square of :func:`per_blur`."""
    return float(np.sqrt(np.mean(per_blur(at, amplitude) ** 2)))


def value_and_gradient(at: Bench, amplitude: FloatArray) -> tuple[float, FloatArray]:
    """The logarithm of :func:`value`, and its gradient by the amplitude, [y, x]."""
    transfer, slope = _planes(at, amplitude)
    if at.objective == "depth":
        variance, (by_transfer, by_slope) = blur_variance(transfer, slope, at.seen, at.texture)
        square = variance / at.dioptre_px**2
        by_told = -(variance**2) / at.dioptre_px**2
        scale = (by_told / (2 * square.sum()))[:, None, None, None]
        by_transfer, by_slope = scale * by_transfer, scale * by_slope
    else:
        square, by_transfer = sharp_error(transfer, at.seen, at.coherence)
        by_transfer = by_transfer / (2 * square.sum())
        by_slope = np.zeros_like(by_transfer)
    step = 1 / (2 * cramer_rao.SLOPE_STEP_PX)
    wanted = np.concatenate([by_transfer / 2 - step * by_slope, by_transfer / 2 + step * by_slope])
    full = np.zeros((len(wanted), len(at.made.electrons), *wanted.shape[2:]), complex)
    full[:, at.planes] = wanted * at.share[:, None, None]
    return float(np.log(np.mean(square)) / 2), pupils.gradient(at.made, amplitude, full)


def _planes(at: Bench, amplitude: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """H and dH/dc of the planes with a mask in the stop, [blur, plane, h, w/2 + 1]."""
    own = pupils.transfers(at.made, amplitude)[:, at.planes]
    below, above = np.split(at.others + at.share[:, None, None] * own, 2, axis=0)
    return (below + above) / 2, (above - below) / (2 * cramer_rao.SLOPE_STEP_PX)
