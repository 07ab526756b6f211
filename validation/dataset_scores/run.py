"""Score a split of a dataset by any executor, and write leaderboard, tables and page.

Tested in tests/validation/test_dataset_scores.py.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import Any

from dasim.base.errors import InputError
from dasim.base.executors import Executor
from dasim.base.fingerprint import text_hash
from dasim.dataset import storage
from dasim.dataset.reading import Dataset
from dasim.dataset.sample import json_bytes
from validation.dataset_scores import leaderboard, page
from validation.dataset_scores.entrants import check_maps
from validation.dataset_scores.figures import EDGE, METRICS
from validation.dataset_scores.leaderboard import MEANINGS, RATIO, Entry, Row
from validation.dataset_scores.work import RESULTS, ScoreJob, content, opened, result_file
from validation.gates.claim import plain_value

PAGE, BOARD, TABLE, SAMPLES = "leaderboard.html", "leaderboard.json", "leaderboard.csv", "samples.csv"
FILES = (PAGE, BOARD, TABLE, SAMPLES)
SCHEMA = 1
RESUME = "finished samples are stored: remove the cause and run the same command"


def check_out(out: str) -> None:
    """Raise InputError if the output holds anything but earlier scores, or cannot be written."""
    others = [name for name in storage.names(out) if name not in FILES and not name.startswith(f"{RESULTS}/")]
    if others:
        raise InputError(f"{out}: holds files that are no scores of a dataset ({others[0]}); choose another --out")
    storage.check_writable(out)


def score_dataset(
    job: ScoreJob,
    executor: Executor,
    *,
    fresh: bool = False,
    show: Callable[[int, int], None] = lambda done, total: None,
) -> list[Row]:
    """Results of all entrants on all samples of a split, of which those that exist are read from their files.

    Args:
        job: what is scored.
        executor: where it is scored; the unit of work is a sample.
        fresh: whether existing results are measured again.
        show: function that is called with the numbers of finished and of all samples.

    Raises InputError for what the user has to correct; finished samples are kept.
    """
    samples = opened(job.dataset, job.split)
    if not len(samples):
        raise InputError(f"{job.dataset}: split '{job.split}' has no samples")
    check_maps(job.entrants, [row["key"] for row in samples.rows])
    check_out(job.out)
    storage.sweep(job.out)
    files = [[result_file(job, one, row) for one in job.entrants] for row in samples.rows]
    for name in (name for names in files for name in names) if fresh else ():
        storage.remove(job.out, name)
    queue = deque(place for place, names in enumerate(files) if any(_result(job, name) is None for name in names))
    done = len(files) - len(queue)
    show(done, len(files))
    with closing(executor(job, queue)) as outcomes:
        for outcome in outcomes:
            if outcome.error:
                key = samples.rows[outcome.index]["key"]
                where = "" if outcome.fatal else f"sample {key}: "
                raise InputError(f"{where}{outcome.error}; {RESUME}")
            done += 1
            show(done, len(files))
    rows = [_result(job, name) for names in files for name in names]
    return [row for row in rows if row is not None]


def _result(job: ScoreJob, name: str) -> Row | None:
    """A stored result; None where there is none, or its file is damaged, which is then removed."""
    if not storage.exists(job.out, name):
        return None
    try:
        row = json.loads(storage.read(job.out, name))
        if {"method", "sample", "scene", "figures", "failed"} <= set(row):
            return dict(row)
    except (ValueError, TypeError):
        pass
    storage.remove(job.out, name)
    return None


def about(samples: Dataset, split: str) -> dict[str, Any]:
    """What the figures are of: the dataset, and a hash of all files of the split's samples."""
    spec = samples.spec
    digests = [f"{row['key']} {text}" for row in samples.rows for text in content(row)]
    return {
        "name": spec.name,
        "version": spec.version,
        "split": split,
        "samples": len(samples),
        "first": spec.first,
        "of": spec.samples,
        "hash": text_hash(digests),
    }


def write(job: ScoreJob, rows: Sequence[Row], found: Sequence[Entry]) -> None:
    """Write the page, the leaderboard as CSV and JSON, and the table of all samples; ``found`` are its entries."""
    samples = opened(job.dataset, job.split)
    described = about(samples, job.split)
    board = {"schema": SCHEMA, "dataset": described, "figures": [_plain(entry) for entry in found]}
    storage.write(job.out, SAMPLES, samples_csv(rows).encode())
    storage.write(job.out, TABLE, table_csv(found).encode())
    storage.write(job.out, BOARD, json_bytes(board))
    storage.write(job.out, PAGE, page.page(described, rows, found, samples.rows).encode())


def failures(rows: Sequence[Row]) -> list[str]:
    """A line for each method that failed on samples, with the first of its messages."""
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        failed = [row for row in own if row["failed"] is not None]
        if failed:
            count = f"{len(failed)} of {len(own)} samples" if len(failed) < len(own) else f"all {len(own)} samples"
            lines.append(f"{method} failed on {count}; {failed[0]['sample']}: {failed[0]['failed']}")
    return lines


def _plain(entry: Entry) -> dict[str, Any]:
    means = {key: [plain_value(number) for number in value[:3]] for key, value in entry.means.items()}
    return {"method": entry.method, "group": entry.group, "part": entry.part, "samples": entry.samples, **means}


def table_csv(found: Sequence[Entry]) -> str:
    """One row per method, group and part: number of samples, and each mean with the ends of its interval."""
    keys = list(dict.fromkeys(key for entry in found for key in entry.means))
    heads = [f"{key} ({MEANINGS[key][0]})" if key in MEANINGS else key for key in keys]
    rows = [["method", "group", "part", "samples", *(f"{h}{end}" for h in heads for end in ("", " low", " high"))]]
    for entry in found:
        means = [entry.means.get(key, (math.nan,) * 3)[:3] for key in keys]
        numbers = [_text(number) for mean in means for number in mean]
        rows.append([entry.method, entry.group, entry.part, str(entry.samples), *numbers])
    return _csv(rows)


def samples_csv(rows: Sequence[Row]) -> str:
    """One row per method and sample, with its figures over the near side of the focus."""
    constants = leaderboard.constants_of(rows)
    heads = ["method", "sample", "scene", "kind", "illuminant", "light_e", "coverage", "seconds", "failed"]
    table = [[*heads, RATIO, *METRICS, EDGE]]
    for row in rows:
        values = row["figures"].get("region", {}).get("all", {})
        numbers = [leaderboard.ratio(row, constants.get(row["sample"])), *(values.get(k) for k in (*METRICS, EDGE))]
        table.append([*(_text(row[head]) for head in heads), *map(_text, numbers)])
    return _csv(table)


def _csv(rows: Sequence[Sequence[str]]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()


def _text(value: Any) -> str:
    """A cell: six digits of a number, empty where it is unknown."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)
