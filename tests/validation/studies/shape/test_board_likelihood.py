"""Maximum likelihood on rendered boards: the search for the largest likelihood.

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
