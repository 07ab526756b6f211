"""Cramer-Rao bounds of depth, computed from transfer functions without rendering; start with ``cramer_rao``."""
