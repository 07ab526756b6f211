"""Rivals of the dual aperture on the same photons: other cameras that tell depth, and one estimator for all."""
