"""Mitsuba XML scenes: their surfaces and lights become spectral; start with ``scene``."""
