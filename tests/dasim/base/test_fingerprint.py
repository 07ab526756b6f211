"""Caches: a change of anything that decides a result misses, a change of anything else hits.

The modules that matter are listed by hand, or are those that a process has loaded after computing the result.
"""

from __future__ import annotations

import functools
import io
import re
import shutil
import subprocess
import sys
import tokenize
from pathlib import Path

import pytest

import dasim
from dasim.base import fingerprint, references
from dasim.base.errors import InputError
from dasim.camera.noise import Exposure
from dasim.render import backend
from recon.calibration import cached
from validation.claims.table import CLAIMS
from validation.gates import stored
from validation.studies.shape import board_likelihood, pipeline
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.point import Sweep, file_of
from validation.studies.sweep.specification import units
from validation.subjects import shots

HERE = Path(dasim.__file__).resolve().parents[1]
VARIANT = "any"

LIGHTS = ["dasim/spectra/illuminants.py", "dasim/spectra/daylight.py", "dasim/data/spctral2.csv"]
CAMERA = [f"dasim/camera/{name}.py" for name in ("specification", "geometry", "stops", "response_curves", "noise")]
PICTURES = ["dasim/simulation/calibration.py", "dasim/camera/pointspread.py", "dasim/camera/radiometry.py"]
CALIBRATION = [f"recon/calibration/{name}.py" for name in ("psf_bank", "pictures", "round_kernel", "unaligned")]
BANK = [*LIGHTS, *CAMERA, *PICTURES, *CALIBRATION, "dasim/spectra/grid.py", "dasim/files/banks.py"]
RENDER = [
    *("dasim/simulation/simulate.py", "dasim/simulation/adaptive_sampling.py", "dasim/materials/library.py"),
    *("dasim/scene/procedural/mannequin.py", "dasim/scene/shapes.py", "dasim/files/truth.py"),
    *(f"dasim/render/{name}.py" for name in ("passes", "wave", "pupil", "translate", "truth", "irradiance")),
]
RECON = [
    *("recon/pipeline.py", "recon/settings.py", "recon/depth/bands.py", "recon/sharp/deconvolution.py"),
    *("recon/depth/surface_net_0.npz", "recon/sharp/restoration_1.npz"),
]
TEMPLATES = ["validation/reports/templates/claims.html", "validation/reports/templates/study.html"]
BINARY = (".npz",)  # files of other kinds are text
ELSEWHERE = ["dasim/cli/check.py", "validation/gates/gates.toml", *TEMPLATES]

# Of each cache: what it depends on, and what it does not.
CACHES = {
    "bank": (
        BANK,
        ["dasim/random_scenes/layout.py", *RENDER, *RECON, *ELSEWHERE, "dasim/cameras/bando.toml", "scenes/desk.toml"],
    ),
    "photograph": (
        [*LIGHTS, *CAMERA, *RENDER, "dasim/files/captures.py", "dasim/files/png.py"],
        [*CALIBRATION, *RECON, *ELSEWHERE, "dasim/cameras/bando.toml", "scenes/adam.toml"],
    ),
    "point": (
        [*BANK, *RENDER, *RECON, "validation/studies/criteria.py", "validation/scores/pictures.py"],
        ["dasim/cli/check.py", *TEMPLATES, "validation/claims/optics/bank.py", "scenes/adam.toml"],
    ),
    "claim bank": (
        [*BANK, "validation/claims/optics/bank.py", "dasim/cameras/da-mobile.toml"],
        [*RENDER, *RECON, *ELSEWHERE, "validation/claims/depth/scenes.py", "scenes/desk.toml"],
    ),
    "claim depth": (
        [*BANK, *RENDER, *RECON, "validation/claims/depth/scenes.py", "scenes/desk.toml", "validation/scores/depth.py"],
        [*TEMPLATES, "dasim/cli/check.py", "validation/gates/gates.toml", "validation/claims/optics/bank.py"],
    ),
    "claim response-curves": (
        [*LIGHTS, "dasim/camera/response_curves.py", "validation/claims/optics/camera.py"],
        [*ELSEWHERE, *CALIBRATION, "recon/pipeline.py", "validation/claims/depth/scenes.py"],
    ),
    "shape, pipeline": ([*BANK, *RENDER, *RECON, "validation/studies/shape/pipeline.py"], ["dasim/cli/study.py"]),
    "shape, boards": ([*RENDER, "dasim/bounds/cramer_rao.py"], ["dasim/cli/study.py", *TEMPLATES]),
    "backend": (["dasim/render/backend.py"], ["dasim/render/passes.py", *RECON]),
}


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    """A copy of the packages and their data."""
    root = tmp_path_factory.mktemp("tree").resolve()
    for name in (*fingerprint.PACKAGES, "scenes"):
        shutil.copytree(HERE / name, root / name, ignore=shutil.ignore_patterns("__pycache__"))
    return root


@pytest.fixture
def copy(tree, monkeypatch):
    """The copy as the tree from which fingerprints are computed; it is restored after the test."""
    monkeypatch.setattr(fingerprint, "ROOT", tree)
    monkeypatch.setattr(backend, "choose", functools.wraps(backend.choose)(lambda *_: backend.Choice(VARIANT, "")))
    fingerprint.forget()
    yield tree
    fingerprint.forget()


@pytest.fixture(scope="module")
def keys(da_mobile):
    """For each cache, a function that returns the key of a result."""
    scene = dasim.load_scene("desk")
    spec = load_study("hole-size", quick=True)
    unit = units(spec)[0]
    return {
        "bank": lambda: cached.bank_file(dasim.calibration_captures(da_mobile, ("D65", "A"))),
        "photograph": lambda: shots._place(scene, da_mobile, Exposure(), 0, 4),
        "point": lambda: file_of(Sweep(spec, "out", {"variant": VARIANT}), unit),
        "claim bank": lambda: stored.key(CLAIMS["bank"].run, VARIANT),
        "claim depth": lambda: stored.key(CLAIMS["depth"].run, VARIANT),
        "claim response-curves": lambda: stored.key(CLAIMS["response-curves"].run, VARIANT),
        "shape, pipeline": lambda: stored.key(pipeline.pipeline_scores, VARIANT),
        "shape, boards": lambda: stored.key(board_likelihood.limits, VARIANT),
        "backend": lambda: backend._cache_key([]),
    }


def with_another_number(text: str, suffix: str) -> str:
    """The text with one number changed: the first of Python code, the last one of data; a remark where there is none.

    The digit 1 before a number changes its value, and leaves it a number.
    """
    if suffix == ".py":
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.NUMBER and not token.string.startswith(("0x", "0b", "0o")):
                lines = text.splitlines(keepends=True)
                row, column = token.start[0] - 1, token.start[1]
                lines[row] = f"{lines[row][:column]}1{lines[row][column:]}"
                return "".join(lines)
        return f"{text}\nNUMBER = 1\n"
    numbers = list(re.finditer(r"\b\d", text))
    return f"{text[: numbers[-1].start()]}1{text[numbers[-1].start() :]}" if numbers else f"{text}\n1\n"


def changed(key, *paths: Path) -> list[str]:
    """Files, by name, of which a change of a number changes the key."""
    before, names = key(), []
    for path in paths:
        data = path.read_bytes()
        try:
            if path.suffix in BINARY:
                path.write_bytes(data + b"1")
            else:
                path.write_bytes(with_another_number(data.decode(), path.suffix).encode())
            fingerprint.forget()
            if key() != before:
                names.append(path.name)
        finally:
            path.write_bytes(data)
            fingerprint.forget()
    return names


@pytest.mark.parametrize("name", CACHES)
def test_cache_misses_after_a_change_of_what_decides(name, copy, keys):
    paths = [copy / path for path in CACHES[name][0]]
    assert changed(keys[name], *paths) == [path.name for path in paths]


@pytest.mark.parametrize("name", CACHES)
def test_cache_hits_after_a_change_of_what_does_not_decide(name, copy, keys):
    assert changed(keys[name], *(copy / path for path in CACHES[name][1])) == []


def test_keys_repeat_and_are_the_same_wherever_the_packages_are(copy, keys, monkeypatch):
    there = {name: str(key()) for name, key in keys.items()}
    assert {name: str(key()) for name, key in keys.items()} == there
    monkeypatch.setattr(fingerprint, "ROOT", HERE)
    fingerprint.forget()
    assert {name: str(key()) for name, key in keys.items()} == there


def test_scenes_in_a_wheel_have_the_same_fingerprint(tree, tmp_path, monkeypatch):
    """Rationale: a wheel holds the scenes inside of dasim."""
    shutil.copytree(tree, tmp_path / "wheel")
    shutil.move(tmp_path / "wheel" / "scenes", tmp_path / "wheel" / "dasim" / "scenes")
    fingerprints = []
    for root in (tree, (tmp_path / "wheel").resolve()):
        monkeypatch.setattr(fingerprint, "ROOT", root)
        fingerprint.forget()
        fingerprints.append(stored.key(CLAIMS["depth"].run, VARIANT))
    fingerprint.forget()
    assert fingerprints[0] == fingerprints[1]


# --- two defects that caches had -----------------------------------------------------------------


def test_bank_does_not_survive_a_change_of_the_lights(copy, keys):
    """A key from a list of modules without the illuminants, the daylight model and its table would miss this change."""
    assert len(changed(keys["bank"], *(copy / path for path in LIGHTS))) == len(LIGHTS)


def test_study_point_does_not_survive_a_change_of_code_at_the_same_version(copy, keys, monkeypatch):
    """A key from the version of dasim alone would miss this change, because the version stays while
    the code changes.
    """
    monkeypatch.setattr(fingerprint, "library_version", lambda name: "0")
    assert changed(keys["point"], copy / "recon/depth/bands.py", copy / "dasim/spectra/illuminants.py")


# --- an independent account: what a process has loaded -------------------------------------------

RUNS = {
    "bank": (
        "import dasim, recon; from dasim.camera.specification import load_camera as load\n"
        "p = dasim.calibration_captures(load('da-mobile'), ('D50',), diffraction='off')\n"
        "next(iter(p)); from recon.calibration.psf_bank import calibrate\n",
        (dasim.calibration_captures, "recon.calibration.psf_bank"),
    ),
    "photograph": (
        "import dasim; s = dasim.load_scene('desk'); c = dasim.cropped(dasim.load_camera('da-mobile'), 16, 12)\n"
        "dasim.simulate(s, dasim.focused(c, s), spp=1)\n",
        (dasim.simulate,),
    ),
    "claim": (
        "import sys, types; v = types.ModuleType('validation'); v.__path__ = ['validation']\n"
        "v.__file__ = 'validation/__init__.py'; sys.modules['validation'] = v  # its own names are not asked for\n"
        "import validation.claims.depth.scenes\n",
        ("validation.claims.depth.scenes",),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_all_that_a_run_loads_is_in_the_fingerprint(name, renderer):
    """Expectation: every module of the packages that a process has loaded after a run is in the fingerprint, except for
    package files that only re-export names.
    """
    program, sources = RUNS[name]
    listed = "import sys; print(*(m.__file__ for n, m in sys.modules.items() if n.partition('.')[0] in "
    listed += f"{fingerprint.PACKAGES}), sep='|')"
    command = [sys.executable, "-c", program + listed]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=HERE)
    loaded = {(HERE / file).resolve() for file in done.stdout.splitlines()[-1].split("|")}
    missing = loaded - set(fingerprint.dependencies(*sources).files)
    assert len(loaded) > 10
    plain_modules = {path for path in missing if references.content(path.read_bytes()).exports is None}
    assert not plain_modules, sorted(path.name for path in plain_modules)


# --- functions of a user's own -------------------------------------------------------------------


def load(path: Path, name: str):
    space: dict = {"__name__": path.stem}
    exec(compile(path.read_text(), str(path), "exec"), space)
    return space[name]


@pytest.fixture
def method(tmp_path):
    """A depth method in a file that imports another one beside it, which imports from a package beside it."""
    (tmp_path / "method.py").write_text(
        "def estimate(capture, bank):\n    import helper\n    import scipy\n    return 'weights.csv'\n"
    )
    for name in ("weights.csv", "notes.csv"):
        (tmp_path / name).write_text("1\n")
    (tmp_path / "helper.py").write_text("from inner.part import value\nfrom numpy import pi\n")
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "__init__.py").write_text("from dasim.camera import noise\n")
    (tmp_path / "inner" / "part.py").write_text("from . import sibling\nvalue = 1\n")
    (tmp_path / "inner" / "sibling.py").write_text("number = 1\n")
    (tmp_path / "stranger.py").write_text("number = 1\n")
    return load(tmp_path / "method.py", "estimate")


@pytest.mark.parametrize("wrapped", [lambda f: f, functools.partial, functools.cache])
def test_function_of_a_users_own_is_followed_beside_its_file(method, tmp_path, wrapped):
    def key() -> str:
        return fingerprint.fingerprint(wrapped(method))

    names = ("method.py", "helper.py", "inner/__init__.py", "inner/part.py", "inner/sibling.py", "weights.csv")
    assert len(changed(key, *(tmp_path / name for name in names))) == len(names)
    assert not changed(key, tmp_path / "stranger.py", tmp_path / "notes.csv")
    followed = fingerprint.dependencies(method)
    assert {"numpy", "scipy"} <= followed.libraries
    assert HERE / "dasim/camera/noise.py" in followed.files


def test_claim_depends_on_the_functions_that_are_passed_to_it(method, tmp_path):
    claim = CLAIMS["bank"].run
    assert changed(lambda: stored.key(claim, VARIANT, uses=(method,)), tmp_path / "inner" / "sibling.py")
    assert not changed(lambda: stored.key(claim, VARIANT), tmp_path / "inner" / "sibling.py")


def test_installed_libraries_count_by_their_version(tmp_path, monkeypatch):
    """Expectation: a method in an installed package is followed within its package; what lies beside is a library."""
    folder = tmp_path / "site-packages"
    for name in ("mine", "other"):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").write_text("")
    (folder / "mine" / "method.py").write_text("import other\nfrom mine import parts\ndef estimate(): ...\n")
    (folder / "mine" / "parts.py").write_text("")
    followed = fingerprint.dependencies(folder / "mine" / "method.py")
    assert {path.name for path in followed.files} == {"method.py", "parts.py", "__init__.py"}
    assert followed.libraries == {"other"}
    assert not any("other" in path.parts for path in followed.files)
    before = fingerprint.fingerprint(folder / "mine" / "method.py")
    monkeypatch.setattr(fingerprint, "library_version", lambda name: "2.0")
    assert fingerprint.fingerprint(folder / "mine" / "method.py") != before


def test_function_without_a_file_is_refused():
    space: dict = {"__name__": "typed"}
    exec("def typed(): ...", space)
    with pytest.raises(InputError, match="has no source file"):
        fingerprint.fingerprint(space["typed"])


# --- rules of following --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("code", "followed"),
    [
        ("import dasim.camera.noise", True),
        ("from dasim.camera import noise", True),
        ("from dasim.camera.noise import expose as e", True),
        ("def f():\n    from dasim.camera import noise", True),
        ("try:\n    import dasim.camera.noise\nexcept ImportError:\n    pass", True),
        ("import dasim\ndasim.camera.noise.expose()", True),
        ("import dasim\ndasim.Exposure()", True),  # passed on by the package
        ("from dasim import Exposure", True),
        ("import dasim\nvars(dasim)", True),  # anything of it
        ("from dasim import *", True),
        ("import importlib\nimportlib.import_module('dasim.camera.noise')", True),
        ("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import dasim.camera.noise", False),
        ("import dasim", False),
        ("import dasim\ndasim.InputError()", False),
        ("from dasim.camera import stops", False),
    ],
)
def test_forms_of_imports(code, followed, tmp_path):
    (tmp_path / "code.py").write_text(code)
    result = fingerprint.dependencies(tmp_path / "code.py")
    assert (HERE / "dasim/camera/noise.py" in result.files) == followed


def test_package_with_code_of_its_own_counts_itself(copy):
    """Set-up: dasim's own package file with a statement beside its imports. Expectation: it is followed then."""
    init = copy / "dasim" / "__init__.py"
    text = init.read_text()
    assert init not in fingerprint.dependencies("dasim.camera.noise").files
    try:
        init.write_text(f"{text}\nNUMBER = 1\n")
        fingerprint.forget()
        assert init in fingerprint.dependencies("dasim.camera.noise").files
    finally:
        init.write_text(text)


def test_variant_decides_only_what_can_be_rendered():
    assert fingerprint.fingerprint("dasim.camera.noise", variant="x") == fingerprint.fingerprint("dasim.camera.noise")
    assert fingerprint.fingerprint(dasim.simulate, variant="x") != fingerprint.fingerprint(dasim.simulate, variant="y")
    with pytest.raises(ValueError, match="depends on the variant"):
        fingerprint.fingerprint(dasim.simulate)


def test_all_bundled_data_are_followed():
    """Expectation: whatever lies in the folders of data is read by code that the follower finds."""
    files = fingerprint.dependencies("validation.claims.table", "validation.studies.sweep.run").files
    data = [file for folder in ("dasim/data", "dasim/cameras", "scenes") for file in (HERE / folder).iterdir()]
    assert len(data) > 10 and not {file for file in data if file.is_file()} - set(files)


def test_texts_are_told_apart():
    """Expectation: the hash depends on the boundary between texts."""
    assert len({fingerprint.text_hash(text) for text in (["ab", "c"], ["a", "bc"], ["abc"], ["ab", "c", ""])}) == 4


def test_files_that_a_scene_names_count_by_their_content(tmp_path):
    (tmp_path / "thing.obj").write_text("v 0 0 0")
    data = {"objects": [{"file": "thing.obj", "name": "missing.obj"}], "number": 1}
    (first,) = fingerprint.named_files(data, tmp_path)
    (tmp_path / "thing.obj").write_text("v 0 0 1")
    assert fingerprint.named_files(data, tmp_path) != [first]
