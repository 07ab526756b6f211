"""Random surface patterns in green and infrared: the textures of the layered rooms that the networks are trained on.

A pattern is periodic with a mean of about 1, and has its own contrast in each of four channels. Near-infrared need not
show the same pattern as visible light: dyes of different colours often look the same in infrared.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from dasim.typing import Float32Array

SIDE = 512  # of a pattern, samples
LEAST_REFLECTANCE = 0.02
SOFT_SIGMA = (0.5, 5.0)  # standard deviation of the blur of soft patterns, samples


class Look(NamedTuple):
    """What patterns of a family of rooms are like."""

    contrast: tuple[float, float]  # least and largest standard deviation over the mean
    shares: tuple[float, ...]  # of ``KINDS``
    smoothest: float  # exponent x of a power 1 / f^(2 x)
    follows: tuple[float, float, float]  # shares of patterns whose infrared repeats green fully, partly, not at all
    least_follows: float  # correlation, where partly
    strengths: tuple[float, float, float]  # shares whose infrared has green's contrast, another one, hardly any
    least_scale: float  # samples of a pattern per fine sample of the picture
    soft: float = 0.0  # share of patterns that are soft, as prints of photographs are


PLAIN = Look((0.04, 0.8), (0.34, 0.18, 0.12, 0.12, 0.08, 0.16), 1.8, (0.4, 0.5, 0.1), 0.3, (0.5, 0.42, 0.08), 0.15)
TEXTURED = Look((0.08, 0.9), (0.37, 0.19, 0.12, 0.14, 0.08, 0.1), 1.4, (0.55, 0.38, 0.07), 0.4, (0.6, 0.35, 0.05), 0.35)


def pattern(random: np.random.Generator, look: Look) -> Float32Array:
    """A periodic pattern, [channel, SIDE, SIDE], in the order R, G, B, IR; between LEAST_REFLECTANCE and about 1."""
    colours = _colour(random)
    draw = KINDS[random.choice(len(KINDS), p=look.shares)]
    shared, infrared = draw(random, look), draw(random, look)
    contrast = np.exp(random.uniform(*np.log(look.contrast)))
    follows = random.choice([1.0, random.uniform(look.least_follows, 1.0), 0.0], p=look.follows)
    strength = contrast * random.choice([1.0, random.uniform(0.2, 1.2), 0.02], p=look.strengths)
    mixed = follows * shared + np.sqrt(1 - follows**2) * infrared
    tint = 1 + 0.3 * random.standard_normal(3)
    parts = [colours[i] * (1 + contrast * tint[i] * shared) for i in range(3)]
    parts.append(colours[3] * (1 + strength * mixed))
    found = np.maximum(np.stack(parts), LEAST_REFLECTANCE).astype(np.float32)
    if look.soft and random.random() < look.soft:
        found = softened(found, float(np.exp(random.uniform(*np.log(SOFT_SIGMA)))), periodic=True)
    return found


def softened(image: Float32Array, sigma: float, *, periodic: bool) -> Float32Array:
    """[channel, h, w] blurred by a Gaussian of ``sigma`` samples; beyond its edges it is repeated, or mirrored."""
    if sigma <= 0:
        return image
    reach = int(np.ceil(4 * sigma))
    padded = np.pad(image, ((0, 0), (reach, reach), (reach, reach)), mode="wrap" if periodic else "reflect")
    return np.stack([cv2.GaussianBlur(part, (0, 0), sigma)[reach:-reach, reach:-reach] for part in padded])


def _colour(random: np.random.Generator) -> Float32Array:
    """Mean reflectance of R, G, B and IR; infrared is brighter on average."""
    grey = random.uniform(0.05, 0.8)
    visible = np.clip(grey * np.exp(0.4 * random.standard_normal(3)), 0.03, 0.95)
    infrared = random.uniform(0.3, 0.9) if random.random() < 0.7 else visible.max()
    return np.array([*visible, infrared], np.float32)


def _unit(image: np.ndarray) -> Float32Array:
    image = image - image.mean()
    return np.asarray(image / max(float(image.std()), 1e-6), np.float32)


def _noise(random: np.random.Generator, look: Look) -> Float32Array:
    """Gaussian noise of power 1 / f^(2 x), x from 0.5, sometimes stretched, like wood."""
    fy, fx = np.meshgrid(np.fft.fftfreq(SIDE), np.fft.rfftfreq(SIDE), indexing="ij")
    stretch = np.exp(random.uniform(0, 2.5)) if random.random() < 0.3 else 1.0
    amplitude = np.maximum(np.hypot(fy * stretch, fx), 2 / SIDE) ** -random.uniform(0.5, look.smoothest)
    spectrum = np.fft.rfft2(random.standard_normal((SIDE, SIDE))) * amplitude
    return _unit(np.fft.irfft2(spectrum, (SIDE, SIDE)))


def _leaves(random: np.random.Generator, _: Look) -> Float32Array:
    """Discs over one another, of radii with a density r^-3 (dead leaves)."""
    image = np.zeros((SIDE, SIDE), np.float32)
    least = np.exp(random.uniform(np.log(2), np.log(10)))
    for radius in np.minimum(least / np.sqrt(random.uniform(0.001, 1, 1500)), SIDE / 5):
        centre = random.integers(0, SIDE, 2)
        grey = float(random.standard_normal())
        for x, y in itertools.product(*([at + turn * SIDE for turn in (-1, 0, 1)] for at in centre)):
            if max(abs(x - SIDE / 2), abs(y - SIDE / 2)) <= SIDE / 2 + radius:
                cv2.circle(image, (int(x), int(y)), round(radius), grey, -1)
    return _unit(image)


def _squares(random: np.random.Generator, look: Look) -> Float32Array:
    """Checks or stripes."""
    period = SIDE // int(random.choice([4, 8, 16, 32, 64]))
    y, x = np.indices((SIDE, SIDE)) // max(period // 2, 1)
    image = ((y + x) if random.random() < 0.5 else x) % 2
    return _unit(image + 0.1 * _noise(random, look))


def _print(random: np.random.Generator, _look: Look) -> Float32Array:
    """Lines of strokes, like text."""
    image = np.zeros((SIDE, SIDE), np.float32)
    height = int(random.integers(6, 28))
    thick = max(1, height // 7)
    for top in range(height, SIDE - height, int(height * 1.7)):
        at = 0
        while at < SIDE:
            width = int(random.integers(max(2, height // 3), height + 1))
            for _ in range(int(random.integers(1, 4))):
                ends = random.integers(0, [width, height], (2, 2)) + np.array([at, top])
                cv2.line(image, ends[0].tolist(), ends[1].tolist(), 1.0, thick)
            at += width + (height if random.random() < 0.15 else thick + 1)
    return -_unit(image)


def _dots(random: np.random.Generator, _: Look) -> Float32Array:
    """Sparse dots."""
    image = np.zeros((SIDE, SIDE), np.float32)
    radius = int(random.integers(1, 8))
    for x, y in random.integers(0, SIDE, (int(random.integers(30, 600)), 2)):
        cv2.circle(image, (int(x), int(y)), radius, float(random.choice([-1, 1])), -1)
    return _unit(image)


def _plain(random: np.random.Generator, _: Look) -> Float32Array:
    """Almost no pattern: slow changes."""
    fy, fx = np.meshgrid(np.fft.fftfreq(SIDE), np.fft.rfftfreq(SIDE), indexing="ij")
    amplitude = np.maximum(np.hypot(fy, fx), 1 / SIDE) ** -3
    amplitude[0, 0] = 0
    return 0.1 * _unit(np.fft.irfft2(np.fft.rfft2(random.standard_normal((SIDE, SIDE))) * amplitude, (SIDE, SIDE)))


KINDS: tuple[Callable[[np.random.Generator, Look], Float32Array], ...] = (
    _noise,
    _leaves,
    _squares,
    _print,
    _dots,
    _plain,
)
