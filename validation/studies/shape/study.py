"""The study ``dasim study shape``: searched masks beside known ones, by bounds and on request by the whole pipeline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dasim.base.errors import InputError
from dasim.camera import stops
from dasim.camera.geometry import aperture_m
from dasim.camera.specification import Camera
from dasim.typing import FloatArray, Progress
from validation.studies import criteria
from validation.studies.criteria import Texture
from validation.studies.shape import designs, finite_patch, free_stop, masks, patch_likelihood, search
from validation.studies.shape.board_likelihood import Limits, limits
from validation.studies.shape.boards import ratio
from validation.studies.shape.designs import Design
from validation.studies.shape.free_stop import FreeStop, Objective
from validation.studies.shape.infrared_stop import infrared_stop, with_disc, with_mask
from validation.studies.shape.pipeline import PRESETS, PipelineScores, pipeline_scores
from validation.studies.shape.search import Search, Symmetry

BLURS, SEARCH_BLURS = 8, 6  # depths that are averaged over, in the table and in the search
SEARCH_FINE, FINE = 48, 96  # cells of the transforms across the lens
REFERENCE_CELLS = 128
RENDERED = 3  # searched designs that are put through the pipeline
SMALLEST_BUDGET, LARGEST_BUDGET = 0.01, 0.95
SEARCHES: tuple[tuple[str, bool, Symmetry], ...] = (
    ("binary", False, "none"), ("symmetric", False, "half-turn"), ("grey", True, "none"),
)  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """What a study computes."""

    camera: Camera
    budget: float  # open area over that of the lens
    cells: int = 64  # of a mask across the lens
    feature_um: float = 80.0  # diameter of the smallest feature
    seeds: int = 5  # starts of each search
    objective: Objective = "depth"
    near_m: float = 0.05
    far_m: float = 0.24
    light: str = "D65"
    level_lux: float = 5000.0
    texture: Texture = "free"
    iterations: int = 20  # at each beta

    @property
    def feature_cells(self) -> float:
        """Diameter of the smallest feature in cells."""
        return self.feature_um * 1e-6 / self.cell_m

    @property
    def cell_m(self) -> float:
        """Side of a cell."""
        return aperture_m(self.camera) / max(self.cells, 1)


@dataclass(frozen=True)
class Row:
    """One design in the table; ratios are relative to the disc of the same study."""

    name: str
    budget: float
    feature_um: float
    depth_dioptre: float  # root mean square of the bound over the depths
    depth_ratio: float
    cut_dioptre: float  # the same for a patch without its surroundings, see validation.studies.shape.finite_patch
    cut_ratio: float
    sharp_error: float  # of the Wiener filter, relative to the texture's contrast
    sharp_ratio: float


@dataclass(frozen=True)
class Study:
    """The results of a study."""

    plan: Plan
    designs: list[Design]  # in the order of the rows
    rows: list[Row]  # the disc first, then by the objective
    curves: list[list[float]]  # the objective of each design, by blur
    blur_px: list[float]
    estimates: dict[str, tuple[float, float]]  # error of maximum likelihood on patches, and its bound, 1/m
    scores: dict[str, PipelineScores]  # by "design, preset"
    limits: dict[str, Limits]

    def steps(self) -> dict[str, list[tuple[str, float, float, float]]]:
        """From the bound to each preset: (design, error on boards in 1/m, ratio to the disc, its spread)."""
        errors: dict[str, dict[str, tuple[float, ...]]] = {}
        for name, one in self.limits.items():
            for step, values in one.steps().items():
                errors.setdefault(step, {})[name] = values
        for key, scores in self.scores.items():
            name, _, preset = key.rpartition(", ")
            errors.setdefault(f"preset {preset}", {})[name] = scores.deviations
        rows = {}
        for step, by_design in errors.items():
            disc = next(iter(by_design.values()))
            rows[step] = [(name, float(np.mean(v)), *ratio(v, disc)) for name, v in by_design.items()]
        return rows


def check_plan(plan: Plan) -> None:
    """Raise InputError that lists everything wrong with a plan."""
    wrong = []
    if not 8 <= plan.cells <= stops.MOST_MASK_CELLS:
        wrong.append(f"cells {plan.cells}: must be 8 to {stops.MOST_MASK_CELLS} across the lens")
    if not SMALLEST_BUDGET <= plan.budget <= LARGEST_BUDGET:
        wrong.append(
            f"budget {plan.budget:g}: must be {SMALLEST_BUDGET:g} to {LARGEST_BUDGET:g} of the lens's area; "
            "less passes no light, more leaves no freedom of shape"
        )
    if plan.iterations < 1:
        wrong.append(f"iterations {plan.iterations}: must be 1 or more")
    if plan.seeds < 1:
        wrong.append(f"seeds {plan.seeds}: must be 1 or more")
    if plan.cells >= 1 and not 1 <= plan.feature_cells <= plan.cells / 2:
        wrong.append(
            f"feature {plan.feature_um:g} um: must be at least a cell, {plan.cell_m * 1e6:.1f} um, "
            f"and at most half the lens, {aperture_m(plan.camera) * 5e5:.0f} um"
        )
    for check in (
        lambda: infrared_stop(plan.camera),
        lambda: criteria.blurs_between(plan.camera, plan.near_m, plan.far_m, BLURS),
        lambda: criteria.texture_patch(plan.camera, plan.light, plan.level_lux),
    ):
        try:
            check()
        except InputError as error:
            wrong.append(str(error))
    if wrong:
        raise InputError("; ".join(wrong))


def run_study(plan: Plan, *, render: bool = False, progress: Progress = lambda stage, share: None) -> Study:
    """Search for masks and compare them with known ones; with ``render``, put the best through the whole pipeline."""
    check_plan(plan)
    blurs = criteria.blurs_between(plan.camera, plan.near_m, plan.far_m, BLURS)
    searched = _searched(plan, progress)
    compared, rows, curves = _compared(plan, searched, blurs, progress)
    names = {design.name for design in searched}
    best = [compared[0], *[design for design in compared if design.name in names][:RENDERED]]
    # Without surroundings, the bound of the disc at the rim is as low as the disc's.
    best += [design for design in compared if design.name == designs.AT_RIM]
    estimates = {}
    for number, design in enumerate(best):
        progress("patches", number / len(best))
        estimates[design.name] = _patch_errors(plan, design, blurs)
    progress("patches", 1.0)
    scores: dict[str, PipelineScores] = {}
    bounds: dict[str, Limits] = {}
    if render:
        for number, design in enumerate(best):
            progress("the whole pipeline", number / len(best))
            camera = _camera(plan, design)
            for preset in PRESETS:
                scores[f"{design.name}, {preset}"] = pipeline_scores(camera, preset)
            bounds[design.name] = limits(camera, plan.light, plan.level_lux)
        progress("the whole pipeline", 1.0)
    return Study(plan, compared, rows, curves, blurs.tolist(), estimates, scores, bounds)


def _searched(plan: Plan, progress: Progress) -> list[Design]:
    """The best mask of each of ``SEARCHES``."""
    blurs = criteria.blurs_between(plan.camera, plan.near_m, plan.far_m, SEARCH_BLURS)
    stop = _free_stop(plan, blurs, plan.cells, plan.budget, plan.objective, SEARCH_FINE)
    best = []
    for name, grey, symmetry in SEARCHES:
        one = Search(plan.cells, plan.budget, plan.feature_cells, grey, symmetry, plan.iterations)
        seeds = range(plan.seeds)
        best.append(search.best_of(stop, one, seeds, lambda share, n=name: progress(f"search, {n}", share)))  # type: ignore[misc]
    return best


def _compared(
    plan: Plan, searched: list[Design], blurs: FloatArray, progress: Progress
) -> tuple[list[Design], list[Row], list[list[float]]]:
    """Searched and known designs with their rows and curves: the disc first, then by the objective."""
    progress("comparison", 0.0)
    known = designs.references(REFERENCE_CELLS, plan.budget)

    def free(cells: int, budget: float) -> FreeStop:
        return _free_stop(plan, blurs, cells, budget, plan.objective, SEARCH_FINE)

    every = [known[0], *searched, *known[1:], designs.best_ring(free, REFERENCE_CELLS // 2, plan.budget)]
    rows: list[Row] = []
    curves = []
    for number, design in enumerate(every):
        values, curve = _criteria(plan, design, blurs)
        rows.append(_row(plan, design, values, _cut_bound(plan, design, blurs), rows[0] if rows else None))
        curves.append(curve.tolist())
        progress("comparison", (number + 1) / len(every))
    order = [0, *sorted(range(1, len(rows)), key=lambda index: objective_value(plan, rows[index]))]
    return [every[i] for i in order], [rows[i] for i in order], [curves[i] for i in order]


def _free_stop(
    plan: Plan, blurs: FloatArray, cells: int, budget: float, objective: Objective, fine_cells: int
) -> FreeStop:
    return free_stop.free_stop(
        plan.camera, blurs, cells, budget=budget, light=plan.light, level_lux=plan.level_lux,
        objective=objective, texture=plan.texture, fine_cells=fine_cells,
    )  # fmt: skip


def _criteria(plan: Plan, design: Design, blurs: FloatArray) -> tuple[dict[Objective, float], FloatArray]:
    """Both criteria of a design at its own light budget, and the plan's objective by blur."""
    values: dict[Objective, float] = {}
    curves: dict[Objective, FloatArray] = {}
    objectives: tuple[Objective, ...] = ("depth", "all-in-focus")
    for one in objectives:
        stop = _free_stop(plan, blurs, len(design.amplitude), masks.budget(design.amplitude), one, FINE)
        curves[one] = free_stop.per_blur(stop, design.amplitude)
        values[one] = float(np.sqrt(np.mean(curves[one] ** 2)))
    return values, curves[plan.objective]


def _cut_bound(plan: Plan, design: Design, blurs: FloatArray) -> float:
    """Root mean square over the depths of the bound of a patch without its surroundings, in dioptres."""
    camera = _camera(plan, design)
    deviation = finite_patch.cut_deviation(camera, blurs, finite_patch.SIDE, light=plan.light, level_lux=plan.level_lux)
    return float(np.sqrt(np.mean(deviation**2))) / criteria.dioptre_px(camera)


def _camera(plan: Plan, design: Design) -> Camera:
    """The camera with a design in its near-infrared stop; the disc is exact, not drawn in cells."""
    if design.name != designs.disc_name(plan.budget):
        return with_mask(plan.camera, design.amplitude)
    return with_disc(plan.camera, round(float(np.sqrt(plan.budget)), 12))


def _patch_errors(plan: Plan, design: Design, blurs: FloatArray) -> tuple[float, float]:
    """Error of maximum likelihood on patches and its bound, root mean square over the depths, in dioptres."""
    camera = _camera(plan, design)
    both = patch_likelihood.likelihood_errors(camera, blurs, light=plan.light, level_lux=plan.level_lux)
    error, bound = (float(np.sqrt(np.mean(one**2))) / criteria.dioptre_px(camera) for one in both)
    return error, bound


def _row(plan: Plan, design: Design, values: dict[Objective, float], cut: float, disc: Row | None) -> Row:
    depth, sharp = values["depth"], values["all-in-focus"]
    feature = masks.smallest_feature(design.amplitude) * aperture_m(plan.camera) * 1e6 / len(design.amplitude)
    return Row(
        design.name,
        masks.budget(design.amplitude),
        feature,
        depth,
        depth / (disc.depth_dioptre if disc else depth),
        cut,
        cut / (disc.cut_dioptre if disc else cut),
        sharp,
        sharp / (disc.sharp_error if disc else sharp),
    )


def objective_value(plan: Plan, row: Row) -> float:
    """The figure of a row that the plan's search minimises."""
    return row.depth_dioptre if plan.objective == "depth" else row.sharp_error
