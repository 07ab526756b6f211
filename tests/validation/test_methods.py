"""A user's depth method and metric go where the bundled ones go: claims, studies, scores and datasets."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import dasim
import recon
import validation
from dasim.base import fingerprint
from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.cli import run
from dasim.files.banks import save_bank
from dasim.files.captures import save_capture
from dasim.simulation.exposure import Shot
from recon import levels
from tests.support import recon_scenes, surfaces
from validation import methods
from validation.claims.depth import scenes
from validation.claims.table import CLAIMS
from validation.methods import NamedMethod, named
from validation.scores.metrics import metric_figures
from validation.studies.sweep import point
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.specification import units

EXAMPLES = Path(__file__).parents[2] / "examples"
LAPLACIAN = f"laplacian={EXAMPLES / 'depth_method.py'}:laplacian_ratio"
SIZE_PX = (256, 192)
LEVELS = (1.0, 8.0)

METHODS = """
import numpy as np
from dasim.values import DepthEstimate

LEVEL = 4.0

def constant(capture, bank):
    return DepthEstimate(level=np.full(capture.raw_dn.shape, LEVEL))

def broken(capture, bank):
    return 1 / np.zeros(3)[5]

def wrong_shape(capture, bank):
    return DepthEstimate(level=np.zeros((4, 4)))
"""


@pytest.fixture(scope="module")
def shot() -> Shot:
    """A slanted photograph without a renderer, with its truth."""
    scene = recon_scenes.make(recon_scenes.slanted(SIZE_PX[1], SIZE_PX[0], *LEVELS), white_e=4000)
    truth = surfaces.truth(scene.capture.camera, scene.level, scene.sharp_e)
    truth = dataclasses.replace(truth, mean_e=scene.mean_e, sharp_srgb=np.clip(truth.sharp_srgb, 0, 1), objects=("a",))
    provenance = {"diffraction": "wave", "scene": {"name": "slanted"}}
    return Shot(dataclasses.replace(scene.capture, provenance=provenance), truth)


@pytest.fixture(scope="module")
def bank():
    return recon_scenes.bank(("D65",))


@pytest.fixture
def mine(tmp_path, monkeypatch) -> Path:
    """A folder to work in, with a file of methods."""
    (tmp_path / "mine.py").write_text(METHODS)
    methods.function.cache_clear()  # the file has the same name in each test
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr("dasim.cli.options.say_variant", lambda variant: None)
    return tmp_path


# --- names ---------------------------------------------------------------------------------------


def test_methods_have_the_names_that_users_give(mine):
    renamed, file, bundled = named(["flat=mine.py:constant", "mine.py:constant", "likelihood"])
    assert (renamed.name, renamed.source) == ("flat", "mine.py:constant")
    assert (file.name, file.source) == ("mine.py:constant", "mine.py:constant")
    assert bundled == NamedMethod("likelihood")
    assert methods.function(bundled) is recon.METHODS["likelihood"]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["nothing"], ("'nothing' is unknown", "bands", "file.py:function")),
        (["bands=mine.py:constant"], ("'bands'", "bundled", "another name")),
        (["a b=mine.py:constant"], ("'a b' is not a valid name",)),
        (["x=mine.py:constant", "x=mine.py:broken"], ("two methods", "'x'")),
        (["bands", "bands"], ("two methods", "'bands'")),
        (["mine.py:nothing"], ("nothing", "constant")),
        (["none.py:constant"], ("none.py",)),
    ],
)
def test_names_that_are_wrong_are_refused_in_one_line(mine, names, message):
    with pytest.raises(InputError) as error:
        named(names)
    assert all(part in str(error.value) for part in message) and "\n" not in str(error.value)


def test_a_methods_own_code_is_part_of_what_a_result_depends_on(mine):
    def identity() -> list[str]:
        methods.function.cache_clear()
        fingerprint.forget()
        return methods.identity(*named(["flat=mine.py:constant"]), variant="x")

    first = identity()
    assert identity() == first
    (mine / "mine.py").write_text(METHODS.replace("LEVEL = 4.0", "LEVEL = 5.0"))
    assert identity() != first


# --- claims --------------------------------------------------------------------------------------


@pytest.fixture
def small_claim(mine, shot, bank, monkeypatch):
    """The claim depth on one small capture that needs no renderer, with the bundled method best alone."""
    monkeypatch.setattr(scenes, "SCENES", ("desk",))
    monkeypatch.setattr(scenes.rendering, "needs_wave", lambda: None)
    monkeypatch.setattr(scenes, "photographed", lambda *args, **options: shot)
    monkeypatch.setattr("dasim.calibration_captures", lambda *args, **options: None)
    monkeypatch.setattr("recon.calibrate", lambda captures: bank)
    monkeypatch.setattr(scenes.depth, "__defaults__", (0, methods.bundled("best")))
    (mine / "gates.toml").write_text(
        '["depth.laplacian.desk.raw-ratio"]\nlimit = "<= 0.9"\n["depth.flat.*.raw"]\nlimit = "<= 0.1"\n'
    )
    return mine


def test_claims_measure_a_users_methods_beside_ours(small_claim):
    """Expectation: a constant map has the error of its level, which the median of |level - 4| tells.

    Every figure of ours stands there for each method; limits are of the method that a gate names; a second run finds
    the results of the first; ours are not measured again for a further method.
    """
    command = ["validate", "--only", "depth", "--gates", "gates.toml"]
    theirs = ["--method", LAPLACIAN, "--method", "flat=mine.py:constant"]
    assert run([*command, *theirs, "--out", "out"]) == 1, "the constant map misses its limit"
    content = json.loads((small_claim / "out" / "results.json").read_text())
    entries = {entry["id"]: entry for entry in content["claims"] if "*" not in entry["id"]}
    figures = [name.removeprefix("depth.best.") for name in entries if name.startswith("depth.best.")]
    assert len(figures) == 9
    assert set(entries) >= {f"depth.{name}.{figure}" for name in ("laplacian", "flat") for figure in figures}
    exact = np.linspace(*LEVELS, SIZE_PX[0])
    assert entries["depth.flat.desk.raw"]["value"] == pytest.approx(np.median(np.abs(exact - 4)), abs=0.05)
    assert entries["depth.flat.desk.raw"]["passed"] is False
    assert entries["depth.laplacian.desk.raw-ratio"]["passed"] is True
    assert entries["depth.laplacian.desk.raw"]["limit"] is None and entries["depth.best.desk.raw"]["passed"] is True
    cases = {case.get("name") for case in ElementTree.parse(small_claim / "out" / "junit.xml").iter("testcase")}
    assert set(entries) <= cases
    page = (small_claim / "out" / "report.html").read_text()
    assert "Methods side by side" in page and "laplacian" in page


def test_a_method_that_raises_fails_its_claim_in_one_line(small_claim, capsys):
    """Expectation: ours are measured all the same; what the user reads names method, exception and line."""
    assert run(["validate", "--only", "depth", "--out", "out", "--method", "mine.py:broken"]) == 1
    content = json.loads((small_claim / "out" / "results.json").read_text())
    entries = {entry["id"]: entry for entry in content["claims"]}
    failed = entries["depth.mine.py:broken"]
    assert failed["passed"] is False and "IndexError" in failed["source"] and "mine.py, line 11" in failed["source"]
    assert entries["depth.best.desk.raw"]["value"] is not None
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err and "IndexError" in printed.err


def test_a_function_that_ends_the_process_is_an_error(tmp_path):
    """Rationale: sys.exit(0) in a user's function would end a gate in CI as passed."""
    capture, bank = object(), object()

    def leaves(*_):
        sys.exit(0)

    with pytest.raises(InputError, match="stopped by SystemExit"):
        methods._guarded(leaves)(capture, bank)
    with pytest.raises(InputError, match="stopped by SystemExit"):
        metric_figures("map", np.ones((2, 2)), None, [leaves])
    with pytest.raises(InputError, match="SystemExit"):
        noise.apply(leaves, np.ones((2, 2)), dasim.load_camera("da-mobile").sensor, 0.1, 0, 1.0)


def test_every_claim_about_depth_takes_methods():
    """A method enters wherever a capture with depth or an all-in-focus picture is measured."""
    able = {name for name, measurement in CLAIMS.items() if measurement.methods}
    assert able == {
        "staircase-camera", "depth", "depth-held-out", "all-in-focus", "refocus", "depth-steps", "light-levels",
        "depth-maps", "yellow-disks", "scene-pictures", "side-of-focus", "sharp-held-out",
    }  # fmt: skip


# --- scores --------------------------------------------------------------------------------------


@pytest.fixture
def capture(mine, shot, bank) -> Path:
    """The capture and its bank on disk."""
    save_capture(mine / "shot", shot.capture, shot.truth)
    save_bank(mine / "bank.npz", bank)
    return mine


def test_score_runs_methods_and_metrics_on_a_capture(capture, shot):
    """Expectation: figures of the method are those of its reconstruction scored in Python; the metric's by hand."""
    (capture / "gates.toml").write_text('["score.flat.raw.all.level-median"]\nlimit = "<= 0.5"\n')
    metric = f"near={EXAMPLES / 'metric.py'}:within_a_centimetre"
    command = ["score", "shot", "--method", "flat=mine.py:constant", "--bank", "bank.npz", "--metric", metric]
    command += ["--metric", f"{EXAMPLES / 'metric.py'}:ordinal", "--json", "score.json", "--junit", "score.xml"]
    assert run(command) == 0
    assert run([*command, "--gates", "gates.toml"]) == 1, "a constant map is off by more than half a level"
    content = json.loads((capture / "score.json").read_text())
    assert content["flat.raw.all.level-median"]["passed"] is False
    assert content["flat.raw.all.level-median"]["value"] == pytest.approx(
        np.median(np.abs(shot.truth.level - 4)), abs=0.05
    )
    constant_m = levels.depth_of(np.full(shot.truth.level.shape, 4.0, np.float32), recon_scenes.bank(("D65",)).depth_m)
    expected = np.mean(np.abs(constant_m - shot.truth.depth_m) < 0.01)
    assert content["flat.raw.near"]["value"] == pytest.approx(expected, abs=0.01)
    assert content["flat.raw.ordinal-right"]["value"] == 0, "a constant map orders nothing"
    (failure,) = ElementTree.parse(capture / "score.xml").iter("failure")
    assert "limit <= 0.5" in failure.get("message")


def test_score_in_python_takes_a_metric(shot, bank):
    result = recon.reconstruct(shot.capture, bank)

    def share(depth_m, truth) -> float:
        """Share of pixels with depth."""
        return float(np.isfinite(depth_m).mean())

    values = {f.id: f.value for f in validation.score(result, shot.capture, shot.truth, metrics=[share])}
    assert values["regularised.share"] == 1 and values["raw.share"] == np.isfinite(result.level_raw).mean()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--method", "mine.py:broken"], ("mine.py:broken", "IndexError")),
        (["--method", "mine.py:wrong_shape"], ("mine.py:wrong_shape", "shape")),
        (["--method", "mine.py:constant", "--scale", "1"], ("--method", "--scale")),
        (["--metric", "mine.py:none", "--method", "bands"], ("mine.py", "none")),
        (["--metric", "mine.py:broken", "--method", "flat=mine.py:constant"], ("metric 'broken'", "IndexError")),
        (["--method", "bands", "--gates", "claims.toml"], ("depth.bands.desk.raw", "score")),
        ([], ("--bank applies to --method", "omit it")),
    ],
)
def test_wrong_scores_are_refused_in_one_line(capture, capsys, arguments, message):
    (capture / "claims.toml").write_text('["depth.bands.desk.raw"]\nlimit = "> 0"\n')
    assert run(["score", "shot", "--bank", "bank.npz", *arguments]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("dasim: ")]
    assert len(lines) == 1 and all(part in lines[0] for part in message), lines


# --- studies -------------------------------------------------------------------------------------


STUDY = """
name = "mine"
camera = "da-mobile"
scene = "desk"
size_px = [256, 192]
seeds = 1
[parameters]
"light.lux" = 1000.0
"""


def test_a_study_measures_a_users_method_beside_the_preset(mine, shot, bank, monkeypatch):
    """Expectation: the same picture for both methods; a constant map has the error of its level.

    Set-up: a study without the parameter recon.preset gets it; the picture is made without a renderer.
    """
    (mine / "study.toml").write_text(STUDY)
    spec = load_study("study.toml", methods=["flat=mine.py:constant"])
    assert spec.parameters["recon.preset"] == ("bands", "flat=mine.py:constant")
    (unit,) = units(spec)
    monkeypatch.setattr("dasim.simulate", lambda *args, **options: shot)
    monkeypatch.setattr("dasim.calibration_captures", lambda *args, **options: None)
    monkeypatch.setattr("recon.calibrate", lambda captures: bank)
    ours, theirs = (row["figures"] for row in point.measure(spec, unit))
    constant_m = levels.depth_of(np.full(shot.truth.level.shape, 4.0, np.float32), bank.depth_m)
    expected = np.median(np.abs(1 / constant_m - 1 / shot.truth.depth_m))
    assert theirs["depth-median"] == pytest.approx(expected, rel=0.02) and theirs["coverage"] == 1
    assert ours["depth-median"] < 0.5 * theirs["depth-median"]
    assert ours["infrared-snr"] == pytest.approx(theirs["infrared-snr"], rel=0.01)


def test_a_studys_points_depend_on_a_users_code(mine):
    """Expectation: a changed function is another code, so that its points are measured again."""
    (mine / "study.toml").write_text(STUDY)
    spec = load_study("study.toml", methods=["flat=mine.py:constant"])
    first = point.code(spec, "x")
    assert first != point.code(load_study("study.toml"), "x")
    (mine / "mine.py").write_text(METHODS.replace("LEVEL = 4.0", "LEVEL = 5.0"))
    fingerprint.forget()
    assert point.code(spec, "x") != first


@pytest.mark.parametrize("text", ["nothing", "mine.py:nothing", "bands=mine.py:constant"])
def test_a_study_with_a_wrong_method_is_refused(mine, text):
    (mine / "study.toml").write_text(STUDY)
    with pytest.raises(InputError, match=r"study.toml.*method"):
        load_study("study.toml", methods=[text])
