"""Procedural meshes: plants, a head with shoulders, solids. Start with ``library``."""
