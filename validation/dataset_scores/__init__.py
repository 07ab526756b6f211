"""Scores of depth methods and depth maps on a split of a dataset, and their leaderboard; start with ``run``."""
