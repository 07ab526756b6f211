"""Other single-shot depth cameras, compared with the dual aperture at equal light, and one estimator for all."""
