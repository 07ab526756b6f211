"""Claims: figures with limits, where the limits come from, and the file ``results.json``.

Tested in tests/validation/gates/test_run.py.
"""

from __future__ import annotations

import json
import math
import operator
import re
import resource
import sys
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from pydantic import RootModel, field_validator

from dasim.base.errors import InputError
from dasim.base.toml import Specification, parse_toml
from dasim.files.folders import software_versions
from validation.scores.figures import Figure

RESULTS_SCHEMA = 1
LIMIT_FROM = ". Limit: "  # between what a figure means and where its limit comes from
GATES = Path(__file__).parent / "gates.toml"


Table = tuple[str, list[str], list[list[str]]]  # caption, head, rows
Pair = tuple[str, tuple[str, str], tuple[str, str]]  # caption, then label and data address of two pictures of one size

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ONE_SIDED = re.compile(rf"(<=|>=|<|>)\s*({_NUMBER})")
_RANGE = re.compile(rf"({_NUMBER})\s*\.\.\s*({_NUMBER})")
_COMPARE = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt}


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
    """What a claim measured: figures; for the report also pictures (caption and data address), tables, and pairs of
    pictures to be compared side by side.
    """

    figures: list[Figure]
    pictures: list[tuple[str, str]] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    pairs: list[Pair] = field(default_factory=list)


# --- limits --------------------------------------------------------------------------------------


def within(value: float, limit: str) -> bool:
    """Whether a value keeps a limit such as ``<= 0.02``, ``> 0`` or ``0.195..0.199``; NaN keeps none."""
    if found := _RANGE.fullmatch(limit):
        return float(found[1]) <= value <= float(found[2])
    found = _ONE_SIDED.fullmatch(limit)
    if not found:
        raise InputError(f"limit '{limit}' is not of the form '<= 0.02', '> 0' or '0.195..0.199'")
    return bool(_COMPARE[found[1]](value, float(found[2])))


def judged(figure: Figure, limit: str | None, *, claim: str, why: str = "") -> Claim:
    """A figure of a claim, compared with its limit."""
    passed = None if limit is None else within(figure.value, limit)
    source = figure.meaning if not why else f"{figure.meaning}{LIMIT_FROM}{why}"
    return Claim(f"{claim}.{figure.id}", figure.value, limit, figure.unit, passed, source, figure.spread)


@dataclass(frozen=True)
class Gate:
    """A limit for the figures whose id matches ``pattern`` (``*`` stands for anything)."""

    pattern: str
    limit: str
    why: str

    @property
    def claim(self) -> str:
        """The claim whose figures it limits."""
        return self.pattern.partition(".")[0]


class _GateText(Specification):
    limit: str
    why: str = ""

    @field_validator("limit")
    @classmethod
    def _readable(cls, limit: str) -> str:
        within(0.0, limit)
        return limit


class _GateFile(RootModel[dict[str, _GateText]]):
    pass


def load_gates(path: Path, claims: Iterable[str]) -> list[Gate]:
    """Limits of a TOML file, those of a single figure first; InputError names every key that is wrong."""
    known = sorted(claims)
    gates = [Gate(key, text.limit, text.why) for key, text in parse_toml(_GateFile, path).root.items()]
    for gate in gates:
        if gate.claim not in known or gate.pattern == gate.claim:
            raise InputError(
                f"{path}: '{gate.pattern}' is no figure of a claim; its form is CLAIM.FIGURE, "
                f"with CLAIM one of {', '.join(known)}"
            )
    return sorted(gates, key=lambda gate: "*" in gate.pattern)


def all_gates(claims: Iterable[str], users: Path | None, bundled: Path = GATES) -> list[Gate]:
    """The bundled limits behind the user's own, which win."""
    own = [] if users is None else load_gates(users, claims)
    return [*own, *load_gates(bundled, claims)]


def gate_of(figure_id: str, gates: list[Gate]) -> Gate | None:
    """The first gate that matches."""
    return next((gate for gate in gates if fnmatchcase(figure_id, gate.pattern)), None)


def judged_all(claim: str, figures: list[Figure], gates: list[Gate]) -> list[Claim]:
    """A claim's figures with their limits; a limit that finds no figure is a claim that failed."""
    entries = []
    for figure in figures:
        gate = gate_of(f"{claim}.{figure.id}", gates)
        limit, why = (gate.limit, gate.why) if gate else (None, "")
        entries.append(judged(figure, limit, claim=claim, why=why))
    ids = [entry.id for entry in entries]
    for gate in gates:
        if gate.claim == claim and not any(fnmatchcase(name, gate.pattern) for name in ids):
            entries.append(Claim(gate.pattern, math.nan, gate.limit, "", False, "no figure of this name was measured"))
    return entries


# --- results.json --------------------------------------------------------------------------------


def plain_value(value: Any) -> Any:
    """The value for JSON, which has no NaN and no infinity: those become null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _peak_memory_mb() -> float:
    """Largest resident set of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3  # bytes there, kilobytes elsewhere


def write_results(path: Path, entries: list[Claim], timings_s: dict[str, float]) -> None:
    """Write ``results.json``; NaN and infinity become null."""
    plain = [{k: plain_value(v) for k, v in asdict(entry).items()} for entry in entries]
    content = {
        "schema": RESULTS_SCHEMA,
        "claims": plain,
        "timings_s": {name: round(seconds, 2) for name, seconds in timings_s.items()},
        "peak_memory_mb": round(_peak_memory_mb()),
        "software": software_versions(),
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
