"""Limits of figures: their notation, the figures that each applies to, and whether a figure is within its limit."""

from __future__ import annotations

import itertools
import math
import operator
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import RootModel, field_validator

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import Specification, parse_toml
from validation.gates.claim import Claim
from validation.scores.figures import Figure

LIMIT_FROM = ". Limit: "  # between what a figure means and where its limit comes from
GATES = Path(__file__).parent / "gates.toml"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ONE_SIDED = re.compile(rf"(<=|>=|<|>)\s*({_NUMBER})")
_RANGE = re.compile(rf"({_NUMBER})\s*\.\.\s*({_NUMBER})")
_DOT = re.compile(r"(?<!\d)\.|\.(?!\d)")  # between names; one between digits is a decimal point
_PART = re.compile(r"\*|\{[^*?\[\]{},]+(?:,[^*?\[\]{},]+)*\}|[^*?\[\]{}]+")
_COMPARE = {"<=": operator.le, ">=": operator.ge, "<": operator.lt, ">": operator.gt}


def within(value: float, limit: str) -> bool:
    """Whether a value is within a limit such as ``<= 0.02``, ``> 0`` or ``0.195..0.199``; NaN is within none."""
    low, high = bounds(limit)
    bound = _ONE_SIDED.fullmatch(limit)
    return bool(_COMPARE[bound[1]](value, float(bound[2]))) if bound else low <= value <= high


def bounds(limit: str) -> tuple[float, float]:
    """The lowest and the highest value of a limit, infinite where it has none; raises InputError if unreadable."""
    if both := _RANGE.fullmatch(limit):
        if float(both[1]) > float(both[2]):
            raise InputError(f"limit '{limit}' holds no value; the smaller end comes first")
        return float(both[1]), float(both[2])
    bound = _ONE_SIDED.fullmatch(limit)
    if not bound:
        raise InputError(f"limit '{limit}' is not of the form '<= 0.02', '> 0' or '0.195..0.199'")
    value = float(bound[2])
    return (-math.inf, value) if bound[1].startswith("<") else (value, math.inf)


def judged(figure: Figure, limit: str | None, *, claim: str, why: str = "") -> Claim:
    """A figure of a claim, compared with its limit."""
    passed = None if limit is None else within(figure.value, limit)
    source = figure.meaning if not why else f"{figure.meaning}{LIMIT_FROM}{why}"
    return Claim(f"{claim}.{figure.id}", figure.value, limit, figure.unit, passed, source, figure.spread)


@dataclass(frozen=True)
class Gate:
    """A limit and the figures that it applies to.

    ``key`` has the form of a figure's id, CLAIM.FIGURE or CLAIM.METHOD.FIGURE. Each part between dots is a name,
    several names as ``{D65,A}``, or ``*`` for exactly one whole name. A dot between two digits is a decimal point and
    belongs to the name, as in ``0.2-0.4-m``. A ``*`` never matches several names or part of a name, so no limit applies
    by accident to a figure that is added later, or to a figure of a user's method.
    """

    key: str
    limit: str
    why: str

    @property
    def claim(self) -> str:
        """The claim whose figures the gate limits."""
        return self.key.partition(".")[0]

    @property
    def exact(self) -> bool:
        """Whether the gate matches a single figure."""
        return not set(self.key) & set("*{")

    @property
    def keys(self) -> list[str]:
        """The key with each combination of its names in braces."""
        parts = [part[1:-1].split(",") if part.startswith("{") else [part] for part in _DOT.split(self.key)]
        return [".".join(names) for names in itertools.product(*parts)]

    def matches(self, figure_id: str) -> bool:
        """Whether the gate matches the figure of this id."""
        parts, names = _DOT.split(self.key), _DOT.split(figure_id)
        return len(parts) == len(names) and all(map(_part_matches, parts, names))


def _part_matches(part: str, name: str) -> bool:
    return part in ("*", name) or (part.startswith("{") and name in part[1:-1].split(","))


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
    """Limits of a TOML file, those for a single figure first; raises InputError if a key is wrong."""
    known = sorted(claims)
    gates = [Gate(key, text.limit, text.why) for key, text in parse_toml(_GateFile, path).root.items()]
    if not gates:
        raise InputError(
            f'{path}: holds no limit; a limit has the form ["CLAIM.FIGURE"] with limit = "<= 0.5" below it'
        )
    for gate in gates:
        if gate.claim not in known or gate.key == gate.claim:
            raise InputError(
                f"{path}: '{gate.key}' is not a figure of a claim; its form is CLAIM.FIGURE or CLAIM.METHOD.FIGURE, "
                f"with CLAIM one of {', '.join(known)}{did_you_mean(gate.claim, known)}"
            )
        for part in _DOT.split(gate.key):
            if not _PART.fullmatch(part):
                raise InputError(
                    f"{path}: '{part}' of '{gate.key}' is not a name, {{NAME,NAME}}, or * for one name between dots"
                )
    return sorted(gates, key=lambda gate: not gate.exact)


def all_gates(claims: Iterable[str], users: Path | None, bundled: Path = GATES) -> list[Gate]:
    """The user's limits followed by the bundled ones; the first that matches a figure applies."""
    users_gates = [] if users is None else load_gates(users, claims)
    return [*users_gates, *load_gates(bundled, claims)]


def gate_of(figure_id: str, gates: Sequence[Gate]) -> Gate | None:
    """The first gate that matches a figure."""
    return next((gate for gate in gates if gate.matches(figure_id)), None)


def judged_all(claim: str, figures: Sequence[Figure], gates: Sequence[Gate]) -> list[Claim]:
    """Compare a claim's figures with their limits; a limit for a figure that is missing gives an entry that failed, and
    so does each of the names in braces without a figure.
    """
    entries = []
    for figure in figures:
        gate = gate_of(f"{claim}.{figure.id}", gates)
        limit, why = (gate.limit, gate.why) if gate else (None, "")
        entries.append(judged(figure, limit, claim=claim, why=why))
    ids = [entry.id for entry in entries]
    for gate in gates:
        for key in gate.keys if gate.claim == claim else ():
            if not any(map(replace(gate, key=key).matches, ids)):
                reason = f"no figure of this name was measured{did_you_mean(key, ids)}"
                entries.append(Claim(key, math.nan, gate.limit, "", False, reason))
    return entries
