"""Evidence of claims, stored between runs under a fingerprint of everything that it depends on.

Tested in tests/validation/gates/test_run.py and tests/dasim/base/test_fingerprint.py.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dasim.base import atomic, cache
from dasim.base.cache import cache_dir
from dasim.base.fingerprint import fingerprint, text_hash
from validation.gates.claim import Evidence
from validation.scores.figures import Figure

__all__ = ["earlier_seconds", "key", "load", "save", "text_hash"]

SCHEMA = 4  # of the files


def key(run: Callable[..., Any], variant: str, seed: int = 0, *, uses: tuple[Callable[..., Any], ...] = ()) -> str:
    """Hash of everything that a claim's evidence depends on: code, data, libraries, the renderer's variant, seed.

    ``uses`` are functions that are passed to the claim, such as a user's depth method. Limits are not part of the key:
    stored evidence is compared with the current limits.
    """
    return fingerprint(run, *uses, variant=variant, values=[str(SCHEMA), str(seed)])


def load(name: str, seed: int, key: str) -> tuple[Evidence, float] | None:
    """Stored evidence of a claim and the seconds that measuring it took; None if nothing is stored under this key."""
    path = _path(name, seed, key)
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        figures = [Figure(**figure | {"value": _number(figure["value"])}) for figure in content["figures"]]
        pictures = [(caption, data) for caption, data in content["pictures"]]
        tables = [(caption, head, rows) for caption, head, rows in content["tables"]]
        pairs = [(caption, tuple(left), tuple(right)) for caption, left, right in content["pairs"]]
        seconds = float(content["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None  # missing or damaged
    cache.used(path)
    return Evidence(figures, pictures, tables, pairs), seconds


def earlier_seconds(name: str, seed: int) -> float | None:
    """How long a claim took when it was measured last, whatever it depends on now; None if that is not known."""
    try:
        newest = max((cache_dir() / "claims").glob(f"{name}.{seed}.*.json"), key=lambda path: path.stat().st_mtime)
        return float(json.loads(newest.read_text(encoding="utf-8"))["seconds"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def save(name: str, seed: int, key: str, evidence: Evidence, seconds: float) -> None:
    """Store a claim's evidence, which replaces that under other keys; a cache folder that is not writable
    is no error.
    """
    content = asdict(evidence) | {"seconds": seconds}
    for figure in content["figures"]:
        if not math.isfinite(figure["value"]):
            figure["value"] = str(figure["value"])  # inf, -inf and nan are no numbers of JSON
    path = _path(name, seed, key)
    try:
        for old in path.parent.glob(f"{name}.{seed}.*.json"):
            old.unlink(missing_ok=True)
        atomic.write(path, json.dumps(content))
        cache.bound(path.parent)
    except OSError as error:
        print(f"note: the evidence of {name} cannot be kept: {error}", file=sys.stderr)


def _path(name: str, seed: int, key: str) -> Path:
    return cache_dir() / "claims" / f"{name}.{seed}.{key}.json"


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
