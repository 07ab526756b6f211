"""Published coded apertures, rebuilt from what their papers say of how they were found; not their bits.

The papers print their patterns as pictures only, and no public text or program was found that holds one as numbers
(programs that use them read picture files). Criteria and numbers stand here from memory, not checked against the
papers' own text, except where a public source is named. Each pattern is searched for again by its own criterion, with
fixed random numbers, so that it stands for its kind; another of the same kind is a little better or worse. The papers'
prior of pictures is taken as 1/f^2.
"""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
from scipy import fft, ndimage

from dasim.typing import FloatArray

_DRAWS = 1500
_FRAME = 32  # samples a side of transforms
_SCALES_PX = np.linspace(5, 15, 8)  # Levin et al. sec. 2: eight sizes of blur between 5 and 15 px
_NOISE = 0.01  # of full scale, with a contrast of 1 at one cycle a frame
_HERD, _GENERATIONS = 120, 60


@cache
def veeraraghavan() -> FloatArray:
    """7 x 7 cells, about half of them open, whose smallest transform value is large (Veeraraghavan et al. 2007).

    "Dappled Photography", ACM Trans. Graph. 26(3), sec. 4: a broadband code has a transform without small values; 7 x 7
    suits a small blur, and was found by a random search. Searched here: 40,000 random codes with 24 or 25 open cells.
    Uncertain: the number that the paper tried, and its exact share of open cells.
    """
    random = np.random.default_rng(2007)
    best, most = np.ones((7, 7)), -1.0
    for _ in range(40):
        order = random.random((1000, 49)).argsort(axis=1)
        codes = (order < random.integers(24, 26, (1000, 1))).astype(np.float64).reshape(-1, 7, 7)
        least = np.abs(fft.rfft2(codes, (16, 16))).min(axis=(1, 2)) / codes.sum(axis=(1, 2))
        if least.max() > most:
            best, most = codes[least.argmax()], float(least.max())
    return best


@cache
def levin() -> FloatArray:
    """13 x 13 cells whose blurs of two sizes make pictures of the most different statistics (Levin et al. 2007).

    "Image and Depth from a Conventional Camera with a Coded Aperture", ACM Trans. Graph. 26(3), sec. 2: random binary
    13 x 13 patterns; the score is the least Kullback-Leibler divergence between the distributions of pictures blurred
    at two of eight sizes between 5 and 15 px. Searched here: 1,500 patterns, half of them symmetric left to right, as
    the paper's picture of its pattern seems to be. Uncertain: how many it tried, and the weights of its prior.
    """
    random = np.random.default_rng(13)
    best, most = np.ones((13, 13)), -1.0
    for number in range(_DRAWS):
        pattern = (random.random((13, 13)) < random.uniform(0.35, 0.65)).astype(np.float64)
        if number % 2:
            pattern[:, 7:] = pattern[:, 5::-1]
        score = _least_divergence(pattern)
        if score > most:
            best, most = pattern, score
    return best


def _least_divergence(pattern: FloatArray) -> float:
    """Least divergence between neighbouring sizes: of Gaussian pictures whose spectra are |K|^2 P + noise."""
    power = _power()
    spectra = []
    for size in _SCALES_PX:
        edges = (np.arange(14) / 13 - 0.5) * size
        own = np.arange(_FRAME + 1) - _FRAME / 2
        low, high = np.maximum(own[:-1, None], edges[None, :-1]), np.minimum(own[1:, None], edges[None, 1:])
        covered = np.clip(high - low, 0.0, None)
        kernel = covered @ pattern @ covered.T
        spectra.append(np.abs(fft.fft2(kernel / kernel.sum())) ** 2 * power + _NOISE**2)
    ratios = [(a / b, b / a) for a, b in itertools.pairwise(spectra)]
    return float(min(0.5 * (r - np.log(r) - 1).sum() for pair in ratios for r in pair))


@cache
def zhou_nayar() -> FloatArray:
    """13 x 13 cells from which a sharp picture comes with the least expected error (Zhou and Nayar 2009).

    "What are Good Apertures for Defocus Deblurring?", ICCP 2009: a genetic algorithm minimises, over frequencies,
    the sum of s^2 / (|K|^2 + s^2 / |F|^2) with s the noise and |F|^2 the mean power of pictures. Searched here: a herd
    of 120 over 60 generations, noise of 1 %, a blur as wide as the pattern. The authors' slides confirm the criterion
    (the error of the best linear filter, relative to the disc's), 13 x 13 binary cells, a genetic algorithm, and eight
    patterns for eight noises: codes help where noise is low, the disc where it is high. Uncertain: the paper's herd,
    which is larger, and its noises.
    """
    random = np.random.default_rng(2009)
    herd = (random.random((_HERD, 13, 13)) < 0.5).astype(np.float64)
    for _ in range(_GENERATIONS):
        order = np.argsort(_deblurring_error(herd))
        parents = herd[order[: _HERD // 4]]
        pairs = parents[random.integers(0, len(parents), (2, _HERD - len(parents)))]
        mixed = np.where(random.random(pairs.shape[1:]) < 0.5, pairs[0], pairs[1])
        children = np.abs(mixed - (random.random(mixed.shape) < 0.01))
        herd = np.concatenate([parents, children])
    return np.asarray(herd[np.argmin(_deblurring_error(herd))])


def _deblurring_error(patterns: FloatArray) -> FloatArray:
    """The criterion of a stack of patterns; the picture's signal is in proportion to what is open."""
    transfer = np.abs(fft.fft2(patterns / 169.0, (_FRAME, _FRAME))) ** 2
    return np.asarray((_NOISE**2 / (transfer + _NOISE**2 / _power())).sum(axis=(1, 2)))


def _power() -> FloatArray:
    """Mean power of pictures at the frame's frequencies, 1/f^2."""
    cycles = np.fft.fftfreq(_FRAME) * _FRAME
    square = cycles[:, None] ** 2 + cycles[None, :] ** 2
    return np.asarray(1 / np.maximum(square, 0.5))


def parts(pattern: FloatArray) -> int:
    """Number of open parts that hang together."""
    return int(ndimage.label(pattern > 0.5)[1])
