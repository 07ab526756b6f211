"""Blur of polygons and masks beside that of rings: mean weights, and small sources against the camera's kernels."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.toml import parse
from dasim.camera import geometry, pointspread, radiometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.materials import library
from dasim.render.wavelengths import draw_density
from dasim.spectra import grid, illuminants

NARROW = {"passes_nm": [[540, 570]]}
STOPS = {
    "annulus": {"shape": "annulus", "inner_ratio": 0.6, "outer_ratio": 0.95},
    "displaced disc": {"shape": "disc", "radius_ratio": 0.3, "centre_ratio": [0.5, -0.3]},
    "displaced ring": {"shape": "annulus", "inner_ratio": 0.25, "outer_ratio": 0.5, "centre_ratio": [-0.1, 0.4]},
    "letter L": {
        "shape": "polygon",
        "corners_ratio": [[-0.6, -0.7], [-0.2, -0.7], [-0.2, 0.3], [0.5, 0.3], [0.5, 0.7], [-0.6, 0.7]],
    },
    "grey mask": {"shape": "mask", "mask": [[0, 0, 0, 0], [0, 1, 0.5, 0], [0, 0, 1, 0], [0, 0, 0, 0]]},
}
CENTROIDS = {  # (x, y) in ratios: letter L by the moments of its stem and foot, the mask by those of its cells
    "annulus": (0.0, 0.0),
    "displaced disc": (0.5, -0.3),
    "displaced ring": (-0.1, 0.4),
    "letter L": (-0.65 / 3, 0.5 / 3),
    "grey mask": (0.25 * 0.5 / 2.5, -0.25 * 0.5 / 2.5),
}
RINGS = 0.002  # a million weights
PATTERNS = 0.005  # tables of steps that fit into memory
ENERGY = 0.03  # 10,000 weighted hits are known to 0.01
CENTROID_PX = 0.1
SOURCE_PX = 2.0
SIDES = {"near": (0.4, 0.18), "far": (0.1, 0.16)}  # focus and depth: blur of +7.9 and -10.6 px
COUNT = 1 << 20


@pytest.fixture(scope="module")
def camera_of(da_mobile):
    """da-mobile with one stop of the shape before green, [48, 48]."""

    def make(shape: str, focus_m: float = 0.4) -> Camera:
        data = da_mobile.model_dump() | {"stops": [{"name": shape} | NARROW | STOPS[shape]]}
        data["lens"] |= {"focus_distance_m": focus_m}
        return cameras.cropped(parse(Camera, data, shape), 48, 48)

    return make


@pytest.mark.parametrize("shape", STOPS)
def test_weights_average_one(jit, camera_of, shape):
    """Rationale: an even area must not change. Set-up: a million draws each at four blurs, at the blur that was
    expected and (0.6 % of light that cannot be drawn there) at another one. Expectation: mean weight 1.
    """
    import drjit as dr
    import mitsuba as mi

    from dasim.render import wave

    camera = camera_of(shape)
    density = draw_density(radiometry.response(camera), radiometry.stop_response(camera, camera.stops[0]))
    blur = wave.blur(camera, camera.stops[0], density, 12.5)
    rng = np.random.default_rng(20)
    wavelength = np.interp(rng.random(COUNT), np.cumsum(density) / np.sum(density), grid.WAVELENGTH_NM)
    first, second = (mi.Point2f(rng.random((2, COUNT), dtype=np.float32)) for _ in range(2))
    limit = RINGS if shape in ("annulus", "displaced disc", "displaced ring") else PATTERNS
    for blur_px, expected_px in ((0.0, 0.0), (1.13, 1.13), (-8.0, -8.0), (12.0, 12.0), (3.07, 6.0), (12.0, 0.0)):
        expected = mi.Float(dr.full(mi.Float, expected_px, COUNT))
        rho, delta, drawn, *_ = blur.draw(first, second, expected, mi.Vector2f(0.0), mi.UInt32(3))
        u = -delta - rho * (blur_px / 2)
        weight = (
            drawn * blur.weights(u, mi.Float(blur_px), mi.Vector2f(0.0), [mi.Float(wavelength.astype(np.float32))])[0]
        )
        lost = 0.006 if blur_px != expected_px else 0.0
        mean = np.array(weight, dtype=np.float64).mean()
        assert -limit - lost < mean - 1 < limit + lost, (blur_px, expected_px, mean)


def lines(picture: np.ndarray) -> np.ndarray:
    """Running sums along x and y, which tell left from right and up from down."""
    return np.concatenate([np.cumsum(picture.sum(axis=0)), np.cumsum(picture.sum(axis=1))])


@pytest.fixture(scope="module")
def spot(jit, loaded, make_scene, camera_of, lamp):
    """Green's picture of a bright disc of 2 px radius before nothing, its light summing to 1, with camera and blur."""
    from dasim.render import passes

    def picture(shape: str, side: str, diffraction: str, spp: int):
        focus_m, depth_m = SIDES[side]
        camera = camera_of(shape, focus_m)
        radius_cm = SOURCE_PX * 1.7e-6 * depth_m / geometry.image_distance_m(camera) * 100
        disc = {"name": "spot", "shape": "disc", "radius_cm": radius_cm, "position_cm": (0, 0, depth_m * 100)}
        scene = make_scene(disc | {"material": "white-paper"}, lights=[lamp])
        sampling = passes.Sampling(spp, 6)
        rate = passes.stop_pass(
            loaded(scene), camera, camera.stops[0], sampling, diffraction=diffraction, max_blur_px=12.0
        )[..., 1]
        return rate / rate.sum(), camera, float(geometry.blur_px(camera, depth_m))

    return picture


@pytest.mark.parametrize(
    ("shape", "side"),
    [
        ("annulus", "near"),
        ("displaced disc", "near"),
        pytest.param("displaced disc", "far", marks=pytest.mark.slow),
        pytest.param("letter L", "near", marks=pytest.mark.slow),
        pytest.param("grey mask", "far", marks=pytest.mark.slow),
    ],
)
def test_small_source_is_spread_by_the_kernel(spot, shape, side):
    """Set-up: the kernel of wave optics at 32 places of the source, summed, both normalised in the frame.

    Expectation: running sums along x and along y within 0.03, and energies within circles about the frame's middle;
    turned by half, all but the annulus differ by more.
    """
    rendered, camera, blur_px = spot(shape, side, "wave", 400)
    light = illuminants.illuminant("D65") * library.reflectance("white-paper")
    kernel_at = pointspread.kernels(camera, [blur_px], light, 49)
    turns = np.arange(32)
    places = SOURCE_PX * np.sqrt((turns + 0.5) / 32) * np.exp(2j * np.pi * turns * 0.381966)
    # The frame has 48 pixels, its centre between two: half a pixel off the middle of 49.
    expected = np.mean([kernel_at(0, (p.imag - 0.5, p.real - 0.5), ...)[0][1] for p in places], axis=0)[:48, :48]
    expected /= expected.sum()
    assert np.abs(lines(rendered) - lines(expected)).max() < ENERGY
    distance = np.hypot(*(np.indices(rendered.shape) - 23.5))
    for radius in np.arange(1.5, 20):
        inside = distance <= radius
        assert rendered[inside].sum() == pytest.approx(expected[inside].sum(), abs=ENERGY), radius
    if shape != "annulus":
        assert np.abs(lines(rendered[::-1, ::-1]) - lines(expected)).max() > 2 * ENERGY


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("shape", STOPS)
def test_displaced_stop_moves_the_picture(spot, shape, side):
    """Expectation: by rays alone the centroid moves by -rho c / 2 with rho the stop's own centroid: to the other side
    for what is nearer than the focus, to the same side behind it; x right, y down.
    """
    rendered, _, blur_px = spot(shape, side, "off", 100)
    place = np.arange(48) - 23.5
    found = np.array([rendered.sum(axis=0) @ place, rendered.sum(axis=1) @ place])
    np.testing.assert_allclose(found, -np.array(CENTROIDS[shape]) * blur_px / 2, atol=CENTROID_PX)
