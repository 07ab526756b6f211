"""Claim on captures that nothing was tuned on: the all-in-focus picture gains on the capture, at every blur."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np

import recon
from dasim.base.errors import InputError
from dasim.simulation.exposure import Shot
from dasim.typing import ShareDone
from dasim.values import PsfBank, Reconstruction, Truth
from validation.gates.captures import capture_table, cell, known, loss_table, losses, mean_cell
from validation.gates.claim import Evidence, Table
from validation.methods import NamedMethod, bundled, prefix, reconstructed
from validation.references import layered_deconvolution
from validation.reports import crops
from validation.scores import sharpness as scores
from validation.scores.depth_edges import edges
from validation.scores.edges import gradients
from validation.scores.figures import Figure
from validation.scores.pictures import displayed
from validation.scores.sharpness import HALO, HALO_TEXT, QUANTITIES, REGIONS, Sharpness
from validation.subjects import held_out as sets
from validation.subjects import rendering
from validation.subjects.conditions import quiet, true_levels

METHODS = bundled("best", "bands", "paper")  # the first has limits, and figures without its name
OVERALL, IN_FOCUS = "gain.all", "gain.0-1"
LOST = "all in focus worse than captured, in PSNR over all pixels"
EDGE_CROP = "depth edge"

# Pictures by library functions from the captured one and the levels of the first method, by the beginning of their ids.
RIVALS: dict[str, tuple[str, layered_deconvolution.Picture]] = {
    "layered-wiener.": ("scikit-image's Wiener filter by level", layered_deconvolution.layered_wiener),
    "denoised.": ("scikit-image's total variation, no sharpening", layered_deconvolution.denoised),
}

Run = Callable[[Shot, PsfBank], tuple[Reconstruction, Truth]]


class Column(NamedTuple):
    """A method as it is, the first one under another condition, or another picture with its levels; ``prefix`` begins
    the ids of its figures.
    """

    label: str
    prefix: str
    run: Run


@dataclass(frozen=True)
class Judged:
    """Scores of one column on one capture, or why there is no reconstruction."""

    capture: str
    scores: Sharpness = field(default_factory=lambda: Sharpness({}, {}, {}))
    failed: str | None = None

    @property
    def lost(self) -> bool:
        """Whether the all-in-focus picture is worse than the captured one over all pixels, or has no score there."""
        return self.failed is not None or not self.value(OVERALL) >= 0

    def value(self, key: str) -> float:
        """A gain, or the halo; NaN where it was not measured."""
        return self.scores.gains.get(key, float("nan"))


def sharp_held_out(
    progress: ShareDone, methods: Sequence[NamedMethod] = METHODS, subset: sets.SetName = "test"
) -> Evidence:
    """On captures that nothing was tuned on, the all-in-focus picture is nearer to the truth than the capture is.

    Rationale: sharpening blurred regions must not degrade regions in focus, nor create halos along outlines. Means over
    a few scenes hide both.

    Set-up: the 40 captures of the set test (``validation/subjects/held_out.toml``), see the claim depth-held-out. Each
    is reconstructed by every method with a bank calibrated for its camera and focus, and by the first also with true
    levels, and from a capture with a tenth of the noise. Beside them stand two pictures by functions of scikit-image
    (``validation/references/layered_deconvolution.py``): the captured one deconvolved by a Wiener filter at each of the
    first method's levels, and with less noise alone. The gain of the all-in-focus picture over the captured one is
    that in PSNR of linear colours without infrared, over all pixels, by visible blur away from boundaries, and within
    3 px on either side of depth edges; a region counts in a capture that has 2 % of the pixels in it. Limits are
    against the truth in focus (``focus_e``), which is all that a lens in focus shows; the sharp truth (``sharp_e``) has
    no diffraction, and a picture near to it would have to invent detail, so that gains against it are reported beside.
    Gains in SSIM, CIEDE2000 (of sRGB with one exposure) and edge width are against the truth in focus. The edge width
    is the 10-90 % width of the Gaussian with which the truth's steepest edges are most like the picture's. A halo is
    the overshoot of the picture beyond the range of the truth near a silhouette (both averaged along it), relative to
    the step there: the percentile 95 over edge pixels (``validation/scores/sharpness.py``). With a tenth of the noise,
    the same ``mean_e`` is exposed 100 times as long on a sensor with 100 times the full well and 16 bits, and with a
    tenth of PRNU, read noise and offsets relative to the signal; the rendering noise of ``mean_e`` stays. That of
    ``focus_e``, 0.1 to 0.3 % at the median pixel and up to 4 % at the 99th percentile, is an error of every picture
    and limits the gains. A capture that a method refuses counts as lost.

    Expectation: a gain at every blur without a loss in focus; larger gains with less noise.

    Limit: for the first method, as means over the captures: 3 dB over all pixels, and no capture gets worse; 0 dB below
    1 px in every capture; 4.5 dB at 3 to 8 px, 4 dB at 8 to 20 px, 2 dB beyond, 2.5 dB at boundaries; halos up to 5 %.
    With a tenth of the noise, a gain in each region. Figures with true levels, and those of other methods and pictures,
    are reported without a limit.

    Source: the project's own.
    """
    rendering.needs_wave()
    caption = f"set {subset}, hash {sets.set_hash(subset)}"
    return compared(sets.recipes(subset), methods, progress, caption)


def compared(
    recipes: Sequence[sets.Recipe], methods: Sequence[NamedMethod], progress: ShareDone, caption: str
) -> Evidence:
    """Figures, tables and pictures of methods side by side on captures; ``caption`` names the captures."""
    columns = [one for method in methods for one in _columns(method, first=method == methods[0])]
    judged: dict[str, list[Judged]] = {column.label: [] for column in columns}
    rows = []
    for recipe, shot, bank in sets.calibrated(recipes, progress):
        for column in columns:
            try:
                result, truth = column.run(shot, bank)
            except InputError as error:
                judged[column.label].append(Judged(recipe.name, failed=str(error)))
                continue
            judged[column.label].append(Judged(recipe.name, scores.sharpness(result, truth)))
            if column is columns[0]:
                rows += _picture(recipe.name, result, truth, judged[column.label][-1])
    figures = [figure for column in columns for figure in column_figures(column, judged[column.label], caption)]
    return Evidence(figures, pictures=rows, tables=_tables(judged, caption))


def _columns(method: NamedMethod, *, first: bool) -> list[Column]:
    """A method, and for the first one the conditions that tell whether depth or noise limits it."""
    label = prefix(method, METHODS[:1])
    as_it_is = Column(method.name, label, partial(_as_taken, method))
    if not first:
        return [as_it_is]
    return [
        as_it_is,
        Column(f"{method}, true levels", f"{label}true-levels.", partial(_with_true_levels, method)),
        Column(f"{method}, a tenth of the noise", f"{label}tenth-noise.", partial(_quiet, method)),
        *(Column(f"{name}, levels of {method}", f"{label}{start}", partial(_rival, method, picture))
          for start, (name, picture) in RIVALS.items()),
    ]  # fmt: skip


def _as_taken(method: NamedMethod, shot: Shot, bank: PsfBank) -> tuple[Reconstruction, Truth]:
    return reconstructed(shot.capture, bank, method), shot.truth


def _with_true_levels(method: NamedMethod, shot: Shot, bank: PsfBank) -> tuple[Reconstruction, Truth]:
    settings = recon.DEFAULT if method.source else recon.PRESETS[method.name]
    return recon.reconstruct(shot.capture, bank, settings, method=true_levels(shot.truth)), shot.truth


def _quiet(method: NamedMethod, shot: Shot, bank: PsfBank) -> tuple[Reconstruction, Truth]:
    return _as_taken(method, quiet(shot), bank)


def _rival(
    method: NamedMethod, picture: layered_deconvolution.Picture, shot: Shot, bank: PsfBank
) -> tuple[Reconstruction, Truth]:
    result, truth = _as_taken(method, shot, bank)
    return replace(result, sharp_e=picture(result, bank)), truth


def column_figures(column: Column, judged: Sequence[Judged], caption: str) -> list[Figure]:
    """Figures over all captures, and the gain of each; ``caption`` names the captures."""
    label, start = column.label, column.prefix
    figures = losses(label, start, judged, caption, LOST)
    meanings = {f"{quantity}.{region}": (unit, f"{text}, {_where(region)}")
                for quantity, (unit, text) in QUANTITIES.items() for region in REGIONS}  # fmt: skip
    for key, (unit, meaning) in (meanings | {HALO: ("1", HALO_TEXT)}).items():
        values = known(judged, key)
        statistics: list[tuple[str, Callable]] = [("mean", np.mean), ("median", np.median)]
        if key.startswith("gain."):
            statistics.append(("least", np.min))
        for name, statistic in statistics:
            value = float(statistic(values)) if values.size else float("nan")
            text = f"{label}: {name} over {values.size} captures of the {meaning}"
            figures.append(Figure(f"{start}{key}.{name}", value, unit, text))
    unit, meaning = meanings[OVERALL]
    return figures + [
        Figure(f"{start}{OVERALL}.{one.capture}", one.value(OVERALL), unit, f"{one.capture}, {label}: {meaning}")
        for one in judged
    ]


def _where(region: str) -> str:
    if region == "boundary":
        return f"within {scores.BOUNDARY_PX} px of depth edges"
    return "all pixels" if region == "all" else f"at {region.replace('over-', 'over ')} px of visible blur"


# --- the report ----------------------------------------------------------------------------------


def _tables(judged: Mapping[str, Sequence[Judged]], caption: str) -> list[Table]:
    """What was lost, means and medians side by side, widths of edges, and every capture."""
    means = [
        [
            f"{text}, {_where(region)} ({unit})",
            *(mean_cell(known(captures, f"{quantity}.{region}")) for captures in judged.values()),
        ]
        for quantity, (unit, text) in QUANTITIES.items()
        for region in REGIONS
    ]
    means.append([f"{HALO_TEXT} (1)", *(mean_cell(known(captures, HALO)) for captures in judged.values())])
    tables: list[Table] = [
        loss_table(judged, LOST, caption),
        (f"Means over the captures, in brackets medians; {caption}", ["figure", *judged], means),
        (
            f"Edge width (px), captured and all in focus: means over the captures; {caption}",
            ["visible blur (px)", *judged],
            [[region, *(_before_after(captures, f"width.{region}") for captures in judged.values())]
             for region in REGIONS],
        ),
    ]  # fmt: skip
    main = [*(f"gain.{region}" for region in REGIONS), *(f"{name}.all" for name in ("gain-sharp", "ssim", "ciede2000")),
            "width.boundary", HALO]  # fmt: skip
    return tables + [capture_table(label, captures, main) for label, captures in judged.items()]


def _before_after(judged: Sequence[Judged], key: str) -> str:
    pairs = np.array([(one.scores.captured[key], one.scores.sharpened[key]) for one in judged if one.failed is None])
    pairs = pairs.reshape(-1, 2)[~np.isnan(pairs.reshape(-1, 2)).any(axis=1)]
    return f"{pairs[:, 0].mean():.2f}, {pairs[:, 1].mean():.2f}" if pairs.size else "-"


def _picture(name: str, result: Reconstruction, truth: Truth, judged: Judged) -> list[tuple[str, str]]:
    """Crops at the highest depth edges and with the most true detail at each blur; none of too small a frame."""
    srgb = displayed(result, truth)
    exact = srgb[f"truth{scores.AGAINST_FOCUS}"]
    regions = {key: region for key, region in scores.regions(truth).items() if key in scores.BINS_PX}
    jump = np.hypot(*gradients(np.where(truth.valid, truth.level, 0))) * edges(truth.level, truth.valid)
    detail = np.square(gradients(exact[..., scores.GREEN])).sum(axis=0)
    details = {key: detail * region for key, region in regions.items() if scores.counts(region)}
    found = crops.places({EDGE_CROP: jump} | details)
    if not found:
        return []
    gains = ", ".join(f"{_where(key)} {cell(judged.value(f'gain.{key}'))}" for key in REGIONS)
    columns = ", ".join(key if key == EDGE_CROP else f"{key} px" for key in found)
    caption = (
        f"{name}: captured, all in focus, truth in focus, from above, with one exposure, each pixel as "
        f"{crops.ENLARGED} x {crops.ENLARGED}. Columns: {columns} of blur. Gain in dB: {gains}"
    )
    rows = [srgb["captured"], srgb["all-in-focus"], exact]
    return [(caption, crops.sheet_address(rows, list(found.values())))]
