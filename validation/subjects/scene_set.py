"""The three bundled scenes that several claims photograph, in one size, so that they share the photographs."""

SCENES = ("desk", "flowers", "adam")
SIZE_PX = (512, 384)
SPP = 160  # samples per pixel and stop
