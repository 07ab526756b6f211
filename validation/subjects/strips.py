"""Strips of a real texture at known levels of blur, as sec. 6.1 makes them: no mosaic, no render, noise that is known.

What an estimator makes of them is held against the Cramer-Rao bound (:mod:`dasim.bounds.cramer_rao`) of these pixels.

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
WINDOW_PX = 31  # of all presets that are compared here
READ_E = 3.0  # da-mobile's
BOUND_SHAPE = (32, 32)  # a patch: lower frequencies do not fit into it
NO_BOUND_PX = 1e4  # in place of infinity: blur near 0 changes nothing to first order
STRENGTHS = np.geomspace(1e-3, 30.0, 10)  # of a patch's texture, relative to the strip's mean


@dataclass(frozen=True)
class Noise:
    """Gaussian noise of a share of full scale on both channels, or photons of so many electrons at full scale."""

    name: str
    share: float = 0.0
    white_e: tuple[float, float] | None = None  # infrared, green

    def variance(self, picture: NDArray, channel: int) -> FloatArray:
        """Variance of pixels of 0..1, in full scale squared."""
        if self.white_e is None:
            return np.full(np.shape(picture), self.share**2)
        white = self.white_e[channel]
        return np.maximum(picture, 0) / white + (READ_E / white) ** 2

    @property
    def said(self) -> str:
        """In words."""
        if self.white_e is None:
            return f"noise of {100 * self.share:g} % of full scale"
        return f"photon noise, full scale {self.white_e[1]:g} electrons green, {self.white_e[0]:g} infrared"

    def added(self, picture: NDArray, channel: int, random: np.random.Generator) -> NDArray:
        """A noisy picture."""
        if self.white_e is None:
            return picture + self.share * random.standard_normal(picture.shape)
        white = self.white_e[channel]
        electrons = random.poisson(np.maximum(picture, 0) * white) + READ_E * random.standard_normal(picture.shape)
        return electrons / white


@dataclass(frozen=True)
class Estimates:
    """Of one strip: levels found at the pixels that show an edge, less the true one; the bound there; their share."""

    level: float
    error: FloatArray  # [n]
    bound: float  # root mean square over these pixels of the least standard deviation, levels
    answered: float


def photograph(name: str, shape: tuple[int, ...]) -> FloatArray:
    """A grey photograph that ships with scikit-image, 0..1 as its values stand, its upper left part."""
    image = np.asarray(getattr(skimage.data, name)())
    grey = skimage.color.rgb2gray(image) if image.ndim == 3 else image / 255
    return np.asarray(grey, np.float64)[: shape[0], : shape[1]]


class Strips:
    """Strips of one texture, blurred with the kernels that a camera has at ``levels``, and what they can tell.

    ``kernels`` [level, channel, y, x] are what the texture is blurred with at each of ``levels``; the camera's own
    ones at any level, whole or not, come from :func:`own_kernels`.
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
        """What a preset finds with a bank's kernels [level, channel, y, x] at each of the levels.

        All presets get the same noise, so that their differences are their own.
        """
        pair = [CHANNELS.index(name) for name in PAIR]
        table = self._bounds(noise)
        strength = self.strength
        if noise.white_e is not None:  # shot noise rises with the patch's brightness
            strength = strength * self.mean.mean() / self.mean
        found = []
        for number, (level, blurred) in enumerate(zip(self.levels, self.blurred, strict=True)):
            random = np.random.default_rng((seed, round(100 * level), round(1e4 * noise.share)))
            planes: list[Channel] = []
            for channel, picture in enumerate(blurred):
                noisy = noise.added(picture, channel, random).astype(np.float32)
                variance = noise.variance(cv2.GaussianBlur(noisy, (0, 0), 1.5), channel).astype(np.float32)
                planes.append((noisy, (0, 0), variance, kernels[:, pair[channel]]))
            seen, edge = levels_of(planes[0], planes[1], settings, 1.0)
            inner = slice(BORDER_PX, -BORDER_PX)
            bound = bound_of(table[:, number], strength[inner, inner][edge])
            found.append(Estimates(level, seen[edge] - level, bound, float(edge.mean())))
        return found

    def _bounds(self, noise: Noise) -> FloatArray:
        """Least standard deviation of the level for a patch of each strength, [strength, level]."""
        mean = float(self.mean.mean())
        variance = [float(noise.variance(np.array(mean), channel)) for channel in range(len(PAIR))]
        return bound_table(self.transfer, self.slope, self.power, variance) / self.step_px


def bound_table(
    transfer: NDArray, slope: NDArray, power: NDArray, variance: NDArray | Sequence[float], **options: Any
) -> FloatArray:
    """Least standard deviation of blur for a patch of each of ``STRENGTHS``, [strength, ...]; see blur_deviation."""
    area = cramer_rao.window_area_px(WINDOW_PX)
    width = BOUND_SHAPE[1]
    found = [
        cramer_rao.blur_deviation(transfer, slope, s * power, variance, width=width, area_px=area, **options)
        for s in STRENGTHS
    ]
    return np.minimum(np.stack(found), NO_BOUND_PX)


def bound_of(table: FloatArray, strength: FloatArray) -> float:
    """Root mean square of the bound over patches of strengths [n], from a table [strength]; NaN for none."""
    least = np.exp(np.interp(np.log(strength), np.log(STRENGTHS), np.log(table)))
    return float(np.sqrt(np.mean(least**2))) if least.size else float("nan")


def strength_of(sharp: FloatArray) -> FloatArray:
    """Gradient energy of a sharp picture in the patch around each pixel, relative to its mean, [h, w]."""
    energy = patch_mean(np.sum(np.square(np.gradient(sharp)), axis=0))
    return np.asarray(energy / energy.mean())


def own_kernels(camera: Camera, levels: Sequence[float], light: str, size: int) -> FloatArray:
    """The camera's own kernels at any levels, of unit sum, [level, channel, size, size]."""
    blurs = np.array(levels) * geometry.level_blur_px(camera)[1]
    at = pointspread.kernels(camera, blurs, illuminants.illuminant(light), size)
    found = np.stack([at(index, (0.0, 0.0), ...)[0] for index in range(len(blurs))])
    return np.asarray(found / found.sum(axis=(-1, -2), keepdims=True))


def levels_of(
    sharper: Channel, green: Channel, settings: Settings, spacing_px: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Estimates of the samples away from the frame's border, and which show an edge in both channels, [h, w]."""
    found = scores.match(sharper, green, settings, spacing_px)
    level, _ = best_level(found.score, found.plain, found.offset, settings)
    border = round(BORDER_PX / spacing_px)
    inner = slice(border, -border)
    edge = (found.snr > settings.edge_snr) & (found.green_snr > settings.edge_snr)
    return level[inner, inner].astype(np.float64), edge[inner, inner]


def patch_mean(image: NDArray) -> FloatArray:
    """Mean over the patch of eq. (11) around each pixel."""
    blurred = cv2.GaussianBlur(image.astype(np.float64), (0, 0), WINDOW_PX / np.sqrt(12), borderType=cv2.BORDER_REFLECT)
    return np.asarray(blurred)
