"""Samples: how numbers are stored, the margin of the truth, an independent mean."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.dataset import verify
from tests.support.datasets import make_dataset, spec_file

HALF_STEP = 2**-11  # relative: half of the last of 11 bits


def test_an_independent_mean_leaves_the_raw_picture_as_it_is(renderer, tmp_path):
    """Expectation: same raw numbers, another realisation of ``mean_e`` with its variance, all else the same."""
    samples = []
    for own in ("false", "true"):
        folder = tmp_path / own
        folder.mkdir()
        make_dataset(spec_file(folder, samples=1, more=f"[truth]\nindependent_mean = {own}"), folder / "ds")
        samples += dasim.open_dataset(folder / "ds")
    shared, own = samples
    np.testing.assert_array_equal(own.raw_dn, shared.raw_dn)
    different = {
        name
        for name, part in shared.truth.items()
        if isinstance(part, np.ndarray) and not np.array_equal(part, own.truth[name], equal_nan=part.dtype.kind == "f")
    }
    assert different == {"mean_e", "mean_e_variance"}
    assert own.meta["provenance"]["independent_mean"] and not shared.meta["provenance"]["independent_mean"]


def test_half_floats_without_a_margin(tmp_path, renderer):
    """Half floats are off by at most half of their last bit, depth and labels are exact, and the truth lacks its
    margin.
    """
    base = spec_file(tmp_path, samples=1)
    make_dataset(base, tmp_path / "whole")
    base.write_text(base.read_text() + "[truth]\nhalf = true\nmargin_px = 4\nkeep = ['depth', 'mean_e', 'labels']\n")
    make_dataset(base, tmp_path / "cut")
    (whole,), (cut,) = dasim.open_dataset(tmp_path / "whole"), dasim.open_dataset(tmp_path / "cut")
    assert np.array_equal(whole.raw_dn, cut.raw_dn)
    inner = (slice(4, -4), slice(4, -4))
    assert {"depth_m", "mean_e", "object_id"} <= set(cut.truth) and "normal" not in cut.truth
    for name in ("depth_m", "object_id", "boundary"):
        assert np.array_equal(whole.truth[name][inner], cut.truth[name], equal_nan=name == "depth_m")
    difference = np.abs(whole.truth["mean_e"][inner] - cut.truth["mean_e"])
    assert 0 < difference.max() and np.all(difference <= HALF_STEP * np.abs(whole.truth["mean_e"][inner]) + 2**-25)
    assert cut.meta["sample"]["truth"]["offset_px"] == [4, 4]
    assert list(verify.problems(str(tmp_path / "cut"))) == []


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_raw_numbers_that_fill_16_bits(form, renderer, tmp_path):
    """Set-up: the same sample with both scales. Expectation: the picture on disk has 64 times the numbers of the 10-bit
    sensor, and every reader gives the sensor's own.
    """
    made, stored = {}, {}
    for scale in ("dn", "full"):
        (tmp_path / scale).mkdir()
        spec = spec_file(tmp_path / scale, samples=1, format=form, top=f'raw_scale = "{scale}"')
        out = tmp_path / scale / "ds"
        make_dataset(spec, out)
        assert list(verify.problems(str(out))) == []
        made[scale] = dasim.open_dataset(out)[0]
        if form == "folders":
            stored[scale] = cv2.imread(str(out / "train" / "000000000" / "raw.png"), cv2.IMREAD_UNCHANGED)
            loaded = dasim.load_capture(out / "train" / "000000000")
            np.testing.assert_array_equal(loaded.raw_dn, made[scale].raw_dn)
    np.testing.assert_array_equal(made["dn"].raw_dn, made["full"].raw_dn)
    assert (made["dn"].meta["raw_scale"], made["full"].meta["raw_scale"]) == (1, 64)
    if form == "folders":
        np.testing.assert_array_equal(stored["full"], 64 * stored["dn"])
        meta = tmp_path / "full" / "ds" / "train" / "000000000" / "meta.json"
        for wrong, message in (("128", "no multiples of 128"), ("3", "raw_scale 3"), ('"a"', "raw_scale 'a'")):
            meta.write_text(json.dumps(made["full"].meta).replace('"raw_scale": 64', f'"raw_scale": {wrong}'))
            with pytest.raises(InputError, match=message):
                dasim.load_capture(meta.parent)
