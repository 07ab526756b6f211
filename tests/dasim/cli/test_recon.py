"""The command recon: captures and raw files, settings, further output, and one line for wrong input."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dasim.camera.specification import cropped, load_camera
from dasim.cli import run
from dasim.files.banks import bank_identity, load_bank
from dasim.files.captures import load_capture, save_capture
from dasim.values import Capture
from recon.files.reconstruction import load_reconstruction
from recon.settings import PRESETS, Settings


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
    assert names >= {"depth.png", "confidence.png", "mosaic.png"}
    assert run(arguments) == 0, "an earlier result with them is replaced"
    assert "anaglyph.png" not in {p.name for p in (here / "plain").iterdir()}


def test_a_surface_that_is_not_known_is_left_out(here, capfd):
    """Set-up: an even grey. Expectation: the rest of the result, and a note that says what is missing."""
    camera = load_capture(here / "shot").camera
    np.save(here / "grey.npy", np.full((camera.sensor.height_px, camera.sensor.width_px), 900, np.uint16))
    arguments = ["--camera", "camera.toml", "--focus", str(camera.lens.focus_distance_m), "--bank", "bank.npz"]
    assert run(["recon", "grey.npy", *arguments, "--out", "plain", "--also", "stereo", "ply"]) == 0
    names = {p.name for p in (here / "plain").iterdir()}
    assert "surface.ply" not in names and names >= {"stereo.png", "sharp.png", "recon.exr"}
    assert "surface.ply was left out" in capfd.readouterr().out
    assert any("surface.ply" in note for note in json.loads((here / "plain" / "meta.json").read_text())["notes"])


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
    assert sorted(p.name for p in (here / "picture").iterdir()) == ["meta.json", "mosaic.png", "recon.exr", "rgb.png"]
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
    ("arguments", "message_part"),
    [
        (("recon", "nowhere", "--out", "new"), ("nowhere", "raw.png", "meta.json")),
        (("recon", "shot/raw.png", "--out", "new"), ("shot/raw.png", "--camera", "folder")),
        (("recon", "shot", "--bank", "none.npz", "--out", "new"), ("none.npz", "dasim calibrate")),
        (("recon", "shot", "--bank", "mine.toml", "--out", "new"), ("mine.toml",)),
        (("recon", "shot", "--bank", "bank.npz", "--settings", "no.toml", "--out", "new"), ("no.toml",)),
    ],
    ids=lambda value: " ".join(value) if value and isinstance(value[0], str) else None,
)
def test_wrong_arguments_are_refused_in_one_line(refused, arguments, message_part):
    refused(*arguments, message_part=message_part)


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
