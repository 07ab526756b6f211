"""Files of masks: a PNG that a camera reads back, and an SVG whose lengths and areas are in millimetres."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

import dasim
import dasim.base.toml
from dasim.camera import stops
from validation.studies.shape import drawings, masks


def test_a_camera_reads_back_the_png_of_a_mask(tmp_path) -> None:  # type: ignore[no-untyped-def]
    grey = np.random.default_rng(1).uniform(0, 1, (16, 16)) * masks.inside(16)
    drawings.save_png(tmp_path / "mask.png", grey)
    stop = dasim.base.toml.parse(
        stops.Mask, {"name": "hole", "shape": "mask", "file": "mask.png"}, "mask", folder=tmp_path
    )
    read = np.array(stop.mask)
    assert len(read) == stops.MOST_MASK_CELLS
    middle = read[8::16, 8::16]
    np.testing.assert_allclose(middle[4:12, 4:12], (grey**2)[4:12, 4:12], atol=1e-4)
    assert cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_ANYDEPTH).dtype == np.uint16


def test_a_drawing_is_in_mm(camera: dasim.Camera) -> None:
    mask = masks.disc(64, 0.2116)
    drawing = drawings.svg(camera, mask, "disc")
    diameter_mm = 3.6 / 2.8
    circles = [float(value) for value in re.findall(r'<circle r="([\d.]+)"', drawing)]
    assert circles == pytest.approx([diameter_mm / 2] * 2, abs=1e-4)
    cells = re.findall(r'<rect x="[-\d.]+" y="[-\d.]+" width="([\d.]+)" height="([\d.]+)"/>', drawing)
    area = sum(float(width) * float(height) for width, height in cells)
    assert area == pytest.approx(masks.budget(mask) * np.pi * (diameter_mm / 2) ** 2, rel=1e-3)
    assert f"{diameter_mm:.3f} mm" in drawing
