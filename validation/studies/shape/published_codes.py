"""Published coded apertures, rebuilt by the criteria of their papers; not the published patterns themselves.

The papers print their patterns as pictures only, and no public text or program was found that holds one as numbers
(programs that use them read picture files). Criteria and numbers are given from memory, not verified in the text of the
papers, except where a public source is named. Each pattern is the result of a new search by its paper's criterion with
fixed random numbers: it represents its kind, and another pattern of the same kind is slightly better or worse. The
papers' prior on pictures is approximated by a power spectrum of 1/f^2.
"""

from __future__ import annotations

import itertools
from functools import cache

import numpy as np
from scipy import fft

from dasim.typing import FloatArray
from validation.studies.shape import masks

_CODES = 1500  # random patterns that are compared
_FRAME = 32  # samples per side of transforms
_SCALES_PX = np.linspace(5, 15, 8)  # Levin et al. sec. 2: eight sizes of blur between 5 and 15 px
_NOISE = 0.01  # of full scale, with a contrast of 1 at one cycle per frame
_POPULATION, _GENERATIONS = 120, 60


@cache
def veeraraghavan() -> FloatArray:
    """7 x 7 cells, about half of them open, whose smallest Fourier magnitude is large (Veeraraghavan et al. 2007).

    "Dappled Photography", ACM Trans. Graph. 26(3), sec. 4: the transform of a broadband code has no small values; 7 x 7
    cells suit a small blur, and the code resulted from a random search. Here: the best of 40,000 random codes with 24
    or 25 open cells. Uncertain: the number of codes in the paper, and its exact share of open cells.
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
    """13 x 13 cells that make pictures of different blur sizes statistically most distinct (Levin et al. 2007).

    "Image and Depth from a Conventional Camera with a Coded Aperture", ACM Trans. Graph. 26(3), sec. 2: random binary
    13 x 13 patterns; the score is the least Kullback-Leibler divergence between the distributions of pictures blurred
    at two of eight sizes between 5 and 15 px. Here: the best of 1,500 patterns, half of them symmetric left to right,
    as the paper's pattern appears to be. Uncertain: the number of patterns in the paper, and the weights of its prior.
    """
    random = np.random.default_rng(13)
    best, most = np.ones((13, 13)), -1.0
    for number in range(_CODES):
        pattern = (random.random((13, 13)) < random.uniform(0.35, 0.65)).astype(np.float64)
        if number % 2:
            pattern[:, 7:] = pattern[:, 5::-1]
        score = _least_divergence(pattern)
        if score > most:
            best, most = pattern, score
    return best


def _least_divergence(pattern: FloatArray) -> float:
    """Least Kullback-Leibler divergence between adjacent blur sizes; Gaussian pictures of power |K|^2 P + noise."""
    power = _power()
    spectra = []
    for size in _SCALES_PX:
        covered = masks.overlap(np.arange(_FRAME + 1) - _FRAME / 2, (np.arange(14) / 13 - 0.5) * size)
        kernel = covered @ pattern @ covered.T
        spectra.append(np.abs(fft.fft2(kernel / kernel.sum())) ** 2 * power + _NOISE**2)
    ratios = [(a / b, b / a) for a, b in itertools.pairwise(spectra)]
    return float(min(0.5 * (r - np.log(r) - 1).sum() for pair in ratios for r in pair))


@cache
def zhou_nayar() -> FloatArray:
    """13 x 13 cells with the least expected error of the deblurred picture (Zhou and Nayar 2009).

    "What are Good Apertures for Defocus Deblurring?", ICCP 2009: a genetic algorithm minimises the sum over frequencies
    of s^2 / (|K|^2 + s^2 / |F|^2), s the noise and |F|^2 the mean power of pictures. Here: a population of 120 over 60
    generations, noise of 1 %, a blur as wide as the pattern. The authors' slides confirm the criterion (the error of
    the best linear filter, relative to that of the disc), 13 x 13 binary cells, a genetic algorithm, and eight patterns
    for eight noise levels: codes are better at low noise, the disc at high noise. Uncertain: the paper's population,
    which is larger, and its noise levels.
    """
    random = np.random.default_rng(2009)
    population = (random.random((_POPULATION, 13, 13)) < 0.5).astype(np.float64)
    for _ in range(_GENERATIONS):
        order = np.argsort(_deblurring_error(population))
        parents = population[order[: _POPULATION // 4]]
        pairs = parents[random.integers(0, len(parents), (2, _POPULATION - len(parents)))]
        mixed = np.where(random.random(pairs.shape[1:]) < 0.5, pairs[0], pairs[1])
        children = np.abs(mixed - (random.random(mixed.shape) < 0.01))
        population = np.concatenate([parents, children])
    return np.asarray(population[np.argmin(_deblurring_error(population))])


def _deblurring_error(patterns: FloatArray) -> FloatArray:
    """The criterion for a stack of patterns, [pattern]; the signal is proportional to the open area."""
    transfer = np.abs(fft.fft2(patterns / 169.0, (_FRAME, _FRAME))) ** 2
    return np.asarray((_NOISE**2 / (transfer + _NOISE**2 / _power())).sum(axis=(1, 2)))


def _power() -> FloatArray:
    """Mean power of pictures at the frequencies of the frame, 1/f^2, [_FRAME, _FRAME]."""
    cycles = np.fft.fftfreq(_FRAME) * _FRAME
    square = cycles[:, None] ** 2 + cycles[None, :] ** 2
    return np.asarray(1 / np.maximum(square, 0.5))
