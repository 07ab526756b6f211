"""Spectral rendering: the only room that knows Mitsuba; start with ``passes``."""
