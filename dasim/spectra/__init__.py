"""The wavelength grid, illuminants and colour; start with ``grid``."""
