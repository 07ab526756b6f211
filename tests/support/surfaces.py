"""Ground truth and reconstructions of frontal surfaces of known blur levels, for tests of scores."""

import numpy as np

from dasim.camera import geometry
from dasim.values import Reconstruction, Truth


def truth(camera, level, image, boundary=False) -> Truth:
    """Ground truth of blur levels [h, w], with ``image`` [h, w, 4] as mean electrons through the lens and a pinhole."""
    level = np.array(level, np.float32)
    image = np.array(image, np.float32)
    blur = level * geometry.level_blur_px(camera)[1]
    return Truth(
        depth_m=geometry.depth_of_blur_m(camera, blur).astype(np.float32),
        valid=np.ones(level.shape, bool),
        normal=np.broadcast_to(np.float32([0, 0, -1]), (*level.shape, 3)),
        object_id=np.ones(level.shape, np.uint32),
        material_id=np.ones(level.shape, np.uint32),
        blur_px=blur.astype(np.float32),
        level=level,
        boundary=np.broadcast_to(boundary, level.shape).copy(),
        channels=("R", "G", "B", "IR"),
        mean_e=image,
        sharp_e=image,
        sharp_srgb=image[..., :3] / image.max(),
    )


def exact_reconstruction(truth: Truth, camera) -> Reconstruction:
    """Reconstruction with the depths of the truth and arbitrary (constant) pictures."""
    shape = truth.level.shape
    colours, ones = np.ones((*shape, 3), np.float32), np.ones(shape, np.float32)
    return Reconstruction(
        rgb=colours, sharp_rgb=colours, linear_e=colours, sharp_e=colours, ir_e=ones, level_raw=truth.level,
        level=truth.level, depth_m=truth.depth_m, confidence=ones, camera=camera, light="D55",
        settings={}, timings_s={},
    )  # fmt: skip
