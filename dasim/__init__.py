"""dasim: physical simulation of dual-aperture cameras."""
