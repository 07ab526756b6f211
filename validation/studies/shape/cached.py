"""Figures of rendered designs, cached as JSON: rendering and calibrating a design takes minutes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from typing import Any

from dasim.base import atomic, cache
from dasim.base.cache import cache_dir
from validation.gates import stored


def figures(key: Sequence[str], compute: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What ``compute`` returns for this key, from the cache if an earlier run computed it. Lists become tuples.

    ``key`` holds everything that the figures depend on.
    """
    path = cache_dir() / "shape-study" / f"{stored.text_hash(key)}.json"
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
        cache.used(path)
    except (OSError, ValueError):  # missing or damaged
        text = json.dumps(compute(), indent=1) + "\n"
        values = json.loads(text)
        try:
            atomic.write(path, text)
            cache.bound(path.parent)
        except OSError as error:
            print(f"note: figures of a design cannot be kept: {error}", file=sys.stderr)
    return {name: as_tuple(value) for name, value in values.items()}


def as_tuple(value: Any) -> Any:
    """Nested lists as nested tuples; other values unchanged."""
    return tuple(as_tuple(one) for one in value) if isinstance(value, list) else value
