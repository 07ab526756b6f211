"""`dasim validate`: claims made up here, files and exit statuses; claims that must fail do."""

from __future__ import annotations

import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest

from dasim.cli import run
from tests.support import browser
from tests.support.claim_runs import results, run_claims
from tests.support.fake_claims import FAKES, dies
from validation.claims.table import CLAIMS
from validation.gates import stored
from validation.gates.claim import Evidence
from validation.gates.limits import Gate
from validation.gates.outcome import Measurement, select
from validation.reports.page import png_address
from validation.scores.figures import Figure

calls: list[int] = []


def test_every_claim_has_a_report_for_its_docstring():
    for name, measurement in CLAIMS.items():
        for part in ("Rationale: ", "Set-up: ", "Expectation: ", "Source: "):
            assert f"\n    {part}" in (measurement.run.__doc__ or ""), f"{name} lacks {part}"


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
        (("--only", "good", "--out", "new", "--compare", "foreign/results.json"), ("not a results.json",)),
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


def counted(progress) -> Evidence:
    """A claim that counts how often it was measured."""
    calls.append(1)
    return Evidence([Figure("calls", float(len(calls)), "1", "calls"), Figure("none", math.nan, "1", "nothing", 0.5),
                     Figure("never", math.inf, "1", "never")],
                    pictures=[("a picture", "data:,")], tables=[("t", ["a"], [["1"]])])  # fmt: skip


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
    assert again.claims[2].value == math.inf
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


def test_folder_is_written_as_a_whole(fakes):
    with pytest.raises(KeyboardInterrupt):
        run_claims(fakes / "new", ["good", "stopped"], FAKES, [])
    assert not (fakes / "new").exists()
