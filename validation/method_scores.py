"""Scores of depth methods on a capture or on every sample of a dataset split.

Tested in tests/validation/test_methods.py and tests/validation/test_method_scores.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import dasim
import recon
from dasim.base.errors import InputError
from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.dataset.reading import Sample
from dasim.dataset.sample import key
from dasim.files.captures import capture_of
from dasim.typing import FloatArray, Progress
from dasim.values import Capture, PsfBank, Truth
from recon import levels
from validation.gates.claim import plain_value
from validation.methods import NamedMethod, estimated, reconstructed
from validation.scores.depth import FAR_SIDE_LEVEL, constant_errors
from validation.scores.figures import Figure
from validation.scores.metrics import Metric, metric_figures
from validation.scores.score import score

NEEDED = {"depth": ("depth_m",), "blur": ("level",), "labels": ("valid", "boundary")}  # parts of a truth file


def score_methods(
    capture: Capture, truth: Truth, bank: PsfBank, methods: Sequence[NamedMethod], metrics: Sequence[Metric] = ()
) -> list[Figure]:
    """Figures of :func:`validation.score` for the reconstruction of a capture by each method, named METHOD.FIGURE."""
    return [
        replace(figure, id=f"{method}.{figure.id}")
        for method in methods
        for figure in score(reconstructed(capture, bank, method), capture, truth, metrics=metrics)
    ]


@dataclass(frozen=True)
class SampleScore:
    """Errors of a method on one sample: absolute, in blur levels, of the pixels with an estimate on the near side of
    the focus.
    """

    sample: str
    coverage: float  # share of the pixels before the focus with an estimate
    error: FloatArray  # [n]
    constant: FloatArray  # [n], of the constant map with the least median error for this sample
    metrics: tuple[Figure, ...] = ()
    failed: str | None = None  # why there is no estimate at all

    def summary(self) -> dict[str, Any]:
        """Plain values for JSON; null if there is no estimate."""
        medians = {name: float(np.median(errors)) if errors.size else None
                   for name, errors in (("level-median", self.error), ("constant", self.constant))}  # fmt: skip
        metrics = {figure.id: plain_value(figure.value) for figure in self.metrics}
        return {
            "sample": self.sample,
            "coverage": self.coverage,
            **medians,
            "lost": self.lost,
            "failed": self.failed,
            **metrics,
        }

    @property
    def lost(self) -> bool:
        """Whether the median error is not below that of the best constant map."""
        return self.failed is not None or not np.median(self.error) < np.median(self.constant)


def score_split(
    samples: Iterable[Sample],
    methods: Sequence[NamedMethod],
    metrics: Sequence[Metric] = (),
    *,
    bank_of: Callable[[Camera, str], PsfBank] | None = None,
    progress: Progress = lambda stage, share: None,
) -> dict[NamedMethod, list[SampleScore]]:
    """Score the depth estimates of methods on samples; a method that fails on a sample loses it.

    ``bank_of`` gives the PSF bank of a camera and a diffraction model, by default the calibrated one. Raises InputError
    if a sample lacks a part of the truth that is needed.
    """
    count = len(samples) if isinstance(samples, Sequence) else 0
    results: dict[NamedMethod, list[SampleScore]] = {method: [] for method in methods}
    for number, sample in enumerate(samples):
        name, truth = key(sample.index), _truth(sample)
        capture = capture_of(sample.meta, sample.raw_dn, f"sample {name}")
        bank = (bank_of or _calibrated)(capture.camera, capture.provenance.get("diffraction", "wave"))
        for method in methods:
            results[method].append(_sample_score(name, capture, truth, bank, method, metrics))
        progress("scoring", (number + 1) / count if count else 0.0)
    return results


def _calibrated(camera: Camera, diffraction: str) -> PsfBank:
    return recon.calibrate(dasim.calibration_captures(camera, diffraction=diffraction))


def _truth(sample: Sample) -> Truth:
    """Ground truth of a sample, with empty arrays for missing parts; raises InputError if depth cannot be scored."""
    missing = [part for part, names in NEEDED.items() if any(name not in sample.truth for name in names)]
    if missing:
        raise InputError(
            f"sample {key(sample.index)}: its truth lacks {', '.join(missing)}, by which depth is judged; "
            f"make the dataset with truth.keep = {[*NEEDED]} or more"
        )
    empty = np.zeros((0, 0), np.float32)
    defaults: dict[str, Any] = {
        name: empty for name in ("normal", "object_id", "material_id", "blur_px", "mean_e", "sharp_e", "sharp_srgb")
    }
    return Truth(**{**defaults, "channels": (), **sample.truth})


def _sample_score(
    name: str, capture: Capture, truth: Truth, bank: PsfBank, method: NamedMethod, metrics: Sequence[Metric]
) -> SampleScore:
    try:
        estimate = estimated(capture, bank, method)
    except InputError as error:
        return SampleScore(name, 0.0, np.zeros(0), np.zeros(0), failed=str(error))
    depth_m = estimate.depth_m if estimate.level is None else levels.depth_of(estimate.level, bank.depth_m)
    assert depth_m is not None  # one of both is there
    depth_m = _central(np.asarray(depth_m, np.float64), truth.depth_m.shape)
    near = truth.valid & (truth.level >= FAR_SIDE_LEVEL)
    known = near & np.isfinite(depth_m)
    blur = np.asarray(geometry.blur_px(capture.camera, depth_m[known]))
    level = blur / float(geometry.level_blur_px(capture.camera)[1])
    exact = truth.level[known].astype(np.float64)
    share = float(known.sum()) / max(float(near.sum()), 1.0)
    figures = tuple(metric_figures(method.name, depth_m, truth, metrics))
    return SampleScore(name, share, np.abs(level - exact), constant_errors(exact), figures)


def _central(image: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """The central part of an image; a truth may lack a margin of the frame."""
    top, left = ((have - want) // 2 for have, want in zip(image.shape, shape, strict=True))
    return image[top : top + shape[0], left : left + shape[1]]


def sample_rows(method: NamedMethod, scores: Sequence[SampleScore]) -> list[str]:
    """Lines for the terminal: each sample's error beside that of its best constant map, and the samples
    that were lost.
    """
    lines = [f"{method}: {'sample':<14}{'coverage':>9}  {'median |l - l*|':>16}  {'best constant':>14}"]
    for one in scores:
        row = one.summary()
        if one.failed is not None:
            lines.append(f"{method}: {one.sample:<14}failed: {one.failed}")
            continue
        error, constant = (float("nan") if row[name] is None else row[name] for name in ("level-median", "constant"))
        mark = "  lost" if one.lost else ""
        lines.append(f"{method}: {one.sample:<14}{one.coverage:>9.2f}  {error:>16.3f}  {constant:>14.3f}{mark}")
    return lines


def split_figures(method: NamedMethod, scores: Sequence[SampleScore]) -> list[Figure]:
    """Figures of a method over all samples: errors pooled over pixels and medians over samples, each beside those of
    the best constant map.
    """
    judged = [one for one in scores if one.failed is None and one.error.size]
    figures = []
    for what, values in (
        (
            "pixels",
            lambda name: np.concatenate([getattr(one, name) for one in judged]) if judged else np.full(1, np.nan),
        ),
        ("samples", lambda name: np.array([np.median(getattr(one, name)) for one in judged] or [np.nan])),
    ):
        of = "pixels of all samples" if what == "pixels" else "samples' medians"
        for statistic in ("mean", "median"):
            for name, suffix, text in (("error", "", ""), ("constant", ".constant", "best constant maps: ")):
                value = float(getattr(np, statistic)(values(name)))
                meaning = f"{text}{statistic} over the {of} of |l - l*|"
                figures.append(Figure(f"{method}.{what}.level-{statistic}{suffix}", value, "level", meaning))
    share = float(np.mean([one.coverage for one in scores])) if scores else float("nan")
    failures = float(sum(one.lost for one in scores))
    figures.append(Figure(f"{method}.coverage", share, "1", "mean share of pixels with an estimate"))
    figures.append(
        Figure(f"{method}.lost", failures, "samples", f"no better than the best constant map, of {len(scores)}")
    )
    for name in dict.fromkeys(figure.id for one in scores for figure in one.metrics):
        metric_figures = [figure for one in scores for figure in one.metrics if figure.id == name]
        value = float(np.mean([figure.value for figure in metric_figures]))
        figures.append(
            replace(metric_figures[0], value=value, meaning=f"{metric_figures[0].meaning}, mean over samples")
        )
    return figures
