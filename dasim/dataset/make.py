"""Make the missing samples of a dataset, in any order and by any executor, and collect them in shards."""

from __future__ import annotations

import json
import tarfile
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dasim.base.durations import words
from dasim.base.errors import InputError, describe_error
from dasim.base.executors import Executor, Outcome
from dasim.dataset import card, plan, reading, storage
from dasim.dataset.plan import Shard
from dasim.dataset.sample import ROW, Job, file_names, json_bytes, key
from dasim.dataset.specification import DatasetSpec
from dasim.dataset.tar_files import add, pack, unpack
from dasim.dataset.work import PART

TRIES = 3
RESUME = "finished samples are stored: solve the problem, and run the same command again"


@dataclass
class Progress:
    """Progress of a run, reported after each sample."""

    total: int  # samples of this run
    before: int = 0  # of ``total``, made by earlier runs
    done: int = 0
    failed: dict[int, str] = field(default_factory=dict)
    start: float = field(default_factory=time.monotonic)
    last: str = ""  # one line about the last sample

    @property
    def rate(self) -> float:
        """Samples per hour of this run."""
        return 3600 * self.done / max(time.monotonic() - self.start, 1e-9)

    @property
    def left_s(self) -> float:
        """Estimated time left, s; NaN before the first sample."""
        missing = self.total - self.before - self.done - len(self.failed)
        return 3600 * missing / self.rate if self.done else float("nan")


def make(
    job: Job,
    executor: Executor,
    *,
    shard: tuple[int, int] = (1, 1),
    retry: bool = False,
    log: Path | None = None,
    show: Callable[[Progress], None] = lambda progress: None,
) -> Progress:
    """Make the missing samples of a dataset, and finish it when none is missing.

    Args:
        job: specification, output and environment.
        executor: where the samples are made.
        shard: (k, n) for the k-th of n parts of the shards, from 1, for n simultaneous runs; the last one to end
            finishes the dataset.
        retry: whether samples that failed in earlier runs are tried again.
        log: file that gets one line per sample.
        show: function that is called after each sample.

    Raises InputError if files cannot be written, or if another process is making one of the shards.
    """
    numbers = range(len(plan.shards(job.spec)))[shard[0] - 1 :: shard[1]]
    try:
        with storage.claimed(job.out, plan.CLAIMS, numbers) as free:
            if not free:
                raise InputError(
                    f"{job.out}: another run is making the same samples; wait for its end, or give each run its own "
                    "part with --shard K/N"
                )
            try:
                return _make(job, executor, shard, retry, log, show)
            finally:
                storage.sweep(job.out)
    except OSError as error:
        raise InputError(f"{job.out}: {describe_error(error)}; {RESUME}") from None


def _make(
    job: Job,
    executor: Executor,
    shard: tuple[int, int],
    retry: bool,
    log: Path | None,
    show: Callable[[Progress], None],
) -> Progress:
    every = plan.shards(job.spec)
    assigned = every[shard[0] - 1 :: shard[1]]
    storage.sweep(job.out)
    if retry:
        _reopen(job, assigned)
    have, failed = parts(job.out), failures(job.out)
    closed = closed_shards(job.out)
    if storage.exists(job.out, plan.SUMS):  # checked last, because another run may just have finished
        card.tidy(job.out)
        _check_whole(job, every, failed)
        return Progress(job.spec.made, before=job.spec.made - len(failed), failed=failed)
    waiting = {group.name: group for group in assigned if group.name not in closed}
    group_of = {index: group for group in waiting.values() for index in group.indices}
    queue = deque(index for index in group_of if index not in have and index not in failed)
    total = sum(len(group.indices) for group in assigned)
    progress = Progress(total, before=total - len(queue) - sum(i in failed for g in assigned for i in g.indices))
    progress.failed |= {index: failed[index] for group in assigned for index in group.indices if index in failed}
    plan.check_space(job.spec, job.out, len(queue))
    left = {name: sum(i not in have and i not in failed for i in group.indices) for name, group in waiting.items()}
    for name, missing in left.items():
        if not missing:
            close(job, waiting[name])
    tries: dict[int, int] = {}
    show(progress)
    with closing(executor(job, queue)) as outcomes:
        for outcome in outcomes:
            if outcome.fatal:
                raise InputError(f"{job.out}: {outcome.error}; {RESUME}")
            tries[outcome.index] = tries.get(outcome.index, 0) + 1
            progress.last = _line(outcome, tries[outcome.index])
            _append(log, progress.last)
            if outcome.error and not outcome.final and tries[outcome.index] < TRIES:
                queue.append(outcome.index)
                show(progress)
                continue
            if outcome.error:
                progress.failed[outcome.index] = outcome.error
                storage.write(
                    job.out,
                    f"failed/{key(outcome.index)}.json",
                    json_bytes({"error": outcome.error}),
                )
            else:
                progress.done += 1
            group = group_of[outcome.index]
            left[group.name] -= 1
            if not left[group.name]:
                close(job, group)
            show(progress)
    if closed_shards(job.out) >= {group.name for group in every}:
        card.finish(job.out, job.spec, failures(job.out))
    if storage.exists(job.out, plan.SUMS):  # finished by another run, maybe before this one wrote its last parts
        card.tidy(job.out)
    return progress


def _check_whole(job: Job, every: Sequence[Shard], failed: Collection[int]) -> None:
    """Raise InputError if files of a finished dataset are gone; ``dasim dataset verify`` checks what they hold."""
    for group in every:
        made = [index for index in group.indices if index not in failed]
        files = [f"{group.name}.tar"] if made else []
        if job.spec.format == "folders":
            files = [f"{group.split}/{key(index)}/{name}" for index in made for name in file_names(job.spec)]
        for name in files:
            if not storage.exists(job.out, name):
                raise InputError(
                    f"{job.out}: was finished, but {name} is gone; 'dasim dataset verify' lists all that is missing; "
                    "make the dataset anew in another folder"
                )


def parts(out: str) -> set[int]:
    """Indices of the samples that are made and whose shard is not complete."""
    return {int(Path(name).stem) for name in storage.names(out, "parts")}


def failures(out: str) -> dict[int, str]:
    """Error message of each failed sample of the dataset ``out``, by index."""
    names = storage.names(out, "failed")
    return {int(Path(name).stem): str(json.loads(storage.read(out, name))["error"]) for name in names}


def closed_shards(out: str) -> set[str]:
    """Names of the complete shards."""
    return {Path(name).stem for name in storage.names(out, "rows")}


def close(job: Job, group: Shard) -> None:
    """Write a shard from its samples; failed samples are left out."""
    failed = failures(job.out)
    indices = [index for index in group.indices if index not in failed]
    try:
        rows = _write_shard(job, group, indices)
    except FileNotFoundError as error:
        if storage.exists(job.out, f"rows/{group.name}.json") or storage.exists(job.out, plan.SUMS):
            return  # another run has written it
        raise InputError(f"{job.out}: {describe_error(error)}; is another run writing there? {RESUME}") from None
    storage.write(job.out, f"rows/{group.name}.json", json_bytes(rows))
    for index in indices:
        storage.remove(job.out, PART.format(key(index)))


def _write_shard(job: Job, group: Shard, indices: list[int]) -> list[dict[str, Any]]:
    """Write the samples of a shard to its tar file or to their folders; returns their rows of the index."""
    rows = []
    with ExitStack() as stack:
        tar = None
        if job.spec.format == "webdataset" and indices:
            file = stack.enter_context(storage.writing(job.out, f"{group.name}.tar"))
            tar = stack.enter_context(tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT))
        for index in indices:
            members = unpack(storage.read(job.out, PART.format(key(index))))
            rows.append(json.loads(members[ROW]) | {"shard": group.name})
            for name in file_names(job.spec):
                if tar is not None:
                    add(tar, f"{key(index)}.{name}", members[name])
                else:
                    storage.write(job.out, f"{group.split}/{key(index)}/{name}", members[name])
    return rows


def _reopen(job: Job, assigned: tuple[Shard, ...]) -> None:
    """Split shards with failed samples into their parts, and remove the failures, so that these are tried again."""
    failed = failures(job.out)
    if storage.exists(job.out, plan.SUMS):
        card.undo(job.out, job.spec)
    for group in assigned:
        if not any(index in failed for index in group.indices):
            continue
        if storage.exists(job.out, f"rows/{group.name}.json"):
            rows = {row["index"]: row for row in json.loads(storage.read(job.out, f"rows/{group.name}.json"))}
            for index, files in reading.samples_of(job.out, job.spec, group, list(rows)):
                row = {name: value for name, value in rows[index].items() if name != "shard"}
                storage.write(job.out, PART.format(key(index)), pack({**files, ROW: json_bytes(row)}))
            storage.remove(job.out, f"rows/{group.name}.json")
        for index in group.indices:
            storage.remove(job.out, f"failed/{key(index)}.json")


def _line(outcome: Outcome, tries: int) -> str:
    """Line of the log about an outcome."""
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    if outcome.error:
        return f"{stamp} {key(outcome.index)} failed, try {tries}: {outcome.error}"
    outside = 1 - outcome.render_s / max(outcome.seconds, 1e-9)
    return (
        f"{stamp} {key(outcome.index)} {outcome.seconds:.2f} s, {outside:.1%} outside the renderer, "
        f"{outcome.peak_mb:.0f} MB"
    )


def _append(log: Path | None, line: str) -> None:
    if log is not None:
        with log.open("a", encoding="utf-8") as file:
            file.write(line + "\n")


def estimate(spec: DatasetSpec, seconds: float, processes: int) -> str:
    """Time and size of a dataset in one line, for ``seconds`` per sample on one core."""
    size = spec.made * plan.sample_bytes(spec)
    unit, name = (1e9, "GB") if size >= 1e9 else (1e6, "MB")
    time = words(spec.made * seconds / processes)
    return f"{spec.made} samples, about {time} on {processes} processes and {size / unit:.3g} {name}"
