"""The command score at the end of the chain, and one line for wrong input."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest

import dasim
from dasim.cli import run
from dasim.files.banks import load_bank
from dasim.files.captures import load_capture, load_truth, save_capture
from dasim.files.truth import write_truth
from recon.files.reconstruction import load_reconstruction


def test_render_recon_score_round_trip(shop, capsys):
    """Expectation: folders as documented, sizes as asked for, figures on the screen and in the file."""
    assert {p.name for p in (shop / "shot").iterdir()} == {"raw.png", "truth.exr", "meta.json"}
    capture, result = load_capture(shop / "shot"), load_reconstruction(shop / "result")
    assert capture.raw_dn.shape == result.depth_m.shape == (48, 64)
    assert (capture.seed, result.light) == (5, "D55")
    assert load_bank(shop / "bank.npz").lights == ("D55",)
    assert run(["score", str(shop / "result"), str(shop / "shot"), "--json", str(shop / "score.json")]) == 0
    printed = capsys.readouterr().out
    figures = json.loads((shop / "score.json").read_text())
    assert {"raw.all.level-median", "regularised.all.rmse-dioptre", "all-in-focus.blurred.psnr-gain"} <= set(figures)
    assert printed.count("pictures against ") == 2  # the sharp truth and the truth in focus
    for name, figure in figures.items():
        assert name.split(".")[-1].removesuffix("-focus") in printed or name.endswith(".constant"), name
        assert set(figure) == {"value", "unit"}
    assert {"raw", "regularised"} == {name.split(".")[0] for name in figures if name.endswith(".constant")}


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("score", "nowhere", "shot"), ("nowhere", "dasim recon")),
        (("score", "shot", "result"), ("shot", "dasim recon")),
        (("score", "result", "nowhere"), ("nowhere",)),
        (("score", "result", "shot", "--json", "no/folder.json"), ("no/folder.json",)),
        (("score", "result", "shot", "--json", "same", "--junit", "same"), ("--json and --junit", "two files")),
        (("score", "result"), ("give the capture folder",)),
        (("score", "result", "shot", "--bank", "bank.npz"), ("--bank applies to --method",)),
        (("score", "result", "shot", "--scale", "1"), ("--scale", "apply to a depth map")),
        (("score", "bank.npz", "shot/raw.png"), ("bank.npz", "is not a reconstruction folder", "dasim recon")),
        (("score", "result", "shot/raw.png", "--confidence", "x.npy"), ("neither --confidence nor --metric",)),
    ],
    ids=lambda value: " ".join(value) if value and isinstance(value[0], str) else None,
)
def test_wrong_arguments_are_refused_in_one_line(refused, arguments, message_part):
    refused(*arguments, message_part=message_part)


def test_reconstruction_and_truth_of_other_sizes_are_refused(refused, here):
    exact = load_truth(here / "shot")
    values = {field.name: getattr(exact, field.name) for field in fields(exact)}
    pictures = {name: value[:32, :32] for name, value in values.items() if isinstance(value, np.ndarray)}
    smaller = replace(exact, **pictures)
    (here / "shot" / "truth.exr").unlink()
    write_truth(here / "shot" / "truth.exr", smaller)
    meta = json.loads((here / "shot" / "meta.json").read_text())
    (here / "shot" / "meta.json").write_text(json.dumps(meta | {"file_bytes": {}}))
    refused("score", "result", "shot", message_part=("64 x 48", "32 x 32"))


def test_a_reconstruction_of_another_sensor_is_refused(shop, tmp_path, capsys):
    """Expectation: folders that were mixed up give no figures."""
    other = dasim.cropped("da-4x4", 64, 48)
    save_capture(tmp_path / "other", replace(load_capture(shop / "shot"), camera=other), load_truth(shop / "shot"))
    assert run(["score", str(shop / "result"), str(tmp_path / "other")]) == 2
    assert "its mosaic is" in capsys.readouterr().err
