"""The pixels that may get light from several depths, from the depths at the pixel centres."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.render.ray_pass import px_per_m
from dasim.simulation import rendering
from dasim.simulation.simulate import prepare

WALL_M, CARD_M, CARD_WIDTH_M = 0.6, 0.25, 0.02
SIZE_PX = 128, 96


@pytest.mark.parametrize("focus_m", [WALL_M, 0.35, CARD_M])
def test_pixels_with_rays_to_two_depths_are_known(make_scene, da_mobile, jit, focus_m):
    """Rationale: few samples bias such a pixel, so that it must have more of them.

    Set-up: the right half of the frame sees a card before a wall; focused on the wall, between both, and on the card.
    Rays of 400 places on the lens through the centre and the corners of each pixel meet the card or the wall, by the
    lines of similar triangles.

    Expectation: a pixel whose rays meet both is in the mask; of those whose rays meet one, at most a fifth is: the mask
    takes the larger blur of two surfaces, although one in focus hides the one behind it sharply.
    """
    card = {"name": "card", "shape": "plane", "size_cm": (100 * CARD_WIDTH_M, 100), "material": "sand"}
    card |= {"position_cm": (50 * CARD_WIDTH_M, 0, 100 * CARD_M)}
    wall = {"name": "wall", "shape": "plane", "size_cm": (200, 200), "material": "sand"}
    wall |= {"position_cm": (0, 0, 100 * WALL_M)}
    lens = da_mobile.lens.model_copy(update={"focus_distance_m": focus_m})
    camera = cameras.cropped(da_mobile.model_copy(update={"lens": lens}), *SIZE_PX)
    view = prepare(make_scene(card, wall), camera, None, None, lambda stage, share: None)
    mask = rendering._sees_several_depths(view)

    slope = np.arange(SIZE_PX[0] + 1) - SIZE_PX[0] / 2
    slope = slope / px_per_m(camera)  # of the rays through the middle of the lens
    x = np.linspace(-1, 1, 400)[:, None] * geometry.aperture_m(camera) / 2
    at_card = x + (slope * focus_m - x) * (CARD_M / focus_m)
    inside = (at_card > 0) & (at_card < CARD_WIDTH_M)
    both = inside.any(axis=0) & ~inside.all(axis=0)
    several = both[:-1] | both[1:]
    assert mask[:, several].all()
    border = int(np.ceil(view.reach_px / 2))
    inner = mask[border:-border, border:-border]
    one = ~several[border:-border]
    assert inner[:, one].mean() < 0.2 and (several.any() or focus_m == CARD_M)
