"""From a scene and a camera to captures with ground truth; start with ``simulate``."""
