"""Scores of a reconstruction with known errors of its levels; claims score the pipeline itself."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from validation.studies.shape import pipeline

VERGENCE = 10.0 + 0.2 * np.arange(16).reshape(4, 4)  # 1/m, of the levels 0 to 15


def result(level_raw: np.ndarray) -> SimpleNamespace:
    """What scores read of a reconstruction, with one known depth for each whole level."""
    return SimpleNamespace(level_raw=level_raw, level=np.arange(16.0).reshape(4, 4), depth_m=1 / VERGENCE)


def test_board_scores_are_the_error_about_its_median_and_about_0() -> None:
    """Half of the levels are off by 0.2 dioptres, half by 0.4: 0.1 about the median, hypot(0.3, 0.1) about 0."""
    level = np.where(np.arange(16).reshape(4, 4) % 2, 1.0, 2.0)
    level[0, :2] = np.nan, 15.0
    where = np.ones((4, 4), bool)
    where[0, 1] = False
    level[3, 3] = np.nan
    where[3, 2] = False  # six of each remain
    truth = SimpleNamespace(valid=np.ones((4, 4), bool), depth_m=np.full((4, 4), 0.1))
    deviation, error = pipeline.board_scores(result(level), truth, where)  # type: ignore[arg-type]
    assert deviation == pytest.approx(0.1, rel=1e-9)
    assert error == pytest.approx(np.hypot(0.3, 0.1), rel=1e-9)
    nothing = np.full((4, 4), np.nan)
    assert np.isnan(pipeline.board_scores(result(nothing), truth, where)).all()  # type: ignore[arg-type]
