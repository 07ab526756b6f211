"""What a sweep says that it found: the reference's place, the best values, rankings."""

from __future__ import annotations

import math

import pytest

from dasim.base.errors import InputError
from tests.support.small_study import GRIDS, HOLE, REFERENCE, STUDY, rows_of, swept
from validation.studies.sweep import findings
from validation.studies.sweep import run as sweep
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.point import FIGURES, Sweep
from validation.studies.sweep.specification import points


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
            *(0.65, "not significantly worse than the best", "0.65 is best, 0.46 is not significantly worse"),
        ),
        (
            {0.3: (3, 3, 3, 3), 0.46: (1.0, 1.1, 1.0, 1.1), 0.65: (1.2, 1.2, 1.3, 1.2)},
            *(0.46, "best", "0.46 is best"),
        ),
        # t is 3.06 of 3 degrees of freedom: clear at 5 % (2.35), not at 5 % shared by two other values (3.18)
        (
            {0.3: (3, 3, 3, 3), 0.46: (1.0, 1.0, 1.0, 1.0), 0.65: (0.8, 0.9, 0.98, 0.85)},
            *(0.65, "not significantly worse than the best", "0.65 is best, 0.46 is not significantly worse"),
        ),
        (
            {0.3: (3,), 0.46: (1.5,), 0.65: (1.0,)},
            *(0.65, "not significantly worse than the best", "0.65 is best, 0.46 is not significantly worse"),
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
