"""Figures of a claim compared with their limits, and the file ``results.json``.

Tested in tests/validation/gates/test_gates.py.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from dasim.base.memory import peak_bytes
from dasim.files.folders import software_versions
from validation.scores.figures import Figure

RESULTS_SCHEMA = 1


Table = tuple[str, list[str], list[list[str]]]  # caption, head, rows
Pair = tuple[str, tuple[str, str], tuple[str, str]]  # caption, then label and data address of two pictures of one size


@dataclass(frozen=True)
class Claim:
    """A figure with its limit: one entry of ``results.json``."""

    id: str
    value: float
    limit: str | None
    unit: str
    passed: bool | None  # None where there is no limit, or nothing was measured: reported, not passed
    source: str
    spread: float | None = None  # standard deviation over seeds, where it was measured


@dataclass(frozen=True)
class Evidence:
    """What a claim measured: figures, and for the report pictures (caption and data address), tables, and pairs of
    pictures to compare side by side.
    """

    figures: list[Figure]
    pictures: list[tuple[str, str]] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    pairs: list[Pair] = field(default_factory=list)


def plain_value(value: Any) -> Any:
    """The value for JSON, which has neither NaN nor infinity; both become null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_results(path: Path, entries: list[Claim], timings_s: dict[str, float]) -> None:
    """Write ``results.json``; NaN and infinity become null."""
    plain = [{k: plain_value(v) for k, v in asdict(entry).items()} for entry in entries]
    content = {
        "schema": RESULTS_SCHEMA,
        "claims": plain,
        "timings_s": {name: round(seconds, 2) for name, seconds in timings_s.items()},
        "peak_memory_mb": round(peak_bytes() / 1e6),
        "software": software_versions(),
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
