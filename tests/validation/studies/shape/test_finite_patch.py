"""The bound of a patch without its surroundings, against that of a periodic patch."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from validation.studies import criteria
from validation.studies.shape import finite_patch, masks
from validation.studies.shape.infrared_stop import with_mask

BUDGET = 0.2116
SMALL_BLUR, WIDE_BLUR = 4.0, 40.0  # an eighth of a patch of 31 px, and more than all of it
BOUNDARY = 0.15  # of a deviation: the effect of the borders of a patch of eight blurs


def windows(camera: dasim.Camera) -> dasim.Camera:
    """The camera with two windows at opposite ends of the lens."""
    half = masks.disc(48, BUDGET / 2, (0.67, 0.0)) + masks.disc(48, BUDGET / 2, (-0.67, 0.0))
    return with_mask(camera, half)


def periodic(camera: dasim.Camera, blur: float) -> float:
    """The periodic bound, scaled from the area of its patch to that of ``SIDE`` x ``SIDE`` samples."""
    area = criteria.texture_patch(camera, "D65", 5000.0).area * criteria.SHAPE[0] * criteria.SHAPE[1]
    deviation = criteria.camera_bound(camera, blur, texture="spectrum")
    return float(deviation[0] * np.sqrt(area / finite_patch.SIDE**2))


def test_a_patch_much_larger_than_the_blur_needs_no_surroundings(camera: dasim.Camera) -> None:
    """Two methods that share no formula: frequencies of a periodic patch, and covariances between all of its pixels."""
    for design in (camera, windows(camera)):
        bound = finite_patch.cut_deviation(design, np.array([SMALL_BLUR]), finite_patch.SIDE)[0]
        assert bound == pytest.approx(periodic(design, SMALL_BLUR), rel=BOUNDARY)


def test_without_its_surroundings_a_patch_gains_nothing_from_two_windows(camera: dasim.Camera) -> None:
    """By the periodic bound two windows have at least 15 % less error than the disc; without surroundings, more."""
    two = windows(camera)
    assert periodic(two, 20.0) < 0.85 * periodic(camera, 20.0)
    cut = [finite_patch.cut_deviation(design, np.array([WIDE_BLUR]), finite_patch.SIDE)[0] for design in (camera, two)]
    assert cut[1] > cut[0] > 1.3 * periodic(camera, WIDE_BLUR)


def test_the_bound_falls_faster_than_the_area_of_the_patch_grows(camera: dasim.Camera) -> None:
    """Four times the pixels would halve the deviation without borders; their share falls as well."""
    small, large = (finite_patch.cut_deviation(camera, np.array([20.0]), side)[0] for side in (8, 16))
    assert large < small / 2


def test_no_patch_is_larger_than_half_its_field(camera: dasim.Camera) -> None:
    with pytest.raises(ValueError, match="twice"):
        finite_patch.cut_deviation(camera, np.array([5.0]), finite_patch.FIELD // 2 + 1)
