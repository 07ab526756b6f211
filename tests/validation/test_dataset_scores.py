"""``dasim dataset score``: figures of depth maps and methods on a split, their means, and the results that are kept."""

from __future__ import annotations

import csv
import json
from collections import deque
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage

import dasim
from dasim.base import fingerprint
from dasim.base.errors import InputError
from dasim.camera import specification as cameras
from dasim.cli import run
from dasim.dataset.reading import open_dataset
from dasim.files.banks import save_bank
from dasim.values import Truth
from tests.support import datasets, recon_scenes, surfaces
from validation import methods
from validation.dataset_scores import estimate, figures, leaderboard, page, work
from validation.dataset_scores.entrants import CONSTANT, Constant, MapFolder, check_maps, entrants
from validation.dataset_scores.run import about, failures, score_dataset, table_csv, write
from validation.dataset_scores.work import ScoreJob
from validation.subjects import rendering

SIZE_PX = (64, 48)
DEPTH_M, FOCUS_M = 0.3, 0.4  # of the wall, which faces the camera, and of the lens
LEVEL = 4.0
METHOD = f"""
import numpy as np
from dasim.values import DepthEstimate

def constant(capture, bank):
    return DepthEstimate(level=np.full(capture.raw_dn.shape, {LEVEL}))

def broken(capture, bank):
    raise IndexError("of mine")
"""
MORE = """
[splits]
test = 1.0
"""


def spec_file(folder: Path, *, more: str = "", **changes) -> Path:
    """A specification of two photographs of a wall in front of the focal plane, all in the split test."""
    near = datasets.WALL.replace("position_cm = [0, 0, 50]", f"position_cm = [0, 0, {100 * DEPTH_M:g}]")
    (folder / "near.toml").write_text(near)
    spec = datasets.spec_file(folder, samples=2, files=["near.toml"], more=MORE + more, **changes)
    spec.write_text(spec.read_text().replace("size_px = [32, 24]", f"size_px = {[*SIZE_PX]}"))
    return spec


def true_level() -> float:
    """Blur level of the wall from the camera's data sheet, by a formula that the simulator does not use."""
    camera = cameras.refocused(dasim.load_camera("da-mobile"), FOCUS_M)
    hole, open_lens = (next(s.radius_ratio for s in camera.stops if s.name == name) for name in ("hole", "open"))
    return abs(rendering.blur_px(camera, DEPTH_M)) * (1 - hole / open_lens)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    (tmp_path / "mine.py").write_text(METHOD)
    methods.function.cache_clear()  # the file has the same name in each test
    work.opened.cache_clear()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def walls(folder, renderer) -> Path:
    """A dataset of two walls, with the truth that the guide's first example keeps."""
    datasets.make_dataset(spec_file(folder, more='[truth]\nkeep = ["depth", "labels", "sharp_srgb"]\n'), folder / "set")
    return folder / "set"


def maps(folder: Path, keys: list[str], depth_m: float = DEPTH_M) -> Path:
    """A folder of constant depth maps, of each format in turn."""
    folder.mkdir()
    image = np.full(SIZE_PX[::-1], depth_m)
    for number, key in enumerate(keys):
        if number % 2:
            cv2.imwrite(str(folder / f"{key}.png"), np.rint(image * 1e4).astype(np.uint16))
        else:
            np.save(folder / f"{key}.npy", image * 1e4)
    return folder


def job_of(dataset: Path, out: Path, everyone, **changes) -> ScoreJob:
    return ScoreJob(str(dataset), "test", str(out), everyone, **{"bank": None, "code": "code", **changes})


def inline(job: ScoreJob, queue: deque[int]):
    """Executor in this process."""
    while queue:
        yield work.work(job, queue.popleft())


# --- one sample ----------------------------------------------------------------------------------


def test_gaps_have_the_depth_of_the_nearest_estimate():
    """Expectation: the nearest by a brute-force search; a map without estimates is all in focus."""
    rng = np.random.default_rng(3)
    sparse = np.where(rng.random((9, 14)) < 0.2, rng.uniform(0.1, 1, (9, 14)), np.nan)
    sparse[0, 0], sparse[8, 13] = -1.0, 0.0  # no depths
    filled = figures.complete(sparse, 0.4)
    known = np.argwhere(np.nan_to_num(sparse) > 0)
    for y, x in np.ndindex(sparse.shape):
        distance = np.hypot(*(known - (y, x)).T)
        nearest = known[np.isclose(distance, distance.min())]
        assert any(filled[y, x] == sparse[tuple(place)] for place in nearest)
    assert (figures.complete(np.full((3, 4), np.nan), 0.4) == 0.4).all()


def test_figures_of_a_map_that_is_off_by_a_factor(da_mobile):
    """Set-up: surfaces at two levels, true depths times 1.1. Expectation: AbsRel 0.1, all within 1.25 and none within
    1.05, RMSE of the dioptres 1/d (1 - 1/1.1), on parts by true depth, region and blur that are disjoint and complete.
    """
    level = np.repeat([[2.0], [8.0]], 40, axis=0) * np.ones((80, 60))
    truth = surfaces.truth(da_mobile, level, np.ones((80, 60, 4)))
    found = figures.map_figures(1.1 * truth.depth_m, truth, da_mobile, np.arange(60) < 30 * np.ones((80, 1)))
    whole = found["region"]["all"]
    dioptres = 1 / truth.depth_m.astype(np.float64)
    assert whole["abs-rel"] == pytest.approx(0.1, rel=1e-5)
    assert whole["delta-1.25"] == 1 and whole["delta-1.05"] == 0
    assert whole["rmse-dioptre"] == pytest.approx(np.sqrt(np.mean((dioptres * (1 - 1 / 1.1)) ** 2)), rel=1e-5)
    assert whole[figures.EDGE] == pytest.approx(1.0), "both maps have one edge, at the same place"
    assert set(found["region"]) == {"all", "textured", "untextured"}, "no boundary, nothing behind the focus"
    for group in ("depth", "blur"):
        assert sum(part["pixels"] for part in found[group].values()) == level.size
    assert all(part["abs-rel"] == pytest.approx(0.1, rel=1e-5) for part in found["depth"].values())


def test_the_constant_map_is_the_best_in_dioptres(da_mobile):
    """Expectation: no other constant has a smaller RMSE in dioptres on the near side."""
    rng = np.random.default_rng(5)
    level = ndimage.gaussian_filter(rng.uniform(0, 12, (40, 30)), 2)
    truth = surfaces.truth(da_mobile, level, np.ones((40, 30, 4)))
    best = figures.best_constant(truth, FOCUS_M)
    assert np.ptp(best) == 0
    exact = 1 / truth.depth_m.astype(np.float64)

    def rmse(depth_m: float) -> float:
        return float(np.sqrt(np.mean((1 / depth_m - exact) ** 2)))

    assert all(rmse(best[0, 0]) <= rmse(other) for other in np.geomspace(0.05, 1.0, 400))


# --- means ---------------------------------------------------------------------------------------


def test_intervals_are_those_of_the_mean_of_independent_scenes():
    """Expectation: the standard error is the standard deviation over sqrt(n), n the number of scenes: ten captures of
    each scene do not make it smaller. 1000 resamples give it to 5 % or so.
    """
    rng = np.random.default_rng(11)
    values = rng.normal(2.0, 0.5, 200)
    scenes = [f"scene {n}" for n in range(200)]
    one = leaderboard.mean(list(values), scenes)
    error = values.std() / np.sqrt(200)
    assert one.value == pytest.approx(values.mean())
    assert one.error == pytest.approx(error, rel=0.15)
    assert one.high - one.low == pytest.approx(2 * 1.96 * error, rel=0.15)
    many = leaderboard.mean(list(np.repeat(values, 10)), list(np.repeat(scenes, 10)))
    assert many.value == pytest.approx(one.value) and many.error == pytest.approx(one.error, rel=1e-9)
    assert np.isnan(leaderboard.mean([1.0, 2.0], ["a", "a"]).low), "one scene says nothing about others"
    assert leaderboard.mean([1.0, None], ["a", "b"]).value == 1.0
    assert np.isnan(leaderboard.mean([None], ["a"]).value)


def row_of(method: str, sample: int, rmse: float, **changes) -> dict:
    values = {"region": {"all": {"rmse-dioptre": rmse, "abs-rel": rmse / 2, figures.EDGE: 0.5}}}
    described = {"method": method, "sample": f"{sample}", "scene": f"s{sample}", "kind": "ab"[sample % 2]}
    described |= {"illuminant": "D65", "light_e": 50.0 * 10**sample, "coverage": 1.0, "failed": None, "seconds": 0.1}
    return {**described, "figures": values, "metrics": {}, **changes}


def test_methods_are_ranked_by_their_ratio_to_the_constant_map():
    """Set-up: constants of 1 and 10 dioptres; a method of half of both, one that is better on the second alone.

    Expectation: ratios 0.5 and (2 + 0.2) / 2; the one that loses a sample is second to the constant map.
    """
    rows = [row_of(CONSTANT, 0, 1.0), row_of(CONSTANT, 1, 10.0), row_of("half", 0, 0.5), row_of("half", 1, 5.0)]
    rows += [row_of("odd", 0, 2.0), row_of("odd", 1, 2.0, failed="stopped")]
    assert leaderboard.ranked(rows) == ["half", CONSTANT, "odd"]
    values = {figure.id: figure.value for figure in leaderboard.figures(rows, leaderboard.entries(rows))}
    assert values["half.rmse-ratio"] == 0.5 and values["odd.rmse-ratio"] == pytest.approx(1.1)
    assert values["half.lost"] == 0 and values["odd.lost"] == 2 and values["odd.failed"] == 1
    assert values["half.kind.b.rmse-dioptre"] == 5.0 and values["half.light.below-100-e.rmse-dioptre"] == 0.5
    assert values["half.abs-rel"] == pytest.approx(1.375)
    found = leaderboard.entries(rows)
    table = list(csv.DictReader(table_csv(found).splitlines()))
    (cell,) = (r for r in table if (r["method"], r["group"], r["part"]) == ("half", "kind", "a"))
    assert cell["samples"] == "1" and float(cell["rmse-dioptre (1/m)"]) == 0.5 and cell["rmse-dioptre (1/m) low"] == ""
    assert failures(rows) == ["odd failed on 1 of 2 samples; 1: stopped"]
    text = page.lines(rows, found)
    assert [line.split()[0] for line in text] == ["method", "half", CONSTANT, "odd"]


# --- what is scored ------------------------------------------------------------------------------


def test_entrants_are_methods_and_folders(folder):
    maps(folder / "theirs", ["000000000"])
    everyone = entrants(["theirs", "best", "again=theirs", "flat=mine.py:constant"], 1e-4)
    assert [one.name for one in everyone] == [CONSTANT, "theirs", "best", "again", "flat"]
    assert isinstance(everyone[0], Constant) and isinstance(everyone[3], MapFolder)


@pytest.mark.parametrize(
    ("texts", "scale", "message"),
    [
        (["nothing"], None, "or a folder of depth maps"),
        (["theirs", "theirs=theirs"], None, "'theirs' is taken"),
        (["constant=theirs"], None, "'constant' is taken, the best constant map has it"),
        (["a b=theirs"], None, "'a b' is not a valid name"),
        (["best"], 0.001, "--scale: applies to folders"),
    ],
)
def test_wrong_entrants_are_refused(folder, texts, scale, message):
    maps(folder / "theirs", ["000000000"])
    with pytest.raises(InputError, match=message):
        entrants(texts, scale)


def test_maps_that_are_missing_are_named(folder):
    one = MapFolder("theirs", maps(folder / "theirs", ["000000000", "000000001"]))
    with pytest.raises(InputError, match=r"lacks the depth maps of 1 of 3 samples, such as 000000007\.npy"):
        check_maps([one], ["000000000", "000000001", "000000007"])
    with pytest.raises(InputError, match=r"000000001\.png: a PNG holds whole numbers"):
        check_maps([one], ["000000000", "000000001"])
    np.save(folder / "theirs" / "000000001.npy", np.ones(SIZE_PX[::-1]))
    with pytest.raises(InputError, match=r"000000001\.npy and 000000001\.png; leave one"):
        check_maps([one], ["000000001"])


# --- a dataset on disk ---------------------------------------------------------------------------


def test_a_folder_of_maps_is_scored_and_results_are_kept(walls, folder):
    """Set-up: exact maps as NPY and PNG in units of 0.1 mm; of a truth without the part ``blur``.

    Expectation: no error but the rounding of the wall's depth; nothing is scored twice, unless a map, the code or
    ``fresh`` asks for it; a damaged result is measured again.
    """
    everyone = entrants([f"theirs={maps(folder / 'theirs', ['000000000', '000000001'])}"], 1e-4)
    job, counted = job_of(walls, folder / "out", everyone), []

    def counting(job, queue):
        counted.append(len(queue))
        return inline(job, queue)

    rows = score_dataset(job, counting)
    theirs = [row["figures"]["region"]["all"] for row in rows if row["method"] == "theirs"]
    assert len(rows) == 4 and len(theirs) == 2
    assert all(values["abs-rel"] < 1e-4 and values["delta-1.05"] == 1 for values in theirs)
    assert score_dataset(job, counting) == rows
    np.save(folder / "theirs" / "000000000.npy", np.full(SIZE_PX[::-1], 2e4 * DEPTH_M))
    changed = score_dataset(job, counting)
    assert next(row["figures"]["region"]["all"]["abs-rel"] for row in changed if row["method"] == "theirs") > 0.99
    score_dataset(job_of(walls, folder / "out", everyone, code="other"), counting)
    score_dataset(job, counting, fresh=True)
    file = next((folder / "out" / "results").iterdir())
    file.write_text("{")
    score_dataset(job, counting)
    assert counted[:5] == [2, 0, 1, 2, 2] and counted[5] <= 1


def test_an_interrupted_run_keeps_what_is_finished(walls, folder):
    job = job_of(walls, folder / "out", entrants(["constant_too=mine.py:broken"]), bank=None)

    def stopped(job, queue):
        yield work.work(job, queue.popleft())
        raise KeyboardInterrupt

    save_bank(folder / "bank.npz", recon_scenes.bank(("D65",)))
    job = job_of(walls, folder / "out", job.entrants, bank=folder / "bank.npz")
    with pytest.raises(KeyboardInterrupt):
        score_dataset(job, stopped)
    left: list[int] = []

    def resumed(job, queue):
        left.extend(queue)
        return inline(job, queue)

    rows = score_dataset(job, resumed)
    assert left == [1] and len(rows) == 4
    failed = [row for row in rows if row["method"] == "constant_too"]
    assert all("IndexError" in row["failed"] and row["coverage"] == 0 for row in failed)
    focus = failed[0]["figures"]["region"]["all"]["abs-rel"]
    assert focus == pytest.approx(FOCUS_M / DEPTH_M - 1, rel=1e-3), "scored as a map that is all in focus"


def test_a_users_metric_counts_failed_samples(walls, folder):
    """Expectation: a sample on which a method fails has a value of its own, that of the map in focus."""
    (folder / "deep.py").write_text(
        "import numpy as np\n\ndef deep(depth_m, truth):\n    return float(np.nanmean(depth_m))\n"
    )
    save_bank(folder / "bank.npz", recon_scenes.bank(("D65",)))
    job = job_of(
        walls,
        folder / "out",
        entrants(["mine.py:broken"]),
        bank=folder / "bank.npz",
        metrics=(f"{folder}/deep.py:deep",),
    )
    values = [value for row in score_dataset(job, inline) if row["failed"] for value in row["metrics"].values()]
    assert values == pytest.approx([FOCUS_M] * 2, rel=1e-3)


def test_kept_results_depend_on_all_code_that_makes_them():
    """Expectation: the scoring of a sample itself, reading it, and a metric's code and name count."""
    names = set(fingerprint.dependencies(work.scored).files.values())
    for name in ("dataset_scores/work.py", "scores/metrics.py", "files/captures.py", "dataset/reading.py"):
        assert any(each.endswith(name) for each in names), name
    metric = "examples/metric.py:within_a_centimetre"
    assert work.code_of((f"a={metric}",), None) != work.code_of((f"b={metric}",), None)


def test_a_method_is_scored_by_its_own_estimate(walls, folder):
    """Expectation: the user's level is off by its distance from the wall's on every pixel."""
    save_bank(folder / "bank.npz", recon_scenes.bank(("D65",)))
    job = job_of(walls, folder / "out", entrants(["flat=mine.py:constant"]), bank=folder / "bank.npz")
    rows = score_dataset(job, inline)
    for row in (row for row in rows if row["method"] == "flat"):
        values = row["figures"]["region"]["all"]
        assert values["level-median"] == pytest.approx(abs(true_level() - LEVEL), abs=0.02)
        assert row["coverage"] == 1 and row["failed"] is None
    write(job, rows, leaderboard.entries(rows))
    html = (folder / "out" / "leaderboard.html").read_text()
    assert "tiny 1.0: test" in html and "flat" in html and "a subset" not in html
    assert "http://" not in html.replace("http://www.w3.org", "") and 'src="http' not in html
    board = json.loads((folder / "out" / "leaderboard.json").read_text())
    samples = open_dataset(str(walls), "test")
    assert board["dataset"] == about(samples, "test") and board["dataset"]["samples"] == 2
    (whole,) = (e for e in board["figures"] if (e["method"], e["part"]) == ("flat", "all"))
    assert whole["samples"] == 2 and whole["level-median"][1] is None, "two captures of one scene have no interval"


def test_maps_may_have_the_size_of_the_capture_or_of_the_truth(da_mobile, folder):
    whole = recon_scenes.make(np.full((48, 64), LEVEL))
    truth = Truth.of_parts({"depth_m": np.full((40, 56), DEPTH_M, np.float32), "valid": np.ones((40, 56), bool)})
    for shape in ((48, 64), (40, 56)):
        (folder / f"{shape[0]}").mkdir()
        np.save(folder / f"{shape[0]}" / "1.npy", np.full(shape, 0.2))
        one = MapFolder("theirs", folder / f"{shape[0]}")
        assert estimate.depth_map(one, whole.capture, truth, "1", None).shape == (40, 56)
    np.save(folder / "48" / "1.npy", np.full((24, 32), 0.2))
    with pytest.raises(InputError, match="is 32 x 24 pixels, the ground truth 56 x 40"):
        estimate.depth_map(MapFolder("theirs", folder / "48"), whole.capture, truth, "1", None)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["folders", "webdataset"])
def test_the_command_scores_a_split(folder, form, capsys):
    """Set-up: the command with its own processes, a method and a metric of the user's, limits, and both formats."""
    spec = spec_file(folder, format=form)
    assert run(["dataset", "make", str(spec), "--out", str(folder / "set"), "--jobs", "1"]) == 0
    save_bank(folder / "bank.npz", recon_scenes.bank(("D65",)))
    (folder / "share.py").write_text("def share(depth_m, truth):\n    return 0.25\n")
    command = ["dataset", "score", "set", "--bank", "bank.npz", "--out", "scores", "--json", "s.json", "--jobs", "2"]
    command += ["--metric", "share.py:share", "--method", "flat=mine.py:constant"]
    assert run(command) == 0
    command.append("mine.py:broken")
    assert run(command) == 2
    assert "mine.py:broken failed on all 2 samples; 000000000: " in capsys.readouterr().err
    (folder / "gates.toml").write_text('["dataset.flat.lost"]\nlimit = "<= 0"\n')
    assert run([*command[:-1], "--gates", "gates.toml", "--junit", "s.xml"]) == 1
    assert run([*command, "--gates", "gates.toml"]) == 2
    content = json.loads(Path("s.json").read_text())
    assert content["flat.level-median"]["value"] == pytest.approx(abs(true_level() - LEVEL), abs=0.02)
    assert content["flat.lost"] == {"value": 2.0, "unit": "samples", "limit": "<= 0", "passed": False}
    assert content["mine.py:broken.failed"]["value"] == 2 and content["flat.share"]["value"] == 0.25
    assert {row["sample"] for row in content["samples"]} == {"000000000", "000000001"}
    printed = capsys.readouterr()
    assert "leaderboard: scores/leaderboard.html" in printed.out and "FAILED" in printed.out


@pytest.mark.slow
def test_the_command_refuses_what_it_cannot_score(folder, capsys):
    datasets.make_dataset(spec_file(folder, more='[truth]\nkeep = ["labels"]\n'), folder / "set")
    (folder / "bank.npz").write_bytes(b"")
    (folder / "foreign").mkdir()
    (folder / "foreign" / "letter.txt").write_text("mine")
    for arguments, parts in (
        (["--method", "flat=mine.py:constant"], ("sample 000000000", "lacks depth", "truth.keep")),
        (["--method", "flat=mine.py:constant", "--out", "foreign"], ("foreign", "letter.txt", "--out")),
        (["--method", "flat=mine.py:constant", "--bank", "bank.npz"], ("bank.npz",)),
        (["--method", "flat=mine.py:constant", "--split", "train"], ("'train'", "test")),
    ):
        assert run(["dataset", "score", "set", "--jobs", "1", *arguments]) == 2
        (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("dasim: "))
        assert all(part in line for part in parts), line
