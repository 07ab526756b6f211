"""Numbers of the paper that claims use as reference, independent of the camera under test."""

HOLE_RATIO = 0.46  # radius of the near-infrared hole over that of the lens (sec. 3)
STOP_RATIOS = (1.0, HOLE_RATIO)  # radius ratios of da-mobile's stops, in the order of its file
