"""The public names of the validation: listed, loaded late, and with arguments checked."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys

import numpy as np
import pytest

import dasim
import validation
from dasim.base.errors import InputError


@pytest.fixture(scope="module")
def shot():
    return dasim.simulate("desk", dasim.cropped("da-mobile", 48, 36), spp=1)


def test_dir_lists_exactly_the_documented_public_names():
    assert sorted(name for name in dir(validation) if not name.startswith("_")) == sorted(validation.__all__)
    assert all(inspect.getdoc(getattr(validation, name)) for name in validation.__all__)


def test_import_loads_no_large_library():
    code = (
        "import validation, sys, json; print(json.dumps(sorted({'mitsuba', 'cv2', 'numba', 'scipy'} & {*sys.modules})))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert json.loads(done.stdout) == []


def test_the_true_depth_has_no_error(shot):
    """Expectation: no error and full coverage of the true map, and a table that shows both."""
    figures = validation.score_map(shot.truth.depth_m, shot.capture, shot.truth)
    values = {figure.id: figure.value for figure in figures}
    assert values["depth.all.coverage"] == 1.0 and values["depth.all.level-median"] == pytest.approx(0.0, abs=1e-6)
    assert "depth depth" in validation.table(figures)


def test_maps_without_depth_are_refused(shot):
    """Rationale: all figures of such a map would be NaN, and no gate would fail."""
    for depth_m in (np.full(shot.truth.depth_m.shape, np.nan), np.zeros(shot.truth.depth_m.shape), [[None] * 48] * 36):
        with pytest.raises(InputError, match="depth map"):
            validation.score_map(depth_m, shot.capture, shot.truth)


def test_swapped_arguments_are_refused_in_one_line(shot):
    with pytest.raises(InputError, match="must be a Capture, not a Truth"):
        validation.score_map(shot.truth.depth_m, shot.truth, shot.capture)
    with pytest.raises(InputError, match="must be a Reconstruction, not a Capture"):
        validation.score(shot.capture, shot.capture, shot.truth)
