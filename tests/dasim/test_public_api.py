"""The names that a user sees: listed, typed, documented, loaded late, and with arguments checked at the edge."""

from __future__ import annotations

import inspect
import json
import pydoc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.camera import geometry

ROOT = Path(dasim.__file__).parents[1]
# Libraries that take long to load: the renderer, its compilers, pictures and curves.
HEAVY = ("mitsuba", "drjit", "cv2", "numba", "scipy", "colour", "skimage", "matplotlib", "trimesh", "pydantic")
MEASURES = ("_m", "_cm", "_px", "_e", "_dn", "level")  # ends of names that carry a unit

USER_SCRIPT = """
from pathlib import Path

import dasim

scene: dasim.Scene | dasim.MitsubaScene = dasim.load_scene("desk")
camera: dasim.Camera = dasim.focused(dasim.cropped("da-mobile", 96, 64), scene)
shot: dasim.Shot = dasim.simulate("desk", Path("da-mobile.toml"), seed=0, spp="auto", exposure=dasim.Exposure(gain=2.0))
brightest: int = int(shot.capture.raw_dn.max())
depth_m: float = float(shot.truth.depth_m[0, 0])
for picture in dasim.calibration_captures("da-mobile", ["D65"]):
    print(picture.light, picture.frames_dn.shape)
board: dasim.Scene = dasim.staircase(camera, 14)
capture, truth = dasim.tiled([(shot.capture, shot.truth)], 64, 16)
try:
    kernel = dasim.psf("da-mobile", 0.3, "IR", "D65")
except dasim.InputError as error:
    print(error, kernel.shape)
"""
WRONG_SCRIPT = """
import dasim

dasim.simulate(dasim.load_camera("da-mobile"), "desk")
dasim.load_camera("da-mobile").focal_length
dasim.no_such_name
"""


def test_dir_lists_exactly_the_public_names():
    names = [name for name in dir(dasim) if not name.startswith("_")]
    assert sorted(names) == sorted(dasim.__all__)
    assert all(getattr(dasim, name) is not None for name in names)


def test_help_shows_the_public_names():
    text = pydoc.plain(pydoc.render_doc(dasim))
    assert all(name in text for name in dasim.__all__)


def test_import_loads_no_large_library():
    code = f"import dasim, sys, json; print(json.dumps([name for name in {HEAVY} if name in sys.modules]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert json.loads(done.stdout) == []


def test_the_first_functions_load_no_library_that_few_cameras_need():
    """Rationale: with these libraries, importing ``dasim.simulate`` took 1.6 times as long."""
    rare = ("scipy.signal", "scipy.stats", "scipy.optimize")
    code = "import dasim, recon, sys, json; dasim.load_camera, dasim.simulate, dasim.save_capture, recon.reconstruct; "
    code += f"print(json.dumps([name for name in {rare} if name in sys.modules]))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert json.loads(done.stdout) == []


def test_every_public_name_has_a_docstring_of_its_own():
    for name in dasim.__all__:
        value = getattr(dasim, name)
        text = inspect.getdoc(value) or ""
        assert len(text) > 20 and not text.startswith(f"{name}("), name
        assert value.__doc__, name  # not that of a base class


@pytest.mark.parametrize("name", [name for name in dasim.__all__ if name[0].islower()])
def test_docstrings_explain_the_arguments(name):
    """Every argument whose name does not carry its unit is mentioned in the docstring."""
    function = getattr(dasim, name)
    text = inspect.getdoc(function) or ""
    for argument in inspect.signature(function).parameters:
        if not argument.endswith(MEASURES) and argument not in ("path", "choices"):
            assert argument.split("_")[0].rstrip("s") in text, f"{name}({argument})"


def _mypy(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Mypy in strict mode on a script outside the project, which sees the packages as installed ones."""
    (folder / "script.py").write_text(script, encoding="utf-8")
    code = "import sys; from mypy.__main__ import console_entry; sys.argv[0] = 'mypy'; console_entry()"
    options = ["--strict", "--config-file", "/dev/null", "--follow-imports", "silent", "--ignore-missing-imports"]
    options += ["--cache-dir", str(folder / "cache"), "script.py"]
    variables = {"MYPYPATH": "", "PATH": "/usr/bin:/bin", "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-c", code, *options], capture_output=True, text=True, cwd=folder, env=variables, check=False
    )


@pytest.mark.slow
def test_a_type_checker_accepts_a_script_and_finds_its_mistakes(tmp_path):
    """Expectation: a correct script passes mypy --strict; swapped arguments and unknown names are errors."""
    done = _mypy(USER_SCRIPT, tmp_path)
    assert done.returncode == 0, done.stdout
    lines = [
        int(line.split(":")[1]) for line in _mypy(WRONG_SCRIPT, tmp_path).stdout.splitlines() if ": error:" in line
    ]
    assert sorted(set(lines)) == [4, 5, 6]


def test_a_name_stands_for_what_its_loader_returns():
    camera = dasim.load_camera("da-mobile")
    assert dasim.cropped("da-mobile", 96, 64) == dasim.cropped(camera, 96, 64)
    assert dasim.refocused("da-mobile", 0.3) == dasim.refocused(camera, 0.3)
    assert dasim.focused("da-mobile", "staircase") == dasim.focused(camera, dasim.load_scene("staircase"))
    assert dasim.staircase("da-mobile", 3) == dasim.staircase(camera, 3)
    assert np.array_equal(dasim.psf("da-mobile", 0.3, "G", "D65"), dasim.psf(camera, 0.3, "G", "D65"))
    first = next(iter(dasim.calibration_captures("da-mobile", ["D65"])))
    assert np.array_equal(first.frames_dn, next(iter(dasim.calibration_captures(camera, ["D65"]))).frames_dn)


def test_a_path_stands_for_its_file(tmp_path):
    text = (ROOT / "dasim" / "cameras" / "da-mobile.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    assert dasim.cropped(tmp_path / "mine.toml", 96, 64) == dasim.cropped("da-mobile", 96, 64)


def test_the_camera_owns_the_focus():
    """A scene's proposal counts only through ``focused``; flowers proposes another focus than da-mobile has."""
    default_m = dasim.load_camera("da-mobile").lens.focus_distance_m
    scene = dasim.load_scene("flowers")
    assert scene.focus_cm is not None and scene.focus_cm != default_m * 1e2
    assert dasim.focused("da-mobile", scene).lens.focus_distance_m == pytest.approx(scene.focus_cm * 1e-2)
    shot = dasim.simulate("flowers", dasim.cropped("da-mobile", 16, 12), spp=1)
    assert shot.capture.camera.lens.focus_distance_m == default_m


def test_random_scenes_and_families_are_names_too():
    camera = dasim.cropped("da-mobile", 96, 64)
    assert dasim.load_scene("random:3:1", camera=camera) == dasim.random_scene(3, 1, camera=camera)
    assert dasim.load_scene("staircase:5") == dasim.staircase(dasim.focused("da-mobile", "staircase"), 5)


SCENE, CAMERA = dasim.load_scene("desk"), dasim.load_camera("da-mobile")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: dasim.simulate(CAMERA, SCENE), "must be a Camera, a bundled name or a path, not a Scene"),
        (lambda: dasim.simulate(None, "da-mobile"), "scene: must be a Scene, the name of a scene or a path, not None"),
        (lambda: dasim.simulate("desk", 3), "camera: must be a Camera, a bundled name or a path, not the int 3"),
        (lambda: dasim.simulate("da-mobile", "desk"), "camera 'desk' is neither a bundled name"),
        (lambda: dasim.focused("desk", "da-mobile"), "camera 'desk' is neither a bundled name"),
        (lambda: dasim.focused("da-mobile", "no-such"), "scene 'no-such' is neither a bundled name"),
        (lambda: dasim.cropped(SCENE, 96, 64), "camera: must be a Camera, a bundled name or a path, not a Scene"),
        (lambda: dasim.cropped("da-mobile", 96.5, 64), "width_px: must be a whole number of pixels"),
        (lambda: dasim.refocused(None, 0.3), "not None"),
        (lambda: dasim.with_values("da-mobile", {"stops.hole.radius": 0.5}), "did you mean 'radius_ratio'?"),
        (lambda: dasim.with_values("da-mobile", {"stops.hole.radius_ratio": 2.0}), "stops.hole.radius_ratio: must be"),
        (lambda: dasim.with_values(None, {}), "not None"),
        (lambda: dasim.refocused("da-mobile", "near"), "focus_distance_m"),
        (lambda: dasim.load_scene(None), "scene: must be the name of a scene or a path, not None"),
        (lambda: dasim.load_camera(CAMERA), "camera: must be the name of a bundled camera or a path, not a Camera"),
        (lambda: dasim.psf("da-mobile", "near", "IR", "D65"), "depth_m: must be a distance above 0, in metres, not"),
        (lambda: dasim.psf("da-mobile", 0.3, "IR", None), "illuminant: must be a name such as 'D65', not None"),
        (lambda: dasim.psf("da-mobile", 0.3, "G", "D65", size=20), "size: must be an odd number of pixels per side"),
        (lambda: dasim.psf("da-mobile", 0.3, "G", "D65", size=-3), "size: must be an odd number of pixels per side"),
        (lambda: dasim.psf("da-mobile", 0.3, "G", "D65", field_px=(1,)), "field_px: must be two numbers of pixels"),
        (
            lambda: dasim.psf("da-mobile", 0.3, "G", "D65", field_px=(float("nan"), 0)),
            "field_px: must be two finite numbers",
        ),
        (
            lambda: dasim.psf("da-mobile", 0.3, "G", "D65", offset_px=(0, float("inf"))),
            "offset_px: must be two finite numbers",
        ),
        (lambda: dasim.psf("da-mobile", 0.3, "G", "D65", field_px=(9e3, 0)), "kernels are computed up to 60 degrees"),
        (lambda: dasim.calibration_captures("da-mobile", field_px="ab"), "field_px: must be two numbers of pixels"),
        (lambda: dasim.calibration_captures(None), "not None"),
        (lambda: dasim.calibration_captures("da-mobile", ()), "must be a list of one illuminant or more"),
        (lambda: dasim.calibration_captures("da-mobile", ("D6",)), "illuminant 'D6' is unknown"),
        (lambda: dasim.calibration_captures("da-mobile", frames=0), "frames is 0"),
        (lambda: dasim.calibration_captures("da-mobile", seed=-1), "seed is -1"),
        (lambda: dasim.cropped("da-mobile", 96, 64, at_px=(0,)), "at_px: must be two whole numbers of pixels"),
        (lambda: dasim.simulate("desk", "da-mobile", noise_share="a"), "noise_share: must be a number"),
        (lambda: dasim.lit_by("desk", ["D65"]), "illuminant: must be a name such as 'D65', not a list"),
        (lambda: dasim.staircase(3, "da-mobile"), "not the int 3"),
        (lambda: dasim.lit_by("desk", "no such light"), "illuminant 'no such light' is unknown"),
    ],
)
def test_wrong_arguments_are_refused_in_one_line(call, message):
    with pytest.raises(InputError) as raised:
        call()
    assert message in str(raised.value) and "\n" not in str(raised.value)


def test_values_can_be_compared_and_be_keys():
    """Expectation: cameras by what they hold; captures, which hold arrays, by identity, and not with an error."""
    assert CAMERA == dasim.load_camera("da-mobile") and len({CAMERA, dasim.load_camera("da-mobile")}) == 1
    raw = np.zeros((CAMERA.sensor.height_px, CAMERA.sensor.width_px), np.uint16)
    first, second = (dasim.Capture(raw.copy(), CAMERA, 0.01, 1.0, 0) for _ in range(2))
    assert first == first and first != second and len({first, second, first}) == 2


def test_specifications_have_a_short_repr():
    assert repr(CAMERA) == (
        "<Camera 'da-mobile': 3.6 mm f/2.8 focused at 40 cm, stops open, hole, 2048x1536 pixels of 1.7 um, "
        "mosaic G R / B IR>"
    )
    assert repr(SCENE).startswith(f"<Scene 'desk': {len(SCENE.objects)} objects, {len(SCENE.lights)} lights (")
    assert repr(dasim.Exposure()) == "<Exposure automatic to 0.85 of full scale, gain 1>"
    assert repr(dasim.Exposure(time_s=0.01, gain=2)) == "<Exposure 0.01 s, gain 2>"


def test_lit_by_changes_the_illuminant_alone():
    scene = dasim.lit_by("desk", "A")
    assert {light.illuminant for light in scene.lights} == {"A"}
    assert [light.lux for light in scene.lights] == [light.lux for light in SCENE.lights]


def test_lit_by_refuses_daylight_whose_spectrum_it_cannot_change():
    """Rationale: a study would have called pictures in daylight those under an incandescent lamp."""
    sun = {"kind": "daylight", "lux": 10000, "elevation_deg": 40}
    outdoors = dasim.Scene.model_validate(SCENE.model_dump() | {"lights": [sun]})
    with pytest.raises(InputError, match=r"'desk': .* 'daylight' .* use the kinds 'sun' and 'sky'"):
        dasim.lit_by(outdoors, "A")


def test_describe_names_every_stop():
    text = dasim.describe("da-mobile")
    assert all(stop.name in text for stop in CAMERA.stops) and f"{CAMERA.lens.f_number:g}" in text


def test_levels_of_the_staircase_are_those_of_the_camera():
    last = len(geometry.level_blur_px(CAMERA)) - 1
    with pytest.raises(InputError, match=f"0 to {last}"):
        dasim.staircase("da-mobile", last + 1)
