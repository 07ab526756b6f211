"""One estimator of depth for all designs: the likelihood of a window's spectra, and its bound.

A window shows a Gaussian texture of power B_r P(f), with P = 1/f^2, whose contrasts in the colours have the covariance
S. At each candidate blur, S is fitted to the window's cross-spectra, with correlations of up to ``MOST_COHERENT``
between colours. In every ring r of frequencies, the factor B_r is free except for a prior: its logarithm has the
standard deviation ``POWER_SD`` about the mean of the window, so that a smooth print is not mistaken for blur. The
covariance of the planes at a frequency is the sum over the frequencies f that alias to it,

    C_ij = B_r / 4 sum over f of S_ij P(f) h_i(f) conj(h_j(f)) + n_i delta_ij,

with h_i the transfer function of plane i, including the phase of its position in the block, and n_i its noise; the
taper of the window smooths it along frequency. The estimated blur maximises the likelihood, itself maximised over B.
The same covariance gives two more results: the Cramer-Rao bound, by the Slepian-Bangs formula with the information of
the prior added and S known (:mod:`dasim.bounds.cramer_rao` omits aliasing), and the sharp texture of green, as its
conditional mean.

A level is an index, here into the candidate blurs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.bounds.cramer_rao import natural_power
from dasim.camera import geometry, pointspread
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import ComplexArray, FloatArray
from validation.rivals.designs import shifted
from validation.rivals.windows import FOLDED, SAMPLES, SPACING_PX, Spectra, half_plane, sites, taper

MOST_COHERENT = 0.95  # correlation of textures in two colours
FIRST_CONTRAST = 0.15  # per octave: weighs the cross-spectra against noise when S is fitted
LEAST_CONTRAST = 0.005
FACTORS = 4.0 ** np.arange(-2, 3)  # of a ring's power that are tried; between them a parabola
POWER_SD = 2.0  # of the logarithm of a ring's power, by the prior
RINGS = 6
LEAST_INFORMATION = 1e-6  # per px^2; less is rounding
BLUR_PX = np.concatenate([np.arange(0.0, 8.0, 0.5), np.arange(8.0, 30.5, 1.0)])  # of the open lens
PATCH_PX = SAMPLES * SPACING_PX


class Model(NamedTuple):
    """Response of a design to a texture of unit strength at every candidate blur.

    Attributes:
        covariance: of the planes without noise, for one contrast in all, [blur, frequency, plane, plane]
        sharp: of the sharp texture with each plane, [blur, frequency, plane]
        channel: number of each plane's colour, [plane]
        power: of the sharp texture, [frequency]
        times: how often each frequency counts, [frequency]
        blur_px: blurs of the open lens, [blur]
    """

    covariance: ComplexArray
    sharp: ComplexArray
    channel: NDArray[np.intp]
    power: FloatArray
    times: FloatArray
    blur_px: FloatArray


class Found(NamedTuple):
    """The likeliest blur of each window, as an index with a fraction, [window], and S of its planes, [window, plane,
    plane].
    """

    place: FloatArray
    textures: FloatArray


def model(
    cameras: Sequence[Camera], light: str, blur_px: FloatArray = BLUR_PX, sweep_um: Sequence[float] = (0.0,)
) -> Model:
    """The model of a design under an illuminant; see :class:`validation.rivals.designs.Design` for ``sweep_um``."""
    planes = sites(cameras)
    transfers = np.stack(  # [picture, blur, channel, y, x]
        [np.mean([_transfers(shifted(one, um), light, blur_px) for um in sweep_um], axis=0) for one in cameras]
    )
    frequency = np.fft.fftfreq(PATCH_PX)
    place = np.array([(plane.y, plane.x) for plane in planes])
    phase = np.exp(2j * np.pi * (place[:, 0, None, None] * frequency[:, None] + place[:, 1, None, None] * frequency))
    chosen = [transfers[plane.picture, :, CHANNELS.index(plane.channel)] for plane in planes]
    whole = np.stack(chosen, 1) * phase  # [blur, plane, y, x]
    power = _texture_power()
    kept, times = half_plane()
    base = baseband()
    seen = np.moveaxis(whole.reshape(*whole.shape[:2], -1)[..., base], 1, -1)
    first = power.ravel()[base]
    sharp = first[:, None] * np.conj(seen)
    channel = np.array([CHANNELS.index(plane.channel) for plane in planes])
    return Model(
        plane_covariance(whole)[:, kept],
        _windowed(sharp, axis=1)[:, kept],
        channel,
        _windowed(first, axis=0)[kept],
        times,
        blur_px,
    )


def plane_covariance(transfer: ComplexArray) -> ComplexArray:
    """Covariance of planes that see a texture of unit strength, [blur, folded frequency, plane, plane].

    ``transfer`` are their transfer functions, [blur, plane, y, x], at the frequencies of a patch.
    """
    power = _texture_power()
    blurs, planes = transfer.shape[:2]
    total = np.zeros((blurs, SAMPLES**2, planes, planes), complex)
    for down in range(SPACING_PX):
        for along in range(SPACING_PX):
            alias = np.s_[down * SAMPLES : (down + 1) * SAMPLES, along * SAMPLES : (along + 1) * SAMPLES]
            h = np.moveaxis(transfer[..., *alias] * np.sqrt(power[alias]), 1, -1).reshape(blurs, -1, planes)
            total += h[..., :, None] * np.conj(h[..., None, :])
    return _windowed(total, axis=1)


def _texture_power() -> FloatArray:
    """Power of a texture of unit strength in a plane's samples, at the frequencies of a patch, [PATCH_PX, PATCH_PX]."""
    return _whole_plane(natural_power((PATCH_PX, PATCH_PX), contrast=1.0)) / SPACING_PX**2


def _transfers(camera: Camera, light: str, blur_px: FloatArray) -> ComplexArray:
    """Transfer functions at the frequencies of a patch, [blur, channel, y, x]."""
    size = pointspread.kernel_size_px(camera, float(blur_px.max()))
    kernels = pointspread.kernels(camera, blur_px, illuminants.illuminant(light), size)
    place = (np.arange(size) - size // 2) % PATCH_PX
    result = np.zeros((len(blur_px), len(CHANNELS), PATCH_PX, PATCH_PX), complex)
    for number in range(len(blur_px)):
        kernel, _ = kernels(number, (0.0, 0.0), ...)
        for name, one in zip(sensors.channels(camera.sensor), kernel, strict=True):
            folded = np.zeros((PATCH_PX, PATCH_PX))
            np.add.at(folded, (place[:, None], place[None]), one)
            result[number, CHANNELS.index(name)] = np.fft.fft2(folded)
    return result


def _whole_plane(half: FloatArray) -> FloatArray:
    """A power spectrum on the whole plane, from its half-plane [h, w/2 + 1]."""
    width = 2 * (half.shape[1] - 1)
    whole = np.empty((half.shape[0], width))
    whole[:, : half.shape[1]] = half
    rows, columns = -np.arange(half.shape[0]) % half.shape[0], -np.arange(half.shape[1], width) % width
    whole[:, half.shape[1] :] = half[rows][:, columns]
    return whole


def _windowed(spectrum: NDArray, axis: int) -> NDArray:
    """Spectra [..., SAMPLES^2, ...] as the window blurs them, at the frequencies of the folded transform."""
    shape = (*spectrum.shape[:axis], SAMPLES, SAMPLES, *spectrum.shape[axis + 1 :])
    blur = np.abs(np.fft.fft2(taper())) ** 2
    factor = np.fft.ifft2(blur / blur.sum()) * SAMPLES**2
    factor = factor.reshape(SAMPLES, SAMPLES, *([1] * (spectrum.ndim - axis - 1)))
    axes = (axis, axis + 1)
    whole = np.fft.fft(
        np.fft.ifft(np.fft.ifft(spectrum.reshape(shape), axis=axes[0]), axis=axes[1]) * factor, axis=axes[0]
    )
    whole = np.fft.fft(whole, axis=axes[1])
    times = SAMPLES // FOLDED
    chosen = whole[(slice(None),) * axis + (slice(None, None, times), slice(None, None, times))]
    result = chosen.reshape(*spectrum.shape[:axis], FOLDED**2, *spectrum.shape[axis + 1 :])
    return result if np.iscomplexobj(spectrum) else np.maximum(result.real, 0)


def baseband() -> NDArray[np.intp]:
    """Indices into the flattened spectrum of a patch of the frequencies below the planes' limit, [SAMPLES^2]."""
    index = np.rint(np.fft.fftfreq(SAMPLES) * SAMPLES).astype(int) % PATCH_PX
    return np.asarray((index[:, None] * PATCH_PX + index).ravel())


def rings() -> NDArray[np.intp]:
    """Ring of each frequency, [frequency], evenly spaced in the logarithm of the frequency."""
    kept, _ = half_plane()
    index = np.fft.fftfreq(FOLDED) * FOLDED
    radius = np.hypot(index[:, None], index).ravel()[kept]
    return np.minimum((np.log(radius) / np.log(radius.max()) * RINGS).astype(np.intp), RINGS - 1)


def estimate(windows: Spectra, known: Model) -> Found:
    """The likeliest blur of each window."""
    weight = ((rings() == np.arange(RINGS)[:, None]) * known.times).T / 2  # [frequency, ring]
    steps = np.log(FACTORS)
    score = np.empty((len(windows.value), len(known.covariance)))
    textures = np.empty((len(windows.value), *known.covariance.shape[-2:]))
    for number, (value, noise) in enumerate(zip(windows.value, windows.noise, strict=True)):
        every = fitted_textures(value, noise, known)  # [blur, plane, plane]
        signal = known.covariance * every[:, None]
        by_factor = []
        for factor in FACTORS:
            whole = signal * factor + np.diag(noise)
            solved = np.linalg.solve(whole, np.broadcast_to(value[..., None], (*whole.shape[:-1], 1)))[..., 0]
            cost = np.linalg.slogdet(whole)[1] + (np.conj(value) * solved).sum(-1).real
            by_factor.append(-cost @ weight)
        found = np.stack(by_factor)  # [factor, blur, ring]
        common = [_highest(found - (((steps - middle) / POWER_SD) ** 2 / 2)[:, None, None]).sum(-1) for middle in steps]
        score[number] = _highest(np.stack(common))
        textures[number] = every[score[number].argmax()]
    return Found(_vertex(score, score.argmax(-1)), textures)


def fitted_textures(value: ComplexArray, noise: FloatArray, known: Model) -> FloatArray:
    """S of a window at every blur, by least squares over its cross-spectra, [blur, plane, plane].

    Args:
        value: spectra of the window, [frequency, plane].
        noise: noise power of the planes, [plane].
        known: the model.
    """
    model = known.covariance
    measured = value[:, :, None] * np.conj(value[:, None, :]) - np.diag(noise)
    spread = np.einsum("bfii->bfi", model).real * FIRST_CONTRAST**2 + noise
    weight = known.times[:, None, None] / (spread[..., :, None] * spread[..., None, :])
    above = (weight * (measured * np.conj(model)).real).sum(1)
    below = (weight * np.abs(model) ** 2).sum(1)
    colours = np.unique(known.channel)
    member = (known.channel == colours[:, None]).astype(float)  # [colour, plane]
    pooled = (member @ above @ member.T) / (member @ below @ member.T)
    contrast = np.sqrt(np.maximum(np.einsum("bcc->bc", pooled), LEAST_CONTRAST**2))
    outer = contrast[:, :, None] * contrast[:, None, :]
    correlation = np.clip(pooled / outer, -MOST_COHERENT, MOST_COHERENT)
    correlation[:, np.arange(len(colours)), np.arange(len(colours))] = 1.0
    values, vectors = np.linalg.eigh(correlation)
    definite = (vectors * np.maximum(values, 1 - MOST_COHERENT)[:, None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(member.T @ (definite * outer) @ member)


def _highest(score: FloatArray) -> FloatArray:
    """Largest value along the first axis, of a parabola through the largest sample and its neighbours, [...]."""
    inner = np.clip(score.argmax(0), 1, len(score) - 2)
    below, at, above = (np.take_along_axis(score, inner[None] + step, 0)[0] for step in (-1, 0, 1))
    bend = below - 2 * at + above
    shift = np.clip(np.divide(below - above, 2 * bend, out=np.zeros_like(bend), where=bend < 0), -1, 1)
    return np.asarray(np.maximum(score.max(0), at + (above - below) * shift / 2 + bend * shift**2 / 2))


def _vertex(score: FloatArray, index: NDArray[np.intp]) -> FloatArray:
    """Place of the maximum of a parabola through the largest score and its neighbours, [window]."""
    inner = np.clip(index, 1, score.shape[1] - 2)
    below, at, above = (np.take_along_axis(score, inner[:, None] + step, 1)[:, 0] for step in (-1, 0, 1))
    bend = below - 2 * at + above
    shift = np.divide(below - above, 2 * bend, out=np.zeros_like(bend), where=bend < 0)
    return np.where(inner == index, inner + np.clip(shift, -0.5, 0.5), index)


def deviation_px(known: Model, noise: FloatArray, blur_px: float, textures: FloatArray) -> float:
    """Least standard deviation in px of an unbiased estimate of the blur from one window; infinite without information.

    Args:
        known: the model.
        noise: noise power of the planes, [plane].
        blur_px: true blur.
        textures: S of the planes, [plane, plane].
    """
    blurs = known.blur_px
    number = int(np.clip(np.searchsorted(blurs, blur_px), 1, len(blurs) - 2))
    slope = textures * (known.covariance[number + 1] - known.covariance[number - 1])
    slope /= blurs[number + 1] - blurs[number - 1]
    signal = textures * known.covariance[number]
    inverse = np.linalg.inv(signal + np.diag(noise))
    change, strengths = inverse @ slope, inverse @ signal
    own, cross, ring = (
        0.5 * known.times * np.einsum("fij,fji->f", a, b).real
        for a, b in ((change, change), (change, strengths), (strengths, strengths))
    )
    member = (rings() == np.arange(RINGS)[:, None]).astype(float)
    prior = (np.eye(RINGS) - 1 / RINGS) / POWER_SD**2
    nuisance = np.diag(member @ ring) + prior
    rest = own.sum() - (member @ cross) @ np.linalg.pinv(nuisance) @ (member @ cross)
    return float(1 / np.sqrt(rest)) if rest > LEAST_INFORMATION else float("inf")


def sharp_texture(windows: Spectra, known: Model, found: Found) -> ComplexArray:
    """Conditional mean of the sharp texture at the likeliest blur, in the planes' band, [window, frequency]."""
    number = np.rint(found.place).astype(int)
    whole = known.covariance[number] * found.textures[:, None]
    whole = whole + windows.noise[:, None, :, None] * np.eye(windows.noise.shape[-1])
    green = found.textures[:, int(np.flatnonzero(known.channel == CHANNELS.index("G"))[0])]
    weight = np.linalg.solve(np.swapaxes(whole, -1, -2), (known.sharp[number] * green[:, None])[..., None])[..., 0]
    return np.asarray((weight * windows.value).sum(-1))


def depth_of(camera: Camera, blur_px: FloatArray) -> FloatArray:
    """Dioptres (1/m) of signed blurs of the open lens, positive in front of the focus."""
    per_px = camera.sensor.pixel_pitch_um * 1e-6 / (geometry.aperture_m(camera) * geometry.image_distance_m(camera))
    return np.asarray(1 / camera.lens.focus_distance_m + np.asarray(blur_px) * per_px)
