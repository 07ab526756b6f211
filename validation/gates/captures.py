"""Figures and tables of claims that judge methods on the same captures.

Tested in tests/validation/claims/test_held_out.py and test_sharp_held_out.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from validation.gates.claim import Table
from validation.scores.figures import Figure


class OnCapture(Protocol):
    """What a method reached on one capture."""

    @property
    def capture(self) -> str:
        """Name of the capture."""

    @property
    def failed(self) -> str | None:
        """Why there is no reconstruction, or None."""

    @property
    def lost(self) -> bool:
        """Whether the method is no gain on this capture."""

    def value(self, key: str) -> float:
        """A score; NaN where it was not measured."""


def losses(label: str, start: str, judged: Sequence[OnCapture], caption: str, meaning: str) -> list[Figure]:
    """The shares of captures that are lost, and the number without a reconstruction.

    Args:
        label: name of the method.
        start: beginning of the ids of its figures.
        judged: the captures.
        caption: names the set of captures.
        meaning: when a capture is lost.
    """
    lost = [one.capture for one in judged if one.lost]
    names = f": {', '.join(lost)}" if lost else ""
    of = f"{len(judged)} captures ({caption})"
    refused = float(sum(one.failed is not None for one in judged))
    return [
        Figure(f"{start}lost", len(lost) / len(judged), "1", f"{label}: share of {of} that are lost: {meaning}{names}"),
        Figure(f"{start}failed", refused, "captures", f"{label}: without a reconstruction, of {of}"),
    ]


def loss_table(judged: Mapping[str, Sequence[OnCapture]], meaning: str, caption: str) -> Table:
    """Table of the captures that each method loses; arguments as of :func:`losses`."""
    rows = []
    for label, captures in judged.items():
        lost = [one.capture for one in captures if one.lost]
        rows.append([label, str(len(lost)), ", ".join(lost)])
    return f"Captures that are lost: {meaning}; {caption}", ["method", "number", "captures"], rows


def capture_table(label: str, judged: Sequence[OnCapture], keys: Sequence[str]) -> Table:
    """Table of a method's scores on every capture."""
    rows = [[one.capture, *(cell(one.value(key)) for key in keys), one.failed or ("lost" if one.lost else "")]
            for one in judged]  # fmt: skip
    return f"{label}: every capture", ["capture", *keys, ""], rows


def known(judged: Sequence[OnCapture], key: str) -> np.ndarray:
    """Scores of the captures that have one; those of an exact picture may be infinite."""
    values = np.array([one.value(key) for one in judged])
    return values[~np.isnan(values)]


def mean_cell(values: np.ndarray) -> str:
    """Mean of scores, in brackets their median."""
    return f"{np.mean(values):.3g} ({np.median(values):.3g})" if values.size else "-"


def cell(value: float) -> str:
    """A score of a table."""
    return "-" if np.isnan(value) else f"{value:.3g}"
