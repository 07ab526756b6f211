"""Studies of aperture design: sweeps, bounds and the search for a shape."""
