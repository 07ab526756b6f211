"""A user's depth method and metric go where the bundled ones go: claims, studies, scores and datasets."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import recon
from dasim.base.errors import InputError
from dasim.cli import run
from dasim.simulation.simulate import Shot
from tests.support import recon_scenes, surfaces
from validation import methods
from validation.claims.depth import scenes
from validation.claims.table import CLAIMS
from validation.methods import NamedMethod, named

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
    made = recon_scenes.make(recon_scenes.slanted(SIZE_PX[1], SIZE_PX[0], *LEVELS), white_e=4000)
    truth = surfaces.truth(made.capture.camera, made.level, made.sharp_e)
    truth = dataclasses.replace(truth, mean_e=made.mean_e, sharp_srgb=np.clip(truth.sharp_srgb, 0, 1), objects=("a",))
    provenance = {"diffraction": "wave", "scene": {"name": "slanted"}}
    return Shot(dataclasses.replace(made.capture, provenance=provenance), truth)


@pytest.fixture(scope="module")
def bank():
    return recon_scenes.bank(("D65",))


@pytest.fixture
def mine(tmp_path, monkeypatch) -> Path:
    """A folder to work in, with a file of methods."""
    (tmp_path / "mine.py").write_text(METHODS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr("dasim.cli.options.say_variant", lambda variant: None)
    return tmp_path


# --- names ---------------------------------------------------------------------------------------


def test_methods_have_the_names_that_users_give(mine):
    own, file, bundled = named(["flat=mine.py:constant", "mine.py:constant", "likelihood"])
    assert (own.name, own.source) == ("flat", "mine.py:constant")
    assert (file.name, file.source) == ("mine.py:constant", "mine.py:constant")
    assert bundled == NamedMethod("likelihood")
    assert methods.function(bundled) is recon.METHODS["likelihood"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["nothing"], ("'nothing' is unknown", "bands", "file.py:function")),
        (["bands=mine.py:constant"], ("'bands'", "bundled", "another name")),
        (["a b=mine.py:constant"], ("'a b' is no name",)),
        (["x=mine.py:constant", "x=mine.py:broken"], ("two methods", "'x'")),
        (["bands", "bands"], ("two methods", "'bands'")),
        (["mine.py:nothing"], ("nothing", "constant")),
        (["none.py:constant"], ("none.py",)),
    ],
)
def test_names_that_are_wrong_are_refused_in_one_line(mine, given, said):
    with pytest.raises(InputError) as error:
        named(given)
    assert all(part in str(error.value) for part in said) and "\n" not in str(error.value)


def test_a_methods_own_code_is_part_of_what_a_result_depends_on(mine):
    from dasim.base import fingerprint

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
    """The claim depth on one small capture that needs no renderer, with the bundled method bands alone."""
    monkeypatch.setattr(scenes, "SCENES", ("desk",))
    monkeypatch.setattr(scenes.rendering, "needs_wave", lambda: None)
    monkeypatch.setattr(scenes, "photographed", lambda *args, **options: shot)
    monkeypatch.setattr("dasim.calibration_captures", lambda *args, **options: None)
    monkeypatch.setattr("recon.calibrate", lambda captures: bank)
    monkeypatch.setattr(scenes.depth, "__defaults__", (0, methods.bundled("bands")))
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
    figures = [name.removeprefix("depth.bands.") for name in entries if name.startswith("depth.bands.")]
    assert len(figures) == 9
    assert set(entries) >= {f"depth.{name}.{figure}" for name in ("laplacian", "flat") for figure in figures}
    exact = np.linspace(*LEVELS, SIZE_PX[0])
    assert entries["depth.flat.desk.raw"]["value"] == pytest.approx(np.median(np.abs(exact - 4)), abs=0.05)
    assert entries["depth.flat.desk.raw"]["passed"] is False
    assert entries["depth.laplacian.desk.raw-ratio"]["passed"] is True
    assert entries["depth.laplacian.desk.raw"]["limit"] is None and entries["depth.bands.desk.raw"]["passed"] is True
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
    assert entries["depth.bands.desk.raw"]["value"] is not None
    printed = capsys.readouterr()
    assert "Traceback" not in printed.err and "IndexError" in printed.err


def test_every_claim_about_depth_takes_methods():
    """A method enters wherever a capture with depth or an all-in-focus picture is measured."""
    able = {name for name, measurement in CLAIMS.items() if measurement.methods}
    assert able == {
        "staircase-camera", "depth", "all-in-focus", "refocus", "depth-steps", "light-levels", "depth-maps",
        "yellow-disks", "scene-pictures",
    }  # fmt: skip
