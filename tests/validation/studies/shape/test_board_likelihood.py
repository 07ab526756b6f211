"""Maximum likelihood on rendered boards: the likelihood at a frequency, and the search for the largest one.

The bounds of its table have tests in ``test_criteria.py`` and ``test_finite_patch.py``.
"""

from __future__ import annotations

import numpy as np
import pytest

from validation.studies.shape import board_likelihood
from validation.studies.shape.board_likelihood import Limits


def test_likelihood_finds_the_candidate_between_two() -> None:
    candidates = np.arange(5.0, 9.0, 0.5)
    scores = -((candidates[:, None, None] - np.array([[6.6, 7.25]])) ** 2)
    np.testing.assert_allclose(board_likelihood._most_likely(scores, candidates), [[6.6, 7.25]])


def test_steps_are_root_mean_squares_over_the_levels() -> None:
    steps = Limits((3.0, 4.0), (1.0, 1.0), ((1.0, 7.0), (2.0, 2.0)), ((0.0, 2.0),)).steps()
    assert list(steps.values()) == [
        pytest.approx(np.sqrt([12.5])), pytest.approx([1.0]), pytest.approx([5.0, 2.0]), pytest.approx(np.sqrt([2.0]))
    ]  # fmt: skip


def test_whitened_spectra_give_the_likelihood_of_the_covariance_matrix() -> None:
    """y^H C^-1 y and ln det C of random spectra, against the inverse and the determinant of each 2x2 matrix."""
    random = np.random.default_rng(4)
    y, s = random.normal(size=(2, 2, 5, 3)) + 1j * random.normal(size=(2, 2, 5, 3))
    power, noise = random.uniform(0.5, 2, (5, 3)), (0.3, 0.7)
    parts, log_determinant = board_likelihood._whitened(y, s, power, noise)
    both, data = np.moveaxis(s, 0, -1)[..., None], np.moveaxis(y, 0, -1)[..., None]
    covariance = power[..., None, None] * both @ np.conj(np.swapaxes(both, -1, -2)) + np.diag(noise)
    square = np.conj(np.swapaxes(data, -1, -2)) @ np.linalg.inv(covariance) @ data
    np.testing.assert_allclose(sum(np.abs(part) ** 2 for part in parts), square[..., 0, 0].real)
    np.testing.assert_allclose(log_determinant, np.log(np.linalg.det(covariance).real))
