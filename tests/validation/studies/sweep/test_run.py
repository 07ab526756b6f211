"""Sweeps: which pictures are rendered once, what is resumed, the table and the page."""

from __future__ import annotations

import base64
import csv
import math
import shutil

import numpy as np
import pytest

from dasim.scene import loading as scene_files
from tests.support import browser
from tests.support.small_study import GRIDS, HOLE, STUDY, swept
from validation.studies.sweep import designs, report
from validation.studies.sweep import run as sweep
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.point import FIGURES, Sweep, file_of
from validation.studies.sweep.specification import points, units

CURVES = f"""
[[curves]]
x = "light.illuminant"
y = "depth-median"
beside = ["depth-bound"]
[[curves]]
x = "{HOLE}"
y = "depth-median"
beside = ["depth-bound"]
log_x = true
"""


def test_what_needs_no_new_picture_shares_one(study):
    """Set-up: two holes, three levels of light, two seeds. Expectation: 6 points, 4 renderings of 3 points each."""
    spec = load_study(str(study))
    assert len(points(spec)) == 6 and spec.parameters["light.lux"] == (100.0, 1000.0, 10000.0)
    assert [(unit.seed, len(unit.points)) for unit in units(spec)] == [(0, 3), (0, 3), (1, 3), (1, 3)]
    assert all("light.lux" not in unit.render for unit in units(spec))


@pytest.mark.usefixtures("undrawn")
def test_a_restarted_sweep_redoes_nothing(study, tmp_path):
    """Set-up: a sweep; again; then with one more hole. Expectation: 4 renderings, none, and the 2 of the new hole."""
    assert swept(load_study(str(study)), tmp_path / "out")[0] == [0, 1, 2, 3]
    assert swept(load_study(str(study)), tmp_path / "out")[0] == []
    study.write_text(STUDY.replace("[0.3, 0.46]", "[0.3, 0.46, 0.6]"))
    assert len(swept(load_study(str(study)), tmp_path / "out")[0]) == 2


def test_points_keep_their_names_in_another_installation(study, tmp_path, monkeypatch):
    """Set-up: the bundled scenes in another folder. Expectation: the same names, so that what was measured counts."""
    job = Sweep(load_study(str(study)), "out", {"variant": "any"})
    before = [file_of(job, unit) for unit in units(job.spec)]
    shutil.copytree(scene_files.SCENE_DIR, tmp_path / "elsewhere")
    monkeypatch.setattr(scene_files, "SCENE_DIR", tmp_path / "elsewhere")
    designs._cached_scene.cache_clear()
    assert [file_of(job, unit) for unit in units(job.spec)] == before and len(set(before)) == len(before)


def test_what_failed_is_said_and_tried_again(study, tmp_path):
    calls, failed = swept(load_study(str(study)), tmp_path / "out", broken=(1,))
    assert len(calls) == 4 and list(failed.values()) == ["no such luck"] and "0.46" in next(iter(failed))
    assert "no such luck" in (tmp_path / "out" / "report.html").read_text()
    assert swept(load_study(str(study)), tmp_path / "out") == ([1], {})


@pytest.mark.parametrize("text", ['[{"a', "[]", "{}", "[1, 2, 3]", "\xff"])
@pytest.mark.usefixtures("undrawn")
def test_a_damaged_file_of_a_point_is_measured_again(study, tmp_path, text):
    spec, out = load_study(str(study)), tmp_path / "out"
    swept(spec, out)
    table = (out / "results.csv").read_text()
    (out / file_of(Sweep(spec, str(out), {"variant": "any"}), units(spec)[2])).write_bytes(text.encode("latin-1"))
    assert swept(spec, out) == ([2], {})
    assert (out / "results.csv").read_text() == table


@pytest.mark.usefixtures("undrawn")
def test_the_table_has_every_point_and_seed(study, tmp_path):
    swept(load_study(str(study)), tmp_path / "out")
    with (tmp_path / "out" / "results.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 12
    one = next(r for r in rows if r["camera.stops.hole.radius_ratio"] == "0.3" and r["light.lux"] == "100")
    assert float(one["depth-median (1/m)"]) == pytest.approx(1 / 0.3 / 100, rel=1e-5)


@pytest.mark.usefixtures("undrawn")
def test_means_and_spread_over_seeds(study, tmp_path):
    """Expectation: seeds give x and 1.1 x: mean 1.05 x, deviation 0.1 x / sqrt(2)."""
    spec = load_study(str(study))
    swept(spec, tmp_path / "out")
    rows = sweep.means(sweep.measured_rows(Sweep(spec, str(tmp_path / "out"), {"variant": "any"})), spec)
    one = next(row for row in rows if row["light.lux"] == 100 and row["camera.stops.hole.radius_ratio"] == 0.3)
    x = 1 / 0.3 / 100
    assert one["depth-median"] == pytest.approx(1.05 * x)
    assert one["depth-median:spread"] == pytest.approx(0.1 * x / math.sqrt(2))
    some = [
        row | {"depth-median": math.inf} if row["seed"] else row
        for row in sweep.measured_rows(Sweep(spec, str(tmp_path / "out"), {"variant": "any"}))
    ]
    assert all(math.isnan(row["depth-median"]) for row in sweep.means(some, spec)), (
        "a design that fails is not the best"
    )


def test_the_page_is_self_contained(study, tmp_path):
    swept(load_study(str(study)), tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/svg+xml") == 3 and "http" not in page.replace("http://www.w3.org", "")
    assert "&lt;hole&gt; &amp; why" in page


def test_curves_of_words_show_them_and_figures_stand_beside_a_curve(tmp_path):
    """Set-up: two lights, a figure drawn beside. Expectation: the words at the ticks, and the figure's line."""
    (tmp_path / "s.toml").write_text(GRIDS + CURVES)
    spec = load_study(str(tmp_path / "s.toml"))
    rows = [
        dict(point) | {key: number + 1.0 for key in FIGURES} | {f"{key}:spread": 0.0 for key in FIGURES}
        for number, point in enumerate(points(spec))
    ]
    words, lines = (base64.b64decode(report._curve(one, rows, spec).split(",")[1]).decode() for one in spec.curves)
    assert "<!-- D65 -->" in words and "<!-- A -->" in words
    assert "stroke-dasharray" in lines and "<!-- 0.46 -->" in lines
    assert "dashes: Cramer" in report._caption(spec.curves[0], spec)


def test_the_page_opens_in_a_browser_without_complaint(referred, tmp_path):
    """Expectation: the page shows its curves, in their first colour, and says where the reference stands."""
    swept(referred, tmp_path / "out")
    page = tmp_path / "out" / "report.html"
    assert "How hole radius / lens radius = 0.46 compares" in page.read_text()
    shot = browser.screenshot(page)
    blue = np.array([int(report.COLOURS[0][k : k + 2], 16) for k in (5, 3, 1)])
    assert (np.abs(shot.astype(int) - blue).max(axis=-1) < 20).sum() > 100
