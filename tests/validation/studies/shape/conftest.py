"""A coarse study that the tests of its files and its report share."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from validation.studies.shape import study as studies
from validation.studies.shape.board_likelihood import Limits
from validation.studies.shape.pipeline import PipelineScores


@pytest.fixture(scope="session")
def study(camera: dasim.Camera) -> studies.Study:
    """Coarse, to be fast; invented scores take the place of the pipeline's, which takes minutes."""
    small = {"REFERENCE_CELLS": 32, "FINE": 24, "SEARCH_FINE": 24, "BLURS": 2, "SEARCH_BLURS": 2}
    scores = PipelineScores(((0.1, np.nan),) * 2, ((0.2, np.nan),) * 2, (0.9, 0.0), (20.0, 18.0), (0.3, 0.3), 25.0)
    limits = Limits((0.1, 0.2), (0.1, 0.3), ((0.2, 0.3), (0.2, 0.4)), ((0.1, 0.2), (0.1, 0.1)))
    with pytest.MonkeyPatch.context() as patch:
        for name, value in small.items():
            patch.setattr(studies, name, value)
        patch.setattr(studies.patch_likelihood, "STEP_PX", 1.0)
        patch.setattr(studies, "pipeline_scores", lambda camera, preset: scores)
        patch.setattr(studies, "limits", lambda camera, light, lux: limits)
        plan = studies.Plan(camera, 0.2116, cells=16, feature_um=170.0, seeds=1, iterations=1)
        return studies.run_study(plan, render=True)
