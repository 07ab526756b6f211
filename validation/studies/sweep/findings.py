"""Findings of a sweep: the best value of a parameter by each figure, its lead, and the ranking by the bound.

The value in question is the study's ``reference``, such as the paper's hole of 0.46. Values are compared seed by seed;
if the parameter changes the rendered picture, equal seeds also mean equal random numbers. The best value is chosen by
the same measurements that state its advantage, which is therefore slightly overestimated. It counts as better than the
reference only if Student's t test of the paired differences is significant, at a level divided by the number of other
values (Bonferroni). Seeds differ in the noise of sensor and rendering; another scene may have another best value.

Tested in tests/validation/studies/sweep/test_findings.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from dasim.typing import FloatArray
from validation.studies.sweep.point import FIGURES
from validation.studies.sweep.specification import StudySpec, Value

Row = dict[str, Any]

LARGER_IS_BETTER = ("infrared-snr", "coverage", "psnr", "psnr-gain", "stereo-coverage")
SHARES = ("light-loss", "coverage", "stereo-coverage", "occluded-matched")  # compared by their difference
# Figures that describe the scene or the computer, not the design.
WITHOUT_VERDICT = ("in-range", "half-pixel-m", "depth-constant", "occluded-share", "seconds")
LEVEL = 0.05  # significance level of all tests of a case together: a false lead in one case of twenty
FEWEST_RANKED = 4  # least number of points for a rank correlation
RANKED = ("depth-bound", "depth-seen")  # the bound and the measured error over the same pixels


@dataclass(frozen=True)
class Finding:
    """The best value of the reference's parameter by one figure, with the other parameters fixed (a case)."""

    figure: str
    others: dict[str, Value]  # the point's other parameters; empty if they have no effect
    best: Value
    at_best: float  # mean of the figure over seeds at the best value
    at_reference: float  # the same at the reference
    spread: float  # standard error over seeds of the paired difference; NaN with a single seed
    clear: bool  # whether the best value is significantly better than the reference

    @property
    def cost(self) -> float:
        """How much worse the reference is: relative to the best value, or a difference for shares and in dB."""
        if FIGURES[self.figure][0] == "dB" or self.figure in SHARES:
            return abs(self.at_best - self.at_reference)
        return abs(self.at_reference / self.at_best - 1) if self.at_best > 0 else math.nan

    @property
    def verdict(self) -> str:
        """The reference's rank: best, not significantly worse than the best, or worse."""
        if self.cost == 0:
            return "best"
        return "worse" if self.clear else "not significantly worse than the best"


def findings(spec: StudySpec, rows: list[Row]) -> list[Finding]:
    """A finding for each figure and each combination of the other parameters; empty without a reference.

    If a figure does not depend on the other parameters, it has one finding.
    """
    result: list[Finding] = []
    if not spec.reference:
        return result
    groups = _groups(spec, rows)
    for figure in FIGURES:
        if figure in WITHOUT_VERDICT or not any(math.isfinite(row[figure]) for row in rows):
            continue
        of_figure = [one for group in groups if (one := _finding(spec, figure, *group)) is not None]
        if len(of_figure) == len(groups) and len({(one.best, one.at_best, one.at_reference) for one in of_figure}) == 1:
            of_figure = [
                Finding(
                    figure,
                    {},
                    of_figure[0].best,
                    of_figure[0].at_best,
                    of_figure[0].at_reference,
                    of_figure[0].spread,
                    of_figure[0].clear,
                )
            ]
        result += of_figure
    return result


def _groups(spec: StudySpec, rows: list[Row]) -> list[tuple[dict[str, Value], list[Row]]]:
    """Rows grouped by all parameters but the reference's; groups with the reference value alone are left out."""
    key, reference = next(iter(spec.reference.items()))
    groups: dict[tuple[Value, ...], list[Row]] = {}
    others = [name for name in spec.parameters if name != key]
    for row in rows:
        groups.setdefault(tuple(row[name] for name in others), []).append(row)
    return [
        (dict(zip(others, values, strict=True)), group)
        for values, group in groups.items()
        if any(row[key] != reference for row in group)
    ]


def _finding(spec: StudySpec, figure: str, others: dict[str, Value], rows: list[Row]) -> Finding | None:
    """The finding of one figure over a group of rows; None if the reference or all other values lack a measurement."""
    key, reference = next(iter(spec.reference.items()))
    seeds = sorted({row["seed"] for row in rows})
    values = {value: _by_seed(rows, key, value, figure, seeds) for value in spec.parameters[key]}
    known = {value: curve for value, curve in values.items() if np.isfinite(curve).all()}
    if reference not in known or len(known) < 2:
        return None
    sign = -1 if figure in LARGER_IS_BETTER else 1
    # Among equal values the reference wins, so that no other value is reported as better.
    best = min(known, key=lambda value: (sign * known[value].mean(), value != reference))
    lead = sign * (known[reference] - known[best])
    error = float(lead.std(ddof=1) / np.sqrt(len(seeds))) if len(seeds) > 1 else math.nan
    level = LEVEL / (len(known) - 1)
    clear = len(seeds) > 1 and bool(lead.mean() > stats.t.ppf(1 - level, len(seeds) - 1) * error)
    return Finding(figure, others, best, float(known[best].mean()), float(known[reference].mean()), error, clear)


def _by_seed(rows: list[Row], key: str, value: Value, figure: str, seeds: list[int]) -> FloatArray:
    """A figure at one value of a parameter for each seed, NaN without a measurement."""
    by_seed = {row["seed"]: row[figure] for row in rows if row[key] == value}
    return np.array([by_seed.get(seed, math.nan) for seed in seeds])


def sentences(spec: StudySpec, all_findings: list[Finding]) -> list[str]:
    """One sentence per figure of the study's plots: the cases in which the reference is best, and the others."""
    if not all_findings:
        return []
    reference = next(iter(spec.reference.values()))
    lines = []
    plotted = {curve.y for curve in spec.curves} | set(spec.pareto or ())
    for figure in dict.fromkeys(one.figure for one in all_findings if one.figure in plotted):
        of_figure = [one for one in all_findings if one.figure == figure]
        best = [one for one in of_figure if one.cost == 0]
        tied = [one for one in of_figure if one.cost != 0 and not one.clear]
        worse = [one for one in of_figure if one.clear]
        parts = []
        if len(of_figure) == 1:
            costs = (
                f", {reference} is worse by {_cost(of_figure[0])}"
                if worse
                else f", {reference} is not significantly worse"
            )
            where = f" for {_where(of_figure[0].others)}" if of_figure[0].others else ""
            parts.append(f"{of_figure[0].best} is best{where}" + ("" if best else costs))
        else:
            parts += [f"{reference} is best in {len(best)} of {len(of_figure)} cases"] if best else []
            parts += (
                [f"{reference} is not significantly worse than the best in {len(tied)} of {len(of_figure)} cases"]
                if tied
                else []
            )
            for value in dict.fromkeys(one.best for one in worse):
                own_cases = [one for one in worse if one.best == value]
                cases = [f"{_where(one.others)} ({reference} is worse by {_cost(one)})" for one in own_cases]
                parts.append(f"{value} is better for {', '.join(cases)}")
        lines.append(f"{figure}: {'; '.join(parts)}")
    return lines


def _cost(one: Finding) -> str:
    decibels = FIGURES[one.figure][0] == "dB"
    unit = "dB" if decibels else "percentage points" if one.figure in SHARES else "%"
    value = one.cost if decibels else 100 * one.cost
    return f"{value:.0f} {unit}" if value >= 9.95 else f"{value:.2g} {unit}"


def _where(others: dict[str, Value]) -> str:
    words = (f"{v:g} {key.rpartition('.')[2]}" if isinstance(v, int | float) else str(v) for key, v in others.items())
    return " and ".join(words)


# --- does the bound rank designs as the pipeline does? -------------------------------------------


@dataclass(frozen=True)
class Ranking:
    """Spearman's rank correlation between the Cramer-Rao bound and the measured error over the points of a sweep."""

    correlation: float
    points: int
    over_bound: float  # median of measured error over bound
    within: tuple[float, ...]  # correlation over values of the reference's parameter, one for each case

    @property
    def sentence(self) -> str:
        """A sentence for reports."""
        text = f"rank correlation of {' and '.join(RANKED)}: {self.correlation:.2f} over {self.points} points"
        if not self.within:
            return text
        middle, least = np.median(self.within), min(self.within)
        return f"{text}; with the other parameters fixed, median {middle:.2f}, minimum {least:.2f}"


def ranking(spec: StudySpec, averaged: list[Row]) -> Ranking | None:
    """The ranking over the points that have both figures; None if fewer than ``FEWEST_RANKED`` bounds differ.

    ``averaged`` has one row per point, the mean over seeds.
    """
    correlation = _spearman(averaged)
    if correlation is None:
        return None
    pairs = _pairs(averaged)
    groups = _groups(spec, averaged) if spec.reference else []
    within = tuple(one for _, rows_of_light in groups if (one := _spearman(rows_of_light)) is not None)
    over_bound = float(np.median(pairs[:, 1] / pairs[:, 0]))
    return Ranking(correlation, len(pairs), over_bound, within if len(within) > 1 else ())


def _pairs(rows: list[Row]) -> FloatArray:
    """The figures ``RANKED`` of the rows that have both, [row, 2]."""
    pairs = np.array([[row[key] for key in RANKED] for row in rows], float)
    return np.asarray(pairs[np.isfinite(pairs).all(axis=1)])


def _spearman(rows: list[Row]) -> float | None:
    pairs = _pairs(rows)
    if len(np.unique(pairs[:, 0])) < FEWEST_RANKED:
        return None
    return float(stats.spearmanr(pairs[:, 0], pairs[:, 1]).statistic)
