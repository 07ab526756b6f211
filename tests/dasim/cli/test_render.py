"""The command render: captures of bundled scenes and of the user's own, and one line for wrong input."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh

from dasim.camera.specification import CAMERA_DIR
from dasim.cli import run
from dasim.files.captures import load_capture, load_truth
from tests.support.commands import CAMERA, RENDER, SCENE, TINY


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


@pytest.mark.parametrize(
    ("arguments", "message_part"),
    [
        (("render", "dsk"), ("scene 'dsk'", "did you mean 'desk'")),
        (("render", "--out", "new"), ("scene",)),
        ((*RENDER, "--bogus", "1"), ("--bogus",)),
        ((*RENDER, "extra"), ("extra",)),
        (("render", "attic", "--out", "new"), ("scene 'attic'", "desk")),
        (("render", "attic.toml", "--out", "new"), ("scene 'attic.toml'", "desk")),
        (("render", ".", "--out", "new"), ("scene '.'", "desk")),
        ((*RENDER, "--camera", "leica"), ("camera 'leica'", "da-mobile")),
        ((*RENDER, "--variant", "gpu"), ("variant 'gpu'", "auto", "scalar_spectral")),
        ((*RENDER, "--diffraction", "ray"), ("diffraction 'ray'", "off")),
        ((*RENDER[:-4], "--spp", "auto", *RENDER[-2:], "--noise-at", "100"), ("noise_at is 100", "1 to 99.9")),
        ((*RENDER, "--noise-share", "0.1"), ("--noise-share", "--spp auto")),
        ((*RENDER, "--noise", "column"), ("noise model 'column'", "file.py:function")),
        ((*RENDER, "--noise", "no.py:column"), ("noise model 'no.py:column'", "no.py cannot be read")),
        ((*RENDER, "--noise", "dasim.camera.noise:columns"), ("has no 'columns'", "expose")),
        ((*RENDER, "--seed", "-1"), ("seed", "-1", "0")),
        ((*RENDER, "--seed", "1.5"), ("seed", "1.5")),
        ((*RENDER, "--exposure", "0"), ("exposure", "0")),
        ((*RENDER, "--exposure", "-1"), ("exposure", "-1")),
        ((*RENDER, "--exposure", "nan"), ("exposure", "nan")),
        ((*RENDER, "--exposure", "long"), ("exposure", "long", "1/60")),
        ((*RENDER, "--exposure", "1/0"), ("exposure", "1/0", "1/60")),
        ((*RENDER, "--focus", "0"), ("focus", "0")),
        ((*RENDER, "--focus", "-1"), ("focus", "-1")),
        ((*RENDER, "--focus", "nan"), ("focus", "nan")),
        ((*RENDER, "--focus", "0.0036"), ("focus", "0.0036 m", "focal length")),
        ((*RENDER, "--focus", "0.0036001"), ("focus", "0.0036001")),
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
        ('"sand"', '"golden"', ("object 'thing'", "material 'golden'", "did you mean 'gold'")),
        ('"D65"', '"F99"', ("illuminant 'F99'", "did you mean 'F9'")),
        ("size_cm = [50, 40]", "size_cm = [0, 40]", ("objects.wall", "size_cm")),
        ("size_cm = [50, 40]", "size_cm = [50, -40]", ("objects.wall", "size_cm")),
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
