"""Huygens's sums against closed forms: the Airy pattern, its width off the axis, and equal light out of focus."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j1

from validation.references.huygens import Bench, intensity

IMAGE_M, PITCH_M, NM = 3.633e-3, 1.7e-6, 730.0
HOLE_M = 0.46 * 3.6e-3 / 5.6
SCALE_PX = NM * 1e-9 * IMAGE_M / (2 * HOLE_M) / PITCH_M  # lambda N
PEAK = 0.002  # of the peak; sines of angles up to 5 degrees are 0.3 % below their tangents
WIDTH_PX = 0.01
LIGHT = 0.02


def hole(angle_deg: float = 0.0, depth_m: float = 0.4) -> Bench:
    return Bench(HOLE_M, IMAGE_M, 0.4, depth_m, (float(np.tan(np.radians(angle_deg))), 0.0))


def width(line: np.ndarray, place: np.ndarray) -> float:
    """Full width at half maximum of a single peak, with linear interpolation."""
    half, peak = line.max() / 2, int(line.argmax())
    return float(np.interp(-half, -line[peak:], place[peak:]) - np.interp(half, line[: peak + 1], place[: peak + 1]))


def test_axis_has_the_airy_pattern():
    place = np.arange(-8, 8.01, 0.5)
    found = intensity(hole(), np.array([NM]), place * PITCH_M, 64)[0]
    v = np.maximum(np.pi * np.hypot(place[:, None], place[None, :]) / SCALE_PX, 1e-9)
    np.testing.assert_allclose(found / found.max(), (2 * j1(v) / v) ** 2, atol=PEAK)


@pytest.mark.parametrize(("angle_deg", "tangential", "sagittal"), [(0, 1, 1), (8.5, 3, 1), (25.6, 3, 1), (31, 3, 1)])
def test_widths_grow_with_powers_of_the_cosine(angle_deg, tangential, sagittal):
    """Expectation: the Airy pattern's full width 1.029 lambda N over cos^3 along the field and cos across it."""
    place = np.arange(-3, 3.01, 0.05)
    found = intensity(hole(angle_deg), np.array([NM]), place * PITCH_M, 48)[0]
    middle, cosine = len(place) // 2, np.cos(np.radians(angle_deg))
    assert width(found[middle], place) == pytest.approx(1.029 * SCALE_PX / cosine**tangential, abs=WIDTH_PX)
    assert width(found[:, middle], place) == pytest.approx(1.029 * SCALE_PX / cosine**sagittal, abs=WIDTH_PX)


def test_light_does_not_depend_on_wavelength_stop_or_focus():
    """Expectation: equal sums over a frame that holds all but the tails, 0.5 to 1 % of the light."""
    place, nm = np.arange(-24, 24, 0.5) * PITCH_M, np.array([650.0, 800.0])
    wide = Bench(2 * HOLE_M, IMAGE_M, 0.4, 0.4, (0.0, 0.0))
    sums = [intensity(bench, nm, place, 48).sum(axis=(1, 2)) for bench in (hole(), wide)]
    np.testing.assert_allclose(sums, np.mean(sums), rtol=LIGHT)
    near = intensity(hole(depth_m=0.2), nm, place, 48).sum(axis=(1, 2)) * 0.2**2 / 0.4**2
    np.testing.assert_allclose(near, np.mean(sums), rtol=LIGHT)
