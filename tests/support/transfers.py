"""Transfer functions of sampled kernels by a direct Fourier sum, as an independent check of closed forms."""

from __future__ import annotations

import numpy as np

from dasim.typing import FloatArray


def kernel_transfer(kernel: FloatArray, shape: tuple[int, int], spacing_px: float = 1.0) -> np.ndarray:
    """Transfer function of a kernel [y, x] of odd size about its middle pixel, [h, w/2 + 1], complex."""
    down = np.fft.fftfreq(shape[0], spacing_px)
    along = np.fft.rfftfreq(shape[1], spacing_px)
    rows, columns = (np.arange(n) - n // 2 for n in kernel.shape)
    return np.exp(-2j * np.pi * np.outer(down, rows)) @ kernel @ np.exp(-2j * np.pi * np.outer(columns, along))
