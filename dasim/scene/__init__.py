"""Scenes as data: objects, lights, meshes and test targets; start with ``specification``."""
