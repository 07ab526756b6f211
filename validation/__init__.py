"""Scores against ground truth, and the proof that simulator and reconstruction can be trusted."""

from validation.metrics import Figure, score

__all__ = ["Figure", "score"]
