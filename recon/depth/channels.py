"""Channels of a depth comparison: colour planes with their phase, noise and kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from numpy.typing import NDArray

from dasim.typing import Float32Array
from recon.picture.mosaic import Phase


class Channel(NamedTuple):
    """A colour plane and its kernels at every blur level."""

    plane: Float32Array  # [h, w] electrons
    phase: Phase  # (row, column) of its first sample in the mosaic's 2x2 block
    variance: Float32Array  # [h, w] of the noise
    kernels: NDArray  # [level, y, x] raw pixels


class Leak(NamedTuple):
    """Share of infrared in a visible channel."""

    alpha: float  # of eq. (8)
    white: float  # infrared electrons of a white point, relative to the channel's


def kernels_without_infrared(visible: Channel, leak: Leak, infrared: Channel) -> NDArray:
    """Kernels of a visible channel less infrared, [level, y, x], of sum 1 as its own."""
    share = leak.alpha * leak.white
    return (visible.kernels - share * infrared.kernels) / (1 - share)


Also = Sequence[tuple[Channel, Leak]]
"""Further visible channels that the score ``bands`` compares with infrared."""
