"""Maximum likelihood on simulated patches, against its bound."""

from __future__ import annotations

import numpy as np

import dasim
from validation.studies.shape import masks, patch_likelihood
from validation.studies.shape.infrared_stop import with_mask

BUDGET = 0.2116


def test_the_likelihood_of_patches_reaches_its_bound(camera: dasim.Camera) -> None:
    """The disc and two windows: the deviation of 300 patches is known to 1 / sqrt(600), 4 %, and may be 3.7 of these
    off; candidates 0.1 px apart add 0.03 px.
    """
    half = masks.disc(32, BUDGET / 2, (0.67, 0.0)) + masks.disc(32, BUDGET / 2, (-0.67, 0.0))
    blurs = np.array([10.0])
    for design in (camera, with_mask(camera, half)):
        error, bound = patch_likelihood.likelihood_errors(design, blurs, patches=300)
        np.testing.assert_allclose(error, np.hypot(bound, 0.03), rtol=0.15)
