"""Datasets that several test files read: one in both formats, and one of more samples."""

from __future__ import annotations

from pathlib import Path

import pytest

from dasim.dataset import sample, verify
from tests.support.datasets import SAMPLES, WALL, make_dataset, spec_file, sums


@pytest.fixture(scope="session")
def both(renderer, tmp_path_factory) -> dict[str, Path]:
    """One specification in both formats, with splits: three scenes, two captures each."""
    folders = {}
    for form in ("webdataset", "folders"):
        folder = tmp_path_factory.mktemp(form)
        for name in ("second", "third"):
            (folder / f"{name}.toml").write_text(WALL.replace('"wall"\nfocus', f'"{name}"\nfocus'))
        files = ["wall.toml", "second.toml", "third.toml"]
        spec = spec_file(folder, files=files, format=form, top="splits = {train = 0.6, test = 0.4}")
        make_dataset(spec, folder / "ds")
        folders[form] = folder / "ds"
    return folders


@pytest.fixture(scope="session")
def spec(renderer, tmp_path_factory) -> Path:
    """Specification of a dataset of 24 samples in five shards."""
    return spec_file(tmp_path_factory.mktemp("spec"), samples=SAMPLES, samples_per_shard=5)


@pytest.fixture(scope="session")
def undisturbed(spec, tmp_path_factory) -> dict[str, str]:
    """Checksums of a run in this process, one sample after the other."""
    out = tmp_path_factory.mktemp("undisturbed") / "ds"
    make_dataset(spec, out)
    assert list(verify.problems(str(out))) == []
    return sums(out)


@pytest.fixture
def remembered(monkeypatch):
    """Render each sample once and reuse it; other tests show that rendering it again gives the same bytes."""
    memory, render = {}, sample.make

    def remember(spec, index, variant):
        key = (spec.model_dump_json(), index)
        if key not in memory:
            memory[key] = render(spec, index, variant)
        return memory[key]

    monkeypatch.setattr(sample, "make", remember)
