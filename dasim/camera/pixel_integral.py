"""Light of point images over the pixels: integrals of radial profiles, and of a pupil's cells.

Tested in tests/dasim/camera/test_pixel_integral.py and tests/dasim/camera/test_pointspread.py.
"""

from __future__ import annotations

import numpy as np

from dasim.camera.radial_pattern import SUBPIXELS, unit_nodes
from dasim.typing import FloatArray


def pixel_kernels(
    profiles: FloatArray,
    radius_px: FloatArray,
    size: int,
    offset_px: tuple[float, float] = (0.0, 0.0),
    nodes: int | None = None,
) -> FloatArray:
    """Integrate radial profiles [..., radius] over the pixels of a ``size`` x ``size`` frame (odd).

    The point's image lies at ``offset_px`` (y, x) from the centre of the middle pixel. Smooth profiles need few
    Gauss-Legendre ``nodes`` per pixel and axis; without a number, a pixel is the mean of ``SUBPIXELS`` x ``SUBPIXELS``
    points, for profiles with edges.
    """
    place, share = (np.arange(SUBPIXELS) + 0.5) / SUBPIXELS, np.full(SUBPIXELS, 1 / SUBPIXELS)
    if nodes is not None:
        place, share = unit_nodes(nodes)
    fine = (np.arange(size)[:, None] + place).ravel() - size / 2
    distance = np.hypot(fine[:, None] - offset_px[0], fine[None, :] - offset_px[1]).ravel()
    flat = profiles.reshape(-1, profiles.shape[-1])
    kernels = np.empty((len(flat), size, size))
    for row, profile in enumerate(flat):
        value = np.interp(distance, radius_px, profile, right=0.0)
        kernels[row] = (value.reshape(size, len(share), size, len(share)) @ share).swapaxes(1, 2) @ share
    return kernels.reshape(*profiles.shape[:-1], size, size)


def deposited(rows: FloatArray, columns: FloatArray, light: FloatArray, side: float, size: int) -> FloatArray:
    """Light of squares of a ``side`` about places in pixels from a frame's corner, over its pixels, [size, size].

    Squares and not points, which would beat with the pixels.
    """
    parts = max(1, int(np.ceil(side)))  # a part covers two pixels of a row at most
    width = max(side / parts, 1e-6)
    offsets = (np.arange(parts) + 0.5) * width - side / 2
    total = np.zeros((size + 2) ** 2)  # with a rim that collects what lies outside
    for down in offsets:
        for across in offsets:
            first, share = [], []
            for place in (rows + down, columns + across):
                low = np.floor(place - width / 2)
                first.append(np.clip(low, -1, size).astype(int) + 1)
                share.append(np.clip((place + width / 2 - (low + 1)) / width, 0, 1))
            for step_y in (0, 1):
                for step_x in (0, 1):
                    y, x = np.minimum(first[0] + step_y, size + 1), np.minimum(first[1] + step_x, size + 1)
                    part = (share[0] if step_y else 1 - share[0]) * (share[1] if step_x else 1 - share[1])
                    total += np.bincount((y * (size + 2) + x).ravel(), (part * light).ravel(), len(total))
    return total.reshape(size + 2, size + 2)[1:-1, 1:-1] / parts**2
