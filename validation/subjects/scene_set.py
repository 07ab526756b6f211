"""The three bundled scenes that several claims capture at the same size, so that they share the cached captures."""

SCENES = ("desk", "flowers", "adam")
SIZE_PX = (512, 384)
SPP = 160  # samples per pixel and stop
