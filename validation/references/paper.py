"""Numbers of the paper that claims compare with, not read from the camera that is checked."""

HOLE_RATIO = 0.46  # radius of the near-infrared hole over that of the lens (sec. 3)
STOP_RATIOS = (1.0, HOLE_RATIO)  # of da-mobile's stops, in its order
