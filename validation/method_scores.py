"""Scores of depth methods on a capture.

Tested in tests/validation/test_methods.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dasim.values import Capture, PsfBank, Truth
from validation.methods import NamedMethod, reconstructed
from validation.scores.figures import Figure
from validation.scores.metrics import Metric
from validation.scores.score import score


def score_methods(
    capture: Capture, truth: Truth, bank: PsfBank, methods: Sequence[NamedMethod], metrics: Sequence[Metric] = ()
) -> list[Figure]:
    """Figures of :func:`validation.score` for the reconstruction of a capture by each method, named METHOD.FIGURE."""
    return [
        replace(figure, id=f"{method}.{figure.id}")
        for method in methods
        for figure in score(reconstructed(capture, bank, method), capture, truth, metrics=metrics)
    ]
