"""Wavelength grid, illuminants and colour; start with ``grid``."""
