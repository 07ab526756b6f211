"""What every room uses: errors, specifications from TOML, caches, fingerprints and processes; start with ``toml``."""
