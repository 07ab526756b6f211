"""Bank files: what is written is read again, and damaged files are refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.files import banks
from dasim.values import LevelsBehind, PsfBank


@pytest.fixture
def bank(da_mobile):
    rng = np.random.default_rng(9)
    kernel = rng.random((2, 3, 4, 5, 5)).astype(np.float32)
    return PsfBank(
        kernel=kernel / kernel.sum(axis=(-2, -1), keepdims=True),
        lights=("D65", "A"),
        signature=rng.random((2, 4)).astype(np.float32),
        depth_m=np.array([0.4, 0.3, 0.2], np.float32),
        blur_px=np.array([0, 2, 4], np.float32),
        camera=da_mobile,
        diffraction="wave",
        field_px=(900.0, -20.5),
    )


def test_bank_comes_back_as_it_was(tmp_path, bank):
    banks.save_bank(tmp_path / "banks" / "b.npz", bank)
    back = banks.load_bank(tmp_path / "banks" / "b.npz")
    for field in dataclasses.fields(PsfBank):
        ours, theirs = getattr(bank, field.name), getattr(back, field.name)
        if isinstance(ours, np.ndarray):
            assert ours.dtype == theirs.dtype
            np.testing.assert_array_equal(ours, theirs)
        else:
            assert ours == theirs, field.name
    assert [path.name for path in (tmp_path / "banks").iterdir()] == ["b.npz"]


def test_levels_behind_the_focus_come_back(tmp_path, bank):
    """They count in the bank's identity, and are refused where they do not fit."""
    behind = LevelsBehind(bank.kernel[:, :2], np.array([0.4, 0.6], np.float32), np.array([0, -2], np.float32))
    both = dataclasses.replace(bank, behind=behind)
    banks.save_bank(tmp_path / "b.npz", both)
    back = banks.load_bank(tmp_path / "b.npz").behind
    for name in ("kernel", "depth_m", "blur_px"):
        np.testing.assert_array_equal(getattr(back, name), getattr(behind, name))
    identities = banks.bank_identity(bank), banks.bank_identity(both)
    assert identities[0]["sha256"] != identities[1]["sha256"]
    assert [each["levels_behind"] for each in identities] == [0, 1] and identities[1]["depths_m"][1] == np.float32(0.6)
    short = dataclasses.replace(behind, depth_m=behind.depth_m[:1])
    banks.save_bank(tmp_path / "b.npz", dataclasses.replace(bank, behind=short))
    with pytest.raises(InputError, match="do not fit"):
        banks.load_bank(tmp_path / "b.npz")


def test_damaged_banks_are_refused(tmp_path, bank):
    one = {name: getattr(bank, name)[:1] for name in ("depth_m", "blur_px")}
    banks.save_bank(tmp_path / "one.npz", dataclasses.replace(bank, kernel=bank.kernel[:, :1], **one))
    with pytest.raises(InputError, match="only one level"):
        banks.load_bank(tmp_path / "one.npz")
    with pytest.raises(InputError, match=r"b\.npz: no such file; make one with 'dasim calibrate'"):
        banks.load_bank(tmp_path / "b.npz")
    banks.save_bank(tmp_path / "b.npz", bank)
    data = (tmp_path / "b.npz").read_bytes()
    for part in (b"", b"text", data[: len(data) // 2], data[:-10]):
        (tmp_path / "b.npz").write_bytes(part)
        with pytest.raises(InputError, match=r"b\.npz"):
            banks.load_bank(tmp_path / "b.npz")
    np.savez(tmp_path / "b.npz", kernel=bank.kernel)
    with pytest.raises(InputError, match=r"b\.npz"):
        banks.load_bank(tmp_path / "b.npz")
    np.savez(tmp_path / "b.npz", about="[]", kernel=bank.kernel, signature=bank.signature, depth_m=[1], blur_px=[1])
    with pytest.raises(InputError, match=r"b\.npz"):
        banks.load_bank(tmp_path / "b.npz")
