"""A dataset's index, card and contact sheet."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

import dasim
from dasim.dataset import plan


def test_index_has_a_row_for_each_sample(both):
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(both["webdataset"] / plan.INDEX)
    assert table.num_rows == 6
    for row, sample in zip(table.to_pylist(), dasim.open_dataset(both["webdataset"]), strict=True):
        depth = sample.truth["depth_m"]
        assert row["depth_p50_m"] == pytest.approx(np.nanmedian(depth), rel=1e-5)  # single precision
        assert sum(row["depth_histogram"]) == np.isfinite(depth).sum()
        assert row["exposure_s"] == sample.meta["exposure_s"]
        picture = cv2.imdecode(np.frombuffer(row["thumbnail"], np.uint8), cv2.IMREAD_COLOR)
        assert picture.shape == (72, 96, 3)


def test_card_says_what_is_in_it(both):
    card = (both["webdataset"] / "README.md").read_text()
    for words in ("# tiny 1.0", "Licence: not stated", "6 of 3 scenes", "contact-sheet.jpg", "da-mobile", "D65"):
        assert words in card
    sheet = cv2.imread(str(both["webdataset"] / "contact-sheet.jpg"))
    assert sheet.shape == (72, 6 * 96, 3)
    manifest = json.loads((both["webdataset"] / plan.MANIFEST).read_text())
    assert {"variant", "llvm", "cpu", "libraries"} <= set(manifest)
