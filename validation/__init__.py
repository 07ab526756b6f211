"""Scores against ground truth, and the proof that simulator and reconstruction can be trusted."""

from validation.scores.figures import Figure
from validation.scores.score import score, score_map

__all__ = ["Figure", "score", "score_map"]
