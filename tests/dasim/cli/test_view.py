"""The command view: pages of reconstructions and captures; their contents: tests/validation/reports/view."""

from __future__ import annotations

import pytest

from dasim.cli import run


def test_view_writes_a_page(shop, tmp_path, capfd):
    """Expectation: a page with the focal stack; with the mosaic and the truth only where the capture is named."""
    out = tmp_path / "view.html"
    arguments = ["view", str(shop / "result"), "--bank", str(shop / "bank.npz"), "--slices", "2", "--out", str(out)]
    assert run(arguments) == 0
    alone = out.read_text(encoding="utf-8")
    assert "give the capture with --capture" in capfd.readouterr().out
    assert '"f_number":2.8' in alone and '"mosaic":null' in alone
    assert run([*arguments, "--capture", str(shop / "shot")]) == 0
    whole = out.read_text(encoding="utf-8")
    assert '"e_per_dn"' in whole and '"true_depth"' in whole
    assert [file.name for file in tmp_path.iterdir()] == ["view.html"]


def test_view_of_a_capture(shop, tmp_path):
    out = tmp_path / "shot.html"
    assert run(["view", str(shop / "shot"), "--out", str(out)]) == 0
    assert '"e_per_dn"' in out.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("nowhere",), ("nowhere", "reconstruction", "capture")),
        ((".",), ("neither",)),
        (("result", "--out", "page.png"), ("--out page.png", "HTML")),
        (("result", "--out", "no/page.html"), ("--out no/page.html", "folder")),
        (("result", "--slices", "1"), ("--slices 1", "2")),
        (("result", "--capture", "nowhere"), ("nowhere",)),
        (("shot", "--slices", "3"), ("shot", "--slices")),
    ],
)
def test_view_refuses_in_one_line(refused, arguments, message_part):
    refused("view", *arguments, message_part=message_part)
