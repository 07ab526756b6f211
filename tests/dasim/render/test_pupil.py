"""Points drawn on stops, and their sampled pupils, against areas and centroids in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import TypeAdapter

from dasim.camera import stops
from dasim.camera.stops import Stop

COUNT = 1 << 18
SHARE = 6 * 0.5 / COUNT**0.5  # six standard deviations of a share, at most
SAMPLED = 6e-4  # area of a sampled polygon: one of its 4,096 rows, 1.1 wide
ROUNDING = 1e-5  # of 32-bit places


def stop(shape: str, **values) -> Stop:
    return TypeAdapter(Stop).validate_python({"name": "stop", "shape": shape} | values)


@pytest.fixture(scope="module")
def points(jit):
    """Places (x, y) that are drawn on a stop, [2, n]."""
    import mitsuba as mi

    from dasim.render import pupil

    def points_of(stop: Stop) -> np.ndarray:
        numbers = np.random.default_rng(4).random((2, COUNT), dtype=np.float32)
        return np.array(pupil.drawer(stop)(mi.Point2f(numbers)), dtype=np.float64)

    return points_of


@pytest.mark.parametrize(("inner", "outer"), [(0.0, 0.4), (0.25, 0.5)])
def test_rings_are_even(points, inner, outer):
    """Expectation: none outside, the middle at the centre, r^2 evenly spread, as many in every eighth of a turn; the
    mean of r^2 is (inner^2 + outer^2) / 2.
    """
    centre = np.array([0.3, -0.2])
    shape = {"shape": "annulus", "inner_ratio": inner, "outer_ratio": outer}
    disc = {"shape": "disc", "radius_ratio": outer}
    place = points(stop(**(shape if inner else disc), centre_ratio=tuple(centre))) - centre[:, None]
    squared = (place**2).sum(axis=0)
    assert inner**2 - ROUNDING <= squared.min() and squared.max() <= outer**2 + ROUNDING
    np.testing.assert_allclose(place.mean(axis=1), 0, atol=SHARE)
    assert squared.mean() == pytest.approx((inner**2 + outer**2) / 2, abs=SHARE)
    for share in (0.2, 0.5, 0.8):
        assert np.mean(squared < inner**2 + share * (outer**2 - inner**2)) == pytest.approx(share, abs=SHARE)
    eighth = ((np.arctan2(place[1], place[0]) + np.pi) / (np.pi / 4)).astype(int) % 8
    np.testing.assert_allclose(np.bincount(eighth, minlength=8) / COUNT, 1 / 8, atol=SHARE)


def test_concave_polygon_is_even(points):
    """Set-up: a letter L of a stem 0.4 x 1.4 and a foot 0.7 x 0.4, y down, its corners in either order.

    Expectation: shares of stem and foot by area, centroid by moments, none in the notch; the sampled pupil has the
    same area and centroid.
    """
    corners = ((-0.6, -0.7), (-0.2, -0.7), (-0.2, 0.3), (0.5, 0.3), (0.5, 0.7), (-0.6, 0.7))
    stem, foot = 0.4 * 1.4, 0.7 * 0.4
    centroid = (np.array([-0.4, 0.0]) * stem + np.array([0.15, 0.5]) * foot) / (stem + foot)
    for order in (1, -1):
        letter = stop("polygon", corners_ratio=corners[::order])
        x, y = points(letter)
        in_stem = (x <= -0.2 + ROUNDING) & (abs(y) <= 0.7 + ROUNDING) & (x >= -0.6 - ROUNDING)
        in_foot = (x > -0.2) & (x <= 0.5 + ROUNDING) & (y >= 0.3 - ROUNDING) & (y <= 0.7 + ROUNDING)
        assert (in_stem | in_foot).all()
        assert np.mean(x <= -0.2) == pytest.approx(stem / (stem + foot), abs=SHARE)
        assert np.mean(in_stem & (y < -0.35)) == pytest.approx(stem / 4 / (stem + foot), abs=SHARE)
        np.testing.assert_allclose([x.mean(), y.mean()], centroid, atol=SHARE)
        values, place = stops.pupil(letter)
        area = values.sum() * (place[1] - place[0]) ** 2
        assert area == pytest.approx(stem + foot, abs=SAMPLED)
        assert stops.open_area(letter) == pytest.approx((stem + foot) / np.pi, rel=1e-12)
        moments = [values.sum(axis=0) @ place, values.sum(axis=1) @ place]
        np.testing.assert_allclose(np.array(moments) / values.sum(), centroid, atol=SAMPLED)


def test_grey_mask_is_drawn_by_its_transmittance(points):
    """Expectation: every cell's share of the points is its transmittance's, top row first; even within a cell."""
    mask = np.array([[0, 0, 0, 0], [0, 1.0, 0.5, 0], [0, 0, 0.25, 0], [0, 0, 0, 0]])
    grey = stop("mask", mask=mask.tolist())
    x, y = points(grey)
    histogram, _, _ = np.histogram2d(y, x, bins=np.linspace(-1, 1, 5).tolist())
    np.testing.assert_allclose(histogram / COUNT, mask / mask.sum(), atol=SHARE)
    cell = (x < 0) & (y < 0)
    np.testing.assert_allclose([x[cell].mean(), y[cell].mean()], -0.25, atol=SHARE)
    np.testing.assert_allclose([x[cell].var(), y[cell].var()], 0.5**2 / 12, atol=SHARE)
    assert stops.open_area(grey) == pytest.approx(1.75 * 0.25 / np.pi)
