"""Random rooms and table tops from a seed and an index. Start with ``scene``."""
