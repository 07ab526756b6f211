"""The example that reads shards without dasim."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dasim
from tests.support.datasets import make_dataset, spec_file

EXAMPLE = Path(__file__).parents[2] / "examples" / "read_shards.py"
FIELDS = {"depth.Z": "depth_m", "labels.object_id": "object_id", "blur.level": "level", "labels.valid": "valid"}


@pytest.mark.slow
@pytest.mark.parametrize("scale", ["dn", "full"])
def test_every_part_is_what_dasim_reads(renderer, tmp_path, scale):
    """Expectation: raw numbers and truth as ``dasim.open_dataset`` reads them, at both scales of raw.png; every channel
    of the truth file is a tensor of the picture's size.
    """
    for name in ("torch", "webdataset"):
        pytest.importorskip(name, reason=f"{name} is not installed")
    make_dataset(spec_file(tmp_path, samples=2, top=f'raw_scale = "{scale}"'), tmp_path / "ds")
    program = (
        f"import sys, numpy; sys.path.insert(0, {str(EXAMPLE.parent)!r}); import read_shards\n"
        "for sample in read_shards.samples(sys.argv[2:]):\n"
        "    tensors = {k: v.numpy() for k, v in sample.items() if hasattr(v, 'numpy')}\n"
        "    numpy.savez(sys.argv[1] + '/' + sample['key'], **tensors)\n"
    )  # a process of its own: webdataset leaves files open, which is an error here
    shards = sorted(map(str, (tmp_path / "ds").glob("*.tar")))
    subprocess.run([sys.executable, "-c", program, str(tmp_path), *shards], check=True)
    for sample in dasim.open_dataset(tmp_path / "ds"):
        with np.load(tmp_path / f"{sample.index:09d}.npz") as found:
            np.testing.assert_array_equal(found["raw"], sample.raw_dn)
            for channel, field in FIELDS.items():
                np.testing.assert_array_equal(found[channel], sample.truth[field])
            assert {value.shape for value in found.values()} == {(24, 32)}
            assert {name.partition(".")[0] for name in found.files} == {"raw", *sample.meta["sample"]["truth"]["keep"]}
    lines = subprocess.run([sys.executable, EXAMPLE, *shards], capture_output=True, text=True, check=True).stdout
    assert [json.loads(line)[0] for line in lines.splitlines()] == ["000000000", "000000001"]
