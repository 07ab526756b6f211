"""Captures, ground truths and PSF banks on disk; start with ``captures``."""
