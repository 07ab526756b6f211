"""Distortion: points of a scene land where the polynomial's inverse says, in pictures, truth and illumination."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import distortion, geometry, radiometry, rings
from dasim.camera.specification import Camera

BARREL, PINCUSHION = (12.0, -300.0), (-8.0,)  # per mm^2 and mm^4: 4 and -3 % at 38 px
CENTROID_PX = 0.06
SIZE_PX = 96
DEPTH_CM = 30.0


def bent(camera: Camera, per_mm: tuple[float, ...]) -> Camera:
    """A frame whose corner is 0.115 mm from the axis."""
    data = dasim.refocused(dasim.cropped(camera, SIZE_PX, SIZE_PX), DEPTH_CM / 100).model_dump(mode="json")
    data["lens"]["distortion_per_mm"] = per_mm
    return parse(Camera, data, "bent")


def lands_at(camera: Camera, pinhole_px: float) -> float:
    """Distance from the axis at which the lens shows what a pinhole shows at another, by the polynomial's roots."""
    pitch_mm = camera.sensor.pixel_pitch_um * 1e-3
    powers = [0.0, 1.0]
    for value in camera.lens.distortion_per_mm:
        powers += [0.0, value]
    powers[0] = -pinhole_px * pitch_mm
    roots = np.polynomial.Polynomial(powers).roots()
    real = roots[np.abs(roots.imag) < 1e-9].real
    return float(real[real > 0].min() / pitch_mm)


@pytest.mark.slow
@pytest.mark.parametrize("per_mm", [BARREL, PINCUSHION])
def test_sources_land_by_the_inverse(jit, make_scene, da_mobile, lamp, per_mm):
    """Set-up: three small discs in focus, along a row, a column and a diagonal, through `dasim.simulate`.

    Expectation: their centroids in `mean_e` and in the pinhole picture, and the middles of their regions of the truth,
    lie at the root of the polynomial, which is a pixel and more from the pinhole's.
    """
    camera = bent(da_mobile, per_mm)
    image_px = geometry.image_distance_m(camera) / 1.7e-6
    scale = DEPTH_CM / image_px
    directions = np.array([[1.0, 0.0], [0.0, -1.0], [-(0.5**0.5), 0.5**0.5]])
    discs = [
        {"name": f"spot-{k}", "shape": "disc", "radius_cm": 3 * scale, "material": "white-paper"}
        | {"position_cm": (*(38.0 * scale * along), DEPTH_CM)}
        for k, along in enumerate(directions)
    ]
    shot = dasim.simulate(make_scene(*discs, lights=[lamp]), camera, spp=64, exposure=dasim.Exposure(time_s=0.01))
    away_px = lands_at(camera, 38.0)
    assert abs(away_px - 38.0) > 1
    y, x = np.indices((SIZE_PX, SIZE_PX)) + 0.5 - SIZE_PX / 2
    for number, along in enumerate(directions, 1):
        near = np.hypot(x - away_px * along[0], y - away_px * along[1]) < 12
        seen = (shot.truth.object_id == number).astype(float)
        for picture in (shot.truth.mean_e[..., 1] * near, shot.truth.sharp_e[..., 1] * near, seen):
            centroid = np.array([(x * picture).sum(), (y * picture).sum()]) / picture.sum()
            limit = CENTROID_PX if picture is not seen else 3 * CENTROID_PX
            np.testing.assert_allclose(centroid, away_px * along, atol=limit)


@pytest.mark.slow
def test_truth_of_a_straight_lens_comes_from_the_same_rays(jit, make_scene, da_mobile, lamp):
    """Rationale: two ways to the geometry: Mitsuba's pinhole sensor, and rays of our own.

    Expectation: with a polynomial that changes nothing, the same depth, normals and objects.
    """
    wall = {"name": "wall", "shape": "plane", "size_cm": (9, 9), "position_cm": (0, 0, 40), "material": "grey-card"}
    ball = {"name": "ball", "shape": "sphere", "radius_cm": 0.5, "position_cm": (0, 0, 30), "material": "white-paper"}
    scene = make_scene(wall, ball, lights=[lamp])
    straight, zero = (
        dasim.simulate(scene, bent(da_mobile, per_mm), spp=1, diffraction="off").truth for per_mm in ((), (0.0,))
    )
    same = straight.object_id == zero.object_id
    assert same.mean() > 0.999 and set(np.unique(zero.object_id)) == {1, 2}
    np.testing.assert_allclose(zero.depth_m[same], straight.depth_m[same], rtol=1e-5)
    np.testing.assert_allclose(zero.normal[same], straight.normal[same], atol=2e-3)


def test_even_surface_has_the_light_of_its_directions(jit, make_scene, da_mobile):
    """Expectation: a dome's light on the sensor is cos^4 of the angle that each pixel sees, within 0.1 %."""
    camera = bent(da_mobile, BARREL)
    pixel = distortion.to_pinhole_px(camera, np.array([47.5, 47.5]))
    expected = np.cos(np.arctan(np.hypot(*pixel) * 1.7e-6 / geometry.image_distance_m(camera))) ** 4
    assert radiometry.relative_illumination(camera)[-1, -1] == pytest.approx(expected, rel=1e-12)
    assert rings.square_of_sine(camera)[-1, -1] == pytest.approx(1 - np.sqrt(expected), rel=1e-9)


def test_places_and_lengths(da_mobile):
    """Expectation: the polynomial written out; a frame's corner moves out by barrel distortion only."""
    camera = bent(da_mobile, BARREL)
    place = np.array([[30.0, 0.0], [-10.0, 20.0]])
    r2 = (place**2).sum(axis=1) * 1.7e-3**2
    np.testing.assert_allclose(
        distortion.to_pinhole_px(camera, place), place * (1 + 12 * r2 - 300 * r2**2)[:, None], rtol=1e-12
    )
    assert distortion.most_outwards_px(camera) > 1
    assert distortion.most_outwards_px(bent(da_mobile, PINCUSHION)) == 0
    assert distortion.most_outwards_px(bent(da_mobile, ())) == 0


def test_refused(da_mobile, make_scene, lamp):
    with pytest.raises(InputError, match=r"lens\.distortion_per_mm: two places of the frame show the same") as problem:
        bent(da_mobile, (-40.0,))
    assert "\n" not in str(problem.value)
    card = {"name": "card", "shape": "plane", "size_cm": (4, 4), "position_cm": (0, 0, 20), "material": "grey-card"}
    with pytest.raises(InputError, match=r"lens\.distortion_per_mm is set"):
        dasim.simulate(make_scene(card, lights=[lamp]), bent(da_mobile, BARREL), variant="scalar_spectral")


def test_kernels_have_the_angle_of_the_light(da_mobile):
    """Expectation: the kernel of a place on a bent picture is that of the pinhole's place, at the same angle."""
    data = da_mobile.model_dump(mode="json")
    data["lens"]["distortion_per_mm"] = (0.03,)  # 16 % at 1360 px
    camera, place_px = parse(Camera, data, "bent"), np.array([1088.0, 816.0])
    bend = 1 + 0.03 * (1360 * 1.7e-3) ** 2
    there, straight = (
        dasim.psf(of, 0.4, "IR", "D65", size=21, field_px=tuple(at))
        for of, at in ((camera, place_px), (da_mobile, bend * place_px))
    )
    np.testing.assert_allclose(there, straight, atol=1e-9)
    unbent = dasim.psf(da_mobile, 0.4, "IR", "D65", size=21, field_px=tuple(place_px))
    assert np.abs(there - unbent).max() > 0.1 * unbent.max()
