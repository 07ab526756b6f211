"""Reading datasets: as a sequence, as captures, as tar files, and in training code."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tarfile

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from tests.support import datasets
from tests.support.datasets import same_sample


def test_both_formats_hold_the_same(both):
    first, second = (dasim.open_dataset(both[form]) for form in ("webdataset", "folders"))
    assert len(first) == len(second) == 6
    for one, other in zip(first, second, strict=True):
        assert same_sample(one, other)
    assert {row["key"]: row["sha256"] for row in first.rows} == {row["key"]: row["sha256"] for row in second.rows}


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_dataset_is_a_sequence(both, form):
    """Each sample is the one that the index names, whether read by number, from the end, in slices, or in sequence."""
    dataset = dasim.open_dataset(str(both[form]))
    samples = list(dataset)
    assert [sample.index for sample in samples] == list(range(6))
    assert same_sample(dataset[2], samples[2]) and same_sample(dataset[-1], samples[5])
    assert [sample.index for sample in dataset[1:5:2]] == [1, 3]
    with pytest.raises(IndexError):
        dataset[6]
    train, test = (dasim.open_dataset(both[form], split=name) for name in ("train", "test"))
    assert sorted(s.index for part in (train, test) for s in part) == list(range(6))
    scenes = [{sample.meta["sample"]["scene"] for sample in part} for part in (train, test)]
    assert scenes[0].isdisjoint(scenes[1]) and len(scenes[0] | scenes[1]) == 3
    with pytest.raises(InputError, match="no split 'val'; it has train, test"):
        dasim.open_dataset(both[form], split="val")


def test_folders_are_captures(both):
    """Each folder is read by the functions for captures."""
    sample = dasim.open_dataset(both["folders"])[0]
    folder = both["folders"] / sample.split / "000000000"
    capture, truth = dasim.load_capture(folder), dasim.load_truth(folder)
    assert np.array_equal(capture.raw_dn, sample.raw_dn)
    assert np.array_equal(truth.depth_m, sample.truth["depth_m"], equal_nan=True)


def test_shards_are_in_the_webdataset_form(both):
    """The members of a sample follow each other with the names KEY.raw.png and so on; they do not state an owner."""
    for path in sorted(both["webdataset"].glob("*.tar")):
        with tarfile.open(path) as tar:
            infos = tar.getmembers()
        keys = [info.name.partition(".")[0] for info in infos]
        assert [info.name.partition(".")[2] for info in infos[:3]] == ["raw.png", "truth.exr", "meta.json"]
        assert keys == [key for key in dict.fromkeys(keys) for _ in range(3)]
        assert {(info.uid, info.mtime, info.uname, info.mode) for info in infos} == {(0, 0, "", 0o644)}


def test_torch_loader(both):
    """The example of the README."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")

    def batch(samples):
        raw = torch.stack([torch.from_numpy(sample.raw_dn.astype("float32")) for sample in samples])
        depth = torch.stack([torch.from_numpy(sample.truth["depth_m"]) for sample in samples])
        return raw, depth

    train = dasim.open_dataset(both["webdataset"], split="train")
    loader = torch.utils.data.DataLoader(train, batch_size=2, shuffle=True, num_workers=2, collate_fn=batch)
    shapes = [(tuple(raw.shape), tuple(depth.shape)) for raw, depth in loader]
    assert shapes == [((2, 24, 32), (2, 24, 32))] * 2


def test_torch_batches_arrays_by_itself(both):
    """PyTorch's own collate function stacks the arrays: [batch, ...], the same numbers; texts become lists."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    samples = dasim.open_dataset(both["webdataset"], split="train")
    batches = list(torch.utils.data.DataLoader(samples.arrays(), batch_size=2))
    assert sum(len(batch["key"]) for batch in batches) == len(samples)
    for place, batch in enumerate(batches):
        for number in range(2):
            sample = samples[2 * place + number]
            assert batch["index"][number] == sample.index and batch["scene"][number] == sample.meta["sample"]["scene"]
            np.testing.assert_array_equal(batch["raw_dn"][number].numpy(), sample.raw_dn)
            for name in ("depth_m", "object_id", "valid", "mean_e"):
                np.testing.assert_array_equal(batch[name][number].numpy(), sample.truth[name])


def test_arrays_have_equal_keys_and_plain_values(both):
    """Rationale: default collate functions batch arrays, numbers and texts of equal keys and shapes, nothing else."""
    dataset = dasim.open_dataset(both["folders"]).arrays()
    rows = list(dataset)
    assert len(dataset) == len(rows) == len(dataset[:4]) + 2 and dataset[1]["index"] == rows[1]["index"] == 1
    for row in rows:
        assert row.keys() == rows[0].keys()
        for name, value in row.items():
            assert isinstance(value, (np.ndarray, int, float, str)), name
            if isinstance(value, np.ndarray):
                assert value.shape == rows[0][name].shape and value.dtype.kind in "bif", name


def test_arrays_tell_what_a_network_needs_of_the_camera_and_its_frames(tmp_path, renderer):
    """Set-up: a bracket of 1 and 4 with a margin of 2 pixels around the truth. Expectation: the sensor's numbers, the
    ratio of the exposure times, and where the truth begins.
    """
    more = "[frames]\nbracket = [1, 4]\n[truth]\nmargin_px = 2\n"
    datasets.make_dataset(datasets.spec_file(tmp_path, samples=1, more=more), tmp_path / "ds")
    row = dasim.open_dataset(tmp_path / "ds").arrays()[0]
    sensor = dasim.load_camera("da-mobile").sensor
    assert (row["adc_bits"], row["mosaic"]) == (sensor.adc_bits, "/".join(map(",".join, sensor.mosaic)))
    assert row["frames_exposure_s"][1] == pytest.approx(4 * row["exposure_s"])
    (x, y), (height, width) = row["truth_offset_px"], row["depth_m"].shape
    assert (height + 2 * y, width + 2 * x) == row["raw_dn"].shape


def test_webdataset_library(both):
    """The library webdataset reads the same samples, without dasim except for the file of the truth."""
    pytest.importorskip("webdataset", reason="webdataset is not installed")
    shards = sorted(str(path) for path in both["webdataset"].glob("*.tar"))
    program = (
        "import hashlib, json, sys, webdataset\n"
        "for item in webdataset.WebDataset(sys.argv[1:], shardshuffle=False):\n"
        "    files = ('raw.png', 'truth.exr', 'meta.json')\n"
        "    print(json.dumps([item['__key__'], {f: hashlib.sha256(item[f]).hexdigest() for f in files}]))"
    )  # a process of its own: the library leaves files open, which is an error here
    done = subprocess.run([sys.executable, "-c", program, *shards], capture_output=True, text=True, check=True)
    rows = dasim.open_dataset(both["webdataset"]).rows
    assert dict(map(json.loads, done.stdout.splitlines())) == {row["key"]: row["sha256"] for row in rows}


@pytest.mark.parametrize("damage", ["truncated", "gone", "changed"])
def test_damaged_shards_are_named_in_one_line(both, tmp_path, damage):
    """Rationale: a training of days must not end in the traceback of a library."""
    shutil.copytree(both["webdataset"], tmp_path / "ds")
    shard = sorted((tmp_path / "ds").glob("*.tar"))[0]
    data = bytearray(shard.read_bytes())
    if damage == "changed":  # within the first sample's truth
        place = data.index(b"truth.exr") + 512 + 4000
        data[place : place + 2000] = bytes(2000)
    shard.write_bytes(data[:5000] if damage == "truncated" else data)
    if damage == "gone":
        shard.unlink()
    with pytest.raises(InputError, match="see 'dasim dataset verify'") as error:
        list(dasim.open_dataset(tmp_path / "ds"))
    assert "/tmp" not in str(error.value).replace(str(tmp_path), "") and "\n" not in str(error.value)
