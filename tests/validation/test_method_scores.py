"""``dasim dataset score`` on datasets on disk, in both formats."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np
import pytest

import dasim
from dasim.camera import specification as cameras
from dasim.cli import run
from dasim.dataset.reading import open_dataset
from dasim.files.banks import save_bank
from tests.support import datasets, recon_scenes
from validation import methods
from validation.subjects import rendering

SIZE_PX = (64, 48)
DEPTH_M, FOCUS_M = 0.3, 0.4  # of the wall, which faces the camera, and of the lens
LEVEL = 4.0
METHOD = f"""
import numpy as np
from dasim.values import DepthEstimate

def constant(capture, bank):
    return DepthEstimate(level=np.full(capture.raw_dn.shape, {LEVEL}))
"""
MORE = """
[splits]
test = 1.0
"""


def spec_file(folder: Path, *, more: str = "", **changes) -> Path:
    """A specification of two photographs of a wall in front of the focal plane, all in the split test."""
    near = datasets.WALL.replace("position_cm = [0, 0, 50]", f"position_cm = [0, 0, {100 * DEPTH_M:g}]")
    (folder / "near.toml").write_text(near)
    spec = datasets.spec_file(folder, samples=2, files=["near.toml"], more=MORE + more, **changes)
    spec.write_text(spec.read_text().replace("size_px = [32, 24]", f"size_px = {[*SIZE_PX]}"))
    return spec


def true_level() -> float:
    """Blur level of the wall from the camera's data sheet, by a formula that the simulator does not use."""
    camera = cameras.refocused(dasim.load_camera("da-mobile"), FOCUS_M)
    hole, open_lens = (next(s.radius_ratio for s in camera.stops if s.name == name) for name in ("hole", "open"))
    return abs(rendering.blur_px(camera, DEPTH_M)) * (1 - hole / open_lens)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    (tmp_path / "mine.py").write_text(METHOD)
    methods.function.cache_clear()  # the file has the same name in each test
    monkeypatch.chdir(tmp_path)
    return tmp_path


def scored(dataset: Path, *options: str) -> dict:
    command = [
        "dataset",
        "score",
        str(dataset),
        "--split",
        "test",
        "--method",
        "flat=mine.py:constant",
        "--json",
        "s.json",
    ]
    assert run([*command, *options]) == 0
    return json.loads(Path("s.json").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("form", ["folders", "webdataset"])
def test_a_dataset_on_disk_is_scored_in_both_formats(folder, form, capsys):
    """Expectation: a constant map is off by the distance of its level from the wall's, on every pixel of every sample.

    Every sample is lost, since the best constant map of a wall that faces the camera has no error.
    """
    spec = spec_file(folder, format=form)
    if form == "webdataset":
        assert run(["dataset", "make", str(spec), "--out", str(folder / "set"), "--jobs", "1"]) == 0
    else:
        datasets.make_dataset(spec, folder / "set")  # what the command runs, without starting a process
    save_bank(folder / "bank.npz", recon_scenes.bank(("D65",)))
    content = scored(folder / "set", "--bank", "bank.npz")
    error = abs(true_level() - LEVEL)
    for figure in ("pixels.level-mean", "pixels.level-median", "samples.level-mean"):
        assert content[f"flat.{figure}"]["value"] == pytest.approx(error, abs=0.02)
    assert content["flat.coverage"]["value"] == 1 and content["flat.lost"]["value"] == 2
    assert [row["sample"] for row in content["samples"]["flat"]] == ["000000000", "000000001"]
    assert "000000001" in capsys.readouterr().out


@pytest.mark.slow
def test_the_bank_of_a_sample_is_calibrated_from_its_description(folder, monkeypatch):
    """Set-up: no ``--bank``; the calibration has one light, which is enough for these photographs."""
    datasets.make_dataset(spec_file(folder), folder / "set")
    one_light = functools.partial(dasim.calibration_captures, lights=("D65",))
    monkeypatch.setattr(dasim, "calibration_captures", one_light)
    content = scored(folder / "set")
    assert content["flat.pixels.level-mean"]["value"] == pytest.approx(abs(true_level() - LEVEL), abs=0.02)


def test_parts_of_the_truth_that_a_dataset_lacks_are_named(folder, capsys):
    datasets.make_dataset(spec_file(folder, more='[truth]\nkeep = ["depth"]\n'), folder / "set")
    (sample, _) = open_dataset(str(folder / "set"), "test")
    assert "level" not in sample.truth and np.isfinite(sample.truth["depth_m"]).all()
    assert run(["dataset", "score", str(folder / "set"), "--method", "flat=mine.py:constant"]) == 2
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("dasim: "))
    assert all(part in line for part in ("sample 000000000", "lacks blur, labels", "truth.keep"))
