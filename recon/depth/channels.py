"""Channels as they are compared: planes with their phase, noise and kernels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from numpy.typing import NDArray

from dasim.typing import Float32Array
from recon.picture.mosaic import Phase

Channel = tuple[Float32Array, Phase, Float32Array, NDArray]
"""Plane [h, w], phase, noise variance [h, w], kernels [level, y, x]."""


class Leak(NamedTuple):
    """Infrared in a channel: alpha of eq. (8), and a white point's infrared electrons relative to the channel's own."""

    alpha: float
    white: float


Also = Sequence[tuple[Channel, Leak]]
"""Further visible channels, compared in the same way by the score ``bands``."""
