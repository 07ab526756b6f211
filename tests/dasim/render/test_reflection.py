"""Surfaces in Mitsuba: textures against their trees and between variants; metals, glass and coats in a furnace."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dasim.camera import radiometry
from dasim.materials import library
from dasim.materials.library import Coated, Diffuse, Metal, Mixture
from dasim.spectra.grid import WAVELENGTH_NM
from tests.support import bsdf_values

ROOT = Path(__file__).parents[3]
SINGLE = 2e-5  # relative: single precision, and spectra printed with nine digits
BETWEEN = 5e-3  # relative, between variants: scalar_spectral's bitmaps and coats have tables of half that step
VANISHES = 0.01  # of the dome, mean over the middle of an object
NOISE = 0.06  # of a pixel of 256 rays that each find the dome or another object
ABSORBED = 0.02  # of the dome by glass: paths end after six legs


@pytest.fixture(scope="module")
def reflection(renderer):
    from dasim.render import reflection

    return reflection


@pytest.fixture(scope="module")
def here(reflection) -> dict[str, list[list[float]]]:
    return bsdf_values.values()


def bilinear(image: np.ndarray, u: float, v: float) -> float:
    """Value of an image whose bottom row is at v = 0, mirrored at its edges."""
    height, width = image.shape
    x, y = u * width - 0.5, v * height - 0.5
    total = 0.0
    for dx in (0, 1):
        for dy in (0, 1):
            column, row = int(np.floor(x)) + dx, int(np.floor(y)) + dy
            share = (1 - abs(x - column)) * (1 - abs(y - row))
            column, row = (
                min(n % (2 * size), 2 * size - 1 - n % (2 * size)) for n, size in ((column, width), (row, height))
            )
            total += share * image[height - 1 - row, column]
    return total


def by_hand(surface, u: float, v: float) -> np.ndarray:
    """Reflectance of a diffuse tree at a place, at the wavelengths of ``bsdf_values``."""
    if isinstance(surface, Diffuse):
        return np.interp(bsdf_values.WAVELENGTHS_NM, WAVELENGTH_NM, surface.reflectance)
    share = bilinear(surface.weight, u * surface.repeat[0], v * surface.repeat[1])
    return (1 - share) * by_hand(surface.first, u, v) + share * by_hand(surface.second, u, v)


@pytest.mark.parametrize("name", [*library.NEAR_INFRARED_RULES, "layers"])
def test_textures_are_their_trees(here, name):
    """Expectation: reflectance cos / pi, each image bilinear with its own repeats, at pixel centres and between."""
    surface = bsdf_values.surfaces()[name]
    cosine = bsdf_values.directions()[0][2]
    for (u, v), values in zip(bsdf_values.UV, here[name], strict=True):
        np.testing.assert_allclose(values, by_hand(surface, u, v) * cosine / np.pi, rtol=SINGLE, atol=1e-7)


def test_variants_agree_on_every_kind_of_mixture(here, jit):
    """Rationale: a JIT variant has one texture of our own where ``scalar_spectral`` nests blends.

    Expectation: the same values for every rule, for layers, coats over them, and blends with metals.
    """
    command = [sys.executable, bsdf_values.__file__, "scalar_spectral"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    scalar = json.loads(done.stdout.splitlines()[-1])
    assert list(scalar) == list(here)
    for name, values in here.items():
        np.testing.assert_allclose(values, scalar[name], rtol=BETWEEN, atol=1e-6, err_msg=name)


# --- metals --------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(library.CONDUCTORS))
def test_metals_reflect_by_their_constants_up_to_830_nm(reflection, name):
    """Expectation: a mirror's weight in Mitsuba is Fresnel's reflectance, finite and below one from 400 to 830 nm."""
    import mitsuba as mi

    mirror = Metal(library.CONDUCTORS[name], 0.0)
    expected = reflection.normal_reflectance(mirror)
    assert np.isfinite(expected).all() and 0.3 < expected.min() and expected.max() < 1
    bsdf = reflection.surface_bsdf(mirror, flip=False)
    for start in (0, 50, 120, len(WAVELENGTH_NM) - 4):
        si = mi.SurfaceInteraction3f()
        si.wi, si.wavelengths = mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(*WAVELENGTH_NM[start : start + 4].tolist())
        _, weight = bsdf.sample(mi.BSDFContext(), si, 0.5, mi.Point2f(0.5, 0.5))
        np.testing.assert_allclose(np.ravel(np.array(weight)), expected[start : start + 4], rtol=1e-4)


def test_gold_and_copper_open_in_the_red_and_silver_is_even(reflection):
    def at(name: str, *wavelengths_nm: float) -> np.ndarray:
        curve = reflection.normal_reflectance(Metal(library.CONDUCTORS[name], 0.0))
        return np.interp(wavelengths_nm, WAVELENGTH_NM, curve)

    for name in ("gold", "copper"):
        blue, near = at(name, 450, 800)
        assert blue < 0.65 and near > 0.94
    assert at("silver", 450, 600, 800).min() > 0.91
    assert 0.84 < at("aluminium", 800)[0] < at("aluminium", 550)[0] < 0.93, "its interband dip lies at 825 nm"


# --- energy --------------------------------------------------------------------------------------


def ball(name: str, x: float, y: float, material: str) -> dict:
    place = (x, y, 40)
    return {"name": name, "shape": "sphere", "radius_cm": 3.5, "position_cm": place, "material": material}


def test_what_absorbs_nothing_vanishes_in_an_even_dome(make_scene, loaded, wide):
    """Set-up: balls of glass, of a perfect diffuser, and of that under a smooth and a rough coat, and a pane of glass.

    Expectation: in their middles they are as bright as the dome around them, and nothing is brighter than it. Glass
    lets light in and out again in two of the path's six legs; what turns in it longer is lost.
    """
    from dasim.render import passes

    white = {"kind": "spectrum", "points": [(400, 1.0), (830, 1.0)]}
    materials = {"white": white}
    materials |= {f"coat-{alpha}": {"kind": "coated", "base": white, "roughness": alpha} for alpha in (0.0, 0.2)}
    balls = {"glass": (-9, -5), "white": (0, -5), "coat-0.0": (9, -5), "coat-0.2": (-9, 5)}
    things = [ball(name, x, y, name) for name, (x, y) in balls.items()]
    pane = {"name": "pane", "shape": "plane", "size_cm": (8, 8), "position_cm": (0, 5, 40), "rotation_deg": (0, 30, 0)}
    scene = loaded(make_scene(*things, pane | {"material": "glass-pane"}, materials=materials))
    camera = wide()
    rate = passes.pinhole_pass(scene, camera, passes.Sampling(256, 0))
    # cos^4 falls off towards the corners: an empty picture is the reference
    empty = passes.pinhole_pass(
        loaded(make_scene(ball("far", 0, 900, "white"), materials=materials)), camera, passes.Sampling(16, 0)
    )
    ratio = rate / empty
    assert (empty > 0).all()
    assert ratio.max() < 1 + NOISE
    px_per_cm = 3.63 / 0.05 / 40  # image distance (mm), pitch (mm), distance (cm)
    for name, (x, y) in (balls | {"pane": (0, 5)}).items():
        column, row = round(24 + x * px_per_cm), round(18 + y * px_per_cm)
        middle = ratio[row - 1 : row + 2, column - 1 : column + 2]
        np.testing.assert_allclose(middle.mean(axis=(0, 1)), 1.0, atol=VANISHES, err_msg=name)
    glass = ratio[2:17, 1:15]  # all of the ball
    assert glass.mean() > 1 - ABSORBED


def test_glass_ball_shows_the_wall_behind_it_the_other_way_round(make_scene, loaded, wide, reflection):
    """Set-up: a wall, white to the left and black to the right, 40 cm away; a ball of glass 20 cm away.

    Expectation: the ball shows white to the right and black to the left. Both surfaces let (1 - R)^2 of the light pass,
    R = ((n - 1) / (n + 1))^2 with n = 1.519 (BK7 at 550 nm), 0.917 in all; nothing is absorbed, and what is reflected,
    0.083, comes from the dome in front, which is as bright as the white wall over its reflectance. Ground truth is the
    depth of the ball's front, not of what is seen in it.
    """
    from dasim.render import passes, truth

    wall = {"shape": "plane", "size_cm": (50, 100)}
    left = wall | {"name": "left", "position_cm": (-25, 0, 40), "material": "white-paper"}
    right = wall | {"name": "right", "position_cm": (25, 0, 40), "material": "carbon-black"}
    glass = {"name": "ball", "shape": "sphere", "radius_cm": 3, "position_cm": (0, 0, 20), "material": "glass"}
    camera = wide()
    scene = loaded(make_scene(left, right, glass))
    rate = passes.pinhole_pass(scene, camera, passes.Sampling(256, 0))[..., 1] / radiometry.relative_illumination(
        camera
    )
    beside = rate[16:20, 5:10].mean()  # the wall outside the ball
    passed = (1 - ((1.519 - 1) / (1.519 + 1)) ** 2) ** 2
    curves = [
        reflection.normal_reflectance(library.surface(name, Path("."))) for name in ("white-paper", "carbon-black")
    ]
    white, black = (float(curve[WAVELENGTH_NM == 550][0]) for curve in curves)
    for columns, wall_seen in ((slice(26, 28), white), (slice(20, 22), black)):
        expected = (passed * wall_seen + 1 - passed) / white
        assert rate[16:20, columns].mean() / beside == pytest.approx(expected, abs=ABSORBED)
    depth = truth.geometry(scene, camera).depth_m
    assert depth[18, 24] == pytest.approx(0.17, rel=1e-3) and depth[18, 4] == pytest.approx(0.40, rel=1e-3)


def test_coats_keep_the_reflectance_of_their_base(reflection):
    """Set-up: reflectance into the hemisphere at normal incidence, by sampling, less the gloss.

    Expectation: a white base reflects all that is not gloss, whatever the coat's roughness and index; a grey base in
    proportion.
    """
    import drjit as dr
    import mitsuba as mi

    if mi.variant().startswith("scalar"):
        pytest.skip("a hundred thousand samples one by one")

    def albedo(base: float, roughness: float, index: float) -> float:
        coat = Coated(Diffuse(np.full(len(WAVELENGTH_NM), base)), roughness, index)
        bsdf = reflection.surface_bsdf(coat, flip=False)
        si = dr.zeros(mi.SurfaceInteraction3f, 100_000)
        si.wi, si.wavelengths = mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(600.0)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, 100_000)
        _, weight = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())
        return float(np.mean(np.array(weight[0])))

    for roughness, index in ((0.05, 1.5), (0.2, 1.5), (0.4, 1.5), (0.2, 1.33)):
        gloss = ((index - 1) / (index + 1)) ** 2
        gloss_loss = 0.5 * gloss  # of the gloss itself, in rough coats
        assert albedo(1.0, roughness, index) == pytest.approx(1.0, abs=VANISHES + gloss_loss)
        diffuse = albedo(0.5, roughness, index) - albedo(0.0, roughness, index)
        assert diffuse == pytest.approx(0.5 * (1 - gloss), abs=VANISHES)


def test_normal_reflectance_of_a_texture_is_no_question(reflection):
    plain = Diffuse(library.reflectance("sand"))
    with pytest.raises(TypeError):
        reflection.normal_reflectance(Mixture(np.zeros((2, 2), np.float32), plain, plain))
    pane = reflection.normal_reflectance(library.surface("glass-pane", Path(".")))
    assert pane == pytest.approx(2 * 0.0426 / 1.0426, abs=1e-3)
