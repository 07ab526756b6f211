"""Blur through an aberrated lens or a phase step: mean weights, and small sources against a sampled pupil."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import j1

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry, pointspread, radial_pattern, radiometry, zernike
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.camera.stops import Disc
from dasim.camera.wavefront import Phase
from dasim.render.blur_tables import cut_off
from dasim.render.wavelengths import draw_density
from dasim.spectra import grid

GREEN = {"name": "open", "shape": "disc", "radius_ratio": 1.0, "passes_nm": [[540, 570]]}
HOLE = {"name": "hole", "shape": "disc", "radius_ratio": 0.46, "passes_nm": [[700, 830]]}
LENSES = {  # Zernike coefficients in nm RMS, and the step of the hole
    "spherical": ({"spherical": 60.0}, 0.0),
    "phase step": ({}, 1750.0),
    "step and spherical": ({"spherical": -40.0, "defocus": 30.0}, -2300.0),
    "coma": ({"coma": 50.0, "vertical_coma": -30.0}, 0.0),
    "astigmatism and step": ({"astigmatism": 60.0}, 1750.0),
}
RINGS = 0.003  # a million weights
PATTERNS = 0.006  # tables of steps that fit into memory
ENERGY = 0.02  # 7,000 weighted hits are known to 0.01
SIDES = {"near": (0.4, 0.25), "far": (0.2, 0.4), "focus": (0.3, 0.3)}  # focus and depth, m
SOURCE_PX = 1.5
MAX_BLUR_PX = 8.0
COUNT = 1 << 20
SIZE, ACROSS = 1024, 128  # samples of the test's own pupil grid, and of the lens in it


def lens(da_mobile, name: str, focus_m: float = 0.4, passes: str = "open") -> Camera:
    """da-mobile with aberrations and green light only, [48, 48]."""
    errors, step = LENSES[name]
    data = da_mobile.model_dump() | {"stops": [GREEN, HOLE | {"phase_nm": step}]}
    data["lens"] |= {"focus_distance_m": focus_m, "wavefront_nm": errors}
    return cameras.cropped(parse(Camera, data, name), 48, 48)


@pytest.mark.slow
@pytest.mark.parametrize("diffraction", ["wave", "off"])
def test_coefficients_of_all_stops_are_those_of_the_lens(jit, da_mobile, diffraction):
    """Expectation: the same pixels from `dasim.simulate`; in the hole alone, infrared as with both, but for the
    light of the open lens that it receives, and, where all draw the same samples, green as with none.
    """
    import dasim

    pictures = {}
    for name in ("lens", "stops", "hole", "none"):
        data = cameras.cropped(da_mobile, 24, 16).model_dump()
        for part in {"lens": [data["lens"]], "stops": data["stops"], "hole": data["stops"][1:], "none": []}[name]:
            part["wavefront_nm"] = {"spherical": 60.0}
        shot = dasim.simulate("desk", parse(Camera, data, name), spp=4, diffraction=diffraction)
        pictures[name] = shot.truth.mean_e / shot.capture.exposure_s
    np.testing.assert_array_equal(pictures["stops"], pictures["lens"])

    def off(reference: str, channel: int) -> float:
        return float(np.median(np.abs(pictures["hole"][..., channel] / pictures[reference][..., channel] - 1)))

    assert off("lens", 3) < 0.2 * off("none", 3)
    if diffraction == "off":
        assert off("none", 1) < 0.2 * off("lens", 1)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name.startswith("astigmatism") else ()) for name in LENSES]
)
def test_weights_average_one(jit, da_mobile, name):
    """Rationale: an even area must not change. Set-up: a million draws each at five blurs of both signs. Expectation:
    mean weight 1.
    """
    import drjit as dr
    import mitsuba as mi

    from dasim.render import wave

    camera = lens(da_mobile, name)
    density = draw_density(radiometry.response(camera), radiometry.stop_response(camera, camera.stops[0]))
    blur = wave.blur(camera, camera.stops[0], density, MAX_BLUR_PX)
    rng = np.random.default_rng(20)
    wavelength = np.interp(rng.random(COUNT), np.cumsum(density) / np.sum(density), grid.WAVELENGTH_NM)
    first, second = (mi.Point2f(rng.random((2, COUNT), dtype=np.float32)) for _ in range(2))
    limit = RINGS if pointspread.is_radial(camera, camera.stops[0]) else PATTERNS
    for blur_px in (0.0, 1.13, -1.13, -7.0, 7.5):
        expected = mi.Float(dr.full(mi.Float, blur_px, COUNT))
        rho, delta, drawn, *_ = blur.draw(first, second, expected, mi.Vector2f(0.0), mi.UInt32(3))
        u = -delta - rho * (blur_px / 2)
        weight = (
            drawn * blur.weights(u, mi.Float(blur_px), mi.Vector2f(0.0), [mi.Float(wavelength.astype(np.float32))])[0]
        )
        mean = np.array(weight, dtype=np.float64).mean()
        assert abs(mean - 1) < limit, (blur_px, mean)


@pytest.mark.parametrize("phase", [0.0, np.pi / 2, np.pi])
def test_a_step_keeps_its_peak_and_its_light_where_the_table_ends(phase):
    """Expectation: |1 - a + a exp(i phi)|^2 of the peak without a step, with a the hole's share of the area, and a unit
    integral; kernels that are scaled as a whole are off by up to 0.009 of the peak.
    """
    radius, waves, end, area = np.arange(0.0, 20.0, 0.02), np.zeros(1), np.full(1, 16.0), 0.46**2
    hole = Disc(name="hole", radius_ratio=0.46)
    none = (0.0,) * len(zernike.TERMS)
    flat = radial_pattern.wave_profile(radius, waves)
    stepped = radial_pattern.wave_profile(radius, waves, phase=Phase(none, hole, np.exp(1j * phase)))
    kernel, scaled = cut_off(stepped, radius, end, 16.0, like=flat), cut_off(stepped, radius, end)
    peak, closed = cut_off(flat, radius, end)[0, 0], abs(1 - area + area * np.exp(1j * phase)) ** 2
    assert kernel[0, 0] / peak == pytest.approx(closed, abs=1e-4)
    assert scaled[0, 0] / peak >= kernel[0, 0] / peak and (phase == 0 or scaled[0, 0] / peak > closed + 0.004)
    assert np.trapezoid(2 * np.pi * radius * kernel[0], radius) == pytest.approx(1, abs=1e-3)


def lines(picture: np.ndarray) -> np.ndarray:
    """Running sums along x and y, which tell left from right and up from down."""
    return np.concatenate([np.cumsum(picture.sum(axis=0)), np.cumsum(picture.sum(axis=1))])


@pytest.fixture(scope="module")
def spot(jit, loaded, make_scene, da_mobile, lamp):
    """Green's picture of a bright disc of 1.5 px radius before nothing, of unit sum, with camera and blur."""
    from dasim.render import passes

    def picture(name: str, side: str, diffraction: str, spp: int):
        focus_m, depth_m = SIDES[side]
        camera = lens(da_mobile, name, focus_m)
        radius_cm = SOURCE_PX * 1.7e-6 * depth_m / geometry.image_distance_m(camera) * 100
        disc = {"name": "spot", "shape": "disc", "radius_cm": radius_cm, "position_cm": (0, 0, depth_m * 100)}
        scene = make_scene(disc | {"material": "white-paper"}, lights=[lamp])
        sampling = passes.Sampling(spp, 6)
        rate = passes.stop_pass(
            loaded(scene), camera, camera.stops[0], sampling, diffraction=diffraction, max_blur_px=MAX_BLUR_PX
        )[..., 1]
        return rate / rate.sum(), camera, float(geometry.blur_px(camera, depth_m))

    return picture


@pytest.mark.parametrize(
    ("name", "side", "diffraction"),
    [
        ("spherical", "near", "wave"),
        pytest.param("spherical", "far", "wave", marks=pytest.mark.slow),
        pytest.param("phase step", "focus", "wave", marks=pytest.mark.slow),
        pytest.param("step and spherical", "near", "wave", marks=pytest.mark.slow),
        pytest.param("coma", "focus", "wave", marks=pytest.mark.slow),
        ("coma", "near", "off"),
        pytest.param("astigmatism and step", "far", "wave", marks=pytest.mark.slow),
    ],
)
def test_small_source_is_spread_by_the_pupil(spot, name, side, diffraction):
    """Set-up: the pupil's Fourier transform by FFT, with polynomials written out, convolved with source and pixel; by
    rays alone, the displacement of each by the slope. Expectation: running sums along x and along y and energies within
    circles about the frame's middle within 0.02, and farther away without aberrations and step.
    """
    picture, camera, blur_px = spot(name, side, diffraction, 1024)
    errors, step = LENSES[name]
    assert difference(picture, expected(camera, errors, step, blur_px, diffraction)) < ENERGY
    assert difference(picture, expected(camera, {}, 0.0, blur_px, diffraction)) > ENERGY


def difference(picture: np.ndarray, other: np.ndarray) -> float:
    """Largest difference of running sums and of energies in circles between two pictures."""
    away = np.hypot(*(np.indices(picture.shape) - 23.5))
    rings = [float(picture[away < r].sum() - other[away < r].sum()) for r in np.arange(1.0, 16)]
    return float(max(np.abs(rings).max(), np.abs(lines(picture) - lines(other)).max()))


def surface_nm(errors: dict[str, float], y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """The wavefront by polynomials in x and y (Wyant and Creath 1992, table III, times their norms)."""
    square = x**2 + y**2
    shapes = {
        "defocus": 3**0.5 * (2 * square - 1),
        "astigmatism": 6**0.5 * (x**2 - y**2),
        "coma": 8**0.5 * x * (3 * square - 2),
        "vertical_coma": 8**0.5 * y * (3 * square - 2),
        "spherical": 5**0.5 * (6 * square**2 - 6 * square + 1),
    }
    return sum((value * shapes[key] for key, value in errors.items()), np.zeros_like(square))


def expected(
    camera: Camera, errors: dict[str, float], step_nm: float, blur_px: float, diffraction: str, cosine: float = 1.0
) -> np.ndarray:
    """The picture [48, 48] of the source through the open lens, its light summing to 1.

    ``cosine`` is that of the field angle, the source to the right of the axis and in focus.
    """
    pitch_um = camera.sensor.pixel_pitch_um
    f_number = pointspread.working_f_number(camera, 1.0)
    if diffraction == "off":
        place = (np.arange(1024) + 0.5) / 512 - 1
        y, x = (axis[np.hypot(*np.meshgrid(place, place)) < 1] for axis in np.meshgrid(place, place, indexing="ij"))
        h = 1e-3
        slopes = [
            (surface_nm(errors, y + h, x) - surface_nm(errors, y - h, x)) / (2 * h),
            (surface_nm(errors, y, x + h) - surface_nm(errors, y, x - h)) / (2 * h),
        ]
        moved = [
            -at * blur_px / 2 - 2 * f_number * slope * 1e-3 / pitch_um for at, slope in zip((y, x), slopes, strict=True)
        ]
        turn, part = np.random.default_rng(3).random((2, len(y)))
        source = SOURCE_PX * np.sqrt(part) * np.array([np.sin(2 * np.pi * turn), np.cos(2 * np.pi * turn)])
        edges = np.arange(49) - 24.0
        counts = np.histogram2d(moved[0] + source[0], moved[1] + source[1], bins=[edges, edges])[0]
        return counts / counts.sum()
    total = np.zeros((48, 48))
    for nm in (547.0, 563.0):
        scale = nm * 1e-3 * f_number / pitch_um
        place = (np.arange(SIZE) - SIZE // 2) / (ACROSS / 2)
        y, x = np.meshgrid(place, place, indexing="ij")
        rho = np.hypot(y, x)
        turns = surface_nm(errors, y, x) / nm + step_nm / nm * (rho < 0.46) + blur_px / (8 * scale) * rho**2
        # The transform's sign: a positive slope moves the picture to the other side.
        field = np.fft.fft2(np.fft.ifftshift((rho <= 1) * np.exp(-2j * np.pi * turns)))
        fine_px = scale * ACROSS / SIZE
        spectrum = np.fft.fft2(np.abs(field) ** 2)
        frequency = np.fft.fftfreq(SIZE, fine_px)
        across, along = cosine * frequency, cosine**3 * frequency  # in the picture: wider by 1 / cos and 1 / cos^3
        argument = np.maximum(2 * np.pi * np.hypot(across[:, None], along) * SOURCE_PX, 1e-9)
        spectrum *= 2 * j1(argument) / argument * np.sinc(across)[:, None] * np.sinc(along)
        rows, columns = (np.exp(2j * np.pi * np.outer(np.arange(48) - 23.5, f)) for f in (across, along))
        part = (rows @ spectrum @ columns.T).real
        total += part / part.sum()
    return total / total.sum()


@pytest.mark.slow
@pytest.mark.parametrize("away", ["right", "down"])
def test_coma_points_away_from_the_axis(jit, make_scene, da_mobile, lamp, away):
    """Set-up: a table of coma from 0 to 90 nm at 30 degrees; a source in focus at 20 degrees, to the right of the axis
    or below it, photographed by a sensor that lies there. Expectation: the Fourier transform of a pupil with 60 nm of
    coma along the direction away from the axis, wider by 1 / cos^3 and 1 / cos.
    """
    import dasim

    data = da_mobile.model_dump(mode="json") | {"stops": [GREEN]}
    data["lens"] |= {
        "focus_distance_m": 0.3,
        "wavefront_by_field": [{"angle_deg": 0.0}, {"angle_deg": 30.0, "coma": 90.0}],
    }
    image_px = geometry.image_distance_m(parse(Camera, data, "axis")) / 1.7e-6
    offset_px = round(image_px * np.tan(np.radians(20)))
    data["sensor"] |= {
        "width_px": 48,
        "height_px": 48,
        "principal_point_px": [24.0 - offset_px, 24.0] if away == "right" else [24.0, 24.0 - offset_px],
    }
    camera = parse(Camera, data, "coma")
    beside_cm = 30 * offset_px / image_px
    place = (beside_cm, 0, 30) if away == "right" else (0, beside_cm, 30)
    disc = {"name": "spot", "shape": "disc", "radius_cm": 30 * SOURCE_PX / image_px, "position_cm": place}
    scene = make_scene(disc | {"material": "white-paper"}, lights=[lamp])
    picture = dasim.simulate(scene, camera, spp=1024, exposure=dasim.Exposure(time_s=0.01)).truth.mean_e[..., 1]
    picture = picture / picture.sum() if away == "right" else picture.T / picture.sum()
    cosine = float(np.cos(np.arctan(offset_px / image_px)))
    assert difference(picture, expected(camera, {"coma": 60.0}, 0.0, 0.0, "wave", cosine)) < ENERGY
    assert difference(picture, expected(camera, {"coma": -60.0}, 0.0, 0.0, "wave", cosine)) > 2 * ENERGY


def test_tables_beyond_all_memory_are_refused(jit, da_mobile):
    """Set-up: 500 nm of coma at the corner of the full frame, 20 px of blur. Expectation: one line, before the work."""
    from dasim.render import wave

    data = da_mobile.model_dump(mode="json")
    data["lens"]["wavefront_by_field"] = [{"angle_deg": 0.0}, {"angle_deg": 31.0, "coma": 500.0}]
    camera = parse(Camera, data, "far too strong")
    density = radiometry.stop_response(camera, camera.stops[0]).sum(axis=0)
    with pytest.raises(
        InputError, match=r"the tables of its blur would take \d+ GB, 8 GB are allowed; .*diffraction 'off'"
    ):
        wave.blur(camera, camera.stops[0], density, 20.0)
