"""The study ``dasim study shape``: search, compare, draw, and where asked for, the whole pipeline."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import asdict, dataclass
from pathlib import Path

import jinja2
import numpy as np

from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.camera import stops
from dasim.camera.geometry import aperture_m
from dasim.camera.specification import Camera
from dasim.files.folders import new_folder
from dasim.typing import Progress
from validation.reports.page import TEMPLATE_DIR, png_address
from validation.reports.plots import plot
from validation.studies import criteria
from validation.studies.criteria import Bench, Objective, Texture
from validation.studies.shape import masks, patch_likelihood
from validation.studies.shape import search as shape
from validation.studies.shape.board_likelihood import SIDE, Reach, cut_deviation, reach
from validation.studies.shape.pipeline import LEVELS, PRESETS, Proof, proof, ratio
from validation.studies.shape.search import Design, Search

BLURS, SEARCH_BLURS = 8, 6  # depths that are averaged over, in the table and in the search
SEARCH_FINE, FINE = 48, 96  # cells of the transforms across the lens
REFERENCE_CELLS = 128
RENDERED = 3
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")


@dataclass(frozen=True)
class Plan:
    """What is asked for."""

    camera: Camera
    budget: float
    cells: int = 64
    feature_um: float = 80.0
    seeds: int = 5
    objective: Objective = "depth"
    near_m: float = 0.05
    far_m: float = 0.24
    light: str = "D65"
    level_lux: float = 5000.0
    texture: Texture = "free"
    iterations: int = 20

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
    """One design in the table; ratios are to the disc of the same study."""

    name: str
    budget: float
    feature_um: float
    depth_dioptre: float  # root mean square of the bound over the depths
    depth_ratio: float
    cut_dioptre: float  # the same of a patch without its surroundings, see validation.studies.shape.board_likelihood
    cut_ratio: float
    sharp_error: float  # of the Wiener filter, relative to the texture's contrast
    sharp_ratio: float


@dataclass(frozen=True)
class Study:
    """What came out."""

    plan: Plan
    designs: list[Design]  # as the rows
    rows: list[Row]
    curves: list[list[float]]  # of each design, by blur
    blur_px: list[float]
    estimates: dict[str, tuple[float, float]]  # error of maximum likelihood on patches and its bound, 1/m
    proofs: dict[str, Proof]  # of "design, preset"
    reaches: dict[str, Reach]

    def steps(self) -> dict[str, list[tuple[str, float, float, float]]]:
        """From the bound to each preset: (design, error on boards in 1/m, ratio to the disc, its spread)."""
        found: dict[str, dict[str, tuple[float, ...]]] = {}
        for name, one in self.reaches.items():
            for step, values in one.steps().items():
                found.setdefault(step, {})[name] = values
        for key, own in self.proofs.items():
            name, _, preset = key.rpartition(", ")
            found.setdefault(f"preset {preset}", {})[name] = own.deviations
        rows = {}
        for step, designs in found.items():
            first = next(iter(designs.values()))
            rows[step] = [(name, float(np.mean(v)), *ratio(v, first)) for name, v in designs.items()]
        return rows


def checked(plan: Plan) -> None:
    """InputError that names all that is wrong with a plan."""
    wrong = []
    try:
        shape.check(Search(plan.cells, plan.budget, 1.0, iterations=plan.iterations))
    except InputError as error:
        wrong.append(str(error))
    if plan.seeds < 1:
        wrong.append(f"seeds {plan.seeds}: must be 1 or more")
    if plan.cells >= 1 and not 1 <= plan.feature_cells <= plan.cells / 2:
        wrong.append(
            f"feature {plan.feature_um:g} um: must be at least a cell, {plan.cell_m * 1e6:.1f} um, "
            f"and at most half the lens, {aperture_m(plan.camera) * 5e5:.0f} um"
        )
    for check in (
        lambda: criteria.infrared_stop(plan.camera),
        lambda: criteria.blurs_between(plan.camera, plan.near_m, plan.far_m, BLURS),
        lambda: criteria.sight(plan.camera, plan.light, plan.level_lux),
    ):
        try:
            check()
        except InputError as error:
            wrong.append(str(error))
    if wrong:
        raise InputError("; ".join(wrong))


def studied(
    plan: Plan, *, render: bool = False, seed: int = 0, progress: Progress = lambda stage, share: None
) -> Study:
    """Search for masks, compare them with others, and render the best where asked for."""
    checked(plan)
    blurs = criteria.blurs_between(plan.camera, plan.near_m, plan.far_m, BLURS)
    designs = _searched(plan, progress)
    best = {design.name for design in designs}
    references = shape.references(REFERENCE_CELLS, plan.budget)
    progress("comparison", 0.0)
    designs = [references[0], *designs, *references[1:], _best_ring(plan, blurs)]
    rows: list[Row] = []
    curves: list[list[float]] = []
    for number, design in enumerate(designs):
        values, curve = _values(plan, design, blurs)
        first = rows[0] if rows else None
        rows.append(_row(plan, design, values, _cut(plan, design, blurs), first))
        curves.append(curve.tolist())
        progress("comparison", (number + 1) / len(designs))
    order = [0, *sorted(range(1, len(rows)), key=lambda index: _key(plan, rows[index]))]
    designs, rows, curves = ([part[i] for i in order] for part in (designs, rows, curves))  # type: ignore[assignment]
    shown = [designs[0], *[design for design in designs if design.name in best][:RENDERED]]
    shown += [design for design in designs if design.name == shape.AT_RIM]  # by the other bound no worse than the disc
    estimates = {}
    for number, design in enumerate(shown):
        progress("patches", number / len(shown))
        estimates[design.name] = _estimated(plan, design, blurs)
    progress("patches", 1.0)
    proofs: dict[str, Proof] = {}
    reaches: dict[str, Reach] = {}
    if render:
        for number, design in enumerate(shown):
            progress("the whole pipeline", number / len(shown))
            camera = _camera(plan, design)
            for preset in PRESETS:
                proofs[f"{design.name}, {preset}"] = proof(camera, cache_dir() / "proofs", preset, seed)
            reaches[design.name] = reach(camera, cache_dir() / "proofs", plan.light, plan.level_lux, seed)
        progress("the whole pipeline", 1.0)
    return Study(plan, designs, rows, curves, blurs.tolist(), estimates, proofs, reaches)


def _searched(plan: Plan, progress: Progress) -> list[Design]:
    """The best of several starts, of binary masks without and with symmetry, and of grey ones."""
    blurs = criteria.blurs_between(plan.camera, plan.near_m, plan.far_m, SEARCH_BLURS)
    at = _bench(plan, blurs, plan.cells, plan.budget, plan.objective, SEARCH_FINE)
    found = []
    for name, grey, symmetry in (
        ("binary", False, "none"), ("symmetric", False, "half-turn"), ("grey", True, "none")
    ):  # fmt: skip
        search = Search(plan.cells, plan.budget, plan.feature_cells, grey, symmetry, plan.iterations)  # type: ignore[arg-type]
        several = shape.best_of(at, search, range(plan.seeds), lambda share, n=name: progress(f"search, {n}", share))  # type: ignore[misc]
        found.append(several[0])
    return found


def _best_ring(plan: Plan, blurs: criteria.FloatArray) -> Design:
    def at(cells: int, budget: float) -> Bench:
        return _bench(plan, blurs, cells, budget, plan.objective, SEARCH_FINE)

    return shape.ring_search(at, REFERENCE_CELLS // 2, plan.budget)


def _bench(plan: Plan, blurs: criteria.FloatArray, cells: int, budget: float, objective: Objective, fine: int) -> Bench:
    return criteria.bench(
        plan.camera, blurs, cells, budget=budget, light=plan.light, level_lux=plan.level_lux,
        objective=objective, texture=plan.texture, fine_cells=fine,
    )  # fmt: skip


def _values(
    plan: Plan, design: Design, blurs: criteria.FloatArray
) -> tuple[dict[Objective, float], criteria.FloatArray]:
    """Both criteria of a design at its own light budget, and the one that is searched for by blur."""
    values: dict[Objective, float] = {}
    curves = {}
    for objective in ("depth", "all-in-focus"):
        one: Objective = objective
        at = _bench(plan, blurs, len(design.amplitude), masks.budget(design.amplitude), one, FINE)
        curves[one] = criteria.per_blur(at, design.amplitude)
        values[one] = float(np.sqrt(np.mean(curves[one] ** 2)))
    return values, curves[plan.objective]


def _cut(plan: Plan, design: Design, blurs: criteria.FloatArray) -> float:
    """Root mean square over the depths of the bound of a patch without its surroundings, dioptres."""
    camera = _camera(plan, design)
    least = cut_deviation(camera, blurs, SIDE, light=plan.light, level_lux=plan.level_lux)
    return float(np.sqrt(np.mean(least**2))) / criteria.dioptre_px(camera)


def _camera(plan: Plan, design: Design) -> Camera:
    """The camera with a design in its near-infrared stop; the disc is a disc and no mask of cells."""
    if design.name != shape.disc_name(plan.budget):
        return masks.camera_with(plan.camera, design.amplitude)
    stop = criteria.infrared_stop(plan.camera)
    radius = round(float(np.sqrt(plan.budget)), 12)
    disc = stops.Disc(name=stop.name, radius_ratio=radius, passes_nm=stop.passes_nm, edge_width_nm=stop.edge_width_nm)
    return criteria.with_stop(plan.camera, disc)


def _estimated(plan: Plan, design: Design, blurs: criteria.FloatArray) -> tuple[float, float]:
    """Root mean square over the depths of the likelihood's error on patches, and of its bound, in dioptres."""
    camera = _camera(plan, design)
    found = patch_likelihood.likelihood_errors(camera, blurs, light=plan.light, level_lux=plan.level_lux)
    error, bound = (float(np.sqrt(np.mean(one**2))) / criteria.dioptre_px(camera) for one in found)
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


def _key(plan: Plan, row: Row) -> float:
    return row.depth_dioptre if plan.objective == "depth" else row.sharp_error


# --- files ---------------------------------------------------------------------------------------


def written(study: Study, out: Path) -> None:
    """A folder with table.csv, results.json, report.html, and masks/ with a PNG, an SVG and a TOML of each design."""
    with new_folder(out, "study") as folder:
        (folder / "masks").mkdir()
        for design in study.designs:
            stem = folder / "masks" / slug(design.name)
            masks.save_png(stem.with_suffix(".png"), design.amplitude)
            stem.with_suffix(".svg").write_text(masks.svg(study.plan.camera, design.amplitude, design.name))
            stem.with_suffix(".toml").write_text(_stop_toml(study.plan.camera, design))
        with (folder / "table.csv").open("w", newline="") as file:
            table = csv.DictWriter(file, list(Row.__annotations__))
            table.writeheader()
            table.writerows(asdict(row) for row in study.rows)
        figures = {slug(row.name): asdict(row) for row in study.rows}
        proofs = {slug(name): asdict(one) for name, one in study.proofs.items()}
        estimates = {slug(name): {"error": e, "bound": b} for name, (e, b) in study.estimates.items()}
        results = {"schema": 1, "study": "shape", "designs": figures, "patches": estimates, "pipeline": proofs}
        results["reach"] = {slug(name): asdict(one) for name, one in study.reaches.items()}
        (folder / "results.json").write_text(json.dumps(results, indent=1) + "\n")
        (folder / "report.html").write_text(report(study))


def slug(name: str) -> str:
    """A name for files."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _stop_toml(camera: Camera, design: Design) -> str:
    """The stop as a camera's TOML file takes it, with the picture beside it."""
    stop = criteria.infrared_stop(camera)
    bands = ", ".join(f"[{low:g}, {high:g}]" for low, high in stop.passes_nm)
    return (
        f"# {design.name}: put this in the place of stop '{stop.name}' of camera '{camera.name}'\n"
        f'[[stops]]\nname = "{stop.name}"\nshape = "mask"\nfile = "{slug(design.name)}.png"\n'
        f"passes_nm = [{bands}]\nedge_width_nm = {stop.edge_width_nm:g}\n"
    )


def report(study: Study) -> str:
    """A self-contained page: masks, the table, curves over depth, how the searches ran, and the pipeline."""
    plan = study.plan
    pictures = [
        (row, png_address(_shown(design.amplitude)), masks.svg(plan.camera, design.amplitude, row.name))
        for design, row in zip(study.designs, study.rows, strict=True)
    ]
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    return environment.get_template("shape.html").render(
        plan=plan,
        rows=study.rows,
        pictures=pictures,
        curves=plot(lambda axes: _draw_curves(axes, study)),
        history=plot(lambda axes: _draw_history(axes, study)),
        proofs=study.proofs,
        steps=study.steps(),
        names=list(study.reaches),
        estimates=study.estimates,
        levels=LEVELS,
        best=min(study.rows, key=lambda row: _key(plan, row)),
        slug=slug,
    )


def _shown(amplitude: criteria.FloatArray) -> criteria.FloatArray:
    """The mask as a picture of about 256 pixels, the coating dark grey on white."""
    whole = masks.inside(len(amplitude))
    picture = np.where(whole, 0.15 + 0.85 * amplitude**2, 1.0)
    times = max(1, 256 // len(amplitude))
    return np.asarray(np.kron(picture, np.ones((times, times))), np.float64)


def _draw_curves(axes, study: Study) -> None:  # type: ignore[no-untyped-def]
    shown = [0, *range(1, min(len(study.rows), 6))]
    for number, index in enumerate(shown):
        axes.plot(study.blur_px, study.curves[index], "o-", ms=3, color=COLOURS[number], label=study.rows[index].name)
    axes.set_xlabel("visible blur, px")
    unit = "least error of depth, 1/m" if study.plan.objective == "depth" else "error of the sharp picture"
    axes.set_ylabel(unit)
    axes.set_yscale("log")
    axes.legend(fontsize=7)


def _draw_history(axes, study: Study) -> None:  # type: ignore[no-untyped-def]
    number = 0
    for design in study.designs:
        if design.history:
            axes.plot(design.history, color=COLOURS[number], label=design.name, lw=1)
            for step in design.steps[1:]:
                axes.axvline(step, color=COLOURS[number], lw=0.5, ls=":")
            number += 1
    axes.set_xlabel("evaluation; dotted: the projection gets steeper")
    axes.set_ylabel("objective")
    axes.legend(fontsize=7)
