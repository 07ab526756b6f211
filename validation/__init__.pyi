from .scores.figures import Figure
from .scores.score import score, score_map, table

__all__ = ["Figure", "score", "score_map", "table"]
