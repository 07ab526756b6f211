"""Array and callback types that all packages share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Complex64Array = NDArray[np.complex64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]

Progress = Callable[[str, float], None]
"""Called with the name of a stage and the share 0..1 of it that is done."""

ShareDone = Callable[[float], None]
"""Called with the share 0..1 that is done of a task that has no stages."""
