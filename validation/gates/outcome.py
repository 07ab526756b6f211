"""A claim in the table, and what came of measuring it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from dasim.base.errors import InputError
from validation.gates.claim import Claim, Evidence
from validation.gates.limits import Gate
from validation.methods import NamedMethod


class Measurement(NamedTuple):
    """How a claim is measured, whether that takes less than about 20 s, and whether it is a time that is measured.

    ``run`` takes ``progress``, also ``seed`` where what it measures depends on random numbers, and ``methods`` where it
    measures depth methods: by default bundled ones, and a user's in their place.
    """

    run: Callable[..., Evidence]
    quick: bool
    alone: bool = False  # nothing else may run at the same time

    @property
    def seeded(self) -> bool:
        """Whether another seed gives other figures."""
        return "seed" in inspect.signature(self.run).parameters

    @property
    def methods(self) -> tuple[NamedMethod, ...]:
        """The bundled depth methods that it measures; none where it takes no methods."""
        parameter = inspect.signature(self.run).parameters.get("methods")
        return () if parameter is None else tuple(parameter.default)


@dataclass(frozen=True)
class Outcome:
    """A claim that was measured, or could not be."""

    id: str
    text: str  # the docstring
    claims: list[Claim]
    seconds: float
    evidence: Evidence = field(default_factory=lambda: Evidence([]))
    gates: list[Gate] = field(default_factory=list)
    not_run: str | None = None
    error: str | None = None
    seeds: int = 1
    stored: bool = False  # measured by an earlier run
    bundled: tuple[str, ...] = ()  # depth methods of the project among its figures
    users: tuple[str, ...] = ()  # a user's depth methods beside them


def title(measurement: Measurement) -> str:
    """First sentence of a claim's docstring."""
    return (inspect.getdoc(measurement.run) or "").split("\n\n")[0].replace("\n", " ")


def chosen(table: Mapping[str, Measurement], only: Sequence[str], *, quick: bool) -> list[str]:
    """Ids to measure, in the table's order; InputError where a name is unknown or nothing is left."""
    for name in only:
        if name not in table:
            raise InputError(f"claim '{name}' is unknown; allowed are {', '.join(table)}")
    names = [name for name in table if (not only or name in only) and (not quick or table[name].quick)]
    if not names:
        raise InputError(f"of {', '.join(only) or 'all claims'} none is quick; leave --quick out")
    return names


def check_methods(table: Mapping[str, Measurement], names: Sequence[str], methods: Sequence[NamedMethod]) -> None:
    """InputError where methods are given and none of the named claims measures methods."""
    if methods and not any(table[name].methods for name in names):
        able = ", ".join(name for name in table if table[name].methods)
        raise InputError(f"--method {methods[0]}: none of these claims measures depth methods; {able} do")


def failed(outcomes: list[Outcome]) -> bool:
    """Whether any gate failed."""
    return any(entry.passed is False for outcome in outcomes for entry in outcome.claims)
