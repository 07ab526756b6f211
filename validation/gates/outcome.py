"""An entry of the table of claims, and the result of measuring it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from validation.gates.claim import Claim, Evidence
from validation.gates.limits import Gate
from validation.methods import NamedMethod


class Measurement(NamedTuple):
    """How a claim is measured, whether that takes less than about 20 s, and whether it measures a time.

    ``run`` takes ``progress``; also ``seed`` if the claim depends on random numbers, and ``methods`` if it measures
    depth methods, of which the defaults are bundled ones that a user's methods can replace.
    """

    run: Callable[..., Evidence]
    quick: bool
    alone: bool = False  # nothing else may run at the same time

    @property
    def seeded(self) -> bool:
        """Whether the figures depend on a seed."""
        return "seed" in inspect.signature(self.run).parameters

    @property
    def methods(self) -> tuple[NamedMethod, ...]:
        """The bundled depth methods that the claim measures; empty if it does not measure methods."""
        parameter = inspect.signature(self.run).parameters.get("methods")
        return () if parameter is None else tuple(parameter.default)


@dataclass(frozen=True)
class Outcome:
    """Result of a claim that was measured or could not be."""

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


def select(table: Mapping[str, Measurement], only: Sequence[str], *, quick: bool) -> list[str]:
    """Ids of the claims to measure, in the table's order; raises InputError if a name is unknown or no
    claim is left.
    """
    for name in only:
        if name not in table:
            hint = did_you_mean(name, table, 3) or f"; allowed are {', '.join(table)}"
            raise InputError(f"claim '{name}' is unknown; 'dasim list claims' prints all{hint}")
    names = [name for name in table if (not only or name in only) and (not quick or table[name].quick)]
    if not names:
        raise InputError(f"of {', '.join(only) or 'all claims'} none is quick; leave --quick out")
    return names


def check_methods(table: Mapping[str, Measurement], names: Sequence[str], methods: Sequence[NamedMethod]) -> None:
    """Raise InputError if methods are given and none of the named claims measures methods."""
    if methods and not any(table[name].methods for name in names):
        able = ", ".join(name for name in table if table[name].methods)
        raise InputError(f"--method {methods[0]}: none of these claims measures depth methods; {able} do")


def verdict(claims: Sequence[Claim]) -> bool | None:
    """False if a figure failed, True if some had limits and none failed, None if none had a limit."""
    judged = [claim.passed for claim in claims if claim.passed is not None]
    return all(judged) if judged else None


def by_verdict(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """The outcomes in the order that a reader needs: failed, passed, without a limit, not run; else unchanged."""

    def place(outcome: Outcome) -> int:
        return 3 if outcome.not_run else (False, True, None).index(verdict(outcome.claims))

    return sorted(outcomes, key=place)


def failed(outcomes: list[Outcome]) -> bool:
    """Whether any figure failed its limit."""
    return any(entry.passed is False for outcome in outcomes for entry in outcome.claims)
