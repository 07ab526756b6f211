"""A dataset's index, card and contact sheet."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

import dasim
from dasim.dataset import card, plan
from dasim.dataset.sample import BLUR_EDGES_PX, DEPTH_EDGES_M, histogram


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


def test_what_is_beyond_the_bins_is_said():
    """Set-up: blur of 8 to 1,450 px, most of it beyond the last bin. Expectation: all pixels count, and the card states
    no number that it does not know.
    """
    counts = histogram(np.geomspace(8, 1450, 1000), BLUR_EDGES_PX)
    assert counts.sum() == 1000
    assert card._quantiles(counts, BLUR_EDGES_PX, "px") == "above 58 px (90 %: 10.4 to above 58)"
    assert card._quantiles(histogram(np.full(9, 1e3), DEPTH_EDGES_M), DEPTH_EDGES_M, "m").startswith("above")


def test_card_says_what_is_in_it(both):
    card = (both["webdataset"] / "README.md").read_text()
    for words in ("# tiny 1.0", "Licence: not stated", "6, scenes: 3", "contact-sheet.jpg", "da-mobile", "D65"):
        assert words in card
    sheet = cv2.imread(str(both["webdataset"] / "contact-sheet.jpg"))
    assert sheet.shape == (72, 6 * 96, 3)
    manifest = json.loads((both["webdataset"] / plan.MANIFEST).read_text())
    assert {"variant", "llvm", "cpu", "libraries"} <= set(manifest)
