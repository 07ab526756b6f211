"""Rounding of the control variate's picture to half precision."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.render import control_picture


def test_half_precision_keeps_the_mean():
    """Rationale: nodes of an even surface differ by less than a step of half precision, and would all round one way.

    Expectation: values between two steps are one or the other, and their mean is the value.
    """
    for value in (0.3 + 1e-5, 0.7 + 3e-4, -0.7 - 3e-4, 5e3 + 1.3, 2e-3, 1e-5 + 2e-8, 1e-8, -1e-8, 0.0):
        found = control_picture._to_half(np.full((300, 500), value, np.float32)).astype(float)
        step = abs(np.spacing(np.float16(value)).astype(float))
        assert np.abs(found - value).max() <= step
        assert found.mean() == pytest.approx(value, abs=4 * step / np.sqrt(128**2 * 4))
