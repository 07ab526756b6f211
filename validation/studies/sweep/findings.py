"""What a sweep says: the best value of a parameter by each criterion, what another one costs, whether the bound ranks.

The value that is asked about is the study's ``reference``, such as the paper's hole of 0.46. Values are compared seed
by seed; where the reference decides the picture, the same seed is also the same random numbers. The best value is
chosen by the same measurements that then say how good it is, so its lead is a little flattered; it counts as clear
only where Student's test of the paired differences says so, at a level shared among the values that it was chosen
from (Bonferroni). Seeds differ by the noise of sensor and rendering: another scene may answer otherwise.

Tested in tests/validation/studies/test_sweep.py.
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
NOT_JUDGED = (
    "in-range",
    "half-pixel-m",
    "depth-constant",
    "occluded-share",
    "seconds",
)  # of the scene, or of the machine
LEVEL = 0.05  # of a case's tests together: one case in twenty has a clear lead that is none
FEWEST_RANKED = 4  # points, for their order to mean something
RANKED = ("depth-bound", "depth-seen")  # of the same pixels


@dataclass(frozen=True)
class Finding:
    """The best value of the reference's parameter by one figure, all else being equal."""

    figure: str
    others: dict[str, Value]  # the point's other parameters; empty where they do not matter
    best: Value
    at_best: float
    at_reference: float
    spread: float  # of the paired difference over seeds, its standard error; NaN with a single seed
    clear: bool  # the best value is better than the reference beyond the noise

    @property
    def cost(self) -> float:
        """What the reference is worse by: a share of the best, a difference for shares and in dB."""
        if FIGURES[self.figure][0] == "dB" or self.figure in SHARES:
            return abs(self.at_best - self.at_reference)
        return abs(self.at_reference / self.at_best - 1) if self.at_best > 0 else math.nan

    @property
    def verdict(self) -> str:
        """In words."""
        if self.cost == 0:
            return "the best"
        return "worse" if self.clear else "not told from the best"


def findings(spec: StudySpec, rows: list[Row]) -> list[Finding]:
    """A finding for each figure and each combination of the other parameters, those that do not matter left out.

    None where the study has no reference.
    """
    found: list[Finding] = []
    if not spec.reference:
        return found
    groups = _groups(spec, rows)
    for figure in FIGURES:
        if figure in NOT_JUDGED or not any(math.isfinite(row[figure]) for row in rows):
            continue
        own = [one for group in groups if (one := _finding(spec, figure, *group)) is not None]
        if len(own) == len(groups) and len({(one.best, one.at_best, one.at_reference) for one in own}) == 1:
            own = [Finding(figure, {}, own[0].best, own[0].at_best, own[0].at_reference, own[0].spread, own[0].clear)]
        found += own
    return found


def _groups(spec: StudySpec, rows: list[Row]) -> list[tuple[dict[str, Value], list[Row]]]:
    """Rows that differ in the reference's parameter and the seed alone; none where nothing stands against it."""
    key, reference = next(iter(spec.reference.items()))
    groups: dict[tuple[Value, ...], list[Row]] = {}
    others = [name for name in spec.parameters if name != key]
    for row in rows:
        groups.setdefault(tuple(row[name] for name in others), []).append(row)
    return [
        (dict(zip(others, values, strict=True)), own)
        for values, own in groups.items()
        if any(row[key] != reference for row in own)
    ]


def _finding(spec: StudySpec, figure: str, others: dict[str, Value], rows: list[Row]) -> Finding | None:
    key, reference = next(iter(spec.reference.items()))
    seeds = sorted({row["seed"] for row in rows})
    values = {value: _by_seed(rows, key, value, figure, seeds) for value in spec.parameters[key]}
    known = {value: curve for value, curve in values.items() if np.isfinite(curve).all()}
    if reference not in known or len(known) < 2:
        return None
    sign = -1 if figure in LARGER_IS_BETTER else 1
    # of equals the reference, so that nothing is said to be better that is not
    best = min(known, key=lambda value: (sign * known[value].mean(), value != reference))
    lead = sign * (known[reference] - known[best])
    error = float(lead.std(ddof=1) / np.sqrt(len(seeds))) if len(seeds) > 1 else math.nan
    level = LEVEL / (len(known) - 1)
    clear = len(seeds) > 1 and bool(lead.mean() > stats.t.ppf(1 - level, len(seeds) - 1) * error)
    return Finding(figure, others, best, float(known[best].mean()), float(known[reference].mean()), error, clear)


def _by_seed(rows: list[Row], key: str, value: Value, figure: str, seeds: list[int]) -> FloatArray:
    found = {row["seed"]: row[figure] for row in rows if row[key] == value}
    return np.array([found.get(seed, math.nan) for seed in seeds])


def said(spec: StudySpec, found: list[Finding]) -> list[str]:
    """One sentence a figure of the study's own pictures: where the reference is the best value, where another is."""
    if not found:
        return []
    reference = next(iter(spec.reference.values()))
    lines = []
    drawn = {curve.y for curve in spec.curves} | set(spec.pareto or ())
    for figure in dict.fromkeys(one.figure for one in found if one.figure in drawn):
        own = [one for one in found if one.figure == figure]
        best = [one for one in own if one.cost == 0]
        close = [one for one in own if one.cost != 0 and not one.clear]
        worse = [one for one in own if one.clear]
        parts = []
        if len(own) == 1:
            costs = f", {reference} costs {_cost(own[0])}" if worse else f", {reference} is not told from it"
            where = f" for {_where(own[0].others)}" if own[0].others else ""
            parts.append(f"{own[0].best} is best{where}" + ("" if best else costs))
        else:
            parts += [f"{reference} is best in {len(best)} of {len(own)} cases"] if best else []
            parts += [f"not told from the best in {len(close)}"] if close else []
            for value in dict.fromkeys(one.best for one in worse):
                cases = [f"{_where(one.others)} ({reference} costs {_cost(one)})" for one in worse if one.best == value]
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
    """Spearman's rank correlation of the bound with the error that was measured, over the points of a sweep."""

    correlation: float
    points: int
    over_bound: float  # median of measured error over bound
    within: tuple[float, ...]  # the same among values of the reference's parameter, all else being equal

    @property
    def said(self) -> str:
        """In words."""
        text = f"rank correlation of {' and '.join(RANKED)}: {self.correlation:.2f}, {self.points} points"
        if not self.within:
            return text
        return f"{text}; all else being equal {np.median(self.within):.2f} (median), {min(self.within):.2f} at least"


def ranking(spec: StudySpec, averaged: list[Row]) -> Ranking | None:
    """Over the points that have both figures; None where fewer than four have."""
    found = _spearman(averaged)
    if found is None:
        return None
    pairs = _pairs(averaged)
    groups = _groups(spec, averaged) if spec.reference else []
    within = tuple(one for _, own in groups if (one := _spearman(own)) is not None)
    return Ranking(found, len(pairs), float(np.median(pairs[:, 1] / pairs[:, 0])), within if len(within) > 1 else ())


def _pairs(rows: list[Row]) -> FloatArray:
    pairs = np.array([[row[key] for key in RANKED] for row in rows], float)
    return np.asarray(pairs[np.isfinite(pairs).all(axis=1)])


def _spearman(rows: list[Row]) -> float | None:
    pairs = _pairs(rows)
    if len(np.unique(pairs[:, 0])) < FEWEST_RANKED:
        return None
    return float(stats.spearmanr(pairs[:, 0], pairs[:, 1]).statistic)
