"""Changes of figures since an earlier ``results.json`` that exceed the spread over seeds.

Tested in tests/validation/gates/test_comparison.py.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

from dasim.base import untrusted
from dasim.base.errors import InputError
from validation.gates.claim import RESULTS_SCHEMA, Claim

SPREADS = 3.0  # difference of two runs, in its standard deviations, that rarely occurs by chance
ROUNDING = 1e-6  # relative, for figures of unknown spread: thread counts change the order of summation


class Change(NamedTuple):
    """A figure of two runs; its value is NaN in a run that does not have it."""

    id: str
    old: float
    new: float
    unit: str
    verdict: str  # better, worse, changed (it has no better side), same, new, gone


class Earlier(NamedTuple):
    """A figure in the results of an earlier run."""

    value: float
    spread: float | None
    unit: str


def load_results(path: Path) -> dict[str, Earlier]:
    """Figures of an earlier ``results.json`` by their id; raises InputError if the file is not one."""
    if not path.exists():
        raise InputError(f"--compare {path}: does not exist; give the results.json of an earlier run")
    content = untrusted.json_object(path, f"--compare {path}")
    try:
        if content["schema"] > RESULTS_SCHEMA:
            raise InputError(f"--compare {path}: schema {content['schema']} is newer than this dasim; update dasim")
        return {
            str(entry["id"]): Earlier(
                math.nan if entry["value"] is None else float(entry["value"]),
                None if entry.get("spread") is None else float(entry["spread"]),
                str(entry["unit"]),
            )
            for entry in content["claims"]
        }
    except InputError:
        raise
    except (KeyError, TypeError, ValueError):
        raise InputError(f"--compare {path}: is not a results.json of dasim validate") from None


def changes(old: dict[str, Earlier], new: list[Claim], measured: set[str]) -> list[Change]:
    """Compare the figures of two runs, by id.

    Figures of claims that were not ``measured`` in the new run do not count as gone.
    """
    result = []
    for claim in new:
        before = old.get(claim.id)
        if before is None:
            result.append(Change(claim.id, math.nan, claim.value, claim.unit, "new"))
        else:
            result.append(Change(claim.id, before.value, claim.value, claim.unit, _verdict(before, claim)))
    here = {claim.id for claim in new}
    gone = [name for name in old if name not in here and name.partition(".")[0] in measured]
    return result + [Change(name, old[name].value, math.nan, old[name].unit, "gone") for name in gone]


def _verdict(before: Earlier, claim: Claim) -> str:
    if math.isnan(before.value) and math.isnan(claim.value):
        return "same"
    distance = _distance(claim.limit)
    if math.isnan(before.value) or math.isnan(claim.value):
        return "changed" if distance is None else "worse" if math.isnan(claim.value) else "better"
    known = [s for s in (before.spread, claim.spread) if s is not None and math.isfinite(s)]
    tolerance = SPREADS * math.sqrt(2) * max(known) if known else ROUNDING * max(abs(before.value), abs(claim.value))
    finite = math.isfinite(before.value) and math.isfinite(claim.value)
    if claim.value == before.value or (finite and abs(claim.value - before.value) <= tolerance):
        return "same"
    if distance is None or distance(claim.value) == distance(before.value):
        return "changed"
    return "better" if distance(claim.value) < distance(before.value) else "worse"


def _distance(limit: str | None):  # type: ignore[no-untyped-def]
    """Distance of a value from the good end of its limit, in the direction of the limit; None without a limit.

    Of a range it is the distance from 0 if that is its middle, else how far the value is outside.
    """
    if limit is None:
        return None
    if ".." in limit:
        low, high = (float(part) for part in re.split(r"\.\.", limit))
        return abs if low == -high else lambda value: max(low - value, 0.0, value - high)
    sign = 1.0 if limit.lstrip().startswith("<") else -1.0
    return lambda value: sign * value


def report(differences: list[Change]) -> list[str]:
    """Lines for the terminal, figures that became worse first; unchanged figures are only counted."""
    order = ("worse", "better", "changed", "gone", "new")
    lines = [
        f"{change.verdict:<8}{change.id:<44}{change.old:>10.4g} -> {change.new:<10.4g} {change.unit}"
        for verdict in order
        for change in differences
        if change.verdict == verdict
    ]
    counts = {verdict: sum(change.verdict == verdict for change in differences) for verdict in (*order, "same")}
    return [*lines, "compared: " + ", ".join(f"{count} {verdict}" for verdict, count in counts.items())]
