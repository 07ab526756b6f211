"""The command expose: the files of a rendering with the other values, series, and one line for wrong input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from dasim.cli import run
from dasim.files.captures import load_capture, load_truth

SCENE = """
name = "card"
focus_cm = 40
[[lights]]
kind = "dome"
illuminant = "D55"
lux = 300
[[lights]]
kind = "lamp"
illuminant = "A"
lux = 100
position_cm = [0, -30, -60]
target_cm = [0, 0, 25]
radius_cm = 5
[[objects]]
name = "wall"
shape = "plane"
size_cm = [60, 60]
position_cm = [0, 0, 40]
material = "brick"
[[objects]]
name = "card"
shape = "plane"
size_cm = [6, 20]
position_cm = [-3, 0, 20]
material = "leaf-green"
"""
TINY = ("--size", "32x24", "--spp", "2", "--seed", "4")


@pytest.fixture(scope="module")
def shop(renderer, tmp_path_factory):
    """A folder with two scenes, the second of twice the light, and a capture of the first."""
    folder = tmp_path_factory.mktemp("exposures")
    (folder / "scene.toml").write_text(SCENE)
    (folder / "bright.toml").write_text(SCENE.replace("lux = 300", "lux = 600").replace("lux = 100", "lux = 200"))
    assert run(["render", str(folder / "scene.toml"), *TINY, "--out", str(folder / "shot")]) == 0
    return folder


@pytest.fixture
def here(shop, tmp_path, monkeypatch):
    shutil.copytree(shop, tmp_path / "shop")
    monkeypatch.chdir(tmp_path / "shop")
    return tmp_path / "shop"


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.parametrize(
    ("rendered", "exposed"),
    [([], []), (["--exposure", "1/1000"], ["--time", "0.001"]), (["--exposure", "0.3"], ["--time", "0.3"])],
    ids=["unchanged", "short", "saturated"],
)
def test_files_are_those_of_a_rendering(here, rendered, exposed):
    """Expectation: ``raw.png``, ``truth.exr`` and ``meta.json`` of both commands are equal, byte for byte, and so are
    those of the way back.
    """
    assert run(["render", "scene.toml", *TINY, *rendered, "--out", "rendered"]) == 0
    assert run(["expose", "shot", *exposed, "--out", "exposed"]) == 0
    assert files(here / "exposed") == files(here / "rendered")
    assert run(["expose", "rendered", "--time", "auto", "--out", "back"]) == 0
    assert files(here / "back") == files(here / "shot")


def test_another_light_is_that_of_a_rendering(here):
    """Set-up: twice the light at automatic and at fixed exposure, with a noise model of the user's own, without noise.

    Expectation: levels and times are those rendered, electrons to single precision, raw numbers to one in few pixels.
    """
    (here / "silent.py").write_text(
        "from dasim.camera import noise\n\n"
        "def model(mean_e, sensor, time_s, seed, gain):\n"
        "    return noise.expose(mean_e, sensor, time_s, seed, gain, noise='off')\n"
    )
    silent = ["--noise", "silent.py:model"]
    for rendered, exposed in (([], []), (["--exposure", "0.003"], ["--time", "0.003"])):
        assert run(["render", "bright.toml", *TINY, *silent, *rendered, "--out", "rendered"]) == 0
        assert run(["expose", "shot", "--lux", "800", *silent, *exposed, "--out", "exposed"]) == 0
        ours, theirs = load_capture(here / "exposed"), load_capture(here / "rendered")
        difference = np.abs(ours.raw_dn.astype(int) - theirs.raw_dn)
        assert difference.max() <= 1 and np.mean(difference > 0) < 0.01
        electrons = (load_truth(here / name).mean_e for name in ("exposed", "rendered"))
        np.testing.assert_allclose(*electrons, rtol=1e-5)
        assert ours.exposure_s == pytest.approx(theirs.exposure_s)
        assert ours.provenance["scene"]["lights"] == theirs.provenance["scene"]["lights"]


def test_bracket_and_burst(here, capsys):
    """Expectation: one capture per time and frame, each what the command gives alone with its seed; a list of them; an
    earlier series is replaced.
    """
    arguments = ["expose", "shot", "--time", "1/1000,auto,0.01", "--frames", "2", "--out", "series"]
    assert run(arguments) == 0 and run(arguments) == 0
    printed = capsys.readouterr().out
    assert "003: " in printed and "series: series (6 captures)" in printed
    rows = json.loads((here / "series" / "series.json").read_text())["captures"]
    assert [row["folder"] for row in rows] == [f"{number:03d}" for number in range(6)]
    automatic_s = load_capture(here / "shot").exposure_s
    np.testing.assert_allclose([row["exposure_s"] for row in rows], np.repeat([1e-3, automatic_s, 1e-2], 2))
    assert rows[0]["seed"] == 4 and len({row["seed"] for row in rows}) == 6
    assert run(["expose", "shot", "--time", "0.01", "--seed", str(rows[5]["seed"]), "--out", "alone"]) == 0
    assert files(here / "alone") == files(here / "series" / "005")
    contents = [(here / "series" / row["folder"] / "truth.exr").read_bytes() for row in rows]
    assert contents[::2] == contents[1::2] and len(set(contents)) == 3
    first, second = (load_capture(here / "series" / name).raw_dn for name in ("002", "003"))
    assert (first != second).mean() > 0.5
    np.testing.assert_array_equal(load_truth(here / "series" / "002").mean_e, load_truth(here / "shot").mean_e)


def test_gain_and_light_of_a_capture(here, capsys):
    """Expectation: a factor on the light at a fixed time; its lights, time and gain stand in ``meta.json``."""
    assert run(["expose", "shot", "--scale", "0.5", "--gain", "2", "--time", "0.002", "--out", "dim"]) == 0
    capture = load_capture(here / "dim")
    assert (capture.exposure_s, capture.gain, capture.seed) == (0.002, 2.0, 4)
    assert [light["lux"] for light in capture.provenance["scene"]["lights"]] == [150, 50]
    assert "rendering noise over sensor noise, percentile   95" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (["none"], ("none", "no such folder")),
        (["scene.toml"], ("is a file",)),
        (["shot", "--lux", "-3"], ("lux is -3",)),
        (["shot", "--time", "soon"], ("--time 'soon'", "1/60")),
        (["shot", "--time", "1/0"], ("--time '1/0'",)),
        (["shot", "--time", "-1"], ("--time, --gain: time_s", "greater than or equal to")),
        (["shot", "--gain", "0"], ("--gain: gain",)),
        (["shot", "--seed", "-1"], ("seed is -1",)),
        (["shot", "--seed", "1.5"], ("--seed '1.5' is not a whole number",)),
        (["shot", "--frames", "0"], ("frames",)),
        (["shot", "--frames", "1001"], ("1001 captures; at most 1000 are allowed",)),
        (["shot", "--noise", "nothing.py:model"], ("nothing.py",)),
    ],
)
def test_wrong_input_is_one_line(here, capsys, arguments, message_part):
    before = sorted(here.rglob("*"))
    assert run(["expose", *arguments, "--out", "new"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dasim: ") and all(part in line for part in message_part), line
    assert sorted(here.rglob("*")) == before, "something was written"


def test_captures_and_outputs_that_do_not_fit(here, capsys):
    """Expectation: a capture without truth is refused, and as output the capture itself and folders of others."""

    def refused(*arguments):
        assert run(["expose", *arguments]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    (here / "mine").mkdir()
    (here / "mine" / "notes.txt").write_text("seen at noon")
    assert "is the capture itself" in refused("shot", "--out", "shot")
    assert "dasim did not write" in refused("shot", "--out", "mine")
    assert "dasim did not write" in refused("shot", "--frames", "2", "--out", "shot")
    (here / "shot" / "truth.exr").unlink()
    assert "truth.exr: is missing" in refused("shot", "--out", "new")
    assert not (here / "new").exists()


@pytest.mark.parametrize(
    "change",
    [
        lambda about: about["scene"]["lights"][0].pop("lux"),
        lambda about: about.update(scene="none"),
        lambda about: about.update(saturated_pixels="x"),
        lambda about: [light.update(lux=0) for light in about["scene"]["lights"]],
    ],
)
def test_changed_provenance_is_one_line(here, capsys, change):
    shutil.copytree(here / "shot", here / "changed")
    about = json.loads((here / "changed" / "meta.json").read_text())
    change(about["provenance"])
    (here / "changed" / "meta.json").write_text(json.dumps(about))
    assert run(["expose", "changed", "--lux", "20", "--out", "new"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "meta.json" in line and "provenance" in line
