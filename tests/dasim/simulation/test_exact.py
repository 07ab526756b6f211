"""The exact pictures: their noise, and their colours in focus."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.simulation import exact as exact_pictures
from dasim.simulation.simulate import simulate

DOME = {"kind": "dome", "illuminant": "D55", "lux": 400.0}


@pytest.mark.slow
@pytest.mark.parametrize(("spherical_nm", "pictures"), [(0.0, ["sharp_e"]), (60.0, ["sharp_e", "focus_e"])])
def test_exact_pictures_have_more_samples_where_they_are_noisy(
    make_scene, da_mobile, lamp, renderer, monkeypatch, spherical_nm, pictures
):
    """Rationale: an all-in-focus picture is scored against ``focus_e``, whose noise counts as an error of it.

    Set-up: a ball of gold before a matt wall, without aberrations, and with them, where stops have rays of their own in
    focus; each twice with other random numbers, and with as many samples everywhere for comparison. Expectation: over
    the ball, less than 0.8 of the noise in ``focus_e``, and less in ``sharp_e``, which has 32 samples everywhere
    besides.
    """
    if renderer.startswith("scalar"):
        pytest.skip("as many samples everywhere")
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 40), "material": "sand"}
    gold = {"kind": "metal", "metal": "gold", "roughness": 0.3}
    ball = {"name": "ball", "shape": "sphere", "radius_cm": 0.2, "position_cm": (0, 0, 30), "material": "gold"}
    scene = make_scene(wall, ball, lights=[DOME, lamp], materials={"gold": gold})
    camera = cameras.cropped(da_mobile, 96, 72)
    values = camera.model_dump()
    camera = type(camera).model_validate(
        values | {"lens": values["lens"] | {"wavefront_nm": {"spherical": spherical_nm}}}
    )

    def noise_of() -> list[float]:
        shots = (simulate(scene, camera, seed, spp=2, exposure=Exposure(time_s=0.01)).truth for seed in (1, 2))
        one, other = shots
        there = one.object_id == 2
        return [
            float(np.sqrt(np.mean((getattr(one, name)[there] - getattr(other, name)[there]) ** 2))) for name in pictures
        ]

    ours = noise_of()
    monkeypatch.setattr(
        exact_pictures, "allotted_spp", lambda pilots, mean: np.full((len(pilots), 72, 96), int(mean / 2))
    )
    even = noise_of()
    most = {"sharp_e": 1.0, "focus_e": 0.8}
    assert all(one < most[name] * other for name, one, other in zip(pictures, ours, even, strict=True)), (ours, even)


def test_the_picture_in_focus_has_the_colours_of_an_even_card_with_axial_colour(make_scene, renderer, jit):
    """Set-up: a green card under a fluorescent lamp through a lens with axial colour, in focus.

    Expectation: without blur and texture, ``focus_e`` is ``sharp_e`` within 0.3 %; with one wavelength per ray it was
    0.6 to 1.5 % off.
    """
    plain = cameras.cropped(cameras.load_camera("chromatic-mobile"), 32, 24)
    camera = plain.model_copy(update={"lens": plain.lens.model_copy(update={"focus_distance_m": 0.4})})
    light = {"kind": "dome", "illuminant": "energy-saving-3500K", "lux": 1000.0}
    card = {
        "shape": "plane",
        "size_cm": (40, 40),
        "position_cm": (0, 0, 40),
        "material": "checker-green",
        "name": "card",
    }
    truth = simulate(make_scene(card, lights=[light]), camera, spp=2).truth
    ratio = truth.focus_e.mean(axis=(0, 1)) / truth.sharp_e.mean(axis=(0, 1))
    np.testing.assert_allclose(ratio, 1, atol=3e-3)
