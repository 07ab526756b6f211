"""Verification: what it finds in a dataset that was damaged, changed or not finished."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.dataset import plan
from tests.support.datasets import make_dataset, problems, spec_file, sums


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_verify_finds_one_flipped_bit_in_any_file(both, form, tmp_path):
    """Set-up: one bit flipped in the first or last byte, in the middle, or in the padding of a tar file."""
    out = tmp_path / "ds"
    shutil.copytree(both[form], out)
    assert problems(out) == []
    logs = ("make.log", "make-claims.log")
    files = [path for path in sorted(out.rglob("*")) if path.is_file() and path.name not in logs]
    assert len(files) == (5 + 3 if form == "webdataset" else 5 + 18)
    for path in files:
        content = path.read_bytes()
        for place in {0, len(content) // 2, len(content) - 1}:
            flipped = bytearray(content)
            flipped[place] ^= 1
            path.write_bytes(flipped)
            messages = problems(out)
            assert messages and all("\n" not in line for line in messages), (path.name, place)
        path.write_bytes(content)
    assert problems(out) == []


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_verify_finds_missing_and_extra_files(both, form, tmp_path):
    out = tmp_path / "ds"
    shutil.copytree(both[form], out)
    (out / "extra.txt").write_text("x")
    assert problems(out) == ["extra.txt: is not part of the dataset"]
    (out / "extra.txt").unlink()
    name = next(name for name in sums(out) if name.endswith((".tar", "truth.exr")))
    (out / name).unlink()
    assert any(name in line and "is missing" in line for line in problems(out))


def test_verify_reads_more_than_checksums(both, tmp_path):
    """Set-up: a dataset that was changed and whose checksums were then rewritten. Expectation: rows, seeds and pixels
    are checked too.
    """
    out = tmp_path / "ds"
    shutil.copytree(both["folders"], out)
    (folder,) = out.glob("*/000000002")

    def resealed(name: str, change) -> list[str]:
        path = folder / name
        before = path.read_bytes()
        path.write_bytes(change(before))
        reseal(out, path, before)
        messages = problems(out)
        path.write_bytes(before)
        reseal(out, path, before)
        return messages

    def meta(**changes):
        return lambda content: json.dumps(json.loads(content) | changes).encode()

    assert any("seed differs from" in line for line in resealed("meta.json", meta(seed=1)))
    white = cv2.imencode(".png", np.full((24, 32), 65535, np.uint16))[1].tobytes()
    assert any("beyond the range of the converter" in line for line in resealed("raw.png", lambda _: white))
    small = cv2.imencode(".png", np.zeros((24, 30), np.uint16))[1].tobytes()
    assert any("raw.png is 30 x 24" in line for line in resealed("raw.png", lambda _: small))
    assert any("cannot be read" in line for line in resealed("truth.exr", lambda content: content[:100]))


def reseal(out: Path, path: Path, before: bytes) -> None:
    """Rewrite the index and the checksums for the files as they are now, as in a forgery."""
    import hashlib

    import pyarrow
    import pyarrow.parquet

    rows = pyarrow.parquet.read_table(out / plan.INDEX).to_pylist()
    for row in rows:
        if row["key"] == path.parent.name:
            row["sha256"][path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), out / plan.INDEX)
    lines = [f"{hashlib.sha256((out / name).read_bytes()).hexdigest()}  {name}\n" for name in sums(out)]
    (out / plan.SUMS).write_text("".join(lines))


def test_verify_needs_no_sources(both, tmp_path, monkeypatch):
    """A dataset can be verified where the files of its scenes are missing."""
    shutil.copytree(both["webdataset"], tmp_path / "elsewhere")
    monkeypatch.chdir(tmp_path)
    assert problems(Path("elsewhere")) == []


def test_verify_of_an_unfinished_dataset(tmp_path, renderer):
    spec = spec_file(tmp_path)
    make_dataset(spec, tmp_path / "ds", shard=(1, 2))
    assert "is not finished" in problems(tmp_path / "ds")[0]
    with pytest.raises(InputError, match=r"is not finished, it has no index\.parquet"):
        dasim.open_dataset(tmp_path / "ds")
