"""Crops show the places with the most detail, and every pixel as it is."""

from __future__ import annotations

import numpy as np

from validation.reports import crops

SHAPE = (100, 150)


def test_a_crop_holds_the_detail_and_no_two_overlap():
    """Set-up: both maps have their largest detail at one place, the second a smaller one elsewhere."""
    first, second = np.zeros(SHAPE), np.zeros(SHAPE)
    first[20, 30] = second[20, 30] = 5.0
    second[80, 120] = 1.0
    found = crops.places({"first": first, "second": second, "nothing": np.zeros(SHAPE)}, 20)
    assert list(found) == ["first", "second"]
    for (top, left), (y, x) in zip(found.values(), [(20, 30), (80, 120)], strict=True):
        assert top <= y < top + 20 and left <= x < left + 20
    assert all(0 <= top <= SHAPE[0] - 20 and 0 <= left <= SHAPE[1] - 20 for top, left in found.values())


def test_the_crop_with_the_largest_sum_is_found():
    detail = np.zeros(SHAPE)
    detail[10, 10], detail[60:70, 90:100] = 50.0, 1.0
    assert crops.places({"": detail}, 10) == {"": (60, 90)}


def test_a_frame_smaller_than_a_crop_has_none():
    assert crops.places({"": np.ones((10, 100))}, 20) == {}


def test_a_sheet_shows_the_pixels_of_each_picture():
    """Expectation: rows of pictures, columns of places; nothing but equal squares and white gaps."""
    pictures = [np.random.default_rng(number).random((*SHAPE, 3)) for number in range(2)]
    corners = [(0, 0), (30, 40), (80, 130)]
    sheet = crops.sheet(pictures, corners, 20)
    side, pitch = 20 * crops.ENLARGED, 20 * crops.ENLARGED + crops.GAP_PX
    assert sheet.shape == (2 * pitch - crops.GAP_PX, 3 * pitch - crops.GAP_PX, 3)
    for row, picture in enumerate(pictures):
        for column, (top, left) in enumerate(corners):
            block = sheet[row * pitch : row * pitch + side, column * pitch : column * pitch + side]
            for y in range(crops.ENLARGED):
                np.testing.assert_array_equal(
                    block[y :: crops.ENLARGED, y :: crops.ENLARGED], picture[top : top + 20, left : left + 20]
                )
    assert (sheet[:, side:pitch] == crops.BACKGROUND).all()
