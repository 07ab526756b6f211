"""A small reconstruction with its bank, capture and ground truth, all different everywhere, for tests of the page."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from dasim.values import Capture, PsfBank, Reconstruction, Truth
from recon.settings import PAPER
from tests.support import recon_scenes, surfaces

HEIGHT, WIDTH = 72, 96
WHITE_E = 3000.0


@dataclass(frozen=True)
class Viewed:
    """What a page is made of."""

    result: Reconstruction
    bank: PsfBank
    capture: Capture
    truth: Truth


@cache
def example() -> Viewed:
    """A photograph on a near box before a far slope; half of the estimates are 0.3 levels off."""
    camera = recon_scenes.da_mobile(WIDTH, HEIGHT)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    true = np.where((x > 30) & (x < 60) & (y > 20), 9.0, 1 + 3 * y / HEIGHT)
    level = (true + 0.3 * (x > WIDTH / 2)).astype(np.float32)
    visible, infrared = recon_scenes.textures(HEIGHT, WIDTH, zoom=0.4)
    image = np.dstack([visible[..., :3], infrared]) * WHITE_E
    truth = surfaces.truth(camera, true, image)
    exact = surfaces.truth(camera, level, image)
    sharp = np.asarray(image[..., :3], np.float32)
    result = Reconstruction(
        rgb=np.clip(sharp / WHITE_E, 0, 1) ** 0.6, sharp_rgb=np.clip(sharp / WHITE_E, 0, 1) ** 0.5,
        linear_e=sharp * np.float32(0.9), sharp_e=sharp, ir_e=np.asarray(image[..., 3], np.float32), level_raw=level,
        level=level, depth_m=exact.depth_m, confidence=(0.2 + 0.7 * x / WIDTH).astype(np.float32), camera=camera,
        light="D65", settings=PAPER.model_dump(), timings_s={}, notes=("a note <b>on</b> it",),
    )  # fmt: skip
    raw = np.random.default_rng(3).integers(64, 1024, (HEIGHT, WIDTH)).astype(np.uint16)
    return Viewed(result, recon_scenes.bank(), Capture(raw, camera, 0.01, 1.0, 0), truth)
