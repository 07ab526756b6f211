"""Crops of pictures side by side, pixel by pixel, at places that the truth chooses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.typing import FloatArray
from validation.reports.page import png_address

CROP_PX = 72  # side of a crop
ENLARGED = 2  # each pixel is shown as a square of so many: seen at 1:1 on screens of high resolution
GAP_PX = 4
BACKGROUND = 1.0


def places(details: Mapping[str, NDArray[Any]], size_px: int = CROP_PX) -> dict[str, tuple[int, int]]:
    """Top left corners (y, x) of the crops with the largest sum of each map of details, by the maps' names.

    Maps are [h, w], 0 and above, and 0 where a crop is not wanted. No two crops overlap: the first has the
    choice. Maps of which no free crop shows anything are left out.
    """
    found: dict[str, tuple[int, int]] = {}
    for name, detail in details.items():
        sums = _window_sums(detail, size_px)
        y, x = np.mgrid[: sums.shape[0], : sums.shape[1]]
        for top, left in found.values():
            sums[np.maximum(np.abs(y - top), np.abs(x - left)) < size_px] = 0
        if sums.size and sums.max() > 0:
            top, left = (int(i) for i in np.unravel_index(np.argmax(sums), sums.shape))
            found[name] = top, left
    return found


def _window_sums(image: NDArray[Any], size_px: int) -> FloatArray:
    """Sums over all windows of a size that lie in the image, [h - size + 1, w - size + 1]; empty without any."""
    if min(image.shape) < size_px:
        return np.zeros((0, 0))
    total = cv2.integral(image.astype(np.float64))
    sums = total[size_px:, size_px:] - total[:-size_px, size_px:] - total[size_px:, :-size_px]
    return np.asarray(np.maximum(sums + total[:-size_px, :-size_px], 0))


def sheet(
    images: Sequence[NDArray[Any]], corners: Sequence[tuple[int, int]], size_px: int = CROP_PX
) -> NDArray[np.float64]:
    """Crops of display pictures [h, w, 3]: a row for each picture, a column for each corner, with white gaps.

    Nothing is interpolated: a pixel becomes ``ENLARGED`` x ``ENLARGED`` equal ones.
    """
    side, pitch = ENLARGED * size_px, ENLARGED * size_px + GAP_PX
    canvas = np.full((pitch * len(images) - GAP_PX, pitch * len(corners) - GAP_PX, 3), BACKGROUND)
    for row, image in enumerate(images):
        for column, (top, left) in enumerate(corners):
            crop = image[top : top + size_px, left : left + size_px].repeat(ENLARGED, axis=0).repeat(ENLARGED, axis=1)
            canvas[row * pitch : row * pitch + side, column * pitch : column * pitch + side] = crop
    return canvas


def sheet_address(images: Sequence[NDArray[Any]], corners: Sequence[tuple[int, int]]) -> str:
    """The sheet of crops as a data URL (PNG)."""
    return png_address(sheet(images, corners))
