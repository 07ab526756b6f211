"""Scenes as data: objects, lights, meshes and test targets. Start with ``specification``."""
