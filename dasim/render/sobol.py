"""Sobol' points with Owen scrambling for the first dimensions of every ray, in the JIT variants.

Mitsuba's samplers stratify pairs of dimensions, which leaves the place on the film jointly with that on the lens
unstratified. A Sobol' sequence is stratified in all its dimensions; each pixel scrambles it with a key of its own
(hash-based scrambling: Laine and Karras, 2011; Burley, J. Computer Graphics Techniques 9(4), 2020).
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.render.plugin import aligned

DIMENSIONS = 12
_BITS = 32


@cache
def _fractions(count: int) -> NDArray[np.uint32]:
    """The first points of the sequence as 32-bit fractions, [count, DIMENSIONS]."""
    from scipy.stats import qmc

    sequence = qmc.Sobol(DIMENSIONS, scramble=False, bits=_BITS)
    whole = sequence.random_base2(int(np.ceil(np.log2(max(count, 2)))))[:count]
    return (whole * 2.0**_BITS).astype(np.uint64).astype(np.uint32)


def points(count: int) -> Any:
    """The first points of the sequence, for :class:`Sobol`."""
    import mitsuba as mi

    return mi.UInt32(aligned(_fractions(count)))


class Sobol:
    """A sampler with the interface of Mitsuba's: each call takes the next one or two of ``DIMENSIONS`` dimensions.

    ``points`` are those of :func:`points`, ``index`` is the number of the sample within its pixel (below their count),
    and ``key`` a number unique to the pixel.
    """

    def __init__(self, points: Any, index: Any, key: Any) -> None:
        self._table = points
        self._index, self._key = index * DIMENSIONS, key
        self._dimension = 0

    def next_1d(self) -> Any:
        """Uniform number in 0..1."""
        import drjit as dr
        import mitsuba as mi

        dimension = self._dimension
        self._dimension += 1
        assert dimension < DIMENSIONS
        bits = dr.gather(mi.UInt32, self._table, self._index + dimension)
        bits = _scrambled(bits, mi.sample_tea_32(self._key, dimension)[0])
        return mi.Float(bits >> 8) * 2.0**-24

    def next_2d(self) -> Any:
        """Two uniform numbers in 0..1."""
        import mitsuba as mi

        first = self.next_1d()
        return mi.Point2f(first, self.next_1d())


def _scrambled(bits: Any, key: Any) -> Any:
    """Nested uniform scrambling: a hash of the key and the higher bits decides whether a bit is flipped."""
    import drjit as dr

    bits = dr.brev(bits)
    bits += key
    for factor in (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6):
        bits ^= bits * factor
    return dr.brev(bits)
