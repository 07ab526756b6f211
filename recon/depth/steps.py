"""Depth discontinuities ("steps") of the blocks' levels, moved to edges of the all-in-focus picture.

Levels that are joined over surfaces are blurred at discontinuities. In the captured picture, the outline of a surface
out of focus is blurred, too, and edges of texture lie beside it; in the all-in-focus picture it is an edge at the right
place. The all-in-focus picture itself is made with the blurred levels: a level of the wrong side does more harm to it
than one between both sides.
"""

from __future__ import annotations

import numpy as np

from dasim.typing import Float32Array
from recon.depth import weighted_median
from recon.depth.peak import confidence_of, sd_of
from recon.depth.upsampling import Levels, log_picture


def aligned(blocks: Levels, sharp_e: Float32Array, ir_e: Float32Array) -> Levels:
    """Levels of the 2x2 blocks with steps at edges of the picture (:mod:`recon.depth.weighted_median`), [h/2, w/2].

    Where a step moved, the estimate favoured another surface: the change adds to the standard deviation.

    Args:
        blocks: levels of either sign and their confidence, [h/2, w/2].
        sharp_e: the all-in-focus picture, [h, w, 3] electrons.
        ir_e: infrared, [h, w] electrons.
    """
    picture, _ = log_picture(sharp_e, ir_e, blocks.level.shape)
    sd = np.asarray(sd_of(blocks.confidence), np.float32)
    level = weighted_median.filtered(blocks.level, sd, np.moveaxis(picture, 0, -1))
    confidence = confidence_of(np.hypot(sd, level - blocks.level).astype(np.float64))
    return Levels(level, confidence.astype(np.float32))
