"""Pixels whose rays end on one surface in even light, against the places of edges and shadows in simple scenes."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import geometry
from dasim.render import one_surface
from dasim.spectra.illuminants import illuminant

WALL = {"name": "wall", "shape": "plane", "size_cm": (200, 200), "material": "ceramic-white", "position_cm": (0, 0, 60)}
CARD = {"name": "card", "shape": "plane", "size_cm": (60, 60), "material": "ceramic-white"}
DOME = {"kind": "dome", "illuminant": "D65", "lux": 300}
LAMP = {
    "kind": "lamp",
    "illuminant": "D65",
    "lux": 300,
    "position_cm": (-60, 0, -20),
    "target_cm": (0, 0, 60),
    "radius_cm": 1,
}
MARGIN_PX = 4


@pytest.fixture
def edges(jit, loaded, make_scene, wide):
    """Function that returns the camera and the blur at the edges of a scene of some objects and lights."""
    from dasim.render import passes

    def found(*objects, lights):
        camera, scene = wide(), loaded(make_scene(*objects, lights=lights))
        field = passes.irradiance_field(scene, camera, illuminant("D65"), 0.0, 64, 7)
        return camera, one_surface.edge_blur_px(scene, camera, MARGIN_PX, field)

    return found


def test_a_plane_is_one_surface(edges):
    slanted = WALL | {"rotation_deg": (30, 20, 0)}
    for wall in (WALL, slanted):
        camera, edge_px = edges(wall, lights=[DOME])
        inside = edge_px[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
        assert inside.shape == (camera.sensor.height_px, camera.sensor.width_px)
        assert (inside < 0).mean() > 0.99


def test_strips_of_rows_leave_no_edges(edges, monkeypatch):
    """Set-up: a wall with a slanted card before it, in strips of 5 rows and in one piece. Expectation: the same map."""
    card = CARD | {"position_cm": (10, 5, 50), "rotation_deg": (20, 10, 30)}
    maps = []
    for rows in (5, 10_000):
        monkeypatch.setattr(one_surface, "STRIP_PX", rows)
        maps.append(edges(WALL, card, lights=[LAMP])[1])
    np.testing.assert_array_equal(*maps)
    assert 0.05 < (maps[0] >= 0).mean() < 0.8


def test_a_step_of_a_millimetre_between_parallel_surfaces_is_an_edge(edges):
    """Expectation: at the card's border, with the blur of the wall's depth, and nowhere far from it."""
    card = CARD | {"position_cm": (30, 0, 59.9)}
    camera, edge_px = edges(WALL, card, lights=[DOME])
    middle = camera.sensor.width_px // 2 + MARGIN_PX
    row = edge_px[len(edge_px) // 2]
    assert (row[middle - 1 : middle + 1] >= 0).any()
    assert row[middle - 1 : middle + 1].max() == pytest.approx(abs(geometry.blur_px(camera, 0.6)), rel=0.02)
    assert (row[middle + 8 : -MARGIN_PX] < 0).all()
    seen = one_surface.seen(edge_px, MARGIN_PX, 1.0)[camera.sensor.height_px // 2]
    assert not seen[middle - MARGIN_PX - 2 : middle - MARGIN_PX + 2].any()


def test_a_smaller_stop_sees_more_pixels_of_one_surface():
    edge_px = np.full((40, 60), -1.0, np.float32)
    edge_px[:, 30] = 20.0
    whole, hole = (one_surface.seen(edge_px, 0, outer) for outer in (1.0, 0.4))
    assert not whole[:, 20:41].any() and whole[:, :17].all()
    assert hole[:, 20:22].all() and not hole[:, 26:35].any()


def test_the_edge_of_a_shadow_is_an_edge(edges):
    """Set-up: a card in front of a wall, left of the frame, whose shadow ends in the frame."""
    card = CARD | {"size_cm": (40, 200), "position_cm": (-50, 0, 40)}
    _, lit = edges(WALL, lights=[LAMP, DOME])
    _, shaded = edges(WALL, card, lights=[LAMP, DOME])
    assert (lit[MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX] < 0).mean() > 0.95
    assert (shaded >= 0).sum() > (lit >= 0).sum()


def test_nothing_is_even_without_a_field(jit, loaded, make_scene, wide):
    assert (one_surface.edge_blur_px(loaded(make_scene(WALL, lights=[DOME])), wide(), MARGIN_PX, None) >= 0).all()
