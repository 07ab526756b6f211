"""Errors, specifications from TOML, caches, fingerprints and processes, for all packages; start with ``toml``."""
