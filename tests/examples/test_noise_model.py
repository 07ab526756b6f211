"""The example of a noise model of one's own has the noise that it says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dasim.base.loading import function_name, load_function
from dasim.camera import noise

EXAMPLE = Path(__file__).parents[2] / "examples" / "noise_model.py"
ROWS, COLUMNS = 1000, 400


@pytest.fixture(scope="module")
def model():
    return load_function(f"{EXAMPLE}:column_and_telegraph", "noise model")


def frame_e(model, sensor, mean_e, seed=0):
    raw, _ = noise.apply(model, np.full((ROWS, COLUMNS), mean_e), sensor, 0.01, seed, 1.0)
    return (raw.astype(float) - sensor.black_level_dn) * noise.electrons_per_dn(sensor)


def test_columns_have_offsets_of_their_own(model, da_mobile):
    """Expectation: the means of columns spread by 2 electrons and by what the noise of 1,000 pixels leaves; those of
    the bundled model by the latter alone. A standard deviation of 400 columns is known to 3.5 %; four of these.
    """
    left = np.sqrt(noise.temporal_variance(da_mobile.sensor, 0.01).at(500.0) / ROWS)
    spread = frame_e(model, da_mobile.sensor, 500.0).mean(axis=0).std()
    assert spread == pytest.approx(np.hypot(2.0, left), rel=0.14)
    silent = da_mobile.sensor.model_copy(update={"prnu": 0.0, "dsnu_e": 0.0, "row_noise_e": 0.0, "column_noise_e": 0.0})
    assert frame_e(noise.expose, silent, 500.0).mean(axis=0).std() == pytest.approx(left, rel=0.14)


def test_telegraph_pixels_add_their_variance(model, da_mobile):
    """Set-up: no light. Expectation: a share q = 0.5 % of the pixels is raised by 20 electrons, which adds
    q (1 - q) 20^2 to the variance within columns of 12.4 (dark current, read noise, rounding). Limit: five standard
    errors sqrt(m4 / n) for a fourth moment m4 of q 20^4 + 3 x 14.4^2 and 400,000 pixels.
    """
    electrons = frame_e(model, da_mobile.sensor, 0.0)
    within = (electrons - electrons.mean(axis=0)).var() * ROWS / (ROWS - 1)
    added, limit = 0.005 * 0.995 * 20.0**2, 5 * np.sqrt((0.005 * 20.0**4 + 3 * 14.4**2) / electrons.size)
    assert within == pytest.approx(noise.temporal_variance(da_mobile.sensor, 0.01).at(0.0) + added, abs=limit)
    assert added > 4 * limit


def test_same_seed_same_numbers_and_a_name(model, da_mobile):
    first, again, other = (frame_e(model, da_mobile.sensor, 500.0, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert function_name(model) == "noise_model.py:column_and_telegraph"
