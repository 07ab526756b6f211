"""The commands ``dasim dataset``: parse and print."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import cyclopts
from cyclopts import Parameter

from dasim.base.errors import InputError
from dasim.cli import options
from dasim.cli.options import Whole

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from dasim.base.executors import Executor
    from dasim.dataset.make import Progress
    from dasim.dataset.reading import Sample

app = cyclopts.App(name="dataset", help="Make, verify, describe and score datasets of captures with ground truth.")

LINE_S = 30.0  # between lines of progress without a terminal


@app.command
def make(
    spec: str,
    *,
    out: Annotated[str | None, Parameter(name="--out")] = None,
    first: Whole | None = None,
    dry_run: Annotated[bool, Parameter(negative="")] = False,
    jobs: Whole | None = None,
    executor: Literal["local", "ray"] = "local",
    address: str = "auto",
    shard: str = "1/1",
    retry: Annotated[bool, Parameter(negative="")] = False,
    variant: str | None = None,
) -> int:
    """Make a dataset from a specification, or continue one that was interrupted; the exit status is 1 if samples fail.

    Args:
        spec: a TOML file, or the name of a bundled specification: dasim-bench
        out: a folder, out/NAME by default, or an fsspec address such as s3://bucket/folder
        first: make only the first samples; each is identical to that of the whole dataset
        dry_run: print the plan and an estimate of its cost from three small renders, without making samples
        jobs: processes of the local executor; by default one per core, with graphics cards at most four per card
        executor: local, or ray for the nodes of a Ray cluster (needs the extra 'cluster')
        address: address of Ray: auto, or ray://host:port
        shard: K/N makes the K-th of N parts of the shards, for batch schedulers; the last to end finishes the dataset
        retry: try again the samples that failed in earlier runs
        variant: Mitsuba variant, auto by default
    """
    from dasim.base import executors
    from dasim.dataset import plan, preview, storage
    from dasim.dataset.make import make as make_dataset
    from dasim.dataset.reading import parquet_library
    from dasim.dataset.sample import Job, provenance
    from dasim.dataset.specification import load_spec, with_first
    from dasim.dataset.work import work
    from dasim.render import backend

    described = with_first(load_spec(spec), first)
    out = options.out_of(described.name) if out is None else out
    part = _part(shard)
    if retry and part != (1, 1):
        raise InputError(f"--retry: changes finished shards, and cannot be used with --shard {shard}")
    parquet_library()
    choice = backend.choose(variant)
    gpu = choice.variant.startswith("cuda")
    processes = processes_of(jobs, len(executors.gpus()) if gpu else None)
    here = provenance(choice.variant)
    if dry_run:
        print("\n".join(preview.lines(described, processes, choice.variant)))
        return 0
    run: Executor
    if executor == "local":
        run = executors.local(processes, work, gpu=gpu)
    else:
        run = executors.ray(address, work, gpu=gpu)
    if not storage.exists(out, plan.MANIFEST):  # a folder that is begun keeps its specification
        storage.check_writable(out)
        plan.check_space(described, out, -(-described.made // part[1]))
    plan.begin(out, plan.description(described, here))
    log = storage.local_path(out) / plan.log_name(part) if storage.is_local(out) else None
    with _progress_bar(described.name) as show:
        progress = make_dataset(Job(described, out, here), run, shard=part, retry=retry, log=log, show=show)
    for index, error in sorted(progress.failed.items()):
        print(f"sample {index} failed: {error}", file=sys.stderr)
    print(f"dataset: {out} ({progress.before + progress.done} of {progress.total} samples)")
    if progress.failed:
        print(f"{len(progress.failed)} samples failed and are missing; --retry tries them again", file=sys.stderr)
    return 1 if progress.failed else 0


@app.command
def verify(dataset: str) -> int:
    """Check a dataset: checksums, shapes, ranges, missing and extra samples; the exit status is 1 if there are
    problems.

    Args:
        dataset: its folder or fsspec address
    """
    from dasim.dataset import plan, verify

    plan.manifest(dataset)
    count = 0
    for problem in verify.problems(dataset):
        count += 1
        print(problem)
    print(f"{dataset}: {count or 'no'} problem{'' if count == 1 else 's'}")
    return 1 if count else 0


@app.command
def info(dataset: str, *, plot: Path | None = None) -> int:
    """Print statistics of a dataset.

    Args:
        dataset: its folder or fsspec address
        plot: write histograms of depth, blur, exposure and illuminants to this PNG or SVG file
    """
    from dasim.dataset import card, histograms, reading

    if plot is not None and (plot.suffix.lower() not in (".png", ".svg") or not plot.resolve().parent.is_dir()):
        raise InputError(f"--plot {plot}: must end in .png or .svg, in a folder that exists")
    spec, rows = reading.spec_of(dataset), reading.index_rows(dataset)
    print(f"{spec.name} {spec.version}, {spec.format}, licence: {spec.licence}")
    print("\n".join(card.statistics(rows)))
    if plot is not None and not rows:
        raise InputError(f"--plot {plot}: the dataset has no samples to plot")
    if plot is not None:
        histograms.plot(rows, plot, f"{spec.name} {spec.version}")
        print(f"plot: {plot}")
    return 0


@app.command
def score(
    dataset: str,
    *,
    method: Annotated[list[str], Parameter(negative="", consume_multiple=True)],
    split: str = "test",
    out: Annotated[str | None, Parameter(name="--out")] = None,
    scale: float | None = None,
    metric: Annotated[list[str] | None, Parameter(negative="", consume_multiple=True)] = None,
    bank: Path | None = None,
    fresh: Annotated[bool, Parameter(negative="")] = False,
    jobs: Whole | None = None,
    executor: Literal["local", "ray"] = "local",
    address: str = "auto",
    gates: Path | None = None,
    json_file: Annotated[Path | None, Parameter(name="--json")] = None,
    junit: Path | None = None,
) -> int:
    """Score depth methods or folders of depth maps on all samples of a split, and write a leaderboard.

    A stopped run resumes; results are kept per sample and method. The exit status is 2 if a method failed on every
    sample, and 1 if a figure violates a limit of --gates.

    Args:
        dataset: its folder or fsspec address
        method: a depth method: a bundled name, or your function as package.module:function or file.py:function, or
            NAME=file.py:function to name its figures; or a folder of depth maps KEY.npy, KEY.exr (metres) or KEY.png
            (16 bits, with --scale), or NAME=FOLDER
        split: the split to score
        out: a folder for leaderboard.html, .csv and .json, samples.csv and the results that are kept, or an fsspec
            address; out/NAME-SPLIT by default, with the name in the dataset's specification
        scale: metres per unit of the depth maps in folders
        metric: your own function of a depth map in metres and the truth, named like a method
        bank: a PSF bank for all samples; by default one is calibrated per camera and focus, and stored in the cache
        fresh: measure kept results again; needed where a function reads other files, such as weights
        jobs: processes of the local executor, one per core by default
        executor: local, or ray for a cluster (extra 'cluster')
        address: address of Ray: auto, or ray://host:port
        gates: a TOML file with limits; its keys are dataset.METHOD.FIGURE
        json_file: also write the figures with their limits, and all samples, to this file
        junit: also write the verdicts to this file, as JUnit XML
    """
    from dasim.base import executors
    from dasim.dataset.reading import open_dataset
    from dasim.files.banks import load_bank
    from validation.dataset_scores import leaderboard, page
    from validation.dataset_scores.entrants import entrants
    from validation.dataset_scores.run import PAGE, failures, score_dataset, write
    from validation.dataset_scores.work import ScoreJob, code_of, work
    from validation.gates.scored import check_score_files, judged_score, write_score
    from validation.reports.lines import of_claims

    check_score_files(json_file, junit)
    judged_score("dataset", [], gates)
    everyone, metrics = entrants(method, scale), tuple(metric or ())
    samples = open_dataset(dataset, split)
    if bank is not None:
        load_bank(bank)
    place = out or options.out_of(samples.spec.name, f"-{split}")
    job = ScoreJob(dataset, split, place, everyone, bank, metrics, code_of(metrics, bank))
    run = executors.local(processes_of(jobs), work) if executor == "local" else executors.ray(address, work)
    with options.progress() as show:
        rows = score_dataset(job, run, fresh=fresh, show=lambda done, total: show("scoring", done / max(total, 1)))
    board = leaderboard.entries(rows)
    write(job, rows, board)
    entries = judged_score("dataset", leaderboard.figures(rows, board), gates)
    print("\n".join(page.lines(rows, board)))
    for line in failures(rows):
        print(line, file=sys.stderr)
    if limited := [entry for entry in entries if entry.limit is not None]:
        print("\n".join(of_claims(limited)))
    print(f"leaderboard: {place}/{PAGE}")
    write_score("dataset", entries, json_file=json_file, junit=junit, more={"samples": rows})
    if {row["method"] for row in rows} > {row["method"] for row in rows if row["failed"] is None}:
        return 2  # a method failed on every sample
    return 1 if any(entry.passed is False for entry in entries) else 0


@app.command
def export(
    dataset: str,
    *,
    as_: Annotated[Literal["hdf5", "coco", "bop", "nyu", "stack", "croissant"], Parameter(name="--as")],
    out: Path | None = None,
    split: str | None = None,
    picture: Literal["taken", "sharp"] | None = None,
) -> int:
    """Write a dataset in the layout of others, with README.md on its conventions; nothing is left if it is stopped.

    hdf5 has all that the dataset has. coco and bop have colour pictures with labels, depth and poses; nyu has the same
    without poses. stack has one folder per scene with its captures at several focus distances and f-numbers. croissant
    describes the whole dataset in a file croissant.json in its folder and takes no --out.

    Args:
        dataset: its folder or fsspec address
        as_: hdf5, coco, bop, nyu, stack or croissant
        out: output folder, which must not exist; out/NAME-FORMAT by default
        split: the split to export; all by default
        picture: colour pictures of coco, bop, nyu and stack: taken, developed from the mosaic with its blur and noise
            (the default), or sharp, through a pinhole
    """
    from dasim.base import atomic
    from dasim.dataset.export import bop, coco, croissant, frames, hdf5, nyu, stack
    from dasim.dataset.reading import open_dataset

    if picture is not None and as_ in ("hdf5", "croissant"):
        raise InputError(f"--picture: applies to coco, bop, nyu and stack; --as {as_} has no developed pictures")
    if as_ == "croissant":
        if out is not None or split is not None:
            raise InputError("--as croissant: describes the whole dataset in a file in it; leave out --out and --split")
        print(f"description: {dataset}/{croissant.write(open_dataset(dataset))}")
        return 0
    samples = open_dataset(dataset, split)
    if out is None:
        out = options.default_out(samples.spec.name, f"-{as_}")
        if out.exists():
            raise InputError(f"{out}: exists; name another folder with --out")
    else:
        options.check_new_file(out, "--out")
    frames.check_parts(samples, ("sharp_srgb",) if picture == "sharp" else (), "--picture sharp")
    made = frames.sharp if picture == "sharp" else _developed
    with options.progress() as progress, atomic.new_folder(out) as folder:

        def show(share: float) -> None:
            progress("exporting", share)

        if as_ == "hdf5":
            hdf5.write(folder, samples, show)
        else:
            {"coco": coco, "bop": bop, "nyu": nyu, "stack": stack}[as_].write(folder, samples, made, show)
    print(f"{as_}: {out} ({len(samples)} samples)")
    return 0


def _developed(sample: Sample) -> NDArray[np.uint8]:
    """The picture of a sample as the camera takes it, sRGB [h, w, 3], white-balanced for the scene's main light."""
    import recon
    from dasim.dataset.export.frames import eight_bits
    from dasim.files.captures import capture_of

    capture = capture_of(sample.meta, sample.raw_dn, f"sample {sample.index}")
    light = capture.illuminant
    return eight_bits((recon.develop(capture, lights=[light]) if light else recon.develop(capture)).rgb)


def _part(text: str) -> tuple[int, int]:
    first, _, second = text.partition("/")
    if not (first.isdigit() and second.isdigit() and 1 <= int(first) <= int(second)):
        raise InputError(f"--shard '{text}': must be K/N, such as 3/8, with K from 1 to N")
    return int(first), int(second)


def processes_of(jobs: int | None, gpus: int | None = None) -> int:
    """Number of processes: ``jobs``, or else :data:`executors.PER_CARD` per graphics card but at most one per core, or
    one per core.
    """
    from dasim.base import executors

    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs {jobs}: must be 1 or more")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return jobs or (cores if gpus is None else max(gpus, min(executors.PER_CARD * gpus, cores)))


@contextmanager
def _progress_bar(name: str) -> Iterator[Any]:
    """Progress bar with rate, time left and failures on a terminal; elsewhere a line every ``LINE_S`` seconds."""
    from rich import progress as bars
    from rich.console import Console

    console = Console(stderr=True)
    text = (bars.TextColumn("{task.description}"), bars.BarColumn(), bars.TextColumn("{task.fields[status]}"))
    last_print = [0.0]
    with bars.Progress(*text, bars.TimeElapsedColumn(), console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(name, total=None, status="")

        def update(progress: Progress) -> None:
            status = _status(progress)
            bar.update(task, total=progress.total, completed=progress.before + progress.done, status=status)
            if not console.is_terminal and time.monotonic() - last_print[0] >= LINE_S:
                last_print[0] = time.monotonic()
                print(f"{name}: {status}", file=sys.stderr, flush=True)

        yield update


def _status(progress: Progress) -> str:
    """Samples, rate, time left and failures in one line."""
    left = progress.left_s
    time_left = "" if left != left else f", {left / 60:.0f} min left" if left > 90 else f", {left:.0f} s left"
    failed = f", {len(progress.failed)} failed" if progress.failed else ""
    rate = f", {progress.rate:.0f} per hour" if progress.done else ""
    return f"{progress.before + progress.done} of {progress.total}{rate}{time_left}{failed}"
