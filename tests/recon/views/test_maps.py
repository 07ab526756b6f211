"""Pictures of depth, confidence and the raw mosaic: colours by value, grey gaps, a scale, a colour per filter."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest

from recon.views import maps
from tests.support import recon_scenes

VIRIDIS = matplotlib.colormaps["viridis"]
STEP = 1.01 / 255  # of a colour in a table of 256


def test_colours_of_depth_are_even_in_dioptres():
    """Set-up: a third each at 10, 20 and 40 cm, and a gap; each pixel enlarged to a square.

    Expectation: the ends of viridis, and a third of the way at 20 cm: (5 - 2.5) / (10 - 2.5); grey without a depth.
    """
    depth = np.repeat([0.1, 0.2, 0.4], 40)[None].repeat(120, axis=0)
    depth[:20, :20] = np.nan
    picture = maps.depth_picture(depth) / 255
    assert picture.shape == (240, 240 + maps.BAR_PX, 3)
    for column, share in ((79, 1.0), (120, 1 / 3), (220, 0.0)):
        np.testing.assert_allclose(picture[120, column], VIRIDIS(share)[:3], atol=4 * STEP)
    np.testing.assert_allclose(picture[10, 10], 0.5, atol=STEP)


def test_the_scale_runs_from_dark_to_light_with_numbers_beside_it():
    picture = maps.depth_picture(np.linspace(0.1, 0.4, 300 * 300).reshape(300, 300)) / 255
    bar = picture[15:-15, 300 + int(0.2 * maps.BAR_PX)]
    np.testing.assert_allclose(bar[[2, -3]], [VIRIDIS(1.0)[:3], VIRIDIS(0.0)[:3]], atol=0.05)
    beside = picture[:, 300 + int(0.4 * maps.BAR_PX) :]
    assert (beside < 0.3).all(axis=-1).sum() > 300, "no text"


@pytest.mark.parametrize("depth", [np.full((30, 40), 0.3), np.full((30, 40), np.nan), np.full((30, 40), np.inf)])
def test_maps_without_a_range_have_a_picture(depth):
    assert maps.depth_picture(depth).shape[0] >= maps.LEAST_HEIGHT_PX


def test_confidence_has_the_whole_range():
    picture = maps.confidence_picture(np.tile(np.linspace(0, 1, 300), (300, 1))) / 255
    np.testing.assert_allclose(picture[150, [0, 299]], [VIRIDIS(0.0)[:3], VIRIDIS(1.0)[:3]], atol=STEP)


def test_each_pixel_of_the_mosaic_has_the_colour_of_its_filter():
    """Set-up: all pixels at the same level. Expectation: the tints in the mosaic's order, black at the black level."""
    sensor = recon_scenes.da_mobile(8, 8).sensor
    picture = maps.coloured_mosaic(np.full((8, 8), 500), sensor)
    for y in range(8):
        for x in range(8):
            name = sensor.mosaic[y % len(sensor.mosaic)][x % len(sensor.mosaic[0])]
            np.testing.assert_allclose(picture[y, x], maps.TINT[name], rtol=1e-6)
    assert not maps.coloured_mosaic(np.full((8, 8), sensor.black_level_dn), sensor).any()
