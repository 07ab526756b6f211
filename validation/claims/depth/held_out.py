"""Claim on captures that nothing was tuned on: maps of levels, their edges and their standard deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.simulation.exposure import Shot
from dasim.typing import BoolArray, FloatArray, ShareDone
from dasim.values import Reconstruction
from recon.depth.peak import REFERENCE_ERROR
from validation.gates.captures import capture_table, cell, known, loss_table, losses, mean_cell
from validation.gates.claim import Evidence, Table
from validation.methods import NamedMethod, bundled, prefix, reconstructed
from validation.reports import pictures
from validation.scores.depth import near_side, regions
from validation.scores.depth_edges import edge_score
from validation.scores.figures import Figure
from validation.scores.level_maps import BOUND_BLUR_PX, MEANINGS, Meaning, bound_ratios, level_dioptres, map_scores
from validation.scores.texture import textured
from validation.subjects import held_out as sets
from validation.subjects import rendering
from validation.subjects.window_bound import level_bounds

METHODS = bundled("best", "bands", "paper", "chakrabarti-zickler")  # the first has limits, and figures without its name
LOST = "RMSE in dioptres not below that of the best constant map"
TIE = 1e-3  # relative difference of errors up to which a map is as good as the constant one
MEASURED_LEVELS = 1.0  # windows with a larger bound do not determine the level and are left out of the comparison

ALL_MEANINGS = {
    **MEANINGS,
    "edges.precision": Meaning("1", "share of estimated depth edges within 3 px of a true one"),
    "edges.recall": Meaning("1", "share of true depth edges within 3 px of an estimated one"),
    "edges.f-score": Meaning("1", "F-score of depth edges at 3 px"),
    "bound.ratio": Meaning("1", "robust error over the Cramer-Rao bound of a window, median over blurs of 3 to 30 px"),
    "bound.rms-ratio": Meaning("1", "rms error over the Cramer-Rao bound of a window, median over blurs of 3 to 30 px"),
}
RATIO, TEXTURED = "all.rmse-ratio", "textured.error-median"
PER_CAPTURE = (RATIO, TEXTURED)  # that have a figure for each capture
MAIN = (
    *(RATIO, "all.rmse", "all.error", "all.error-constant", TEXTURED, "bound.ratio", "edges.f-score"),
    *("all.within-sd", "half.error-median", "near-focus.bias", "near-focus.sd"),
)  # of the tables


@dataclass(frozen=True)
class Judged:
    """Scores of one method on one capture (see ``ALL_MEANINGS``), or why there is no reconstruction."""

    capture: str
    scores: Mapping[str, float] = field(default_factory=dict)
    failed: str | None = None

    @property
    def lost(self) -> bool:
        """Whether the map is unknown, or no better than the best constant one; a capture of one depth is not judged."""
        known = self.failed is None and np.isfinite(self.scores["all.rmse"])
        return not known or self.scores[RATIO] > 1 - TIE

    def value(self, key: str) -> float:
        """A score, NaN where it is not finite; without a reconstruction NaN, and the error of the best constant map as
        that over it.
        """
        if self.failed is not None:
            return 1.0 if key == RATIO else float("nan")
        score = self.scores[key]
        return score if np.isfinite(score) else float("nan")


def depth_held_out(
    progress: ShareDone, methods: Sequence[NamedMethod] = METHODS, subset: sets.SetName = "test"
) -> Evidence:
    """On captures that nothing was tuned on, depth is better than the best constant map, and states how sure it is.

    Rationale: an estimator is used on pictures that its makers have not seen. Medians over textured pixels of a few
    scenes hide where it fails.

    Set-up: the 40 captures of the set test (``validation/subjects/held_out.toml``), 384 x 288 px: random scenes focused
    far (20 to 80 cm) and near (5 to 40, 5 to 12 cm), bundled scenes, eight lights, 100 to 10,000 lux, da-mobile, da-8mm
    and da-4x4, rendered with spp auto. Choices are made on the set tune, which has none of these scenes. Every method
    reconstructs each capture with a bank calibrated for its camera and focus. Scored are the regularised level of all
    pixels on the near side of the focus, and its standard deviation s sqrt(1/c - 1) from the confidence c, with s one
    level. Figures are means over the captures with equal weights, and medians beside them. Textured and untextured
    pixels (as judged from the capture) exclude boundaries. A depth edge is a pixel whose 3 x 3 neighbourhood spans more
    than max(1 level, 10 %). The Cramer-Rao bound is that of a 31 px window in green and infrared, with a coherent 1/f^2
    texture of the strength and noise of each window (``validation/subjects/window_bound.py``). The ratio of error to
    bound is the median in intervals of 3 px of visible blur, divided by that of a normal distribution, where the bound
    is below one level. If a method refuses a capture, the capture is lost to the constant map, with a ratio of 1, and
    has no other scores.

    Expectation: near the focus, a window alone does not determine the level, and the standard deviation says so.
    Elsewhere, errors come near the bound. Depth edges lie at the outlines of objects.

    Limit: for the first method. RMSE in dioptres at most half that of the best constant map, which wins in at most 1 of
    20 captures; textured median 0.3 levels; 1.5 times the bound; F-score of edges 0.6; 0.6 to 0.75 of the errors within
    the stated standard deviation; 0.2 levels for the most confident half; a bias of 0.5 levels at true levels 0 to 2.

    Source: the project's own.
    """
    rendering.needs_wave()
    caption = f"set {subset}, hash {sets.set_hash(subset)}"
    return compared(sets.recipes(subset), methods, progress, caption)


def compared(
    recipes: Sequence[sets.Recipe], methods: Sequence[NamedMethod], progress: ShareDone, caption: str
) -> Evidence:
    """Figures, tables and pictures of methods side by side on captures; ``caption`` names the captures."""
    judged: dict[NamedMethod, list[Judged]] = {method: [] for method in methods}
    rows = []
    for recipe, shot, bank in sets.calibrated(recipes, progress):
        windows = measured_windows(shot)
        maps: list[tuple[str, NDArray]] = []
        for method in methods:
            try:
                result = reconstructed(shot.capture, bank, method)
            except InputError as error:
                judged[method].append(Judged(recipe.name, failed=str(error)))
                maps.append((f"{method}: failed", np.full(shot.truth.level.shape, np.nan)))
                continue
            judged[method].append(Judged(recipe.name, scores_of(result, shot, windows)))
            maps.append((method.name, result.level))
        rows.append((_picture_caption(recipe.name, judged), _picture(shot, maps)))
    figures = [figure for method in methods for figure in method_figures(method, judged[method], caption)]
    return Evidence(figures, pictures=rows, tables=_tables(judged, caption))


class Windows(NamedTuple):
    """Pixels whose window tells the level, and the Cramer-Rao bound of each in levels."""

    where: BoolArray  # [h, w]
    bound: FloatArray  # [n]


def measured_windows(shot: Shot) -> Windows:
    """Textured pixels away from boundaries with 3 to 30 px of visible blur and a bound below ``MEASURED_LEVELS``."""
    truth = shot.truth
    low, high = BOUND_BLUR_PX[[0, -1]]
    where = regions(truth, textured(shot.capture))["textured"] & (truth.blur_px >= low) & (truth.blur_px < high)
    bound = level_bounds(shot, where)
    where[where] = bound <= MEASURED_LEVELS
    return Windows(where, bound[bound <= MEASURED_LEVELS])


def scores_of(result: Reconstruction, shot: Shot, windows: Windows) -> dict[str, float]:
    """All scores of a reconstruction, see ``ALL_MEANINGS``."""
    truth, dioptres = shot.truth, level_dioptres(shot.capture.camera)
    scores = map_scores(result.level, stated_sd(result.confidence), truth, textured(shot.capture), dioptres)
    edge = edge_score(result.level, truth.level, near_side(truth))
    scores |= {"edges.precision": edge.precision, "edges.recall": edge.recall, "edges.f-score": edge.f_score}
    error = result.level[windows.where].astype(np.float64) - truth.level[windows.where]
    intervals = bound_ratios(error, windows.bound, truth.blur_px[windows.where].astype(np.float64))
    for name, column in (("ratio", 1), ("rms-ratio", 2)):
        scores[f"bound.{name}"] = float(np.median([row[column] for row in intervals])) if intervals else float("nan")
    return scores


def stated_sd(confidence: NDArray) -> FloatArray:
    """Standard deviation in levels that a confidence 0..1 of the pipeline stands for; infinite for 0."""
    with np.errstate(divide="ignore"):
        return np.asarray(REFERENCE_ERROR * np.sqrt(np.maximum(1 / confidence.astype(np.float64) - 1, 0)))


def method_figures(method: NamedMethod, judged: Sequence[Judged], caption: str) -> list[Figure]:
    """Figures of a method: over all captures, and some of each; ``caption`` names the captures."""
    label = prefix(method, METHODS[:1])
    figures = losses(method.name, label, judged, caption, LOST)
    text = (
        f"{method}: RMSE in dioptres over all captures that it reconstructs, of equal weight, over the constant maps'"
    )
    figures.append(Figure(f"{label}{RATIO}.pooled", pooled_ratio(judged), "1", text))
    for key, (unit, meaning) in ALL_MEANINGS.items():
        values = known(judged, key)
        for name, statistic in (("mean", np.mean), ("median", np.median)):
            value = float(statistic(values)) if values.size else float("nan")
            text = f"{method}: {name} over {values.size} captures of {meaning}"
            figures.append(Figure(f"{label}{key}.{name}", value, unit, text))
        if key in PER_CAPTURE:
            figures += [
                Figure(f"{label}{key}.{one.capture}", one.value(key), unit, f"{one.capture}, {method}: {meaning}")
                for one in judged
            ]
    return figures


def pooled_ratio(judged: Sequence[Judged]) -> float:
    """RMSE over that of the best constant maps, of all reconstructed captures, of equal weight; near ones prevail."""
    pairs = [(one.scores["all.rmse"], one.scores[RATIO]) for one in judged if one.failed is None]
    squares = np.array([(rmse**2, (rmse / ratio) ** 2) for rmse, ratio in pairs if ratio > 0])
    return float(np.sqrt(squares[:, 0].sum() / squares[:, 1].sum())) if squares.size else float("nan")


# --- the report ----------------------------------------------------------------------------------


def _tables(judged: Mapping[NamedMethod, Sequence[Judged]], caption: str) -> list[Table]:
    """What was lost, means and medians of the methods side by side, and every capture."""
    by_name = {str(method): captures for method, captures in judged.items()}
    means = [
        [f"{ALL_MEANINGS[key].text} ({ALL_MEANINGS[key].unit})",
         *(mean_cell(known(captures, key)) for captures in by_name.values())]
        for key in MAIN
    ]  # fmt: skip
    return [
        loss_table(by_name, LOST, caption),
        (f"Means over the captures, in brackets medians; {caption}", ["figure", *by_name], means),
        *(capture_table(name, captures, MAIN) for name, captures in by_name.items()),
    ]


def _picture_caption(name: str, judged: Mapping[NamedMethod, Sequence[Judged]]) -> str:
    ratios = ", ".join(
        f"{method} {cell(captures[-1].value(RATIO))}{' (lost)' if captures[-1].lost else ''}"
        for method, captures in judged.items()
    )
    return f"{name}: levels on one scale, hatched behind the focus; RMSE over the best constant map's: {ratios}"


def _picture(shot: Shot, maps: Sequence[tuple[str, NDArray]]) -> str:
    truth = shot.truth
    return pictures.level_panels(truth.sharp_srgb, [("true level", truth.level), *maps], near_side(truth))
