"""Scores against ground truth, and the proof that simulator and reconstruction can be trusted."""

from validation.figures import Figure
from validation.scores import score, score_map

__all__ = ["Figure", "score", "score_map"]
