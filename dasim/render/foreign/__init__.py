"""Mitsuba XML scenes, whose RGB surfaces and lights are replaced by spectral ones; start with ``scene``."""
