"""`dasim validate`: comparison with an earlier run, several seeds, proposed limits."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

from dasim.cli import run
from tests.support.claim_runs import results
from tests.support.fake_claims import FAKES
from validation.gates import stored
from validation.gates.claim import Claim, Evidence
from validation.gates.comparison import Earlier, changes
from validation.gates.limits import bounds, within
from validation.gates.outcome import Measurement
from validation.gates.proposal import proposed
from validation.gates.run import over_seeds
from validation.scores.figures import Figure


@pytest.mark.parametrize(
    ("limit", "old", "new", "spread", "verdict"),
    [
        ("<= 1", 0.5, 0.4, 0.01, "better"),
        ("<= 1", 0.5, 0.6, 0.01, "worse"),
        (">= 1", 0.5, 0.6, 0.01, "better"),
        ("0..1", 0.5, 0.6, 0.01, "changed"),
        ("0..1", 1.2, 1.1, 0.01, "better"),
        ("0..1", 0.4, -0.1, 0.01, "worse"),
        ("-1..1", 0.5, 0.6, 0.01, "worse"),
        ("<= 1", 0.5, math.inf, 0.01, "worse"),
        ("<= 1", math.inf, math.inf, None, "same"),
        ("<= 1", 0.5, 0.6, 0.03, "same"),
        ("<= 1", 0.5, 0.5 + 1e-8, None, "same"),
        ("<= 1", 0.5, 0.5001, None, "worse"),
        (None, 0.5, 0.6, None, "changed"),
        ("<= 1", math.nan, 0.6, 0.03, "better"),
        ("<= 1", 0.6, math.nan, 0.03, "worse"),
        (None, 0.6, math.nan, 0.03, "changed"),
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


def test_figures_of_several_seeds_are_joined_by_their_kind():
    """Expectation: the mean of values; of probabilities the smallest times their number; NaN where a seed lacks one."""
    runs = [[("a.size", 1.0), ("a.p", 0.8), ("a.rare", 2.0)], [("a.size", 3.0), ("a.p", 1e-9)]]
    joined = over_seeds([[Figure(name, value, "1", "") for name, value in one] for one in runs])
    size, p, rare = (figure.value for figure in joined)
    assert (size, p) == (2.0, 2e-9) and math.isnan(rare)


@pytest.mark.parametrize("limit", ["<= 9", ">= 5", None])
@pytest.mark.parametrize(
    ("value", "spread"), [(1234.56, 0.01), (0.123456, 1e-6), (-3e-5, 2e-9), (7.0, 0.0), (5e7, 3e5)]
)
def test_proposed_limits_hold_for_what_was_measured(value, spread, limit):
    """Rationale: a limit that is rounded towards the measured value may be missed by it."""
    claim = Claim("a.b", value, limit, "px", None, "", spread)
    text = proposed(claim, 5)
    assert within(value, text)
    margin = np.max(np.abs(np.array([end for end in bounds(text) if np.isfinite(end)]) - value))
    assert margin <= 5.2 * spread + 1e-12 * abs(value), "and it is not looser than it has to be"


def test_proposed_limits_are_gates(random_claim):
    """Expectation: the file is one that --gates takes, and its limits replace the bundled ones."""
    assert run(["validate", "--seeds", "3", "--out", "new", "--propose-gates", "mine.toml"]) == 0
    text = (random_claim / "mine.toml").read_text()
    assert "3 +- 2 px over 3 seeds" in text and "good" not in text
    assert run(["validate", "--out", "again", "--gates", "mine.toml"]) == 0
    entry = results(random_claim / "again")["seeded.size"]
    # one-sided Student's t of 99 % and 2 degrees of freedom, 6.965, times 2 sqrt(1 + 1/3)
    assert entry["limit"] == f"<= {math.ceil(10 * (3 + 6.9646 * 2 * math.sqrt(4 / 3))) / 10:.1f}"
