"""Rendered electrons: radiometry from first principles, blur by moments, and two renderers against each other."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dasim.camera import geometry
from dasim.camera import specification as cameras
from validation.references.radiometry import wall_electrons

ROOT = Path(__file__).parents[3]
RADIOMETRY = 0.01  # spectra on different grids 0.2 %, sampling noise, and a patch of pixels at the corner
AREAS = 0.005  # both stops see the same light: what is left is sampling noise
MOMENTS = 0.02  # a second moment of about 60,000 hits is known to 1 %
T_BEYOND_4 = 1.3e-3  # share of Student's t with 14 degrees of freedom beyond 4
SEEDS = 8  # pictures a renderer: 14 degrees of freedom for the difference of two means


@pytest.fixture(scope="module")
def passes(renderer):
    from dasim.render import passes

    return passes


@pytest.fixture(scope="module")
def grey_wall(make_scene, loaded):
    """A grey wall that fills every view, under an even dome of 500 lux of illuminant A."""
    wall = {"name": "wall", "shape": "plane", "size_cm": (400, 400), "position_cm": (0, 0, 40), "material": "grey-card"}
    return loaded(make_scene(wall))


@pytest.mark.parametrize("stop", [0, 1])
def test_electrons_from_first_principles(passes, grey_wall, wide, stop):
    """Rationale: exposure and gain mean what they mean on a camera only if the electrons are right.

    Set-up: E = pi L (r/s)^2 cos^4, L = rho E_wall / pi, integrated over wavelength by quadrature with CODATA
    constants and Planck's law; cos^4 reaches 0.77 in this view's corner. Expectation: 1 % in the middle and
    the corner, and 0.1 % of the channel's light through both stops (the other stop's share is all in the coating's
    edge, which the wavelength grid of 2 nm knows to some per cent).
    """
    camera = wide()
    rate = passes.stop_pass(grey_wall, camera, camera.stops[stop], passes.Sampling(64, 1))
    ratio, side = camera.stops[stop].radius_ratio, camera.stops[stop].name
    for channel in range(4):
        for rows, columns in ((slice(15, 21), slice(21, 27)), (slice(0, 6), slice(0, 6))):
            y, x = np.mean([rows.start, rows.stop]) - 18, np.mean([columns.start, columns.stop]) - 24
            expected = wall_electrons(camera, channel, x, y, ratio, side)
            other = camera.stops[1 - stop]
            whole = expected + wall_electrons(camera, channel, x, y, other.radius_ratio, other.name)
            limit = RADIOMETRY * expected + 1e-3 * whole
            assert rate[rows, columns, channel].mean() == pytest.approx(expected, abs=limit), (channel, y, x)


def test_hole_collects_the_square_of_its_radius(passes, grey_wall, wide):
    """Expectation: the same glass without a hole would let in 1 / 0.46^2 of the near-infrared."""
    camera = wide(16, 12)
    hole = camera.stops[1]
    whole = hole.model_copy(update={"radius_ratio": 1.0})
    small, large = (passes.stop_pass(grey_wall, camera, stop, passes.Sampling(256, 2)) for stop in (hole, whole))
    assert small[..., 3].mean() / large[..., 3].mean() == pytest.approx(0.46**2, rel=AREAS)


def test_stops_add_up_to_the_pinhole_picture_on_even_areas(passes, grey_wall, wide):
    """Expectation: where nothing changes across the blur, a lens and a pinhole of the same light see the same."""
    camera = wide(16, 12)
    lens = sum(passes.stop_pass(grey_wall, camera, stop, passes.Sampling(256, 3)) for stop in camera.stops)
    pinhole = passes.pinhole_pass(grey_wall, camera, passes.Sampling(256, 4))
    np.testing.assert_allclose(lens.mean(axis=(0, 1)), pinhole.mean(axis=(0, 1)), rtol=AREAS)


@pytest.mark.parametrize("depth_cm", [10, 20])
@pytest.mark.parametrize("stop", [0, 1])
def test_blur_has_the_variance_of_a_disc(passes, loaded, make_scene, da_mobile, lamp, depth_cm, stop):
    """Rationale: depth is read from blur, so the rendered blur's size must be right in each channel.

    Set-up: a disc 4 px in radius before nothing, 10 and 20 cm away, focus 40 cm, geometric optics.
    Expectation: variance along y and x of c^2 / 16 (blur of this stop), r^2 / 4 (source) and 1 / 12 (pixel); in the
    middle of the frame; c by similar triangles.
    """
    image_mm = 3.6 * 400 / 396.4
    radius_cm = 4 * 1.7e-3 * depth_cm / image_mm
    disc = {"name": "disc", "shape": "disc", "radius_cm": radius_cm, "position_cm": (0, 0, depth_cm)}
    scene = loaded(make_scene(disc | {"material": "white-paper"}, lights=[lamp]))
    camera = cameras.cropped(da_mobile, 48, 48)
    used = camera.stops[stop]
    rate = passes.stop_pass(scene, camera, used, passes.Sampling(256, 5))
    picture = rate[..., 1 if stop == 0 else 3]
    picture = picture / picture.sum()
    place = np.arange(48) - 23.5
    blur_px = used.radius_ratio * (3.6 / 2.8) * image_mm * (0.1 / depth_cm - 1 / 400) / 1.7e-3
    expected = blur_px**2 / 16 + 4**2 / 4 + 1 / 12
    for line in (picture.sum(axis=1), picture.sum(axis=0)):
        mean = line @ place
        assert mean == pytest.approx(0, abs=0.05)
        assert line @ place**2 - mean**2 == pytest.approx(expected, rel=MOMENTS)
    assert blur_px == pytest.approx(used.radius_ratio * geometry.blur_px(camera, depth_cm / 100), rel=1e-9)


def test_seeds_decide_the_bytes(passes, make_scene, loaded, wide):
    """Expectation: the same seed gives the same bytes; another one others, and so do the stops of one seed."""
    ball = {"name": "ball", "shape": "sphere", "radius_cm": 6, "position_cm": (0, 0, 25), "material": "brick"}
    scene, camera = loaded(make_scene(ball)), wide(16, 12)

    def picture(seed):
        return passes.stop_pass(scene, camera, camera.stops[0], passes.Sampling(4, seed))

    np.testing.assert_array_equal(picture(0), picture(0))
    assert (picture(0) != picture(1)).mean() > 0.3
    whole = camera.stops[0].model_copy(update={"name": "other", "radius_ratio": 0.999})
    other = passes.stop_pass(scene, camera, whole, passes.Sampling(4, 0)) / 0.999**2
    assert not np.allclose(other, picture(0), rtol=1e-6)


_COMPARED = """
import sys
import numpy as np
from dasim.base.toml import parse
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.render import backend
from dasim.scene.specification import Scene
backend.activate(backend.choose(sys.argv[1]))
import mitsuba as mi
from dasim.render import passes, translate
data = cameras.load_camera("da-mobile").model_dump()
data["sensor"] |= {"width_px": 32, "height_px": 24, "pixel_pitch_um": 40.0, "principal_point_px": [14.0, 8.5]}
camera = parse(Camera, data, "camera")
lamp = {"kind": "lamp", "illuminant": "D65", "lux": 600, "position_cm": [-40, -40, 0], "target_cm": [0, 0, 25],
        "radius_cm": 20}
dome = {"kind": "dome", "illuminant": "A", "lux": 400}
things = [
    {"name": "wall", "shape": "plane", "size_cm": [60, 60], "position_cm": [0, 0, 40], "material": "wood-light"},
    {"name": "ball", "shape": "sphere", "radius_cm": 3, "position_cm": [-2, 0, 20], "material": "leaf-green"},
    {"name": "card", "shape": "plane", "size_cm": [4, 4], "position_cm": [1, 1, 6], "rotation_deg": [0, 40, 0],
     "material": "cotton-red"},
]
scene = parse(Scene, {"name": "compared", "lights": [lamp, dome], "objects": things}, "scene")
loaded = mi.load_dict(translate.scene_dict(scene), optimize=False)
pictures = [
    np.stack([passes.stop_pass(loaded, camera, stop, passes.Sampling(36, seed)) for stop in camera.stops])
    for seed in range(int(sys.argv[3]))
]
np.save(sys.argv[2], np.stack(pictures))
"""


@pytest.mark.slow
def test_ray_loop_agrees_with_the_stock_plugins(jit_variant, tmp_path):
    """Rationale: two independent ways to render a pass: our loop over rays, and Mitsuba's thinlens with specfilm.

    Set-up: a small scene with near and far, red and green, slanted and curved, 8 seeds each, both stops, the axis off
    the frame's middle, no diffraction. Expectation: pixel by pixel Welch's t between the two means. Its square averages
    14 / 12 for 14 degrees of freedom (less degrees where variances differ, so up to 1.5), few lie beyond 4, and no
    channel is brighter as a whole: sums within five of their standard deviations plus 0.2 % of tabulated spectra.
    """
    pictures = []
    for variant in (jit_variant, "scalar_spectral"):
        file = tmp_path / f"{variant}.npy"
        subprocess.run(
            [sys.executable, "-c", _COMPARED, variant, str(file), str(SEEDS)],
            check=True,
            timeout=300,
            cwd=ROOT,
            env={**os.environ, "DASIM_VARIANT": variant},
        )
        pictures.append(np.load(file))
    for stop, channel in ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 3)):
        ours, stock = (item[:, stop, :, :, channel] for item in pictures)
        variance = (ours.var(axis=0, ddof=1) + stock.var(axis=0, ddof=1)) / SEEDS
        difference = ours.mean(axis=0) - stock.mean(axis=0)
        t = difference / np.sqrt(variance)
        assert np.mean(t**2) < 1.5, (stop, channel)
        assert np.mean(np.abs(t) > 4) < 5 * T_BEYOND_4, (stop, channel)
        limit = 5 * np.sqrt(variance.sum()) + 2e-3 * stock.mean(axis=0).sum()
        assert abs(difference.sum()) < limit, (stop, channel)
