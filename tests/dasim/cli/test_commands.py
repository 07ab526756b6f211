"""The command line: the whole chain at small size, and one line on stderr for wrong input."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh

from dasim.base.cache import cache_dir
from dasim.camera.specification import CAMERA_DIR, cropped, load_camera
from dasim.cli import run
from dasim.files.banks import bank_identity, load_bank
from dasim.files.captures import load_capture, load_truth, save_capture
from dasim.files.truth import write_truth
from dasim.values import Capture
from recon.files.reconstruction import load_reconstruction
from recon.settings import PRESETS, Settings

TINY = ("--size", "64x48", "--spp", "4")
SIGINT_DEADLINE_S = 180.0  # for start, import and stop together, on a busy computer
INTERRUPTED = 130  # 128 + SIGINT, as shells say it

SCENE = """
name = "mine"
focus_cm = 40
[[lights]]
kind = "lamp"
illuminant = "D65"
lux = 500
position_cm = [-20, -30, -10]
target_cm = [0, 0, 25]
radius_cm = 5
[[objects]]
name = "wall"
shape = "plane"
size_cm = [50, 40]
position_cm = [0, 0, 40]
material = "brick"
[[objects]]
name = "thing"
shape = "mesh"
file = "thing.obj"
position_cm = [0, 0, 20]
rotation_deg = [20, 30, 0]
material = "sand"
"""
CAMERA = Path(__file__).parents[3] / "dasim" / "cameras" / "da-mobile.toml"


@pytest.fixture(scope="module")
def shop(renderer, tmp_path_factory):
    """A folder with a capture, a bank of one light and a reconstruction, all made by commands; a cache of its own.

    The renderer is chosen before, with the user's own cache: trying the variants out takes a while.
    """
    folder = tmp_path_factory.mktemp("shop")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DASIM_CACHE_DIR", str(folder / "cache"))
        patch.setenv("DASIM_VARIANT", renderer)
        model = "airy" if renderer.startswith("scalar") else "wave"
        assert run(["render", "desk", *TINY, "--seed", "5", "--out", str(folder / "shot")]) == 0
        focus = str(load_capture(folder / "shot").camera.lens.focus_distance_m)
        lights = ["--illuminant", "D55", "--focus", focus, "--diffraction", model]
        assert run(["calibrate", *lights, "--out", str(folder / "bank.npz")]) == 0
        arguments = ["--bank", str(folder / "bank.npz"), "--out", str(folder / "result")]
        assert run(["recon", str(folder / "shot"), *arguments]) == 0
        yield folder


@pytest.fixture
def here(shop, tmp_path, monkeypatch):
    """An empty working folder with a scene of the user's own, and the shop's capture, bank and result."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(shop / "shot", tmp_path / "shot")
    shutil.copytree(shop / "result", tmp_path / "result")
    shutil.copy(shop / "bank.npz", tmp_path / "bank.npz")
    shutil.copy(CAMERA, tmp_path / "camera.toml")
    (tmp_path / "mine.toml").write_text(SCENE)
    trimesh.creation.icosphere(subdivisions=2, radius=1.0).export(tmp_path / "thing.obj")
    return tmp_path


def tree(*folders: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() if p.is_file() else b"" for f in folders for p in sorted(f.rglob("*"))}


@pytest.fixture
def refused(here, capfd):
    """Run a command that must fail: status 2, one line on stderr with all of ``message_part``, and nothing written."""

    def begun(*arguments, **options):
        raise AssertionError("the work has begun with this input")

    def check(*arguments: str, message_part: tuple[str, ...] = ()) -> str:
        before = tree(here, cache_dir())
        capfd.readouterr()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("dasim.render.passes.stop_ratios", begun)
            patch.setattr("dasim.render.passes.sharp_pass", begun)
            patch.setattr("dasim.camera.pointspread.pixel_kernels", begun)
            status = run(list(arguments))
        printed = capfd.readouterr()
        assert status == 2, f"exit status {status}\n{printed.out}{printed.err}"
        assert tree(here, cache_dir()) == before, "something was written"
        assert "Traceback" not in printed.out + printed.err
        lines = printed.err.splitlines()
        assert lines and lines[-1].startswith("dasim: "), printed.err
        for part in message_part:
            assert part in lines[-1], lines[-1]
        assert len(lines) == 1, printed.err
        assert "arning" not in printed.out, printed.out
        return lines[0]

    return check


# --- the chain -----------------------------------------------------------------------------------


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


def test_same_seed_same_bytes(shop, tmp_path):
    assert run(["render", "desk", *TINY, "--seed", "5", "--out", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again" / "raw.png").read_bytes() == (shop / "shot" / "raw.png").read_bytes()
    first, second = load_truth(shop / "shot"), load_truth(tmp_path / "again")
    for field in fields(first):
        np.testing.assert_array_equal(getattr(first, field.name), getattr(second, field.name), err_msg=field.name)


def test_noise_model_of_the_users_own(shop, here, capfd):
    """Expectation: the raw picture is the model's, the truth that of the bundled one; a model that raises is one line
    with its place.
    """
    Path("mine.py").write_text(
        "import numpy as np\ndef dark(mean_e, sensor, time_s, seed, gain):\n"
        "    return np.full(mean_e.shape, 70, np.uint16), 0\ndef broken(*arguments):\n    return 1 / 0\n"
    )
    assert run(["render", "desk", *TINY, "--seed", "5", "--noise", "mine.py:dark", "--out", "own"]) == 0
    assert (load_capture(Path("own")).raw_dn == 70).all()
    assert load_capture(Path("own")).provenance["noise"] == "mine.py:dark"
    np.testing.assert_array_equal(load_truth(Path("own")).mean_e, load_truth(shop / "shot").mean_e)
    capfd.readouterr()
    assert run(["render", "desk", *TINY, "--noise", "mine.py:broken", "--out", "none"]) == 2
    last = capfd.readouterr().err.splitlines()[-1]
    assert "noise model 'mine.py:broken': raised ZeroDivisionError: division by zero (mine.py, line 5)" in last
    assert not Path("none").exists()


@pytest.mark.parametrize("suffix", ["obj", "ply", "glb"])
def test_scene_and_mesh_of_the_users_own(here, suffix, capfd):
    """Expectation: the mesh stands where the scene puts it, its front 19 cm before the lens.

    A sphere of 1 cm about (0, 0, 20) cm; its flat triangles lie up to 4 % of the radius inside it.
    """
    trimesh.creation.icosphere(subdivisions=2, radius=1.0).export(here / f"thing.{suffix}")
    (here / "mine.toml").write_text(SCENE.replace("thing.obj", f"thing.{suffix}"))
    assert run(["render", "mine.toml", *TINY, "--out", "new/photo"]) == 0
    truth = load_truth(Path("new/photo"))
    assert truth.object_id[24, 32] == 2
    assert 0.1899 < truth.depth_m[24, 32] < 0.1905
    assert "Traceback" not in capfd.readouterr().err


@pytest.mark.parametrize("change", ["dome alone", "two lamps"])
def test_scenes_of_other_kinds_render(here, change):
    """Expectation: one even light is enough, two lamps are not too many."""
    lamp = SCENE[SCENE.index("[[lights]]") : SCENE.index("[[objects]]")]
    text = {
        "dome alone": SCENE.replace(lamp, '[[lights]]\nkind = "dome"\nilluminant = "D65"\nlux = 500\n'),
        "two lamps": SCENE.replace(lamp, lamp + lamp.replace("-20", "20")),
    }[change]
    (here / "mine.toml").write_text(text)
    assert run(["render", "mine.toml", *TINY, "--out", "photo"]) == 0
    assert load_truth(here / "photo").mean_e.max() > 0


def test_camera_that_looks_at_nothing_is_refused(here, capsys):
    """Expectation: one line, found before anything is rendered."""
    (here / "mine.toml").write_text(SCENE.replace("[0, 0, ", "[900, 0, "))
    assert run(["render", "mine.toml", *TINY, "--out", "photo"]) == 2
    message_part = capsys.readouterr().err
    assert "the camera looks at nothing" in message_part and "rendering through" not in message_part
    assert not (here / "photo").exists()


@pytest.mark.slow
def test_mitsuba_scene_through_our_camera(here, capsys):
    """Expectation: `dasim render scene.xml` with a unit and a rule of one's own; what was done is printed and kept."""
    (here / "wall.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"/><shape type="rectangle" id="wall">'
        '<transform name="to_world"><scale value="50"/><rotate y="1" angle="180"/><translate z="4"/></transform>'
        '<bsdf type="diffuse"><rgb name="reflectance" value="0.1, 0.2, 0.6"/></bsdf></shape>'
        '<emitter type="constant"><rgb name="radiance" value="1"/></emitter></scene>'
    )
    options = ["--unit-cm", "5", "--near-infrared", "print", "--illuminant", "A"]
    assert run(["render", "wall.xml", *options, *TINY, "--out", "photo"]) == 0
    message_part = capsys.readouterr().out
    assert "note: RGB surface colours: spectra by the near-infrared rule 'print'" in message_part
    assert "the spectrum of A" in message_part
    truth = load_truth(here / "photo")
    np.testing.assert_allclose(truth.depth_m, 0.2, rtol=1e-4)
    notes = json.loads((here / "photo" / "meta.json").read_text())["provenance"]["notes"]
    assert any("rule 'print'" in note for note in notes)
    assert run(["render", "desk", "--unit-cm", "5", *TINY, "--out", "other"]) == 2
    assert "is for Mitsuba scenes" in capsys.readouterr().err
    assert run(["render", "none.xml", *TINY, "--out", "other"]) == 2
    assert "none.xml" in capsys.readouterr().err


def test_scene_is_found_from_another_folder(here, monkeypatch):
    """Expectation: a mesh beside its TOML is found though the command runs elsewhere."""
    (here / "elsewhere").mkdir()
    monkeypatch.chdir(here / "elsewhere")
    assert run(["render", "../mine.toml", "--camera", "../camera.toml", *TINY, "--out", "photo"]) == 0


def test_earlier_result_is_replaced_as_a_whole(here):
    before = (here / "shot" / "raw.png").read_bytes()
    assert run(["render", "desk", *TINY, "--seed", "6", "--out", "shot"]) == 0
    assert load_capture(here / "shot").seed == 6
    assert (here / "shot" / "raw.png").read_bytes() != before, "another seed, other noise"
    assert not [p.name for p in here.iterdir() if p.name.startswith(".")]


def test_recon_takes_settings(here):
    (here / "settings.toml").write_text("window_px = 21\ndenoise = false\n")
    arguments = ["--bank", "bank.npz", "--settings", "settings.toml", "--out", "plain"]
    assert run(["recon", "shot", *arguments]) == 0
    assert load_reconstruction(here / "plain").settings["window_px"] == 21


def even(name: str, level_dn: int) -> Capture:
    """A capture of an even grey by a bundled camera."""
    camera = cropped(load_camera(name), 64, 48)
    return Capture(np.full((48, 64), level_dn, np.uint16), camera, 0.01, 1.0, 0)


def test_recon_of_a_raw_file_equals_that_of_its_capture(here, capfd):
    """Expectation: the same from raw.png with a camera file as from the folder; meta.json says what was used."""
    focus = str(load_capture(here / "shot").camera.lens.focus_distance_m)
    raw = ["recon", "shot/raw.png", "--camera", "camera.toml", "--focus", focus, "--bank", "bank.npz"]
    exposure = str(load_capture(here / "shot").exposure_s)
    assert run([*raw, "--exposure", exposure, "--out", "plain"]) == 0
    np.testing.assert_array_equal(load_reconstruction(here / "plain").level, load_reconstruction(here / "result").level)
    about = json.loads((here / "plain" / "meta.json").read_text())
    assert (about["preset"], about["light"]) == ("best", "D55")
    assert about["bank"] == bank_identity(load_bank(here / "bank.npz"))
    assert set(about["timings_s"]) >= {"denoise", "depth", "sharpen"}
    assert Settings.model_validate(about["settings"]) == PRESETS["best"]


def test_stereo_pictures_and_surfaces_beside_the_result(here):
    arguments = ["recon", "shot", "--bank", "bank.npz", "--out", "plain"]
    assert run([*arguments, "--also", "anaglyph", "stereo", "ply", "glb"]) == 0
    names = {p.name for p in (here / "plain").iterdir()}
    assert names >= {"anaglyph.png", "stereo.png", "surface.ply", "surface.glb"}
    assert run(arguments) == 0, "an earlier result with them is replaced"
    assert "anaglyph.png" not in {p.name for p in (here / "plain").iterdir()}


def test_settings_are_printed_changed_and_found_again(here, capfd):
    assert run(["recon", "--preset", "likelihood", "--print-settings"]) == 0
    printed = capfd.readouterr().out
    (here / "mine.toml").write_text(printed.replace("window_px = 31", "window_px = 21"))
    assert run(["recon", "shot", "--bank", "bank.npz", "--settings", "mine.toml", "--out", "plain"]) == 0
    about = json.loads((here / "plain" / "meta.json").read_text())
    assert about["preset"] is None
    assert about["settings"] == {**PRESETS["likelihood"].model_dump(mode="json"), "window_px": 21}


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("shot/raw.png", "--camera", "none"), ("camera 'none'",)),
        (("shot/raw.png", "--camera", "camera.toml", "--format", "raw7"), ("--format 'raw7'", "raw10, raw12")),
        (("shot/raw.png", "--camera", "camera.toml", "--format", "raw10"), ("raw.png", "bytes", "2048 x 1536")),
        (("shot", "--camera", "camera.toml"), ("--camera", "leave it out")),
        (("shot", "--focus", "0.3"), ("--focus", "raw files")),
        (("shot", "--preset", "finest"), ("'finest'", "chakrabarti-zickler")),
        (("shot", "--preset", "paper", "--settings", "mine.toml"), ("--preset and --settings",)),
        (("--preset", "paper"), ("capture",)),
        (("shot", "--also", "hologram"), ("'hologram'", "anaglyph, stereo, ply, glb")),
    ],
)
def test_raw_files_and_settings_that_are_wrong(refused, arguments, message_part):
    refused("recon", *arguments, "--out", "new", message_part=message_part)


def test_recon_of_a_camera_without_infrared_is_a_picture(here, refused, capfd):
    """Rationale: the Bayer twin is there to compare pictures with. It has no depth, and no bank is made for it."""
    save_capture(here / "twin", even("bayer-mobile", 400), None)
    save_capture(here / "even", even("bayer-mobile", 500), None)
    assert run(["recon", "twin", "--flat", "even", "--out", "picture"]) == 0
    assert "no depth" in capfd.readouterr().out
    assert sorted(p.name for p in (here / "picture").iterdir()) == ["meta.json", "recon.exr", "rgb.png"]
    refused("recon", "twin", "--bank", "bank.npz", "--out", "new", message_part=("--bank", "no infrared pixels"))
    refused("score", "picture", "shot", message_part=("picture", "no depth"))
    refused("recon", "shot", "--bank", "bank.npz", "--flat", "even", "--out", "new", message_part=("flat", "mosaic"))
    assert run(["recon", "twin", "--out", "picture"]) == 0, "an earlier picture is replaced"


def test_recon_needs_no_truth(here):
    """Rationale: real photographs have none. A truth that was written and is gone is another matter."""
    (here / "shot" / "truth.exr").unlink()
    assert run(["recon", "shot", "--bank", "bank.npz", "--out", "plain"]) == 2
    meta = json.loads((here / "shot" / "meta.json").read_text())
    del meta["file_bytes"]["truth.exr"]
    (here / "shot" / "meta.json").write_text(json.dumps(meta))
    assert run(["recon", "shot", "--bank", "bank.npz", "--out", "plain"]) == 0


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("scenes", "desk"),
        ("cameras", "da-mobile"),
        ("materials", "brick"),
        ("illuminants", "D65"),
        ("claims", "staircase-camera"),
        ("studies", "hole-size"),
        ("methods", "chakrabarti-zickler"),
    ],
)
def test_list_names_what_is_bundled(kind, name, capsys):
    assert run(["list", kind]) == 0
    assert name in capsys.readouterr().out
    assert run(["list", kind, "--verbose"]) == 0


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("demo", ["--out", "folder"]),
        ("render", ["--size", "central crop", "--spp", "samples", "--focus", "metres", "--seed"]),
        ("expose", ["--time", "1/60", "--lux", "--scale", "--seed", "--frames", "burst"]),
        ("calibrate", ["--illuminant", "--focus", "metres"]),
        ("recon", ["--bank", "cache", "--settings", "preset"]),
        ("score", ["--json", "figures"]),
        ("emva", ["--camera", "--channel", "R, G, B or IR", "--gain", "--size", "WxH", "--seed"]),
        ("list", ["cameras", "illuminants"]),
    ],
)
def test_help_explains_every_option(command, options, capsys):
    """Expectation: what the docstring says of an option stands in --help, with its unit."""
    assert run([command, "--help"]) == 0
    output = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for part in options:
        assert part in output, f"'{part}' is not in\n{output}"


# --- what the user may get wrong -----------------------------------------------------------------

RENDER = ("render", "desk", *TINY, "--out", "new")


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("nonsense",), ("nonsense", "render", "recon")),
        (("render", "desk"), ("--out",)),
        (("render", "--out", "new"), ("scene",)),
        ((*RENDER, "--bogus", "1"), ("--bogus",)),
        ((*RENDER, "extra"), ("extra",)),
        (("list", "fruit"), ("fruit", "scenes", "cameras", "claims", "studies", "methods")),
        (("list",), ("kind",)),
        (("render", "attic", "--out", "new"), ("scene 'attic'", "desk")),
        (("render", "attic.toml", "--out", "new"), ("scene 'attic.toml'", "desk")),
        (("render", ".", "--out", "new"), ("scene '.'", "desk")),
        ((*RENDER, "--camera", "leica"), ("camera 'leica'", "da-mobile")),
        ((*RENDER, "--variant", "gpu"), ("variant 'gpu'", "auto", "scalar_spectral")),
        ((*RENDER, "--diffraction", "ray"), ("diffraction 'ray'", "off")),
        ((*RENDER, "--noise-at", "100"), ("noise_at is 100", "1 to 99.9")),
        ((*RENDER, "--noise", "column"), ("noise model 'column'", "file.py:function")),
        ((*RENDER, "--noise", "no.py:column"), ("noise model 'no.py:column'", "no.py cannot be read")),
        ((*RENDER, "--noise", "dasim.camera.noise:columns"), ("has no 'columns'", "expose")),
        ((*RENDER, "--seed", "-1"), ("seed", "-1", "0")),
        ((*RENDER, "--seed", "1.5"), ("seed", "1.5")),
        ((*RENDER, "--exposure", "0"), ("exposure", "0")),
        ((*RENDER, "--exposure", "-1"), ("exposure", "-1")),
        ((*RENDER, "--exposure", "nan"), ("exposure", "nan")),
        ((*RENDER, "--exposure", "long"), ("exposure", "long")),
        ((*RENDER, "--focus", "0"), ("focus", "0")),
        ((*RENDER, "--focus", "-1"), ("focus", "-1")),
        ((*RENDER, "--focus", "nan"), ("focus", "nan")),
        ((*RENDER, "--focus", "0.0036"), ("focus", "0.0036 m", "focal length")),
        ((*RENDER, "--focus", "0.0036001"), ("focus", "0.0036001")),
        (("calibrate", "--illuminant", "F99", "--out", "new"), ("illuminant 'F99'", "nearest are")),
        (
            ("calibrate", "--illuminant", "D55", "--illuminant", "F99", "--out", "new"),
            ("illuminant 'F99'", "nearest are"),
        ),
        (("calibrate", "--illuminant", "D55", "--diffraction", "x", "--out", "new"), ("diffraction 'x'", "wave")),
        (("calibrate", "--focus", "nan", "--out", "new"), ("focus", "nan")),
        (("calibrate", "--camera", "leica", "--out", "new"), ("camera 'leica'", "da-mobile")),
        (("calibrate", "--out", "shot"), ("shot", "folder")),
        (("calibrate", "--out", "mine.toml/bank.npz"), ("mine.toml",)),
        (("calibrate", "--out", "camera.toml"), ("camera.toml",)),
        (("recon", "nowhere", "--out", "new"), ("nowhere", "raw.png", "meta.json")),
        (("recon", "shot/raw.png", "--out", "new"), ("shot/raw.png", "--camera", "folder")),
        (("recon", "shot", "--bank", "none.npz", "--out", "new"), ("none.npz", "dasim calibrate")),
        (("recon", "shot", "--bank", "mine.toml", "--out", "new"), ("mine.toml",)),
        (("recon", "shot", "--bank", "bank.npz", "--settings", "no.toml", "--out", "new"), ("no.toml",)),
        (("score", "nowhere", "shot"), ("nowhere", "dasim recon")),
        (("score", "shot", "result"), ("shot", "dasim recon")),
        (("score", "result", "nowhere"), ("nowhere",)),
        (("score", "result", "shot", "--json", "no/folder.json"), ("no/folder.json",)),
    ],
    ids=lambda value: " ".join(value) if value and isinstance(value[0], str) else None,
)
def test_wrong_arguments_are_refused_in_one_line(refused, arguments, message_part):
    refused(*arguments, message_part=message_part)


def test_stock_plugins_refuse_other_stops(refused):
    """Expectation: in one line, with what to install."""
    from dasim.render import backend

    backend.choose("scalar_spectral")  # what works here is kept in the cache folder
    source = (CAMERA_DIR / "da-mobile.toml").read_text()
    Path("ring.toml").write_text(
        source.replace("radius_ratio = 1.0", 'shape = "annulus"\ninner_ratio = 0.5\nouter_ratio = 1.0')
    )
    refused(
        *RENDER,
        "--camera",
        "ring.toml",
        "--variant",
        "scalar_spectral",
        message_part=("stop 'open'", "install LLVM 17"),
    )


@pytest.mark.parametrize("spp", ["0", "-1", "1.5", "nan", "many"])
def test_wrong_samples_are_refused(refused, spp):
    refused("render", "desk", "--size", "64x48", f"--spp={spp}", "--out", "new", message_part=("spp", spp))
    refused("demo", f"--spp={spp}", "--out", "new", message_part=("spp", spp))


@pytest.mark.parametrize(
    "size", ["0x0", "0x48", "64x0", "64x-48", "-64x48", "64", "64x", "x48", "64x48x3", "axb", "nanxnan", "64.5x48", ""]
)
def test_wrong_sizes_are_refused(refused, size):
    refused("render", "desk", f"--size={size}", "--out", "new", message_part=("size", size))


@pytest.mark.parametrize("size", ["2x2", "63x48", "4096x48", "64x99999"])
def test_sizes_that_do_not_fit_the_sensor_are_refused(refused, size):
    """Expectation: the message speaks of the size, and of no file: the user named none."""
    message = refused("render", "desk", f"--size={size}", "--out", "new", message_part=(f"size {size}",))
    assert "the file" not in message


@pytest.mark.parametrize(
    ("old", "new", "message_part"),
    [
        ("lux = 500", "lux = nan", ("lights.0", "lux")),
        ("lux = 500", "lux = 500\ncolour = 1", ("colour: unknown key",)),
        ("lux = 500", "lux = ", ("not valid TOML",)),
        ('"sand"', '"golden"', ("object 'thing'", "material 'golden'", "nearest are gold")),
        ('"D65"', '"F99"', ("illuminant 'F99'", "nearest are")),
        ("size_cm = [50, 40]", "size_cm = [0, 40]", ("objects.0", "size_cm")),
        ("size_cm = [50, 40]", "size_cm = [50, -40]", ("objects.0", "size_cm")),
        ("position_cm = [0, 0, 20]", "position_cm = [0, 0, -20]", ("object 'thing'", "behind the lens")),
        ("position_cm = [0, 0, 20]", "position_cm = [0, 0, 0]", ("object 'thing'", "the camera is inside it")),
        ("position_cm = [0, 0, 40]", "position_cm = [0, 0, 0]", ("object 'wall'", "the lens")),
        ("thing.obj", "nothing.obj", ("object 'thing'", "nothing.obj", "no such file")),
        ("thing.obj", "camera.toml", ("object 'thing'", "camera.toml", "OBJ, PLY, GLB")),
        ("focus_cm = 40", "focus_cm = 0", ("focus_cm",)),
        ("focus_cm = 40", "focus_cm = 0.3", ("focus", "focal length")),
    ],
)
def test_wrong_scenes_are_refused(refused, here, old, new, message_part):
    assert SCENE.count(old) == 1
    (here / "mine.toml").write_text(SCENE.replace(old, new))
    refused("render", "mine.toml", *TINY, "--out", "new", message_part=message_part)


@pytest.mark.parametrize("kind", ["obj", "ply", "glb"])
@pytest.mark.parametrize("damage", ["empty", "cut", "no faces", "binary"])
def test_broken_meshes_are_refused(refused, here, kind, damage):
    file = here / f"thing.{kind}"
    sphere = trimesh.creation.icosphere(subdivisions=1, radius=1.0)
    sphere.export(file)
    if damage == "empty":
        file.write_bytes(b"")
    elif damage == "cut":
        if kind == "obj":
            pytest.skip("an OBJ that ends at a line's end is whole")
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    elif damage == "binary":
        file.write_bytes(bytes(range(256)) * 4)
    else:
        trimesh.PointCloud(sphere.vertices).export(file)
    (here / "mine.toml").write_text(SCENE.replace("thing.obj", file.name))
    refused("render", "mine.toml", *TINY, "--out", "new", message_part=("object 'thing'", file.name))


@pytest.mark.parametrize(
    ("old", "new", "message_part"),
    [
        ("pixel_pitch_um = 1.7", "pixel_pitch_um = nan", ("pixel_pitch_um",)),
        ("pixel_pitch_um = 1.7", "pixel_pitch_um = 0", ("pixel_pitch_um",)),
        ("pixel_pitch_um = 1.7", "pixel_pitch_um = 1.7\ncolour = 1", ("colour: unknown key",)),
        ("pixel_pitch_um = 1.7", "", ("pixel_pitch_um: is missing",)),
    ],
)
def test_wrong_cameras_are_refused(refused, here, old, new, message_part):
    text = CAMERA.read_text()
    assert text.count(old) == 1
    (here / "camera.toml").write_text(text.replace(old, new))
    refused(
        "render", "desk", "--camera", "camera.toml", *TINY, "--out", "new", message_part=("camera.toml", *message_part)
    )


@pytest.mark.parametrize("length", [None, 0.0, 0.5, 0.99])
@pytest.mark.parametrize("name", ["raw.png", "meta.json", "truth.exr"])
def test_captures_with_missing_or_cut_files_are_refused(refused, here, name, length):
    """Reconstruction needs raw.png and meta.json, scoring truth.exr."""
    file = here / "shot" / name
    data = file.read_bytes()
    if length is None:
        file.unlink()
    else:
        file.write_bytes(data[: int(len(data) * length)])
    command = ("score", "result", "shot") if name == "truth.exr" else ("recon", "shot", "--out", "new")
    refused(*command, message_part=(f"shot/{name}",))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("exposure_s", "long"),
        ("exposure_s", float("nan")),
        ("exposure_s", -1.0),
        ("gain", 0.0),
        ("gain", float("nan")),
        ("seed", "x"),
        ("camera", 3),
        ("schema", 99),
        ("provenance", 5),
    ],
)
def test_captures_with_wrong_metadata_are_refused(refused, here, key, value):
    file = here / "shot" / "meta.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {key: value}))
    refused("recon", "shot", "--bank", "bank.npz", "--out", "new", message_part=("shot/meta.json", key))


@pytest.mark.parametrize("damage", ["cut", "empty", "text", "about", "list", "channels", "levels", "lights", "nan"])
def test_damaged_banks_are_refused(refused, here, damage):
    """Expectation: a bank that is no bank, or whose arrays do not fit each other, is refused by name."""
    file = here / "bank.npz"
    with np.load(file) as data:
        arrays = dict(data)
    about = json.loads(str(arrays["about"]))
    if damage in ("cut", "empty", "text"):
        content = {"cut": file.read_bytes()[:2000], "empty": b"", "text": b"hello"}[damage]
        file.write_bytes(content)
    else:
        if damage == "about":
            about = {"schema": about["schema"]}
        elif damage == "list":
            about = [about]
        elif damage == "lights":
            about["lights"] = []
        elif damage == "channels":
            arrays["kernel"] = arrays["kernel"][:, :, :3]
        elif damage == "levels":
            arrays["kernel"] = arrays["kernel"][:, :5]
        else:
            arrays["kernel"] = np.full_like(arrays["kernel"], np.nan)
        np.savez(file, **(arrays | {"about": np.array(json.dumps(about))}))
    refused("recon", "shot", "--bank", "bank.npz", "--out", "new", message_part=("bank.npz",))


def test_bank_of_another_focus_is_refused(refused, here):
    """Expectation: both distances are named, and what makes a bank that fits."""
    file = here / "shot" / "meta.json"
    meta = json.loads(file.read_text())
    meta["camera"]["lens"]["focus_distance_m"] = 0.2
    file.write_text(json.dumps(meta))
    refused("recon", "shot", "--bank", "bank.npz", "--out", "new", message_part=("0.4 m", "0.2 m", "dasim calibrate"))


@pytest.mark.parametrize(
    ("text", "message_part"),
    [
        ("windows_px = 31", "windows_px: unknown key"),
        ("window_px = 2", "window_px"),
        ("denoise_bandwidth = nan", "denoise_bandwidth"),
        ("window = 'round'", "window"),
        ("[[[", "not valid TOML"),
    ],
)
def test_wrong_settings_are_refused(refused, here, text, message_part):
    (here / "settings.toml").write_text(text)
    arguments = ("--bank", "bank.npz", "--settings", "settings.toml", "--out", "new")
    refused("recon", "shot", *arguments, message_part=("settings.toml", message_part))


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


# --- what is there already -----------------------------------------------------------------------

WRITERS = [RENDER[:-1], ("recon", "shot", "--bank", "bank.npz", "--out"), ("demo", "--out")]
each_writer = pytest.mark.parametrize("command", WRITERS, ids=lambda command: command[0])


@each_writer
def test_output_that_is_a_file_is_refused(refused, command):
    refused(*command, "mine.toml", message_part=("mine.toml", "is a file"))
    refused(*command, "mine.toml/new", message_part=("mine.toml/new", "folder"))


@each_writer
@pytest.mark.parametrize("extra", [None, "meta.json", "results.json"])
def test_folder_with_foreign_files_is_never_touched(refused, here, command, extra):
    """Rationale: results.json and meta.json are common names; a folder that has one is not therefore ours to delete."""
    (here / "thesis").mkdir()
    (here / "thesis" / "thesis.txt").write_text("ten years of work")
    if extra:
        (here / "thesis" / extra).write_text('{"accuracy": 0.9}')
    refused(*command, "thesis", message_part=("thesis", "dasim did not write"))


def test_notes_beside_a_capture_are_not_deleted(refused, here):
    (here / "shot" / "notes.txt").write_text("seen at noon")
    refused(*RENDER[:-1], "shot", message_part=("shot", "dasim did not write"))


def test_a_command_does_not_replace_its_own_input(refused):
    refused("recon", "shot", "--bank", "bank.npz", "--out", "shot", message_part=("shot",))


def test_a_result_of_another_kind_is_not_replaced(refused):
    """Rationale: a photograph that took hours must not vanish under a reconstruction's name."""
    refused(*RENDER[:-1], "result", message_part=("result",))


@each_writer
def test_working_folder_itself_is_written_or_refused_before_work(refused, here, command, monkeypatch):
    """Expectation: what cannot be replaced is refused at once, not after the work."""
    arguments = [str(here / part) if part in ("shot", "bank.npz") else part for part in command]
    (here / "empty").mkdir()
    monkeypatch.chdir(here / "empty")
    refused(*arguments, ".", message_part=("output",))


@pytest.mark.parametrize("target", ["target", "nowhere"])
def test_link_as_output_leaves_no_litter(here, target):
    """Expectation: the command works or is refused; either way nothing hidden stays beside the output."""
    (here / "target").mkdir()
    (here / "link").symlink_to(target)
    status = run(["recon", "shot", "--bank", "bank.npz", "--out", "link"])
    if status == 0:
        assert load_reconstruction(here / "link").light == "D55"
    else:
        assert status == 2 and (here / "link").is_symlink()
    assert not [p.name for p in here.iterdir() if p.name.startswith(".")]


# --- interrupts ----------------------------------------------------------------------------------


def interrupted(arguments: list[str], folder: Path, environment: dict[str, str], after: str) -> tuple[int, str]:
    """Start a command, send SIGINT once ``after`` stands on stderr, and return exit status and stderr."""
    command = [sys.executable, "-m", "dasim.cli", *arguments]
    started = subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL)
    watchdog = threading.Timer(SIGINT_DEADLINE_S, started.kill)
    watchdog.start()
    lines: list[str] = []
    with started as process:
        try:
            assert process.stderr is not None
            for line in process.stderr:
                lines.append(line.decode())
                if after in lines[-1]:
                    time.sleep(0.5)  # into the work of this stage
                    process.send_signal(signal.SIGINT)
        finally:
            watchdog.cancel()
            if process.poll() is None and not lines:
                process.kill()
    return process.returncode, "".join(lines)


@pytest.fixture
def environment(renderer):
    """Of a process of its own, with the user's cache for the choice of renderer."""
    return os.environ | {"DASIM_VARIANT": renderer, "PYTHONUNBUFFERED": "1"}


@pytest.mark.slow
def test_interrupt_leaves_no_partial_capture(tmp_path, environment):
    arguments = ["render", "desk", "--size", "512x384", "--spp", "128", "--out", "photos/one"]
    status, printed = interrupted(arguments, tmp_path, environment, "rendering through stop")
    assert status == INTERRUPTED, printed
    assert "Traceback" not in printed
    assert not list(tmp_path.rglob("*one*")), "a partial folder stays"


@pytest.mark.slow
def test_interrupt_leaves_no_partial_demo(tmp_path, environment):
    """Rationale: the demo's folder is filled from the first stage on, under a temporary name."""
    arguments = ["demo", "--spp", "64", "--out", "demo"]
    status, printed = interrupted(arguments, tmp_path, environment, "rendering through stop")
    assert status == INTERRUPTED, printed
    assert "Traceback" not in printed
    assert not list(tmp_path.iterdir()), "a partial folder stays"


# --- refocus ---------------------------------------------------------------------------------------


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


# --- view ------------------------------------------------------------------------------------------


def test_view_writes_a_page(shop, tmp_path, capfd):
    """Expectation: a page with the focal stack; with the mosaic and the truth only where the capture is named."""
    out = tmp_path / "view.html"
    arguments = ["view", str(shop / "result"), "--bank", str(shop / "bank.npz"), "--slices", "2", "--out", str(out)]
    assert run(arguments) == 0
    alone = out.read_text(encoding="utf-8")
    assert "--capture names it" in capfd.readouterr().out
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
