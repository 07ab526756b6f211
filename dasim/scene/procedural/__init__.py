"""Meshes by formula: plants, a head, solids; start with ``library``."""
