"""Diffraction off the axis: T as a matrix, and weighted draws against the transform of the foreshortened pupil."""

from __future__ import annotations

import numpy as np
import pytest

COUNT = 1 << 20
THETA = np.radians(31.0)
ENERGY = 0.01  # a million draws are known to 0.001, the rest is the astigmatism of defocus
NM = 730.0


def matrix(tangent: np.ndarray) -> np.ndarray:
    """T in the picture, from its tangential and sagittal directions."""
    along = tangent / np.hypot(*tangent)
    across = np.array([-along[1], along[0]])
    cosine = 1 / np.sqrt(1 + tangent @ tangent)
    return cosine**3 * np.outer(along, along) + cosine * np.outer(across, across)


@pytest.mark.parametrize("tangent", [(0.6, 0.0), (0.0, -0.2), (-0.3, 0.4)])
def test_foreshortening_is_the_matrix(jit, tangent):
    import mitsuba as mi

    from dasim.render import field_angle

    v, expected = np.array([1.5, -0.7]), matrix(np.array(tangent))
    at, angle = mi.Vector2f(*v.tolist()), mi.Vector2f(*tangent)
    np.testing.assert_allclose(np.array(field_angle.foreshortened(at, angle)).ravel(), expected @ v, rtol=1e-5)
    np.testing.assert_allclose(
        np.array(field_angle.widened(at, angle)).ravel(), np.linalg.solve(expected, v), rtol=1e-5
    )
    ratio = np.hypot(*(expected @ v)) / np.hypot(*v)
    assert float(field_angle.scale_along(at, angle)[0]) == pytest.approx(ratio, rel=1e-5)
    assert float(field_angle.mean_scale(angle)[0]) == pytest.approx(np.sqrt(np.linalg.det(expected)), rel=1e-5)
    assert float(field_angle.scale_along(mi.Vector2f(0.0), mi.Vector2f(0.0))[0]) == 1


def pattern(own_px: float, scale_px: float, place: np.ndarray) -> np.ndarray:
    """Intensity [sagittal, tangential] of a disc's light at THETA; ``scale_px`` is lambda N.

    |int exp(i pi rho T u / scale + 2 pi i W rho T rho)|^2 with W of the axis.
    """
    t, cells = np.cos(THETA) ** np.array([3, 1]), 200
    rho = (np.arange(cells) + 0.5) * 2 / cells - 1
    y, x = np.meshgrid(rho, rho, indexing="ij")
    waves = own_px / (8 * scale_px)
    light = (np.hypot(x, y) <= 1) * np.exp(2j * np.pi * waves * (t[0] * x**2 + t[1] * y**2))
    path = [np.exp(1j * np.pi * np.outer(place * scale / scale_px, rho)) for scale in t]
    return np.abs(path[1] @ light @ path[0].T) ** 2


@pytest.mark.parametrize("own_px", [0.0, 4.0, 10.0])
def test_weighted_draws_have_the_pattern_of_the_foreshortened_pupil(jit, da_mobile, own_px):
    """Set-up: a million draws through the hole at 730 nm, 31 degrees off the axis, in focus and out of it.

    Expectation: energies within circles and on either side of the middle in both directions, within 0.01 of those of
    the pupil's transform in the same square; those of the axis differ by up to 0.2 in focus.
    """
    import drjit as dr
    import mitsuba as mi

    from dasim.render import field_angle, radial_tables

    hole = da_mobile.stops[1]
    blur = radial_tables.tables(da_mobile, hole, [(NM, 1.0)], NM, 60.0)
    scale_px = NM * float(blur.px_per_nm[0])
    rng = np.random.default_rng(4)
    first, second = (mi.Point2f(rng.random((2, COUNT), dtype=np.float32)) for _ in range(2))
    angle = mi.Vector2f(dr.full(mi.Float, np.tan(THETA), COUNT), 0.0)
    visible_px = mi.Float(own_px / hole.radius_ratio)
    expected = visible_px * field_angle.mean_scale(angle)
    rho, delta, drawn, *_ = blur.draw(first, second, expected, mi.Vector2f(0.0), mi.UInt32(3))
    u = -field_angle.widened(delta, angle) - rho * (visible_px / 2)
    weight = np.array(drawn * blur.weights(u, visible_px, angle, [mi.Float(NM)])[0], dtype=np.float64)
    x, y = np.array(u, dtype=np.float64)

    step, half = 0.2, 20.0
    place = np.arange(-half + step / 2, half, step)
    expected = pattern(own_px, scale_px, place)
    expected /= expected.sum()
    found, *_ = np.histogram2d(y, x, bins=[np.append(place - step / 2, half)] * 2, weights=weight)
    found /= found.sum()
    for axis in (0, 1):
        assert np.abs(np.cumsum(found.sum(axis)) - np.cumsum(expected.sum(axis))).max() < ENERGY, axis
    distance = np.hypot(place[:, None], place[None, :])
    for radius in np.arange(0.5, half, 0.5):
        inside = distance <= radius
        assert found[inside].sum() == pytest.approx(expected[inside].sum(), abs=ENERGY), radius
