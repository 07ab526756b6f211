"""Packed values come back as they were, and pictures nearly so."""

import base64

import cv2
import numpy as np

from tests.support import viewed
from validation.reports.view.packing import LARGEST, NO_VALUE, lossless, lossy, packed_map, unpacked

GOOD_DB = 35.0  # of WebP at quality 92 on a small photograph full of edges, with half the resolution of colour


def test_integers_come_back():
    """Rationale: differences run over the ends of 16 bits; both ends are there."""
    values = np.random.default_rng(1).integers(0, LARGEST, (7, 33), endpoint=True).astype(np.uint16)
    values[0, :3] = 0, LARGEST, 0
    assert np.array_equal(unpacked(lossless(values), values.shape), values)


def test_map_is_within_half_a_step():
    values = np.random.default_rng(2).uniform(-3, 11, (20, 31)).astype(np.float32)
    values[4, 5], values[6, 7] = np.nan, np.inf
    packed = packed_map(values)
    numbers = unpacked(packed["data"], values.shape)
    known = np.isfinite(values)
    assert np.array_equal(numbers == NO_VALUE, ~known)
    back = packed["low"] + (numbers.astype(np.float64) - 1) * packed["step"]
    assert np.abs(back - values)[known].max() <= packed["step"] * 0.501
    assert packed["step"] < 14 / (LARGEST - 2)


def test_maps_without_a_range_or_a_value():
    level = packed_map(np.full((3, 4), 2.5))
    assert level["low"] == 2.5 and level["step"] == 0 and (unpacked(level["data"], (3, 4)) == 1).all()
    assert (unpacked(packed_map(np.full((3, 4), np.nan))["data"], (3, 4)) == NO_VALUE).all()


def test_pictures_are_close():
    picture = viewed.example().result.rgb
    for image in (picture, picture[..., 0]):
        data = np.frombuffer(base64.b64decode(lossy(image, 92)), np.uint8)
        back = cv2.imdecode(data, cv2.IMREAD_COLOR)[..., ::-1]
        shown = np.rint(image * 255).astype(np.uint8)
        assert cv2.PSNR(back if image.ndim == 3 else back[..., 0].copy(), shown) > GOOD_DB
