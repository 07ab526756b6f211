"""What a patch tells without its surroundings, against the bound of a periodic one."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.bounds import pupils
from dasim.camera import specification as cameras
from validation.studies import criteria
from validation.studies.shape import board_likelihood, masks, pipeline

BUDGET = 0.2116
SMALL_BLUR, WIDE_BLUR = 4.0, 40.0  # an eighth of a patch of 31 px, and more than all of it
BOUNDARY = 0.15  # of a deviation, what the borders of a patch of eight blurs take


@pytest.fixture(scope="module")
def camera() -> dasim.Camera:
    return cameras.refocused(dasim.load_camera("da-mobile"), 0.4)


def windows(camera: dasim.Camera) -> dasim.Camera:
    """The camera with two windows at opposite ends of the lens."""
    half = masks.disc(48, BUDGET / 2, (0.67, 0.0)) + masks.disc(48, BUDGET / 2, (-0.67, 0.0))
    return masks.camera_with(camera, half)


def periodic(camera: dasim.Camera, blur: float) -> float:
    seen = criteria.sight(camera, "D65", 5000.0)
    transfer, slope = pupils.camera_transfers(camera, blur, "D65", criteria.SHAPE, spacing_px=criteria.SPACING_PX)
    pair = [cameras.channels(camera.sensor).index(name) for name in criteria.PLANES]
    variance, _ = criteria.blur_variance(transfer[:, pair], slope[:, pair], seen, "spectrum")
    return float(np.sqrt(variance[0] * seen.area * criteria.SHAPE[0] * criteria.SHAPE[1] / board_likelihood.SIDE**2))


def test_a_patch_much_larger_than_the_blur_needs_no_surroundings(camera: dasim.Camera) -> None:
    """Two ways that share no formula: frequencies of a periodic patch, and covariances between all of its pixels."""
    for own in (camera, windows(camera)):
        found = board_likelihood.cut_deviation(own, np.array([SMALL_BLUR]), board_likelihood.SIDE)[0]
        assert found == pytest.approx(periodic(own, SMALL_BLUR), rel=BOUNDARY)


def test_without_its_surroundings_a_patch_of_one_blur_tells_nothing_more_by_two_windows(camera: dasim.Camera) -> None:
    """The periodic bound promises a fifth less error and more; cut out, the same patch has more error than the disc."""
    two = windows(camera)
    assert periodic(two, 20.0) < 0.85 * periodic(camera, 20.0)
    cut = [
        board_likelihood.cut_deviation(own, np.array([WIDE_BLUR]), board_likelihood.SIDE)[0] for own in (camera, two)
    ]
    assert cut[1] > cut[0] > 1.3 * periodic(camera, WIDE_BLUR)


def test_a_larger_patch_tells_more_than_its_share(camera: dasim.Camera) -> None:
    """Four times the pixels without borders would halve the deviation; borders lose their weight as well."""
    small, large = (board_likelihood.cut_deviation(camera, np.array([20.0]), side)[0] for side in (8, 16))
    assert large < small / 2


def test_no_patch_is_larger_than_half_its_field(camera: dasim.Camera) -> None:
    with pytest.raises(ValueError, match="twice"):
        board_likelihood.cut_deviation(camera, np.array([5.0]), board_likelihood.FIELD // 2 + 1)


def test_ratios_are_taken_exposure_by_exposure() -> None:
    assert pipeline.ratio((1.0, 2.0, 3.0), (2.0, 4.0, 6.0)) == (0.5, 0.0)
    mean, spread = pipeline.ratio((1.0,), (2.0,))
    assert mean == 0.5
    assert np.isnan(spread)


def test_likelihood_finds_the_candidate_between_two() -> None:
    candidates = np.arange(5.0, 9.0, 0.5)
    scores = -((candidates[:, None, None] - np.array([[6.6, 7.25]])) ** 2)
    np.testing.assert_allclose(board_likelihood._refined(scores, candidates), [[6.6, 7.25]])
