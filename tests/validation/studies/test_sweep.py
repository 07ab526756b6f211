"""Sweeps: what a file may say, which pictures are rendered once, what is resumed, the table and the page."""

from __future__ import annotations

import base64
import csv
import json
import math
import shutil
from collections import deque

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.base.executors import Outcome
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.cli import run
from dasim.scene import loading as scene_files
from dasim.values import Capture
from tests.support import browser, surfaces
from validation.claims.optics.resolution import half_pixel_m
from validation.studies import criteria
from validation.studies.sweep import designs, findings, loading, report
from validation.studies.sweep import run as sweep
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.point import FIGURES, Sweep, depth_figures, file_of, light_loss, limits, median_error
from validation.studies.sweep.specification import Curve, points, units

STUDY = """
name = "small"
question = "Which <hole> & why?"
seeds = 2
pareto = ["light-loss", "depth-median"]
[parameters]
"camera.stops.hole.radius_ratio" = [0.3, 0.46]
"light.lux" = { log_grid = [100.0, 10000.0, 3] }
[[curves]]
x = "camera.stops.hole.radius_ratio"
y = "depth-median"
by = "light.lux"
log_y = true
"""
HOLE = "camera.stops.hole.radius_ratio"
GRIDS = f"""
name = "grids"
[design]
"{HOLE}" = 0.46
"light.illuminant" = "D65"
[[parameters]]
"{HOLE}" = [0.3, 0.46, 0.6]
[[parameters]]
"light.illuminant" = ["D65", "A"]
[quick]
"{HOLE}" = [0.6]
"""
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
EDGES = 0.004  # of the light: coatings have edges of 8 nm, which eq. (1) has not


@pytest.fixture
def study(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(STUDY)
    return file


def measured(job: Sweep, index: int, broken=()) -> Outcome:
    """A worker that knows a formula: error falls with the hole and with light, loss with the hole."""
    from dasim.dataset import sample, storage

    unit = units(job.spec)[index]
    if index in broken:
        return Outcome(index, "no such luck")
    rows = []
    for point in unit.points:
        alpha, lux = point["camera.stops.hole.radius_ratio"], point["light.lux"]
        values = dict.fromkeys(FIGURES, 1.0) | {"light-loss": (1 - alpha**2) / 4, "depth-median": 1 / alpha / lux}
        values["depth-median"] *= 1 + 0.1 * unit.seed
        values |= {"depth-bound": values["depth-median"] ** 0.5, "depth-seen": values["depth-median"]}
        rows.append({"point": point, "seed": unit.seed, "light_chosen": "D55", "figures": values})
    storage.write(job.out, file_of(job, unit), sample.json_bytes(rows))
    return Outcome(index)


def inline(calls: list[int], broken=()):
    def run_all(job, queue: deque[int]):
        while queue:
            calls.append(queue[0])
            yield measured(job, queue.popleft(), broken)

    return run_all


def swept(spec, out, broken=()) -> tuple[list[int], dict[str, str]]:
    calls: list[int] = []
    failed = sweep.sweep(Sweep(spec, str(out), {"variant": "any"}), inline(calls, broken), lambda *counts: None)
    return calls, failed


@pytest.fixture
def undrawn(monkeypatch):
    """Sweeps without their pictures, which take a second."""
    monkeypatch.setattr(report, "page", lambda *parts: "")


# --- specification -------------------------------------------------------------------------------


def test_what_needs_no_new_picture_shares_one(study):
    """Set-up: two holes, three levels of light, two seeds. Expectation: 6 points, 4 renderings of 3 points each."""
    spec = load_study(str(study))
    assert len(points(spec)) == 6 and spec.parameters["light.lux"] == (100.0, 1000.0, 10000.0)
    assert [(unit.seed, len(unit.points)) for unit in units(spec)] == [(0, 3), (0, 3), (1, 3), (1, 3)]
    assert all("light.lux" not in unit.render for unit in units(spec))


@pytest.mark.parametrize("name", loading.names())
def test_bundled_studies_are_sound(name):
    for quick in (False, True):
        spec = load_study(name, quick=quick)
        assert spec.question and units(spec)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ('"camera.stops.hole.radius_rato" = [0.3]', ("radius_rato", "radius_ratio")),
        ('"camera.lens.f_numbr" = [2]\n"light.luks" = [3]', ("light.luks", "light.lux")),
        ('"light.lux" = []', ("light.lux", "empty")),
        ('"light.lux" = ["bright", 10.0]', ("light.lux", "words and numbers")),
        ("disc_edge_nm = [820.0]", ("disc_edge_nm = 820.0", "no light", "stop 'hole'")),
        ('"light.lux" = {log_grid = [0, 10, 3]}', ("log_grid", "above 0")),
        ('"light.lux" = {grid = [1, 10, 0]}', ("grid.2: must be greater than or equal to 1",)),
        ('"light.lux" = {grid = [1, 10, 1000000000]}', ("less than or equal to 10000",)),
        ("", ("parameters", "empty")),
        ('camera = ["bayer-mobile"]', ("bayer-mobile", "no infrared pixels")),
        ('"camera.stops.hole.radius_ratio" = [0.3, 1.5]', ("1.5",)),
        ('"camera.stops.hole.radius_ratio" = [0.0, 0.46]', ("0.0",)),
        ('"camera.sensor.cutoff_nm" = [300]', ("cutoff_nm",)),
        ('"light.illuminant" = ["D66"]', ("D66",)),
        ('"recon.window_px" = [31]\n"recon.no_such" = [1]', ("recon.no_such",)),
        ('camera = ["da-mobil"]', ("da-mobil",)),
        ('scene = ["dask"]', ("dask",)),
        ('"focus_m" = [-1]', ("focus_m = -1",)),
        ('"light.lux" = ["bright"]', ("bright", "number")),
        ("distance_cm = [20]", ("desk", "scenes of planes")),
        ('scene = ["staircase"]\ndistance_cm = [0]', ("distance 0 cm",)),
        ('mosaic = ["GR/BX"]', ("GR/BX", "GR/BI")),
        ('mosaic = ["GRB/IGR"]', ("IGR", "2048 x 1536")),
        ('mosaic = ["GI/RB"]', ("cannot be reconstructed", "diagonal")),
    ],
)
def test_wrong_studies_are_refused_before_the_first_render(tmp_path, capsys, parameters, message):
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n[parameters]\n{parameters}\n')
    assert run(["study", "sweep", str(tmp_path / "s.toml"), "--out", str(tmp_path / "new")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dasim: ") and all(part in line for part in message), line
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[[parameters]]\nfocus_m = [2]\n[[parameters]]\n"light.lux" = [9]',
            ("table 1", "light.lux", "table 2", "focus"),
        ),
        ("[design]\nfocus_n = 2\n[parameters]\nfocus_m = [2]", ("focus_n", "focus_m")),
        ('[parameters]\nfocus_m = [2]\n[[curves]]\nx = "focus_m"\ny = "psnt"', ("psnt", "psnr")),
        ('pareto = ["psnr", "dept-rmse"]\n[parameters]\nfocus_m = [2]', ("dept-rmse", "depth-rmse")),
        ("[parameters]\nfocus_m = [2]\n[quick]\nfocus = [2]", ("quick.focus",)),
    ],
)
def test_wrong_grids_and_curves_are_refused(tmp_path, text, message):
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n{text}\n')
    with pytest.raises(InputError) as refused:
        load_study(str(tmp_path / "s.toml"), quick=True)
    assert all(part in str(refused.value) for part in message), refused.value


def test_several_grids_stand_about_one_design(tmp_path):
    """Set-up: a base design; three holes and two levels of light about it; one hole of the three quick.

    Expectation: the union, the base design once; curves show what else is as in the base design.
    """
    (tmp_path / "s.toml").write_text(GRIDS)
    spec = load_study(str(tmp_path / "s.toml"))
    hole, light = HOLE, "light.illuminant"
    pairs = [(point[hole], point[light]) for point in points(spec)]
    assert pairs == [(0.3, "D65"), (0.46, "D65"), (0.6, "D65"), (0.46, "A")]
    assert spec.parameters == {hole: (0.3, 0.46, 0.6), light: ("D65", "A")}
    rows = [dict(point, number=number) for number, point in enumerate(points(spec))]
    panels = [report.about_design(Curve(x=x, y="psnr"), rows, spec) for x in (hole, light)]
    assert [[row["number"] for row in panel] for panel in panels] == [[0, 1, 2], [1, 3]]
    quick = load_study(str(tmp_path / "s.toml"), quick=True)
    assert [(point[hole], point[light]) for point in points(quick)] == [(0.6, "D65"), (0.46, "D65"), (0.46, "A")]


def test_all_problems_are_said_at_once(tmp_path):
    text = '"light.illuminant" = ["D66"]\n"camera.stops.hole.radius_ratio" = [2.0]'
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n[parameters]\n{text}\n')
    with pytest.raises(InputError, match=r"(?s)D66.*2\.0"):
        load_study(str(tmp_path / "s.toml"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('scene = "dask"\ncamera = "da-mobil"\npreset = "bandz"', ("'dask'", "'da-mobil'", "'bandz'")),
        ('camera = "bayer-mobile"', ("no infrared pixels",)),
        ("size_px = [0, 48]", ("size_px.0", "greater than or equal to 8")),
    ],
)
def test_what_no_point_can_be_made_of_is_said_once(tmp_path, text, message):
    """Expectation: camera, scene, preset and size of the study itself, once, not for each value of a parameter."""
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n{text}\n[parameters]\nfocus_m = [2, 3]\n')
    with pytest.raises(InputError) as refused:
        load_study(str(tmp_path / "s.toml"))
    assert all(str(refused.value).count(part) == 1 for part in message), refused.value
    assert "focus_m" not in str(refused.value)


def test_an_unknown_study_is_answered_with_the_nearest(capsys, tmp_path):
    assert run(["study", "sweep", "hole-siz", "--out", str(tmp_path / "new")]) == 2
    assert "hole-size" in capsys.readouterr().err


# --- running -------------------------------------------------------------------------------------


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


# --- what a sweep says ----------------------------------------------------------------------------


def rows_of(spec, errors, figure="depth-median"):
    """Rows with an error for each hole and seed: errors[hole][seed]."""
    rows = []
    for hole, by_light in errors.items():
        for seed, value in enumerate(by_light):
            row = dict.fromkeys(FIGURES, math.nan) | {figure: value, "seed": seed, "light.lux": 100.0}
            rows.append(row | {"camera.stops.hole.radius_ratio": hole})
    return rows


@pytest.fixture
def referred(study):
    text = STUDY.replace("[0.3, 0.46]", "[0.3, 0.46, 0.65]").replace("[parameters]", REFERENCE + "[parameters]")
    study.write_text(text)
    return load_study(str(study))


REFERENCE = '[reference]\n"camera.stops.hole.radius_ratio" = 0.46\n'


@pytest.mark.parametrize(
    ("errors", "best", "verdict", "sentence"),
    [
        # every seed has its own noise, far larger than the lead, and 0.65 leads in each of them
        (
            {0.3: (3, 7, 2, 5), 0.46: (2.0, 6.1, 1.0, 4.2), 0.65: (1.8, 5.9, 0.8, 4.0)},
            *(0.65, "worse", "0.65 is best, 0.46 is worse by 6.4 %"),
        ),
        (
            {0.3: (3, 3, 3, 3), 0.46: (1.0, 2.0, 1.0, 2.0), 0.65: (1.9, 0.9, 1.9, 0.9)},
            *(0.65, "statistically tied with the best", "0.65 is best, 0.46 is statistically tied"),
        ),
        (
            {0.3: (3, 3, 3, 3), 0.46: (1.0, 1.1, 1.0, 1.1), 0.65: (1.2, 1.2, 1.3, 1.2)},
            *(0.46, "best", "0.46 is best"),
        ),
        # t is 3.06 of 3 degrees of freedom: clear at 5 % (2.35), not at 5 % shared by two other values (3.18)
        (
            {0.3: (3, 3, 3, 3), 0.46: (1.0, 1.0, 1.0, 1.0), 0.65: (0.8, 0.9, 0.98, 0.85)},
            *(0.65, "statistically tied with the best", "0.65 is best, 0.46 is statistically tied"),
        ),
        (
            {0.3: (3,), 0.46: (1.5,), 0.65: (1.0,)},
            *(0.65, "statistically tied with the best", "0.65 is best, 0.46 is statistically tied"),
        ),
    ],
    ids=["paired", "noise", "best", "shared level", "one seed"],
)
def test_where_the_reference_stands(referred, errors, best, verdict, sentence):
    results = findings.findings(referred, rows_of(referred, errors))
    assert [(one.figure, one.best, one.verdict) for one in results] == [("depth-median", best, verdict)]
    assert findings.sentences(referred, results) == [f"depth-median: {sentence}"]


@pytest.mark.usefixtures("undrawn")
def test_a_sweep_says_what_it_found(referred, tmp_path):
    """Expectation: by the worker's formula the largest hole has the least error and loss; the bound has its order."""
    swept(referred, tmp_path / "out")
    lines = sweep.summary(Sweep(referred, str(tmp_path / "out"), {"variant": "any"}))
    assert lines[0] == "light-loss: 0.65 is best, 0.46 is worse by 5.3 percentage points"  # (0.65^2 - 0.46^2) / 4
    (depth,) = (line for line in lines if line.startswith("depth-median:"))
    assert depth == "depth-median: 0.65 is better for " + ", ".join(
        f"{lux} lux (0.46 is worse by 41 %)" for lux in (100, 1000, 10000)
    )
    assert lines[-1] == "rank correlation of depth-bound and depth-seen: 1.00 over 9 points"


def test_figures_that_are_better_large_are_judged_so(referred):
    """Expectation: the higher PSNR is the better one, and the cost is in dB."""
    rows = rows_of(referred, {0.3: (20.0, 20.1), 0.46: (24.0, 24.1), 0.65: (26.0, 26.1)}, "psnr")
    (one,) = findings.findings(referred, rows)
    assert (one.best, one.cost) == (0.65, pytest.approx(2.0)) and one.clear


def test_a_cost_is_a_share_of_the_best(referred):
    """Set-up: a signal over noise of 60 where the best is 100. Expectation: 40 %, not 67 %."""
    rows = rows_of(referred, {0.3: (20.0, 20.0), 0.46: (60.0, 60.0), 0.65: (100.0, 100.0)}, "infrared-snr")
    (cost,) = (one.cost for one in findings.findings(referred, rows))
    assert cost == pytest.approx(0.4)


def test_a_case_without_another_value_is_none(tmp_path):
    """Set-up: several grids about one design: holes under D65, and light A with the reference's hole alone.

    Expectation: A is no case that the reference is best in.
    """
    (tmp_path / "s.toml").write_text(GRIDS.replace("[design]", REFERENCE + "[design]"))
    spec = load_study(str(tmp_path / "s.toml"))
    rows = [
        dict.fromkeys(FIGURES, math.nan) | point | {"depth-median": 1.0 + point[HOLE], "seed": seed}
        for point in points(spec)
        for seed in (0, 1)
    ]
    assert [one.best for one in findings.findings(spec, rows)] == [0.3]


def test_what_is_known_of_one_case_is_not_said_of_all(referred):
    """Set-up: errors at 100 lux; at 1,000 lux none were measured. Expectation: the finding keeps its level of light."""
    rows = rows_of(referred, {0.3: (3, 3), 0.46: (2, 2), 0.65: (1, 1)})
    rows += [row | {"light.lux": 1000.0, "depth-median": math.nan} for row in rows]
    results = findings.findings(referred, rows)
    assert [one.others for one in results] == [{"light.lux": 100.0}]
    assert findings.sentences(referred, results) == ["depth-median: 0.65 is best for 100 lux, 0.46 is worse by 100 %"]


def test_a_reference_must_be_a_value_of_the_study(study):
    study.write_text(STUDY.replace("[parameters]", REFERENCE.replace("0.46", "0.47") + "[parameters]"))
    with pytest.raises(InputError, match=r"reference: camera.stops.hole.radius_ratio = 0.47 is not among the values"):
        load_study(str(study))


def test_the_ranking_is_spearmans(study):
    """Expectation: the same order by whatever law 1; two neighbours of five exchanged 1 - 6 * 2 / (5 * 24) = 0.9."""
    bound = [1.0, 2.0, 3.0, 4.0, 5.0]

    def of(errors):
        rows = [{"depth-bound": b, "depth-seen": e} for b, e in zip(bound, errors, strict=True)]
        return findings.ranking(load_study(str(study)), rows)

    assert of([b**3 for b in bound]).correlation == pytest.approx(1.0)
    assert of([1, 3, 2, 4, 5]).correlation == pytest.approx(0.9)
    assert of([math.nan, math.nan, 2, 4, 5]) is None


def test_the_ranking_is_also_told_within_each_light(referred):
    """Set-up: four holes in the order of their bounds at 100 lux, in the opposite one at 1,000."""
    hole = "camera.stops.hole.radius_ratio"
    rows = [
        {hole: value, "light.lux": lux, "depth-bound": value, "depth-seen": value if lux == 100 else lux - value}
        for lux in (100.0, 1000.0)
        for value in (0.3, 0.4, 0.46, 0.65)
    ]
    ranking = findings.ranking(referred, rows)
    assert ranking.within == (pytest.approx(1.0), pytest.approx(-1.0)) and "minimum -1.00" in ranking.sentence


def test_the_median_of_normal_errors_of_several_spreads():
    """Expectation: 0.6745 of one spread; of two, what 400,000 drawn errors have."""
    assert median_error(np.full(7, 0.2)) == pytest.approx(0.6745 * 0.2, rel=1e-4)
    spreads = np.tile([0.1, 0.1, 3.0], 100)
    errors = np.random.default_rng(0).normal(size=(4000, 300)) * spreads
    assert median_error(spreads) == pytest.approx(np.median(np.abs(errors)), rel=0.01)


def test_every_design_of_a_study_is_calibrated_at_the_same_blurs(study):
    """Expectation: holes of 0.3 and 0.9 have the levels of the study's camera, not steps of 1.4 and 10 px."""
    study.write_text(STUDY.replace("[0.3, 0.46]", "[0.3, 0.9]"))
    spec = load_study(str(study))
    ladders = [
        geometry.level_blur_px(designs.camera_of(spec, {"camera.stops.hole.radius_ratio": hole})) for hole in (0.3, 0.9)
    ]
    np.testing.assert_allclose(ladders[0], ladders[1], rtol=1e-12)
    np.testing.assert_allclose(ladders[0], np.arange(29) / 0.54, rtol=1e-12)


def test_the_page_opens_in_a_browser_without_complaint(referred, tmp_path):
    """Expectation: the page shows its curves, in their first colour, and says where the reference stands."""
    swept(referred, tmp_path / "out")
    page = tmp_path / "out" / "report.html"
    assert "How hole radius / lens radius = 0.46 compares" in page.read_text()
    shot = browser.screenshot(page)
    blue = np.array([int(report.COLOURS[0][k : k + 2], 16) for k in (5, 3, 1)])
    assert (np.abs(shot.astype(int) - blue).max(axis=-1) < 20).sum() > 100


# --- points --------------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.3, 0.46, 0.9])
def test_light_loss_is_that_of_eq_1(da_mobile, alpha):
    from dasim.dataset.dotted_keys import with_values

    loss = light_loss(with_values(da_mobile, {"stops.hole.radius_ratio": alpha}))
    assert loss == pytest.approx((1 - alpha**2) / 4, abs=EDGES)


def test_a_mosaic_with_fewer_infrared_pixels_loses_less():
    """Expectation: a 4x4 mosaic with two infrared pixels of sixteen loses half as much as one with four."""
    four = cameras.load_camera("da-4x4")
    count = sum(name == "IR" for row in four.sensor.mosaic for name in row)
    pixels = sum(len(row) for row in four.sensor.mosaic)
    assert light_loss(four) == pytest.approx((1 - 0.46**2) * count / pixels, abs=EDGES)


@pytest.mark.parametrize("mosaic", ["GR/BI", "RG/IB", "BI/GR", "IB/RG", "GB/RI", "GIGI/RGBG/GIGI/BGRG"])
def test_mosaics_by_their_letters_have_a_quarter_of_infrared(da_mobile, mosaic):
    """Expectation: wherever it stands, and in the 4x4 block too, infrared loses (1 - alpha^2) / 4 of the light."""
    camera = designs.with_mosaic(da_mobile, mosaic)
    assert ["".join(name[0] for name in row) for row in camera.sensor.mosaic] == mosaic.split("/")
    assert light_loss(camera) == pytest.approx((1 - 0.46**2) / 4, abs=EDGES)


BOARD = {"distance_cm": 10.0}
DESIGNS = ({}, {"camera.lens.focal_length_mm": 8.0}, {"camera.sensor.pixel_pitch_um": 3.0}, {"distance_cm": 90.0})


def test_a_board_keeps_its_picture(tmp_path):
    """Expectation: width times f / (z p), in pixels, is that of the scene's own file, and the distance the point's."""
    (tmp_path / "s.toml").write_text('name = "board"\nscene = "staircase"\n[parameters]\ndistance_cm = [10, 90]\n')
    spec = load_study(str(tmp_path / "s.toml"))
    widths = []
    for changes in DESIGNS:
        point = BOARD | changes
        camera, (board,) = designs.camera_of(spec, point), designs.scene_of(spec, point).objects
        assert board.position_cm[2] == pytest.approx(point["distance_cm"])
        pixels = camera.lens.focal_length_mm / (camera.sensor.pixel_pitch_um * 1e-3)
        widths.append(board.size_cm[0] / board.position_cm[2] * pixels)
    assert widths == pytest.approx([12.5 / 10 * 3.6 / 1.7e-3] * len(DESIGNS))


FAR_M = 100.0
FIRST_ORDER = 0.01  # (e / d)^2 of half a pixel, at most 0.005 here, and the focus at 100 m in the place of infinity


@pytest.mark.parametrize(("name", "depth_m"), [("da-mobile", 0.1), ("da-mobile", 0.4), ("da-8mm", 0.4)])
def test_half_a_pixel_is_worth_the_depth_of_fig_13(name, depth_m):
    """Expectation: the formula is half the distance of the depths whose blur is half a pixel more and less, which is
    found by inverting the camera's blur; and the bound of a board is the median of normal errors at its one depth.
    """
    camera = cameras.cropped(cameras.refocused(cameras.load_camera(name), FAR_M), 64, 48)
    depth = np.full((48, 64), depth_m)
    exact = surfaces.truth(
        camera, geometry.blur_px(camera, depth) / geometry.level_blur_px(camera)[1], np.ones((48, 64, 4))
    )
    figures = limits(Capture(np.zeros((48, 64), np.uint16), camera, 0.01, 1.0, 0), exact, "D65", 1000.0)
    assert figures["half-pixel-m"] == pytest.approx(half_pixel_m(camera, depth_m), rel=FIRST_ORDER)
    deviation = criteria.camera_bound(camera, geometry.blur_px(camera, depth_m), light="D65", level_lux=1000.0)
    assert figures["depth-bound-m"] == pytest.approx(
        0.6745 * float(deviation[0]) / criteria.dioptre_px(camera) * depth_m**2, rel=1e-4
    )


@pytest.mark.parametrize(("level", "share"), [(10.0, 1.0), (-3.0, 0.0), (40.0, 0.0)])
def test_depth_is_scored_where_the_bank_reaches(da_mobile, level, share):
    """Set-up: a board at a level of the bank, behind the focus, and nearer than the bank's nearest; exact depth.

    Expectation: no error; none is said where the pipeline has no such depth.
    """
    camera = cameras.cropped(cameras.refocused(da_mobile, 2.0), 64, 48)
    exact = surfaces.truth(camera, np.full((48, 64), level), np.ones((48, 64, 4)))
    estimate = surfaces.exact_reconstruction(exact, camera)
    figures = depth_figures(estimate, exact)
    assert figures["in-range"] == share
    assert figures.get("depth-median", math.nan) == pytest.approx(0.0 if share else math.nan, abs=1e-9, nan_ok=True)


@pytest.mark.slow
def test_a_point_is_photographed_and_scored(study, tmp_path, renderer):
    """Set-up: one design, two levels of light, tiny. Expectation: the same picture in more light has less noise."""
    from validation.studies.sweep.point import measure

    text = STUDY.replace("[0.3, 0.46]", "[0.46]").replace("seeds = 2", "seeds = 1\nsize_px = [64, 48]\nspp = 4")
    study.write_text(text)
    spec = load_study(str(study))
    rows = measure(spec, units(spec)[0])
    dim, _, bright = (row["figures"] for row in rows)
    assert set(dim) < set(FIGURES) and json.dumps(rows)
    assert bright["infrared-snr"] > 2 * dim["infrared-snr"]
