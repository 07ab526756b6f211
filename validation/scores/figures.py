"""Named figures, of which scores and claims consist."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Figure:
    """One named figure of a score."""

    id: str
    value: float
    unit: str
    meaning: str
    spread: float | None = None  # standard deviation over seeds, where it was measured
