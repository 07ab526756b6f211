"""The camera: lens, stops, sensor, noise and point-spread functions; start with ``specification``."""
