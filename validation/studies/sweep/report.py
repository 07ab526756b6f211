"""The report page of a sweep: its question, curves with error bars, Pareto fronts, and all figures.

Tested in tests/validation/studies/sweep/test_run.py.
"""

from __future__ import annotations

from typing import Any

import jinja2
import numpy as np

from validation.reports.claims import wide
from validation.reports.page import TEMPLATE_DIR
from validation.reports.plots import COLOURS, plot
from validation.studies.sweep import findings, naming
from validation.studies.sweep import front as fronts
from validation.studies.sweep.point import FIGURES
from validation.studies.sweep.specification import Curve, StudySpec

Row = dict[str, Any]

MARKERS = "os^Dv<>"
SIDE = 0.08  # horizontal offset between the markers of two lines, as a share of the distance between two text ticks


def page(spec: StudySpec, rows: list[Row], failed: dict[str, str]) -> str:
    """One self-contained HTML page."""
    from validation.studies.sweep.run import means

    averaged = means(rows, spec)
    all_findings = findings.findings(spec, rows)
    ranked = findings.ranking(spec, averaged)
    pictures = [(_caption(curve, spec), _curve(curve, averaged, spec)) for curve in spec.curves]
    front: list[Row] = []
    across = []  # captions of plots with several columns of panels
    if spec.pareto:
        front = [row for rows_of_front in fronts.fronts(spec, averaged).values() for row in rows_of_front]
        caption = f"{_meaning(spec.pareto[1])} against {_meaning(spec.pareto[0])}: the front in each light"
        pictures.append((caption, fronts.fronts_plot(spec, averaged)))
        across = [caption] if len(fronts.conditions(spec, averaged)) > 1 else []
    if ranked:
        caption = f"{_meaning(findings.RANKED[1])} against the bound; rank correlation {ranked.correlation:.2f}"
        pictures.append((caption, _ranking(averaged)))
    known = {key: about for key, about in FIGURES.items() if any(np.isfinite(row[key]) for row in averaged)}
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    return environment.get_template("study.html").render(
        spec=spec, pictures=pictures, figures=known, rows=averaged, front=front, failed=failed, number=_number,
        findings=all_findings, sentences=findings.sentences(spec, all_findings), ranked=ranked,
        unit=lambda name: FIGURES[name][0], parameter=naming.parameter, wide=wide, across=across,
        drawings=fronts.drawings(spec, averaged),
    )  # fmt: skip


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _meaning(figure: str) -> str:
    unit, meaning = FIGURES.get(figure, ("", figure))
    return meaning if unit in ("", "1") else f"{meaning} ({unit})"


def _caption(curve: Curve, spec: StudySpec) -> str:
    by = f", by {naming.parameter(curve.by)}" if curve.by else ""
    kinds = ("dashes", "crosses") if _words(curve, spec) else ("dashed", "dotted")
    beside = "".join(f"; {kind}: {_meaning(one)}" for one, kind in zip(curve.beside, kinds, strict=False))
    fixed = "".join(
        f"; {naming.valued(key, value)}" for key, value in spec.design.items() if key not in (curve.x, curve.by)
    )
    free = any(key not in (curve.x, curve.by, *spec.design) for key in spec.parameters)
    bars = "; bars: standard deviation over seeds" + (" and other parameters" if free else "")
    return f"{_meaning(curve.y)} against {naming.parameter(curve.x)}{by}{fixed}{beside}{bars}"


def _words(curve: Curve, spec: StudySpec) -> bool:
    return any(isinstance(value, str) for value in spec.parameters[curve.x])


def about_design(curve: Curve, rows: list[Row], spec: StudySpec) -> list[Row]:
    """The rows that differ from the base design in the curve's parameters alone; all rows without a base design."""
    fixed = {key: value for key, value in spec.design.items() if key not in (curve.x, curve.by)}
    return [row for row in rows if all(row[key] == value for key, value in fixed.items())]


def _curve(curve: Curve, averaged: list[Row], spec: StudySpec) -> str:
    rows = about_design(curve, averaged, spec)
    lines: tuple[Any, ...] = spec.parameters[curve.by] if curve.by else (None,)
    lines = tuple(value for value in lines if curve.by is None or any(row[curve.by] == value for row in rows))
    ticks = [tick for tick in spec.parameters[curve.x] if any(row[curve.x] == tick for row in rows)]
    words = _words(curve, spec)

    def draw(axes: Any) -> None:
        for number, value in enumerate(lines):
            group = [row for row in rows if curve.by is None or row[curve.by] == value]
            middle, spread = [], []
            at = [place for place, tick in enumerate(ticks) if any(row[curve.x] == tick for row in group)]
            for tick in (ticks[place] for place in at):
                here = [row for row in group if row[curve.x] == tick]
                measured = np.array([row[curve.y] for row in here])
                middle.append(np.nanmean(measured) if np.isfinite(measured).any() else np.nan)
                within = np.sqrt(np.mean([row[f"{curve.y}:spread"] ** 2 for row in here])) if here else np.nan
                spread.append(np.hypot(within, measured.std()) if len(here) else np.nan)
            side = SIDE * (number - (len(lines) - 1) / 2)
            x = np.array(at) + side if words else np.array([ticks[place] for place in at], float)
            label = None if value is None else naming.value(value)
            style = {"color": COLOURS[number % len(COLOURS)], "marker": MARKERS[number % len(MARKERS)]}
            style["linestyle"] = "" if words else "-"  # no interpolation between text values
            axes.errorbar(x, middle, spread, capsize=3, markersize=4, linewidth=1, label=label, **style)
            for kind, figure in enumerate(curve.beside):
                means = [_mean([row[figure] for row in group if row[curve.x] == ticks[place]]) for place in at]
                if words:
                    axes.plot(x, means, color=style["color"], linestyle="", marker="_x"[kind], markersize=9)
                else:
                    axes.plot(x, means, color=style["color"], linestyle=("--", ":")[kind], linewidth=1)
        axes.set(xlabel=naming.parameter(curve.x), ylabel=naming.figure(curve.y))
        axes.set_yscale("log" if curve.log_y else "linear")
        if words:
            axes.set_xticks(range(len(ticks)), [str(tick) for tick in ticks], rotation=20, ha="right")
        elif curve.log_x:  # matplotlib resets the ticks with the scale
            axes.set_xscale("log")
            axes.set_xticks(np.array(ticks, float), [naming.value(tick) for tick in ticks])
            axes.set_xticks([], minor=True)
        if curve.by:
            axes.legend(title=naming.parameter(curve.by), fontsize=8)

    return plot(draw)


def _mean(values: list[float]) -> float:
    known = np.array(values)[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")


def _ranking(rows: list[Row]) -> str:
    x, y = ([row[key] for row in rows] for key in findings.RANKED)

    def draw(axes: Any) -> None:
        axes.loglog(x, y, "o", color=COLOURS[0], markersize=4)
        known = [value for value in x if np.isfinite(value)]
        ends = [min(known), max(known)]
        axes.loglog(ends, ends, "--", color="0.5", linewidth=1, label="error equal to the bound")
        axes.set(xlabel=naming.figure(findings.RANKED[0]), ylabel=naming.figure(findings.RANKED[1]))
        axes.legend(fontsize=8)

    return plot(draw)
