"""Studies of aperture designs: sweeps of simulated captures, bounds without rendering, a search of shapes."""
