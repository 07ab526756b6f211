"""A small share of ``python -m tests.soak``."""

from __future__ import annotations

import pytest

from tests.soak import runner


@pytest.mark.slow
def test_disturbed_dataset_is_that_of_an_undisturbed_run(tmp_path):
    assert runner.soak(tmp_path, 30, 3, "files", 8.0, print) == []


def test_growing_memory_is_found():
    assert runner._growth([100.0] * 40) == [] and runner._growth([float(n) for n in range(40)])
