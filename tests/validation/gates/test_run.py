"""`dasim validate`: limits, gates, files and exit statuses with claims made up here; claims that must fail do."""

from __future__ import annotations

import json
import math
import re
from functools import partial
from xml.etree import ElementTree

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.cli import run
from tests.support import browser
from tests.support.fake_claims import FAKES, dies
from validation.claims.table import CLAIMS
from validation.gates import stored
from validation.gates.claim import Claim, Evidence
from validation.gates.comparison import Earlier, changes
from validation.gates.limits import GATES, Gate, all_gates, gate_of, judged_all, load_gates, within
from validation.gates.outcome import Measurement, select
from validation.gates.proposal import proposed
from validation.gates.run import measured_claims
from validation.reports.lines import of_claims
from validation.reports.page import png_address
from validation.scores.figures import Figure
from validation.validate import write_claims

LIMITS = '["good.size"]\nlimit = "<= 0.5"\nwhy = "half"\n["bad.*"]\nlimit = "<= 0.5"\n["absent.size"]\nlimit = "> 0"\n'


@pytest.fixture
def fakes(monkeypatch, tmp_path, tmp_path_factory, renderer):
    """The command with made-up claims and limits."""
    file = tmp_path / "bundled.toml"
    file.write_text(LIMITS)
    monkeypatch.setattr("validation.claims.table.CLAIMS", FAKES)
    monkeypatch.setattr("validation.gates.limits.all_gates", lambda table, users: all_gates(table, users, file))
    monkeypatch.setattr("dasim.cli.options.say_variant", lambda variant: None)
    monkeypatch.setenv("DASIM_CACHE_DIR", str(tmp_path_factory.mktemp("cache")))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def results(folder) -> dict:
    content = json.loads((folder / "results.json").read_text())
    assert content["schema"] == 1
    return {entry["id"]: entry for entry in content["claims"]}


# --- limits and gates ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("limit", "inside", "outside"),
    [
        ("<= 0.02", (0.02, -1), (0.0201, math.nan, math.inf)),
        ("< -0.6", (-0.7,), (-0.6, 0, math.nan)),
        (">= 50", (50, math.inf), (49.9, math.nan)),
        ("> 0", (1e-9,), (0, -1, math.nan)),
        ("0.195..0.199", (0.195, 0.197, 0.199), (0.1949, 0.2, math.nan)),
        ("-1e-3 .. 1e-3", (0,), (0.002,)),
    ],
)
def test_limits(limit, inside, outside):
    """Expectation: what was not measured (NaN) keeps no limit."""
    assert all(within(value, limit) for value in inside)
    assert not any(within(value, limit) for value in outside)


@pytest.mark.parametrize("limit", ["", "0.5", "= 0.5", "<= x", "<= nan", "1..", "<= 1 px"])
def test_unreadable_limits_are_refused(limit, tmp_path):
    (tmp_path / "gates.toml").write_text(f'["good.size"]\nlimit = "{limit}"\n')
    with pytest.raises(InputError, match=r"gates.toml.*good.size.limit"):
        load_gates(tmp_path / "gates.toml", FAKES)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('["nothing.size"]\nlimit = "> 0"\n', r"nothing.size.*good, stopped"),
        ('["good"]\nlimit = "> 0"\n', r"'good'.*CLAIM.FIGURE"),
        ('["good.size"]\nwhy = "so"\n', r"good.size.limit: is missing"),
        ('["good.size"]\nlimit = "> 0"\ncolour = 1\n', r"good.size.colour: unknown key"),
        ('good = "> 0"\n', r"gates.toml.*good"),
        ("[[[", "not valid TOML"),
    ],
)
def test_wrong_gates_are_refused(text, message, tmp_path):
    (tmp_path / "gates.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        load_gates(tmp_path / "gates.toml", FAKES)


@pytest.mark.parametrize(
    ("key", "figure_id", "matches"),
    [
        ("depth.bands.desk.raw", "depth.bands.desk.raw", True),
        ("depth.bands.*.raw", "depth.bands.desk.raw", True),
        ("depth.bands.*.raw", "depth.bands.desk.raw-ratio", False),
        ("depth.bands.*", "depth.bands.desk.raw", False),
        ("depth.*.desk.raw", "depth.my.desk.raw", True),
        ("depth.*.desk.raw", "depth.my.own.desk.raw", False),
        ("depth.*.desk.raw", "depth.file.py:function.desk.raw", False),
        ("depth.file.py:function.*.raw", "depth.file.py:function.desk.raw", True),
        ("light-levels.{D65,A}.order", "light-levels.A.order", True),
        ("light-levels.{D65,A}.order", "light-levels.D55.order", False),
        ("light-levels.*.order", "light-levels.my.D65.order", False),
    ],
)
def test_a_gate_names_figures_part_by_part(key, figure_id, matches):
    """Expectation: a * is one name between dots, never a part of one, nor several."""
    assert Gate(key, "> 0", "").matches(figure_id) is matches


@pytest.mark.parametrize(
    "key", ["good.si*", "good.[abc]", "good.s?ze", "good.{a,b", "good.{}", "good.{a.b}", "good.", "good..size"]
)
def test_keys_that_could_catch_a_name_by_accident_are_refused(key, tmp_path):
    (tmp_path / "gates.toml").write_text(f'["{key}"]\nlimit = "> 0"\n')
    with pytest.raises(InputError, match=r"gates.toml.*for one name between dots"):
        load_gates(tmp_path / "gates.toml", FAKES)


def test_users_gate_wins_and_a_figures_own_before_a_pattern(tmp_path):
    (tmp_path / "bundled.toml").write_text('["good.*"]\nlimit = "<= 1"\n["good.size"]\nlimit = "<= 2"\n')
    (tmp_path / "users.toml").write_text('["good.*"]\nlimit = "<= 3"\n')
    bundled = all_gates(FAKES, None, tmp_path / "bundled.toml")
    assert gate_of("good.size", bundled).limit == "<= 2" and gate_of("good.other", bundled).limit == "<= 1"
    both = all_gates(FAKES, tmp_path / "users.toml", tmp_path / "bundled.toml")
    assert gate_of("good.size", both).limit == gate_of("good.other", both).limit == "<= 3"
    assert gate_of("bad.size", both) is None


def test_a_limit_that_finds_no_figure_fails(tmp_path):
    (tmp_path / "gates.toml").write_text('["good.length"]\nlimit = "> 0"\n')
    entries = judged_all("good", [Figure("size", 1.0, "px", "a size")], load_gates(tmp_path / "gates.toml", FAKES))
    assert [(entry.id, entry.passed) for entry in entries] == [("good.size", None), ("good.length", False)]
    (missing,) = judged_all("good", [], [Gate("good.sise", "> 0", "")])[-1:]
    (mistyped,) = judged_all("good", [Figure("size", 1.0, "px", "a size")], [Gate("good.sise", "> 0", "")])[-1:]
    assert "did you mean" not in missing.source and "did you mean 'good.size'?" in of_claims([mistyped])[0]


def test_bundled_limits_are_readable_and_say_where_they_come_from():
    gates = load_gates(GATES, CLAIMS)
    assert gates and all(len(gate.why) > 20 for gate in gates)


def test_every_claim_has_a_report_for_its_docstring():
    for name, measurement in CLAIMS.items():
        for part in ("Rationale: ", "Set-up: ", "Expectation: ", "Source: "):
            assert f"\n    {part}" in (measurement.run.__doc__ or ""), f"{name} lacks {part}"


# --- the command ---------------------------------------------------------------------------------


def test_kept_limits_end_with_status_0(fakes, capsys):
    assert run(["validate", "--only", "good", "--out", "new"]) == 0
    assert {p.name for p in (fakes / "new").iterdir()} == {"results.json", "report.html", "junit.xml"}
    entries = results(fakes / "new")
    assert entries["good.size"] == {
        "id": "good.size",
        "value": 0.25,
        "limit": "<= 0.5",
        "unit": "px",
        "passed": True,
        "source": "a size. Limit: half",
        "spread": None,
    }
    assert entries["good.other"]["passed"] is None and entries["good.other"]["limit"] is None
    output = capsys.readouterr().out
    assert output.startswith("passed") and "good.size" not in output
    assert "1 claim in " in output and "1 of 1 figures within their limits" in output
    assert run(["validate", "--only", "good", "--out", "new", "--verbose"]) == 0
    assert "good.size" in capsys.readouterr().out


def test_a_failed_limit_ends_with_status_1_after_all_claims(fakes):
    assert run(["validate", "--only", "bad", "good", "--out", "new"]) == 1
    assert [entry["passed"] for entry in results(fakes / "new").values()] == [True, None, False]


def test_figures_without_a_limit_neither_pass_nor_fail(fakes):
    assert run(["validate", "--only", "free", "--out", "new"]) == 0
    entry = results(fakes / "new")["free.size"]
    assert entry["passed"] is None and entry["value"] is None


def test_what_cannot_be_run_is_not_passed(fakes, capsys):
    """Expectation: its reason is named, no limit of it counts, and it is no failure."""
    assert run(["validate", "--only", "absent", "--out", "new"]) == 0
    assert results(fakes / "new") == {
        "absent": {
            "id": "absent",
            "value": None,
            "limit": None,
            "unit": "",
            "passed": None,
            "source": "not run: there is no renderer",
            "spread": None,
        }
    }
    assert "not run" in capsys.readouterr().out


def test_a_defect_fails_its_claim_and_not_the_others(fakes, capsys):
    assert run(["validate", "--only", "broken", "--only", "good", "--out", "new"]) == 1
    entries = results(fakes / "new")
    assert (
        entries["broken"]["passed"] is False
        and "stopped by ZeroDivisionError: by nothing" in entries["broken"]["source"]
    )
    assert entries["good.size"]["passed"] is True
    assert "ZeroDivisionError" in capsys.readouterr().err


def test_interrupt_leaves_nothing(fakes):
    before = sorted(fakes.rglob("*"))
    assert run(["validate", "--only", "good", "stopped", "--out", "new"]) == 130
    assert sorted(fakes.rglob("*")) == before


def test_users_gates_decide(fakes):
    (fakes / "mine.toml").write_text('["good.size"]\nlimit = "<= 0.1"\n["good.other"]\nlimit = "2..4"\n')
    assert run(["validate", "--only", "good", "--gates", "mine.toml", "--out", "new"]) == 1
    entries = results(fakes / "new")
    assert entries["good.size"]["passed"] is False and entries["good.other"]["passed"] is True


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--only", "nothing", "--out", "new"), ("claim 'nothing'", "good", "absent")),
        (("--only", "bad", "--quick", "--out", "new"), ("bad", "--quick")),
        (("--gates", "none.toml", "--out", "new"), ("none.toml",)),
        (("--only", "bad,godo"), ("claim 'godo'", "did you mean 'good'")),
        (("--only", "good", "--out", "."), ("output",)),
        (("--only", "good", "--out", "new", "--jobs", "0"), ("--jobs 0", "1 or more")),
        (("--only", "good", "--out", "new", "--seeds", "0"), ("--seeds 0", "1 or more")),
        (("--only", "good", "--out", "new", "--propose-gates", "g.toml"), ("--propose-gates", "--seeds")),
        (("--out", "new", "--seeds", "2", "--propose-gates", "bundled.toml"), ("bundled.toml", "exists")),
        (("--only", "good", "--out", "new", "--compare", "none.json"), ("none.json", "results.json")),
        (("--only", "good", "--out", "new", "--compare", "bundled.toml"), ("bundled.toml", "JSON")),
        (("--only", "good", "--out", "new", "--compare", "foreign/results.json"), ("no results.json",)),
        (("--only", "good", "--out", "new", "--fail-on-worse"), ("--fail-on-worse", "--compare")),
        (("--only", "good", "--out", "new", "--method", "bandz"), ("'bandz' is unknown", "bands", "file.py:function")),
        (("--only", "good", "--out", "new", "--method", "likelihood"), ("--method likelihood", "none")),
        (("--only", "good", "--out", "foreign"), ("foreign", "dasim did not write")),
    ],
)
def test_wrong_input_is_refused_in_one_line(fakes, capsys, arguments, message):
    (fakes / "foreign").mkdir()
    (fakes / "foreign" / "results.json").write_text("{}")
    assert run(["validate", *arguments]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dasim: ") and all(part in line for part in message), line
    assert not (fakes / "new").exists()


def test_an_earlier_result_is_replaced(fakes):
    for name in ("good", "free"):
        assert run(["validate", "--only", name, "--out", "new"]) == 0
    assert set(results(fakes / "new")) == {"free.size"}


def test_lists(fakes, capsys):
    """Expectation: both list commands name all claims with their first sentence; --quick those that are quick."""
    assert run(["validate", "--list"]) == 0
    output = capsys.readouterr().out
    assert run(["list", "claims"]) == 0
    assert capsys.readouterr().out == output
    assert [line.split()[0] for line in output.splitlines()] == list(FAKES)
    assert re.search(r"^good +quick +A claim that keeps its limit\.$", output, re.MULTILINE)
    assert run(["validate", "--list", "--quick"]) == 0
    assert "bad" not in capsys.readouterr().out
    assert run(["list", "claims", "--verbose"]) == 0
    assert "Rationale: something" in capsys.readouterr().out


def test_order_is_that_of_the_table():
    assert select(FAKES, ("bad", "good"), quick=False) == ["good", "bad"]
    assert "bad" not in select(FAKES, (), quick=True)


def test_junit_parses_and_counts(fakes):
    """Expectation: one suite per claim, one case per figure; failures, errors and skipped ones as their figures say."""
    run(["validate", "--only", "good", "bad", "absent", "broken", "--out", "new"])
    root = ElementTree.parse(fakes / "new" / "junit.xml").getroot()
    suites = {suite.get("name"): suite for suite in root}
    counts = {
        name: [int(suite.get(k)) for k in ("tests", "failures", "errors", "skipped")] for name, suite in suites.items()
    }
    assert counts == {"good": [2, 0, 0, 1], "bad": [1, 1, 0, 0], "absent": [1, 0, 0, 1], "broken": [1, 0, 1, 0]}
    for name, suite in suites.items():
        for column, tag in enumerate(("failure", "error", "skipped"), start=1):
            assert len(suite.findall(f"testcase/{tag}")) == counts[name][column]


def test_report_is_self_contained_and_shows_all(fakes):
    run(["validate", "--only", "good", "bad", "absent", "broken", "--out", "new"])
    page = (fakes / "new" / "report.html").read_text()
    for part in ("good.size", "bad.size", "A claim that keeps its limit.", "there is no renderer", "ZeroDivisionError"):
        assert part in page, part
    assert "something &lt;must&gt; &amp; should" in page, "texts are escaped"
    assert not re.search(r"https?://|<script|@import", page)
    assert re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', page) == []


def paired(progress) -> Evidence:
    """A claim with two pictures to compare."""
    left, right = (png_address(np.full((40, 60, 3), colour, float)) for colour in ((1, 0, 0), (0, 0, 1)))
    return Evidence([Figure("size", 0.25, "px", "a size")], pairs=[("Two", ("one", left), ("other", right))])


def test_pairs_show_both_pictures_with_a_slider(fakes, monkeypatch):
    """Expectation: a browser, where there is one, shows the left half of one and the right half of the other."""
    monkeypatch.setitem(FAKES, "paired", Measurement(paired, quick=True))
    for _ in range(2):  # the second time from what the first has kept
        run(["validate", "--only", "paired", "--out", "new"])
        page = (fakes / "new" / "report.html").read_text()
        assert "Left: one; right: other" in page and 'type="range"' in page
    (fakes / "new" / "report.html").write_text(page.replace("<details", "<details open"))
    shot = browser.screenshot(fakes / "new" / "report.html", 800, 1600).astype(int)
    red, blue = (np.nonzero((shot == colour).all(axis=-1))[1] for colour in ([0, 0, 255], [255, 0, 0]))
    assert len(red) > 1000 and len(blue) == pytest.approx(len(red), rel=0.1)
    assert red.max() <= blue.min()


# --- kept results, several at once, comparison ----------------------------------------------------


def counted(progress) -> Evidence:
    """A claim that counts how often it was measured."""
    calls.append(1)
    return Evidence([Figure("calls", float(len(calls)), "1", "calls"), Figure("none", math.nan, "1", "nothing", 0.5)],
                    pictures=[("a picture", "data:,")], tables=[("t", ["a"], [["1"]])])  # fmt: skip


def run_claims(out, *arguments, **options):
    """Measure claims and write their folder."""
    return write_claims(out, partial(measured_claims, *arguments, **options))


calls: list[int] = []


def test_an_unchanged_claim_is_not_measured_again(fakes, monkeypatch, capsys):
    """Expectation: the same evidence with limits judged anew; --fresh, another variant, or damage measure again."""
    calls.clear()
    monkeypatch.setitem(FAKES, "counted", Measurement(counted, quick=True))
    table, limits = {"counted": FAKES["counted"]}, [Gate("counted.calls", "<= 1", "once")]
    first = run_claims(fakes / "a", ["counted"], table, [], variant="x", fresh=False)[0]
    again = run_claims(fakes / "b", ["counted"], table, limits, variant="x", fresh=False)[0]
    assert len(calls) == 1 and again.stored and not first.stored
    assert again.evidence.pictures == first.evidence.pictures and again.evidence.tables == first.evidence.tables
    assert again.claims[0].passed is True and first.claims[0].passed is None
    assert math.isnan(again.claims[1].value) and again.claims[1].spread == 0.5
    run_claims(fakes / "a", ["counted"], table, [], variant="y", fresh=False)
    assert len(calls) == 2
    (stored_file,) = (stored.cache_dir() / "claims").glob("counted.*.json")
    stored_file.write_text("{")
    run_claims(fakes / "a", ["counted"], table, [], variant="y", fresh=False)
    assert len(calls) == 3
    assert run(["validate", "--only", "counted", "--out", "new", "--fresh"]) == 0 and len(calls) == 4
    assert run(["validate", "--only", "counted", "--out", "new"]) == 0 and len(calls) == 4
    assert "1 of 1 claims were taken from an earlier run" in capsys.readouterr().out


def test_what_did_not_run_or_broke_is_tried_again(fakes):
    for _ in range(2):
        outcomes = run_claims(fakes / "new", ["absent", "broken"], FAKES, [], variant="x", fresh=False)
        assert not any(outcome.stored for outcome in outcomes)


def test_key_depends_on_variant_and_seed():
    """What code and data it depends on: tests/dasim/base/test_fingerprint.py."""
    claim = CLAIMS["blur-off"].run
    keys = [stored.key(claim, "x"), stored.key(claim, "y"), stored.key(claim, "x", 1)]
    assert len(set(keys)) == 3 and stored.key(claim, "x") == keys[0]


@pytest.mark.slow
def test_several_at_once_give_the_same(fakes):
    """Set-up: two processes; one claim that stops. Expectation: order, figures and failures as one after the other."""
    names = ["good", "bad", "free", "absent", "broken"]
    one = run_claims(fakes / "one", names, FAKES, [], jobs=1)
    two = run_claims(fakes / "two", names, FAKES, [], jobs=2)
    assert [outcome.id for outcome in two] == names
    for a, b in zip(one, two, strict=True):
        assert [(c.id, c.passed, c.source) for c in a.claims] == [(c.id, c.passed, c.source) for c in b.claims]
        np.testing.assert_array_equal([c.value for c in a.claims], [c.value for c in b.claims])


@pytest.mark.slow
def test_several_at_once_begin_when_they_are_measured(fakes):
    """Set-up: two processes for three claims. Expectation: the third begins after another has ended."""
    said: list[tuple[str, float]] = []
    run_claims(fakes / "new", ["good", "bad", "free"], FAKES, [], jobs=2, progress=lambda *at: said.append(at))
    begun = [number for number, (_, share) in enumerate(said) if share == 0]
    ended = [number for number, (_, share) in enumerate(said) if share == 1]
    assert len(begun) == len(ended) == 3 and begun[2] > ended[0]


@pytest.mark.slow
def test_a_process_that_dies_takes_no_other_claim_with_it(fakes):
    table = FAKES | {"dies": Measurement(dies, quick=True)}
    dead, *others = run_claims(fakes / "new", ["dies", "good", "free"], table, [], jobs=2)
    assert dead.error is not None and all(other.error is None for other in others)


@pytest.mark.parametrize(
    ("limit", "old", "new", "spread", "verdict"),
    [
        ("<= 1", 0.5, 0.4, 0.01, "better"),
        ("<= 1", 0.5, 0.6, 0.01, "worse"),
        (">= 1", 0.5, 0.6, 0.01, "better"),
        ("0..1", 0.5, 0.6, 0.01, "worse"),
        ("0..1", 0.4, 0.6, 0.01, "changed"),
        ("<= 1", 0.5, 0.6, 0.03, "same"),
        ("<= 1", 0.5, 0.5 + 1e-8, None, "same"),
        ("<= 1", 0.5, 0.5001, None, "worse"),
        (None, 0.5, 0.6, None, "changed"),
        ("<= 1", math.nan, 0.6, 0.03, "changed"),
        ("<= 1", math.nan, math.nan, None, "same"),
    ],
)
def test_changes_count_beyond_the_spread(limit, old, new, spread, verdict):
    """Expectation: three standard deviations of a difference, 4.2 spreads, are chance; a limit says what is better."""
    claim = Claim("good.size", new, limit, "px", None, "", spread)
    (change,) = changes({"good.size": Earlier(old, None, "px")}, [claim], {"good"})
    assert change.verdict == verdict


def test_compare_prints_what_changed(fakes, capsys):
    run(["validate", "--only", "good", "bad", "--out", "old"])
    content = json.loads((fakes / "old" / "results.json").read_text())
    content["claims"][0]["value"] = 0.125
    content["claims"][1]["id"] = "good.lost"
    content["claims"].append(content["claims"][0] | {"id": "other.size"})
    (fakes / "old.json").write_text(json.dumps(content))
    capsys.readouterr()
    assert run(["validate", "--only", "good", "bad", "--out", "new", "--compare", "old.json"]) == 1
    output = capsys.readouterr().out
    assert re.search(r"^worse +good\.size +0\.125 -> 0\.25 +px$", output, re.MULTILINE)
    assert re.search(r"^gone +good\.lost ", output, re.MULTILINE) and re.search(
        r"^new +good\.other", output, re.MULTILINE
    )
    assert "1 worse, 0 better, 0 changed, 1 gone, 1 new, 1 same" in output


def test_fail_on_worse_ends_with_status_1_where_a_figure_became_worse(fakes, capsys):
    """Set-up: the claim good, which keeps its limit, against an earlier run whose figure was better, and the same."""
    assert run(["validate", "--only", "good", "--out", "old"]) == 0
    content = json.loads((fakes / "old" / "results.json").read_text())
    content["claims"][0]["value"] = 0.125
    (fakes / "better.json").write_text(json.dumps(content))
    again = ["validate", "--only", "good", "--out", "new", "--fail-on-worse", "--compare"]
    assert run([*again, "old/results.json"]) == 0
    assert run([*again, "better.json"]) == 1
    assert run(["validate", "--only", "good", "--out", "new", "--compare", "better.json"]) == 0


def test_folder_is_written_as_a_whole(fakes):
    with pytest.raises(KeyboardInterrupt):
        run_claims(fakes / "new", ["good", "stopped"], FAKES, [])
    assert not (fakes / "new").exists()


# --- seeds ---------------------------------------------------------------------------------------


def seeded(progress, seed: int = 0) -> Evidence:
    """A claim of random numbers: 1, 3, 5 at the seeds 0, 1, 2."""
    return Evidence([Figure("size", 1.0 + 2 * seed, "px", "a size")], pictures=[(f"seed {seed}", "data:,")])


@pytest.fixture
def random_claim(fakes, monkeypatch):
    table = {"good": FAKES["good"], "seeded": Measurement(seeded, quick=True)}
    monkeypatch.setattr("validation.claims.table.CLAIMS", table)
    (fakes / "bundled.toml").write_text('["seeded.size"]\nlimit = "<= 4"\n["good.size"]\nlimit = "<= 1"\n')
    return fakes


def test_seeds_give_mean_and_spread(random_claim, capsys):
    """Expectation: 1, 3, 5 have the mean 3 and the deviation 2; one seed has none; other claims are run once."""
    assert run(["validate", "--seeds", "3", "--out", "new"]) == 0
    entries = results(random_claim / "new")
    assert (entries["seeded.size"]["value"], entries["seeded.size"]["spread"]) == (3.0, 2.0)
    assert entries["good.size"]["spread"] is None
    printed = capsys.readouterr().err
    assert "seeded, seed 2" in printed and "good, seed 1" not in printed
    assert run(["validate", "--out", "one"]) == 0
    entry = results(random_claim / "one")["seeded.size"]
    assert (entry["value"], entry["spread"]) == (1.0, None)


def test_more_seeds_measure_only_the_further_ones(random_claim, capsys):
    run(["validate", "--only", "seeded", "--seeds", "2", "--out", "new"])
    first = set((stored.cache_dir() / "claims").glob("seeded.*"))
    run(["validate", "--only", "seeded", "--seeds", "3", "--out", "new"])
    assert len(first) == 2 and first < set((stored.cache_dir() / "claims").glob("seeded.*"))


def test_proposed_limits_hold_for_one_more_seed():
    """Expectation: of normal values, 99 % of further ones keep a limit proposed from four.

    10,000 draws: the share is known to .1 %, five standard deviations are .5 %.
    """
    values = np.random.default_rng(0).normal(7, 0.3, (10_000, 5))
    for limit, sign in (("<= 9", 1), (">= 5", -1)):
        count = 0
        for four, fifth in zip(values[:, :4], values[:, 4], strict=True):
            claim = Claim("a.b", float(four.mean()), limit, "px", True, "", float(four.std(ddof=1)))
            count += within(fifth, proposed(claim, 4))
        assert count / len(values) == pytest.approx(0.99, abs=0.005), sign
    assert ".." in proposed(Claim("a.b", 7.0, None, "px", None, "", 0.3), 4)
    assert proposed(Claim("a.b", 7.0, "<= 9", "px", True, "", None), 4) is None


def test_proposed_limits_are_gates(random_claim):
    """Expectation: the file is one that --gates takes, and its limits replace the bundled ones."""
    assert run(["validate", "--seeds", "3", "--out", "new", "--propose-gates", "mine.toml"]) == 0
    text = (random_claim / "mine.toml").read_text()
    assert "3 +- 2 px over 3 seeds" in text and "good" not in text
    assert run(["validate", "--out", "again", "--gates", "mine.toml"]) == 0
    entry = results(random_claim / "again")["seeded.size"]
    # one-sided Student's t of 99 % and 2 degrees of freedom, 6.965, times 2 sqrt(1 + 1/3)
    assert entry["limit"] == f"<= {3 + 6.9646 * 2 * math.sqrt(4 / 3):.4g}"
