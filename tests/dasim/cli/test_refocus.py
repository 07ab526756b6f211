"""The command refocus."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from dasim.cli import run


def test_refocus_writes_a_picture(shop, tmp_path):
    """Expectation: the size of the capture; through a pinhole of an aperture, the all-in-focus picture itself."""
    out = tmp_path / "near.png"
    common = ["refocus", str(shop / "result"), "--bank", str(shop / "bank.npz"), "--out", str(out)]
    assert run([*common, "--depth", "0.1"]) == 0
    near = cv2.imread(str(out))
    assert near.shape == (48, 64, 3)
    assert run([*common, "--depth", "0.1", "--f-number", "1e6"]) == 0
    sharp = cv2.imread(str(shop / "result" / "sharp.png")).astype(int)
    assert np.abs(cv2.imread(str(out)).astype(int) - sharp).max() <= 1
    assert np.abs(near.astype(int) - sharp).mean() > 1


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("result", "--depth", "0.1", "--out", "picture.jpg"), ("--out picture.jpg", "PNG")),
        (("result", "--depth", "0.1", "--out", "no/near.png"), ("--out no/near.png", "folder")),
        (("shot", "--depth", "0.1", "--out", "near.png"), ("shot", "dasim recon")),
        (("result", "--depth", "-1", "--out", "near.png"), ("--depth -1",)),
        (("result", "--depth", "0.1", "--f-number", "0", "--out", "near.png"), ("--f-number 0",)),
    ],
)
def test_refocus_refuses_in_one_line(refused, arguments, message_part):
    refused("refocus", *arguments, message_part=message_part)
