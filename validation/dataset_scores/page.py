"""The page of a leaderboard: the table, figures by group, and every sample; and the table for the terminal.

Tested in tests/validation/test_dataset_scores.py.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from typing import Any

import jinja2
import numpy as np

from validation.dataset_scores.entrants import CONSTANT
from validation.dataset_scores.figures import EDGE, METRICS
from validation.dataset_scores.leaderboard import (
    BIGGER_IS_BETTER,
    GROUPS,
    MEANINGS,
    RATIO,
    WHOLE,
    Entry,
    Mean,
    Row,
    constants_of,
    lost,
    ranked,
    ratio,
)
from validation.reports.page import TEMPLATE_DIR
from validation.reports.plots import plot

COLUMNS = (RATIO, "rmse-dioptre", "abs-rel", "delta-1.25", "level-median", EDGE)
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")  # Okabe and Ito
MARKERS = "os^Dv<>"
WIDTH = 0.7  # of the markers of all methods in one part, as a share of the distance between two parts
UNKNOWN = Mean(*[float("nan")] * 4)


def lines(rows: Sequence[Row], found: Sequence[Entry]) -> list[str]:
    """The leaderboard for the terminal: means with 95 % intervals, coverage, and samples that were lost or failed."""
    cells = [["method", *COLUMNS, "coverage", "lost", "failed"]]
    for one in board(rows, found):
        means = [short(one["means"].get(key, UNKNOWN)) for key in COLUMNS]
        cells.append([one["method"], *means, one["coverage"], one["lost"], one["failed"]])
    width = [max(len(row[column]) for row in cells) for column in range(len(cells[0]))]
    return ["  ".join(text.ljust(size) for text, size in zip(row, width, strict=True)).rstrip() for row in cells]


def short(mean: Mean, digits: int = 3) -> str:
    """A mean with its interval, such as ``0.71 [0.66, 0.78]``; a dash where it is unknown."""
    if np.isnan(mean.value):
        return "-"
    interval = "" if np.isnan(mean.low) else f" [{mean.low:.{digits}g}, {mean.high:.{digits}g}]"
    return f"{mean.value:.{digits}g}{interval}"


def board(rows: Sequence[Row], found: Sequence[Entry]) -> list[dict[str, Any]]:
    """One row per method in the order of the ranks, as values for the template and the terminal."""
    whole = {entry.method: entry for entry in found if (entry.group, entry.part) == WHOLE}
    constants = constants_of(rows)
    table = []
    for method in ranked(rows):
        own = [row for row in rows if row["method"] == method]
        coverage = [row["coverage"] for row in own if row["coverage"] is not None]
        count = sum(lost(row, constants.get(row["sample"])) for row in own)
        table.append(
            {
                "method": method,
                "means": whole[method].means if method in whole else {},
                "coverage": f"{np.mean(coverage):.2f}" if coverage else "-",
                "lost": "-" if method == CONSTANT else f"{count} of {len(own)}",
                "failed": str(sum(row["failed"] is not None for row in own)),
            }
        )
    return table


def page(about: dict[str, Any], rows: Sequence[Row], found: Sequence[Entry], index: Sequence[dict[str, Any]]) -> str:
    """One self-contained HTML page; ``index`` are the rows of the dataset's index, with thumbnails."""
    methods = ranked(rows)
    groups = [(group, text) for group, text in GROUPS.items() if len({e.part for e in found if e.group == group}) > 1]
    pictures = [
        (f"{MEANINGS[RATIO][1]}, by {text}; bars: 95 %", _by_group(group, found, methods)) for group, text in groups
    ]
    tables = [(text, [e for e in found if e.group == group]) for group, text in groups]
    failures = [row for row in rows if row["failed"] is not None]
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    return environment.get_template("leaderboard.html").render(
        about=about, board=board(rows, found), columns=COLUMNS, metrics=(RATIO, *METRICS, EDGE), meanings=MEANINGS,
        bigger=BIGGER_IS_BETTER, pictures=pictures, tables=tables, methods=methods, failures=failures,
        samples=_samples(rows, methods, index), short=short, unknown=UNKNOWN, constant=CONSTANT,
    )  # fmt: skip


def _samples(rows: Sequence[Row], methods: Sequence[str], index: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Every sample with its thumbnail and each method's ratio to the best constant map."""
    by_name = {(row["sample"], row["method"]): row for row in rows}
    table = []
    for one in index:
        constant = by_name.get((one["key"], CONSTANT))
        own = [by_name.get((one["key"], method)) for method in methods]
        ratios = [None if row is None else ratio(row, constant) for row in own]
        address = "data:image/jpeg;base64," + base64.b64encode(one["thumbnail"]).decode()
        about = ", ".join(str(one[key]) for key in ("kind", "illuminant") if one.get(key))
        table.append({"key": one["key"], "picture": address, "about": about, "ratios": ratios})
    return table


def _by_group(group: str, found: Sequence[Entry], methods: Sequence[str]) -> str:
    """The ratio of every method in each part of a group, with intervals."""
    entries = {(entry.part, entry.method): entry for entry in found if entry.group == group}
    names = list(dict.fromkeys(part for part, _ in entries))
    shown = [method for method in methods if method != CONSTANT]

    def draw(axes: Any) -> None:
        for number, method in enumerate(shown):
            side = WIDTH * ((number + 0.5) / max(len(shown), 1) - 0.5)
            means = [entries[name, method].means[RATIO] if (name, method) in entries else UNKNOWN for name in names]
            value = np.array([mean.value for mean in means])
            ends = np.array([[mean.value - mean.low, mean.high - mean.value] for mean in means]).T
            style = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)], "linestyle": ""}
            axes.errorbar(
                np.arange(len(names)) + side, value, np.clip(np.nan_to_num(ends), 0, None), capsize=3, markersize=4,
                linewidth=1, label=method, **style,
            )  # fmt: skip
        axes.axhline(1.0, color="0.5", linewidth=1, linestyle="--")
        axes.set_xticks(range(len(names)), names, rotation=20, ha="right")
        axes.set(ylabel=f"{RATIO} (1)")
        axes.set_ylim(0, None)
        if shown:
            axes.legend(fontsize=8)

    return plot(draw)
