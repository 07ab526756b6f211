"""Examples of the training: captures of bundled cameras with their levels, the same in every process."""

from __future__ import annotations

import numpy as np
import pytest

from recon.depth import evidence
from validation.training import files, level_examples, traced

INPUTS = evidence.SCORES * len(evidence.level_grid(28)) + evidence.FITS + evidence.SIGNALS + 1


@pytest.mark.slow
def test_an_example_is_a_capture_with_levels(tmp_path, monkeypatch):
    """Set-up: few pictures in place of all. Expectation: two processes' parts, or a second run, give the same file."""
    monkeypatch.setattr(traced, "PICTURES", 4)
    files.make(tmp_path, level_examples.example, level_examples.EXAMPLES, 0, count=1)
    with np.load(tmp_path / "textured-0.npz") as stored:
        inputs, picture, level = stored["inputs"], stored["picture"], stored["level"]
    assert inputs.shape == (36, 48, INPUTS)
    assert picture.shape == (144, 192, 4)
    assert level.shape == (144, 192)
    assert np.isfinite(inputs).all() and np.isfinite(picture).all()
    before = (tmp_path / "textured-0.npz").read_bytes()
    (tmp_path / "textured-0.npz").unlink()
    files.make(tmp_path, level_examples.example, level_examples.EXAMPLES, 0, count=1)
    assert (tmp_path / "textured-0.npz").read_bytes() == before
