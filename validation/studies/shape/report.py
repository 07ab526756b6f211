"""The report of a shape study: a self-contained page, and the lines that the command prints."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import jinja2
import numpy as np

from dasim.typing import FloatArray
from validation.reports.page import TEMPLATE_DIR, png_address
from validation.reports.plots import COLOURS, plot
from validation.studies.shape import masks
from validation.studies.shape.boards import LEVELS
from validation.studies.shape.study import Study, objective_value

CURVES = 6  # designs whose objective is drawn over the blur
PICTURE_PX = 256  # width of a mask's picture, at most


def page(study: Study, slug: Callable[[str], str]) -> str:
    """The HTML page: masks, the table, curves over depth, the course of the searches, and the pipeline.

    ``slug`` gives the stem of a design's files.
    """
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    return environment.get_template("shape.html").render(
        plan=study.plan,
        rows=study.rows,
        pictures=[(design.name, png_address(_picture(design.amplitude))) for design in study.designs],
        curves=plot(lambda axes: _draw_curves(axes, study)),
        history=plot(lambda axes: _draw_history(axes, study)),
        scores=study.scores,
        steps=study.steps(),
        names=list(study.limits),
        estimates=study.estimates,
        levels=LEVELS,
        best=min(study.rows, key=lambda row: objective_value(study.plan, row)),
        slug=slug,
    )


def lines(study: Study) -> Iterator[str]:
    """The table of designs, the likelihood on patches, and if rendered the scores of the pipeline, as text."""
    yield f"{'design':<44} {'open':>7} {'depth, 1/m':>11} {'to disc':>8} {'cut out':>8} {'sharp':>7} {'to disc':>8}"
    for row in study.rows:
        yield (
            f"{row.name:<44} {100 * row.budget:5.1f} % {row.depth_dioptre:11.4f} {row.depth_ratio:8.2f} "
            f"{row.cut_ratio:8.2f} {row.sharp_error:7.4f} {row.sharp_ratio:8.3f}"
        )
    for name, (error, bound) in study.estimates.items():
        yield f"patches, {name}: error of maximum likelihood {error:.4f} 1/m, its bound {bound:.4f} 1/m"
    for name, scores in study.scores.items():
        boards = " ".join(f"{sum(errors) / len(errors):.3f}" for errors in zip(*scores.board_deviation, strict=True))
        coverage = " ".join(f"{100 * share:.0f}" for share in scores.board_coverage)
        yield (
            f"pipeline, {name}: boards {boards} 1/m, coverage {coverage} %, desk {scores.desk_error[0]:.3f} 1/m, "
            f"all in focus {scores.desk_sharp_db:.1f} dB"
        )
    for step, by_design in study.steps().items():
        parts = []
        for name, error, to_disc, spread in by_design:
            deviation = "" if math.isnan(spread) else f" +- {spread:.2f}"  # a bound has none
            parts.append(f"{name} {error:.3f} 1/m ({to_disc:.2f}{deviation} of the disc)")
        yield f"{step}: {'; '.join(parts)}"


def _picture(amplitude: FloatArray) -> FloatArray:
    """The mask as a picture of about ``PICTURE_PX`` pixels, the coating dark grey on white."""
    picture = np.where(masks.inside(len(amplitude)), 0.15 + 0.85 * amplitude**2, 1.0)
    times = max(1, PICTURE_PX // len(amplitude))
    return np.asarray(np.kron(picture, np.ones((times, times))), np.float64)


def _draw_curves(axes, study: Study) -> None:  # type: ignore[no-untyped-def]
    for colour, row, curve in zip(COLOURS, study.rows[:CURVES], study.curves, strict=False):
        axes.plot(study.blur_px, curve, "o-", ms=3, color=colour, label=row.name)
    axes.set_xlabel("visible blur, px")
    unit = "bound of depth, 1/m" if study.plan.objective == "depth" else "error of the sharp picture"
    axes.set_ylabel(unit)
    axes.set_yscale("log")
    axes.legend(fontsize=7)


def _draw_history(axes, study: Study) -> None:  # type: ignore[no-untyped-def]
    searched = [design for design in study.designs if design.history]
    for colour, design in zip(COLOURS, searched, strict=False):
        axes.plot(design.history, color=colour, label=design.name, lw=1)
        for step in design.steps[1:]:
            axes.axvline(step, color=colour, lw=0.5, ls=":")
    axes.set_xlabel("evaluation; dotted: the projection becomes steeper")
    axes.set_ylabel("objective")
    axes.legend(fontsize=7)
