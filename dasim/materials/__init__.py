"""Spectral reflectances and surfaces of materials, from 400 to 830 nm. Start with ``library``."""
