"""Strips of a real texture at known blur levels, as in sec. 6.1: no mosaic, no rendering, known noise.

Level estimates on them are compared with the Cramer-Rao bound (:mod:`dasim.bounds.cramer_rao`) of the same pixels.

Tested in tests/validation/claims/test_depth.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import skimage.color
import skimage.data
from numpy.typing import NDArray
from scipy import signal

from dasim.bounds import cramer_rao
from dasim.camera import geometry, pointspread
from dasim.camera.specification import Camera
from dasim.spectra import illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray
from recon.depth import scores
from recon.depth.channels import Channel
from recon.depth.peak import best_level
from recon.settings import Settings

PAIR = ("IR", "G")
STRIP_PX = (128, 224)  # of each level: the window and twice its reach stay clear of the borders
BORDER_PX = 45  # three sigma of the patch and half the largest kernel
WINDOW_PX = 31  # window of all presets that are compared here
READ_E = 3.0  # read noise of da-mobile in electrons
BOUND_SHAPE = (32, 32)  # the size of a patch, which contains no lower spatial frequencies
NO_BOUND_PX = 1e4  # replaces an infinite bound: near focus, blur has no effect to first order
STRENGTHS = np.geomspace(1e-3, 30.0, 10)  # gradient energy of a patch relative to the strip's mean


@dataclass(frozen=True)
class Noise:
    """The noise of a strip: Gaussian with a standard deviation of ``share`` of full scale, or photon and read noise.

    Photon noise applies if ``white_e`` gives the electrons at full scale.
    """

    name: str
    share: float = 0.0
    white_e: tuple[float, float] | None = None  # infrared, green

    def variance(self, picture: NDArray, channel: int) -> FloatArray:
        """Variance, in full scale squared, of pixels whose values are 0..1; ``channel`` indexes ``PAIR``."""
        if self.white_e is None:
            return np.full(np.shape(picture), self.share**2)
        white = self.white_e[channel]
        return np.maximum(picture, 0) / white + (READ_E / white) ** 2

    @property
    def label(self) -> str:
        """A description for reports."""
        if self.white_e is None:
            return f"noise of {100 * self.share:g} % of full scale"
        return f"photon noise, {self.white_e[1]:g} electrons in green and {self.white_e[0]:g} in IR at full scale"

    def add_to(self, picture: NDArray, channel: int, random: np.random.Generator) -> NDArray:
        """The picture, 0..1, with a realisation of the noise."""
        if self.white_e is None:
            return picture + self.share * random.standard_normal(picture.shape)
        white = self.white_e[channel]
        electrons = random.poisson(np.maximum(picture, 0) * white) + READ_E * random.standard_normal(picture.shape)
        return electrons / white


@dataclass(frozen=True)
class Estimates:
    """The level estimates of one strip, at the pixels where both channels show an edge."""

    level: float  # true level
    error: FloatArray  # estimated less true level at these pixels, [n]
    bound: float  # root mean square of the Cramer-Rao bound over these pixels, in levels
    coverage: float  # share of the strip's pixels that have an estimate


def photograph(name: str, shape: tuple[int, ...]) -> FloatArray:
    """The upper left part [h, w] of a photograph of scikit-image in grey, 0..1, taken as linear light."""
    image = np.asarray(getattr(skimage.data, name)())
    grey = skimage.color.rgb2gray(image) if image.ndim == 3 else image / 255
    return np.asarray(grey, np.float64)[: shape[0], : shape[1]]


class Strips:
    """Strips of one texture, one per blur level, with level estimates and their Cramer-Rao bound.

    ``kernels`` [level, channel, y, x] are the PSFs that blur the texture at each of ``levels``. :func:`own_kernels`
    computes those of the camera at any level, fractional ones included.
    """

    def __init__(self, texture: str, levels: Sequence[float], kernels: NDArray, camera: Camera, light: str):
        self.levels = [float(level) for level in levels]
        pair = [CHANNELS.index(name) for name in PAIR]
        half = kernels.shape[-1] // 2
        sharp = photograph(texture, tuple(n + 2 * half for n in STRIP_PX))
        self.blurred = [
            [signal.fftconvolve(sharp, kernel[index].astype(float), mode="valid") for index in pair]
            for kernel in kernels
        ]
        self.step_px = float(geometry.level_blur_px(camera)[1])
        blurs = np.array(self.levels) * self.step_px
        transfer, slope = cramer_rao.camera_transfers(camera, blurs, light, BOUND_SHAPE)
        self.transfer, self.slope = transfer[:, pair], slope[:, pair]
        self.power = cramer_rao.picture_power(sharp, BOUND_SHAPE)
        inner = sharp[half : sharp.shape[0] - half, half : sharp.shape[1] - half]
        self.mean, self.strength = patch_mean(inner), strength_of(inner)

    def estimates(self, noise: Noise, kernels: NDArray, settings: Settings, seed: int) -> list[Estimates]:
        """Level estimates of a preset at each level, with a bank's kernels [level, channel, y, x].

        All presets get the same realisation of the noise, so that it does not contribute to their differences.
        """
        pair = [CHANNELS.index(name) for name in PAIR]
        table = self._bounds(noise)
        strength = self.strength
        if noise.white_e is not None:  # the variance of shot noise rises with the patch's brightness
            strength = strength * self.mean.mean() / self.mean
        estimates = []
        for number, (level, blurred) in enumerate(zip(self.levels, self.blurred, strict=True)):
            random = np.random.default_rng((seed, round(100 * level), round(1e4 * noise.share)))
            planes: list[Channel] = []
            for channel, picture in enumerate(blurred):
                noisy = noise.add_to(picture, channel, random).astype(np.float32)
                variance = noise.variance(cv2.GaussianBlur(noisy, (0, 0), 1.5), channel).astype(np.float32)
                planes.append(Channel(noisy, (0, 0), variance, kernels[:, pair[channel]]))
            score_map, edge = levels_of(planes[0], planes[1], settings, 1.0)
            inner = slice(BORDER_PX, -BORDER_PX)
            bound = bound_of(table[:, number], strength[inner, inner][edge])
            estimates.append(Estimates(level, score_map[edge] - level, bound, float(edge.mean())))
        return estimates

    def _bounds(self, noise: Noise) -> FloatArray:
        """Cramer-Rao bound of the level, as standard deviation, for patches of each strength, [strength, level]."""
        mean = float(self.mean.mean())
        variance = [float(noise.variance(np.array(mean), channel)) for channel in range(len(PAIR))]
        return bound_table(self.transfer, self.slope, self.power, variance) / self.step_px


def bound_table(
    transfer: NDArray, slope: NDArray, power: NDArray, variance: NDArray | Sequence[float], **options: Any
) -> FloatArray:
    """Cramer-Rao bound of the blur's standard deviation in pixels for patches of each strength, [strength, ...].

    ``power`` is the power spectrum of a patch of strength 1, one of ``STRENGTHS``; for the other parameters see
    :func:`dasim.bounds.cramer_rao.blur_deviation`.
    """
    area = cramer_rao.window_area_px(WINDOW_PX)
    width = BOUND_SHAPE[1]
    deviations = [
        cramer_rao.blur_deviation(transfer, slope, s * power, variance, width=width, area_px=area, **options)
        for s in STRENGTHS
    ]
    return np.minimum(np.stack(deviations), NO_BOUND_PX)


def bound_of(table: FloatArray, strength: FloatArray) -> float:
    """Root mean square of the bound over patches of the given strengths [n]; NaN without patches.

    ``table`` [strength] holds the bound at each of ``STRENGTHS``; it is interpolated in logarithms.
    """
    least = np.exp(np.interp(np.log(strength), np.log(STRENGTHS), np.log(table)))
    return float(np.sqrt(np.mean(least**2))) if least.size else float("nan")


def strength_of(sharp: FloatArray) -> FloatArray:
    """Gradient energy of a sharp picture in the patch around each pixel, relative to the picture's mean, [h, w]."""
    energy = patch_mean(np.sum(np.square(np.gradient(sharp)), axis=0))
    return np.asarray(energy / energy.mean())


def own_kernels(camera: Camera, levels: Sequence[float], light: str, size: int) -> FloatArray:
    """The camera's PSFs at any levels, fractional ones included, of unit sum, [level, channel, size, size]."""
    blurs = np.array(levels) * geometry.level_blur_px(camera)[1]
    at = pointspread.kernels(camera, blurs, illuminants.illuminant(light), size)
    kernels = np.stack([at(index, (0.0, 0.0), ...)[0] for index in range(len(blurs))])
    return np.asarray(kernels / kernels.sum(axis=(-1, -2), keepdims=True))


def levels_of(
    sharper: Channel, green: Channel, settings: Settings, spacing_px: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Estimated levels away from the frame's border, and the mask of samples with an edge in both channels, [h, w].

    ``spacing_px`` is the distance of the channels' samples in pixels of the sensor.
    """
    matches = scores.match(sharper, green, settings, spacing_px)
    level, _ = best_level(matches.score, matches.ncc, matches.offset, settings.window_px)
    border = round(BORDER_PX / spacing_px)
    inner = slice(border, -border)
    edge = (matches.snr > settings.edge_snr) & (matches.green_snr > settings.edge_snr)
    return level[inner, inner].astype(np.float64), edge[inner, inner]


def patch_mean(image: NDArray) -> FloatArray:
    """Mean over the patch of eq. (11) around each pixel."""
    blurred = cv2.GaussianBlur(image.astype(np.float64), (0, 0), WINDOW_PX / np.sqrt(12), borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred)
