"""Work of an executor on one sample: the results of all entrants that are missing.

Tested in tests/validation/test_dataset_scores.py.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base.errors import InputError, describe_error
from dasim.base.executors import Outcome
from dasim.base.fingerprint import fingerprint, text_hash
from dasim.dataset import storage
from dasim.dataset.reading import Dataset, open_dataset
from dasim.dataset.sample import json_bytes
from dasim.files.captures import capture_of
from dasim.files.truth import truth_of
from dasim.values import Capture, Truth
from validation.dataset_scores import figures
from validation.dataset_scores.entrants import Entrant, result_identity
from validation.dataset_scores.estimate import depth_map
from validation.gates.claim import plain_value
from validation.methods import NamedMethod
from validation.scores.margin import central
from validation.scores.metrics import load_metrics, metric_figures
from validation.scores.score import DEPTH_NEEDS
from validation.scores.texture import textured

RESULTS = "results"


@dataclass(frozen=True)
class ScoreJob:
    """A split of a dataset, what is scored on it, and where the results are kept."""

    dataset: str
    split: str
    out: str
    entrants: tuple[Entrant, ...]
    bank: Path | None  # for all samples; None: one is calibrated per camera and focus
    metrics: tuple[str, ...] = ()  # a user's, by name
    code: str = ""  # fingerprint of what turns a sample into a result


def code_of(metrics: tuple[str, ...], bank: Path | None) -> str:
    """Fingerprint of all code between a sample and its figures, of the user's metrics, and of the bank's file."""
    own = [fingerprint(metric, variant="none") for metric in load_metrics(metrics)]
    content = [] if bank is None else [text_hash([bank.read_bytes().hex()])]
    return fingerprint(scored, variant="none", values=[*own, *metrics, *content], excluding=("cameras", "scenes"))


def result_file(job: ScoreJob, one: Entrant, row: dict[str, Any]) -> str:
    """File of the result of an entrant on the sample with the row ``row`` of the index, named by all it depends on."""
    return f"{RESULTS}/{text_hash([job.code, *result_identity(one, row['key']), row['key'], *content(row)])}.json"


def content(row: dict[str, Any]) -> list[str]:
    """Names and checksums of a sample's files, from its row of the index."""
    return [f"{name} {digest}" for name, digest in sorted(row["sha256"].items()) if digest]


@lru_cache(maxsize=2)
def opened(dataset: str, split: str) -> Dataset:
    """The samples of a split; the index is read once per process."""
    return open_dataset(dataset, split)


def work(job: ScoreJob, place: int) -> Outcome:
    """Score the entrants without a result on sample ``place`` of the split, and write their results.

    An entrant that fails on a sample has a result that says so. What the user has to correct ends the run.
    """
    start = time.perf_counter()
    try:
        samples = opened(job.dataset, job.split)
        row = samples.rows[place]
        sample = samples[place]
        where = f"sample {row['key']}"
        capture = capture_of(sample.meta, sample.raw_dn, where)
        truth = truth_of(sample.truth, capture.camera, where)
        truth.require(*DEPTH_NEEDS)
        light_e = figures.light_e(capture)
        for one in job.entrants:
            name = result_file(job, one, row)
            if not storage.exists(job.out, name):
                result = {"method": one.name, **about(row, light_e), **scored(job, one, capture, truth, row["key"])}
                storage.write(job.out, name, json_bytes(result))
    except InputError as error:
        return Outcome(place, describe_error(error), fatal=True)
    except OSError as error:
        return Outcome(place, f"cannot be read or written: {describe_error(error)}", fatal=True)
    return Outcome(place, seconds=time.perf_counter() - start)


def about(row: dict[str, Any], light_e: float) -> dict[str, Any]:
    """What samples are grouped by."""
    return {
        "sample": row["key"],
        "scene": row["scene"],
        "kind": row.get("kind"),
        "illuminant": row["illuminant"],
        "light_e": light_e,
    }


def scored(job: ScoreJob, one: Entrant, capture: Capture, truth: Truth, sample: str) -> dict[str, Any]:
    """Coverage, failure, figures and values of the user's metrics of an entrant on a sample."""
    start = time.perf_counter()
    failed = None
    try:
        found = depth_map(one, capture, truth, sample, job.bank)
    except InputError as error:
        if not isinstance(one, NamedMethod):
            raise
        failed, found = str(error), np.full(truth.depth_m.shape, np.nan)
    near = figures.depth.near_side(truth)
    camera = capture.camera
    whole = figures.complete(found, camera.lens.focus_distance_m)
    texture = central(textured(capture), truth.depth_m.shape)
    judged = whole if failed else found
    metrics = metric_figures(one.name, judged, truth, load_metrics(job.metrics)) if job.metrics else []
    return {
        "coverage": float(np.mean(np.isfinite(found[near]))) if near.any() else None,
        "failed": failed,
        "seconds": round(time.perf_counter() - start, 3),
        "figures": figures.map_figures(whole, truth, camera, texture),
        "metrics": {figure.id.removeprefix(f"{one.name}."): plain_value(figure.value) for figure in metrics},
    }
