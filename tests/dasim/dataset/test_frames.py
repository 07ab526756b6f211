"""Brackets and bursts: the frames of a sample share one rendering."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import dasim
from dasim.camera import noise
from dasim.cli import run
from dasim.dataset import verify
from tests.support.datasets import backwards, inline, make_dataset, problems, same_sample, spec_file

SIGMAS = 5


@pytest.fixture(scope="module")
def bursts(renderer, tmp_path_factory) -> dict[str, Path]:
    """Samples of a bracket and burst with a mean of their own, in both formats; shards are made in opposite order."""
    folders = {}
    for form, executor in (("webdataset", inline), ("folders", backwards)):
        folder = tmp_path_factory.mktemp(f"bursts-{form}")
        more = "[frames]\nbracket = [0.5, 1, 2]\nburst = 2\n[truth]\nindependent_mean = true"
        make_dataset(spec_file(folder, samples=3, format=form, more=more), folder / "ds", executor)
        folders[form] = folder / "ds"
    return folders


def test_frames_of_a_sample_are_exposures_of_one_rendering(bursts):
    """Expectation: two frames at each time of the bracket, times the automatic one, with seeds of their own; noise
    differs from frame to frame, and is that of the sensor: raw numbers scatter about the same light.
    """
    assert list(verify.problems(str(bursts["folders"]))) == []
    for sample in dasim.open_dataset(bursts["folders"]):
        frames = sample.meta["sample"]["frames"]
        names = ["raw.png", *(f"raw-{number}.png" for number in range(1, 6))]
        assert [frame["file"] for frame in frames] == names and len(sample.frames_dn) == 6
        np.testing.assert_array_equal(sample.frames_dn[0], sample.raw_dn)
        times = np.array([frame["exposure_s"] for frame in frames])
        np.testing.assert_allclose(times / times[2], np.repeat([0.5, 1, 2], 2))
        assert len({frame["seed"] for frame in frames}) == 6 and frames[0]["seed"] == sample.meta["seed"]
        camera = dasim.load_capture(bursts["folders"] / sample.split / f"{sample.index:09d}").camera
        mean = noise.mosaic(sample.truth["mean_e"].astype(float), camera) / times[0]
        step = noise.electrons_per_dn(camera.sensor)
        electrons = [(raw.astype(float) - 64) * step for raw in sample.frames_dn]
        for number, time_s in enumerate(times):
            assert electrons[number].mean() == pytest.approx(mean.mean() * time_s, rel=0.05)
        for first, second in ((0, 1), (2, 3), (4, 5)):
            temporal = noise.temporal_variance(camera.sensor, times[first]).at(mean * times[first]).mean()
            ratio = (electrons[first] - electrons[second]).var() / (2 * temporal)
            assert ratio == pytest.approx(1.0, abs=SIGMAS * np.sqrt(2 / mean.size) + 0.05)
        shares = [max(frame["rendering_noise_share"]["95"].values()) for frame in frames]
        assert shares[0] == shares[1] < shares[2] < shares[4], "a brighter frame shows more of the rendering's noise"


def test_frames_do_not_depend_on_order_or_format(bursts):
    """Expectation: the same bytes of all files, and one row of the index per sample."""
    first, second = (dasim.open_dataset(bursts[form]) for form in ("webdataset", "folders"))
    assert {row["key"]: row["sha256"] for row in first.rows} == {row["key"]: row["sha256"] for row in second.rows}
    assert all(row["frames"] == 6 and len(row["sha256"]) == 8 for row in first.rows)
    assert "`raw-1.png` to `raw-5.png` further frames" in (bursts["folders"] / "README.md").read_text()
    for one, other in zip(first, second, strict=True):
        assert same_sample(one, other) and len(one.frames_dn) == 6
        assert all(map(np.array_equal, one.frames_dn, other.frames_dn))


def test_damaged_frames_are_found(bursts, tmp_path):
    out = tmp_path / "ds"
    shutil.copytree(bursts["folders"], out)
    (folder,) = out.glob("*/000000001")
    content = bytearray((folder / "raw-3.png").read_bytes())
    content[-20] ^= 1
    (folder / "raw-3.png").write_bytes(content)
    messages = problems(out)
    assert any("raw-3.png: its checksum differs" in line for line in messages)
    assert any("raw-3.png does not have the checksum of the index" in line for line in messages)


def test_frames_of_a_folder_are_what_the_command_exposes(renderer, tmp_path):
    """Expectation: `dasim expose` with the time and seed of a frame gives its raw numbers, byte for byte."""
    spec = spec_file(tmp_path, samples=1, format="folders", more="[frames]\nbracket = [1, 8]")
    make_dataset(spec, tmp_path / "ds")
    (sample,) = dasim.open_dataset(tmp_path / "ds")
    frame = sample.meta["sample"]["frames"][1]
    arguments = ["--time", repr(frame["exposure_s"]), "--seed", str(frame["seed"]), "--out", str(tmp_path / "shot")]
    folder = tmp_path / "ds" / sample.split / "000000000"
    assert run(["expose", str(folder), *arguments]) == 0
    assert (tmp_path / "shot" / "raw.png").read_bytes() == (folder / "raw-1.png").read_bytes()
