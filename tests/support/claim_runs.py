"""Runs of `dasim validate` with claims made up for tests."""

from __future__ import annotations

import json
from functools import partial

from validation.gates.run import measured_claims
from validation.validate import write_claims

LIMITS = '["good.size"]\nlimit = "<= 0.5"\nwhy = "half"\n["bad.*"]\nlimit = "<= 0.5"\n["absent.size"]\nlimit = "> 0"\n'


def results(folder) -> dict:
    content = json.loads((folder / "results.json").read_text())
    assert content["schema"] == 1
    return {entry["id"]: entry for entry in content["claims"]}


def run_claims(out, *arguments, **options):
    """Measure claims and write their folder."""
    return write_claims(out, partial(measured_claims, *arguments, **options))
