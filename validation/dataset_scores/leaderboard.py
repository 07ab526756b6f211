"""The leaderboard of a split: means over samples with bootstrap intervals, by method, group and part.

Tested in tests/validation/test_dataset_scores.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dasim.typing import FloatArray
from validation.dataset_scores.entrants import CONSTANT
from validation.dataset_scores.figures import EDGE, EDGE_TEXT, LIGHT_EDGES_E, METRICS, ranges
from validation.scores.depth import METRICS as DEPTH_METRICS
from validation.scores.figures import Figure

Row = dict[str, Any]  # the result of an entrant on a sample, as validation.dataset_scores.work writes it

RESAMPLES = 1000
INTERVAL = (2.5, 97.5)  # percentiles of the resampled means
RATIO = "rmse-ratio"
MEANINGS = {
    RATIO: ("1", "RMSE in dioptres over that of the best constant map, mean over samples"),
    **{key: (DEPTH_METRICS[key].unit, f"{DEPTH_METRICS[key].meaning}, mean over samples") for key in METRICS},
    EDGE: ("1", f"{EDGE_TEXT}, mean over samples"),
}
BIGGER_IS_BETTER = ("delta-1.05", "delta-1.25", EDGE)
WHOLE = ("region", "all")  # group and part of the figures that rank
SAMPLE_GROUPS: dict[str, Callable[[Row], str | None]] = {
    "kind": lambda row: row["kind"],
    "light": lambda row: next(
        name for name, (low, high) in ranges(LIGHT_EDGES_E, "e").items() if row["light_e"] < high or np.isinf(high)
    ),
    "illuminant": lambda row: row["illuminant"],
}
GROUPS = {
    "kind": "kind of scene",
    "region": "region of the picture",
    "depth": "true depth",
    "blur": "true visible blur",
    "light": "light: median signal of the green pixels, electrons",
    "illuminant": "illuminant of the main light",
}


class Mean(NamedTuple):
    """Mean over samples with its 95 % interval and its standard error; NaN where unknown."""

    value: float
    low: float
    high: float
    error: float


@dataclass(frozen=True)
class Entry:
    """Means of a method in one part of the data."""

    method: str
    group: str
    part: str
    samples: int
    means: dict[str, Mean]


def mean(values: Sequence[float | None], scenes: Sequence[str]) -> Mean:
    """Mean of the known values, with an interval by the bootstrap over scenes (Efron and Tibshirani 1993, ch. 13).

    The captures of one scene are drawn together, because they are alike. With one scene the interval is unknown, and
    with a few it is too narrow.
    """
    known = [(float(value), scene) for value, scene in zip(values, scenes, strict=True) if value is not None]
    if not known:
        return Mean(*[float("nan")] * 4)
    names, place = np.unique([scene for _, scene in known], return_inverse=True)
    numbers = np.array([value for value, _ in known])
    middle = float(numbers.mean())
    if len(names) < 2:
        return Mean(middle, *[float("nan")] * 3)
    sums, counts = np.bincount(place, numbers), np.bincount(place)
    drawn = np.random.default_rng(0).multinomial(len(names), np.full(len(names), 1 / len(names)), RESAMPLES)
    resampled: FloatArray = (drawn @ sums) / (drawn @ counts)
    low, high = np.percentile(resampled, INTERVAL)
    return Mean(middle, float(low), float(high), float(resampled.std()))


def entries(rows: Sequence[Row]) -> list[Entry]:
    """Means of every method in every part, the methods in the order of their rank."""
    found, constants = [], constants_of(rows)
    for method in ranked(rows):
        own = [row for row in rows if row["method"] == method]
        for group in GROUPS:
            for part in _parts(group, rows):
                cells = [(row, figures) for row in own if (figures := _figures(row, group, part)) is not None]
                if cells:
                    found.append(_entry(method, group, part, cells, constants))
    return found


def ranked(rows: Sequence[Row]) -> list[str]:
    """Methods by their ratio to the best constant map, the best first; without a ratio last."""
    names, constants = list(dict.fromkeys(row["method"] for row in rows)), constants_of(rows)
    ratios = {name: mean(*_ratios([row for row in rows if row["method"] == name], constants)).value for name in names}
    return sorted(names, key=lambda name: (np.isnan(ratios[name]), ratios[name]))


def constants_of(rows: Sequence[Row]) -> dict[str, Row]:
    """The result of the best constant map on each sample, by the sample's key."""
    return {row["sample"]: row for row in rows if row["method"] == CONSTANT}


def _entry(
    method: str, group: str, part: str, cells: list[tuple[Row, dict[str, Any]]], constants: dict[str, Row]
) -> Entry:
    scenes = [row["scene"] for row, _ in cells]
    means = {RATIO: mean(*_ratios([row for row, _ in cells], constants, group, part))}
    means |= {key: mean([figures.get(key) for _, figures in cells], scenes) for key in METRICS}
    if group not in ("depth", "blur") and any(EDGE in figures for _, figures in cells):
        means[EDGE] = mean([figures.get(EDGE) for _, figures in cells], scenes)
    if (group, part) == WHOLE:
        own = dict.fromkeys(key for row, _ in cells for key in row["metrics"])
        means |= {key: mean([row["metrics"].get(key) for row, _ in cells], scenes) for key in own}
    return Entry(method, group, part, len(cells), means)


def _parts(group: str, rows: Sequence[Row]) -> list[str]:
    """Parts of a group in their order."""
    if group in SAMPLE_GROUPS:
        named = dict.fromkeys(part for row in rows if (part := SAMPLE_GROUPS[group](row)) is not None)
        orders = {"light": list(ranges(LIGHT_EDGES_E, "e")), "illuminant": sorted(named)}
        return [part for part in orders.get(group, named) if part in named]
    return list(dict.fromkeys(part for row in rows for part in row["figures"].get(group, {})))


def _figures(row: Row, group: str, part: str) -> dict[str, Any] | None:
    """Figures of a row in a part; None where the sample has none of it."""
    if group in SAMPLE_GROUPS:
        return _figures(row, *WHOLE) if SAMPLE_GROUPS[group](row) == part else None
    return row["figures"].get(group, {}).get(part)


def _ratios(
    own: Sequence[Row], constants: dict[str, Row], group: str = WHOLE[0], part: str = WHOLE[1]
) -> tuple[list[float | None], list[str]]:
    """RMSE of each row over that of the best constant map on the same sample and part, and the scenes."""
    ratios = [ratio(row, constants.get(row["sample"]), group, part) for row in own]
    return ratios, [row["scene"] for row in own]


def ratio(row: Row, constant: Row | None, group: str = WHOLE[0], part: str = WHOLE[1]) -> float | None:
    """RMSE in dioptres of a row over that of the constant map; None where one is unknown, or the latter is 0."""
    ours, best = (
        None if one is None else (_figures(one, group, part) or {}).get(METRICS[0]) for one in (row, constant)
    )
    return None if ours is None or not best else float(ours / best)


def lost(row: Row, constant: Row | None) -> bool:
    """Whether a method has failed on a sample, or is no better there than the best constant map."""
    if row["failed"] is not None or constant is None:
        return row["failed"] is not None
    ours, best = ((_figures(one, *WHOLE) or {}).get(METRICS[0]) for one in (row, constant))
    return ours is None or best is None or not ours < best


def figures(rows: Sequence[Row], board: Sequence[Entry]) -> list[Figure]:
    """Figures for gates and JSON: METHOD.METRIC over all, METHOD.GROUP.PART.METRIC, coverage and numbers of samples.

    ``board`` are the entries of the rows.
    """
    found, constants = [], constants_of(rows)
    for entry in board:
        whole = (entry.group, entry.part) == WHOLE
        place = entry.method if whole else f"{entry.method}.{entry.group}.{entry.part.replace(' ', '-')}"
        for key, value in entry.means.items():
            unit, meaning = MEANINGS.get(key, ("1", "your metric, mean over samples"))
            found.append(Figure(f"{place}.{key}", value.value, unit, meaning, spread=value.error))
    for method in ranked(rows):
        own = [row for row in rows if row["method"] == method]
        coverage = float(np.mean([row["coverage"] for row in own if row["coverage"] is not None] or [np.nan]))
        text = "failed, or no better than the best constant map"
        found += [
            Figure(f"{method}.coverage", coverage, "1", "mean share of pixels with an estimate of their own"),
            Figure(f"{method}.failed", float(sum(row["failed"] is not None for row in own)), "samples", "failed"),
        ]
        if method != CONSTANT:
            count = float(sum(lost(row, constants.get(row["sample"])) for row in own))
            found.append(Figure(f"{method}.lost", count, "samples", f"{text}, of {len(own)}"))
    return found
