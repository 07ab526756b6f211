"""Examples of the training: captures of bundled cameras with their levels, the same in every process."""

from __future__ import annotations

import numpy as np
import pytest

from recon.depth import evidence
from validation.training import examples

INPUTS = evidence.SCORES * len(evidence.level_grid(28)) + evidence.SIGNALS + evidence.BLOCK


@pytest.mark.slow
def test_an_example_is_a_capture_with_levels(tmp_path):
    """Expectation: two processes' parts, or a second run, give the same file."""
    examples.make(tmp_path, 3, 4)
    with np.load(tmp_path / "3.npz") as stored:
        inputs, level = stored["inputs"], stored["level"]
    assert inputs.shape == (36, 48, INPUTS)
    assert level.shape == (144, 192)
    assert np.isfinite(inputs).all()
    before = (tmp_path / "3.npz").read_bytes()
    (tmp_path / "3.npz").unlink()
    examples.make(tmp_path, 3, 4)
    assert (tmp_path / "3.npz").read_bytes() == before
