"""Zernike terms and a phase step: orthonormality, Strehl ratios and transfer functions in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry, pointspread, radial_pattern, radiometry, wavefront, zernike
from dasim.camera.pupil_pattern import pupil_pattern
from dasim.camera.specification import Camera, load_camera
from dasim.camera.stops import Disc
from dasim.camera.wavefront import Phase
from dasim.spectra import grid, illuminants

OPEN = Disc(name="open", radius_ratio=1.0)
RATIO = 0.46
HOLE = Disc(name="hole", radius_ratio=RATIO)
MIDDLE = np.zeros(1)
NONE = (0.0,) * len(zernike.TERMS)
SMALL_WAVES = 0.05  # RMS, for which the Strehl ratio is exp(-(2 pi sigma)^2) to its third moment
EXTENDED_MARECHAL = 1.2e-3
GRID_OF_256 = 2e-5  # a disc on the pupil's grid
TRANSFER = 6e-3  # kernels sampled ten times per pixel and cut at 45 px
EDGES = 0.004  # of a kernel's light in a pixel, through both stops at 650 nm


def strehl(phase: Phase, ring: bool) -> float:
    """Peak of the open lens with a phase over its peak without."""
    if ring:
        return float(radial_pattern.wave_profile(MIDDLE, MIDDLE, 0.0, phase)[0, 0] / (np.pi / 4))
    return float(pupil_pattern(OPEN, 0.0, MIDDLE, MIDDLE, phase)[0, 0] / (np.pi / 4))


def changed(camera: Camera, phase_nm: float = 0.0, **wavefront_nm: float) -> Camera:
    data = camera.model_dump()
    data["stops"][1]["phase_nm"] = phase_nm
    data["lens"]["wavefront_nm"] = wavefront_nm
    return parse(Camera, data, "changed")


def test_polynomials_are_orthonormal():
    """Set-up: integrals over the disc by Gauss-Legendre in radius and equal steps in angle. Expectation: identity."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    rho, angle = (nodes + 1) / 2, np.arange(24) * 2 * np.pi / 24
    y, x = np.outer(rho, np.sin(angle)), np.outer(rho, np.cos(angle))
    values = np.array([zernike.polynomial(n, m, y, x) for n, m in zernike.TERMS.values()])
    share = np.outer(weights * rho, np.full(24, 1 / 24))
    np.testing.assert_allclose(np.einsum("ayx,byx,yx->ab", values, values, share), np.eye(len(values)), atol=1e-12)


@pytest.mark.parametrize("name", zernike.TERMS)
def test_small_errors_cost_their_variance(name):
    """Expectation: a Strehl ratio of exp(-(2 pi sigma)^2) (Mahajan 1982), by both ways that kernels are computed."""
    turns = tuple(SMALL_WAVES if name == term else 0.0 for term in zernike.TERMS)
    expected = np.exp(-((2 * np.pi * SMALL_WAVES) ** 2))
    assert strehl(Phase(turns, None, 1.0), ring=False) == pytest.approx(expected, abs=EXTENDED_MARECHAL)
    if zernike.is_radial(turns):
        assert strehl(Phase(turns, None, 1.0), ring=True) == pytest.approx(expected, abs=EXTENDED_MARECHAL)


@pytest.mark.parametrize("phase", [0.0, 1.0, np.pi, 5.0])
def test_step_of_the_hole_costs_its_interference(phase):
    """Expectation: a Strehl ratio of |1 - a^2 + a^2 exp(i phi)|^2; averaged over the phase, (1 - a^2)^2 + a^4."""
    area = RATIO**2
    expected = abs(1 - area + area * np.exp(1j * phase)) ** 2
    for ring in (True, False):
        assert strehl(Phase(NONE, HOLE, np.exp(1j * phase)), ring) == pytest.approx(expected, abs=GRID_OF_256)
        assert strehl(Phase(NONE, HOLE, 0.0), ring) == pytest.approx((1 - area) ** 2 + area**2, abs=GRID_OF_256)


def test_step_averages_over_a_band():
    """Expectation: the mean of exp(2 pi i s / lambda) over 10 nm by 2,001 points."""
    nm = np.linspace(545, 555, 2001)
    front = wavefront.Wavefront((NONE,), opening=HOLE, step_nm=7000.0)
    phase = wavefront.at(front, 550.0, 10.0)
    assert phase is not None
    assert phase.step == pytest.approx(np.exp(2j * np.pi * 7000.0 / nm).mean(), abs=0.01)


def mtf(kernel: np.ndarray, frequency: float) -> float:
    """The light beyond the frame is spread too wide to count at these frequencies."""
    place = np.arange(len(kernel)) - len(kernel) // 2
    return float(abs(kernel.sum(axis=0) @ np.exp(-2j * np.pi * frequency * place)))


def test_transfer_of_green_with_a_thick_step(da_mobile):
    """Rationale: a step of many waves averages over a channel's band: little is left of what ring and hole share.

    Expectation: the transfer function of `dasim.psf` is that of ring and hole, each the overlap of two displaced pupils
    in closed form, plus that of both times the cosine of the phase, summed over the wavelengths and times the pixel's.
    At 0.3 cycles per pixel it loses 35 % and more.
    """
    focus, size = da_mobile.lens.focus_distance_m, 91
    thick, plain = (dasim_psf(changed(da_mobile, nm), focus, size) for nm in (9000.0, 0.0))
    weights = radiometry.stop_response(da_mobile, da_mobile.stops[0])[1] * illuminants.illuminant("D65")
    scale = grid.WAVELENGTH_NM * 1e-3 * pointspread.working_f_number(da_mobile, 1.0) / 1.7
    near_infrared = radiometry.stop_response(da_mobile, da_mobile.stops[1])[1] * illuminants.illuminant("D65")
    electrons = grid.integrate(weights + near_infrared)
    cosine = np.cos(2 * np.pi * 9000.0 / grid.WAVELENGTH_NM)

    def transfer(frequency: float) -> np.ndarray:
        """With the step and without."""
        v, hole_v = scale * abs(frequency), scale * abs(frequency) / RATIO
        hole = RATIO**2 * disc(hole_v)
        ring = disc(v) + hole - 2 * shared(v)
        stepped = ring + hole + (disc(v) - ring - hole) * cosine
        infrared = grid.integrate(near_infrared * disc(hole_v))
        both = np.array([grid.integrate(weights * stepped), grid.integrate(weights * disc(v))])
        return (both + infrared) / electrons * np.sinc(frequency)

    for frequency in (0.1, 0.2, 0.3):
        expected = sum(transfer(frequency + alias) for alias in (-1, 0, 1))  # of the pixels' sampling
        assert [mtf(thick, frequency), mtf(plain, frequency)] == pytest.approx(expected, abs=TRANSFER)
    assert mtf(thick, 0.3) < 0.65 * mtf(plain, 0.3)


def disc(v: np.ndarray) -> np.ndarray:
    """Area that two discs displaced by 2 v share, over that of a disc."""
    v = np.clip(v, 0, 1)
    return np.asarray(2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2)))


def dasim_psf(camera: Camera, depth_m: float, size: int) -> np.ndarray:
    return pointspread.psf(camera, depth_m, "G", "D65", size=size)


def shared(v: np.ndarray) -> np.ndarray:
    """Area that the disc and the hole displaced by 2 v share, over that of the disc: two circular segments."""
    d = np.clip(2 * v, 1 - RATIO + 1e-12, 1 + RATIO - 1e-12)
    of_disc = np.arccos((d**2 + 1 - RATIO**2) / (2 * d))
    of_hole = np.arccos((d**2 + RATIO**2 - 1) / (2 * d * RATIO))
    lens = of_disc - np.sin(2 * of_disc) / 2 + RATIO**2 * (of_hole - np.sin(2 * of_hole) / 2)
    return np.where(2 * v <= 1 - RATIO, RATIO**2, np.where(2 * v >= 1 + RATIO, 0.0, lens / np.pi))


def test_the_hole_itself_has_no_step(da_mobile):
    """Expectation: IR stays, but for light of both stops within the coating's edges; green does not."""
    assert wavefront.is_flat(wavefront.of_stop(changed(da_mobile, 1234.0), da_mobile.stops[1]))
    for channel, low, high in (("IR", 0.0, EDGES), ("G", 0.02, 1.0)):
        before, after = (pointspread.psf(changed(da_mobile, nm), 0.3, channel, "D65") for nm in (0.0, 1234.0))
        assert low <= np.abs(after - before).max() < high


def test_defocus_term_is_a_shift_of_focus(da_mobile):
    """Rationale: sqrt(3) (2 rho^2 - 1) c is W20 = 2 sqrt(3) c, the blur of a point at c_px = 8 N W20 / p.

    Expectation: the kernel of the term at the focus is that of a nearer point.
    """
    nm = 150.0
    f_number = pointspread.working_f_number(da_mobile, 1.0)
    blur_px = 8 * f_number * 2 * 3**0.5 * nm * 1e-3 / da_mobile.sensor.pixel_pitch_um
    nearer_m = float(geometry.depth_of_blur_m(da_mobile, blur_px))
    assert nearer_m < da_mobile.lens.focus_distance_m
    size = 41
    term = dasim_psf(changed(da_mobile, defocus=nm), da_mobile.lens.focus_distance_m, size)
    np.testing.assert_allclose(term, dasim_psf(da_mobile, nearer_m, size), atol=1e-6)


@pytest.mark.parametrize("name", ["coma", "vertical_coma"])
def test_coma_moves_the_centroid(da_mobile, name):
    """Expectation: the centroid of a kernel is -2 N times the mean slope over the stop, by the theorem of Gauss
    sqrt(8) c for coma: 0.47 px for 50 nm, to the left or upwards, and none across.
    """
    one = da_mobile.model_copy(update={"stops": da_mobile.stops[:1]})
    data = one.model_dump(mode="json")
    data["lens"]["wavefront_nm"] = {name: 50.0}
    kernel = dasim_psf(parse(Camera, data, "coma"), 0.4, 61)
    place = np.arange(61) - 30
    x, y = (float(kernel.sum(axis=axis) @ place / kernel.sum()) for axis in (0, 1))
    expected = -2 * pointspread.working_f_number(one, 1.0) * 8**0.5 * 50e-3 / 1.7
    along, across = (x, y) if name == "coma" else (y, x)
    assert along == pytest.approx(expected, rel=0.1)
    assert across == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("down", [False, True])
def test_coma_of_the_field_points_away_from_the_axis(da_mobile, down):
    """Expectation: at 20 degrees to the right of the axis or below it, the centroid is moved along that direction by
    the slope's mean as on the axis, wider by 1 / cos^3.
    """
    data = da_mobile.model_dump(mode="json")
    data["stops"] = data["stops"][:1]
    data["lens"]["wavefront_by_field"] = [{"angle_deg": 0.0}, {"angle_deg": 40.0, "coma": -100.0}]
    camera = parse(Camera, data, "field")
    away = round(geometry.image_distance_m(camera) / 1.7e-6 * np.tan(np.radians(20)))
    field_px = (0.0, float(away)) if down else (float(away), 0.0)
    kernel = pointspread.psf(camera, 0.4, "G", "D65", size=61, field_px=field_px)
    place = np.arange(61) - 30
    x, y = (float(kernel.sum(axis=axis) @ place / kernel.sum()) for axis in (0, 1))
    expected = 2 * pointspread.working_f_number(camera, 1.0) * 8**0.5 * 50e-3 / 1.7 / np.cos(np.radians(20)) ** 3
    along, across = (y, x) if down else (x, y)
    assert along == pytest.approx(expected, rel=0.1)
    assert across == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(
    ("lens", "hole", "message"),
    [
        ({"wavefront_nm": {"spherical": 900}}, {}, "lens.wavefront_nm.spherical: must be less than or equal"),
        ({"wavefront_nm": {"tilt": 9}}, {}, "lens.wavefront_nm.tilt: unknown key"),
        ({}, {"phase_nm": 2e4}, "stops.hole.phase_nm: must be less than or equal to 10000"),
        ({}, {"wavefront_nm": {"coma": "much"}}, "stops.hole.wavefront_nm.coma: "),
    ],
)
def test_refused_keys(da_mobile, lens, hole, message):
    data = da_mobile.model_dump(mode="json")
    data["lens"] |= lens
    data["stops"][1] |= hole
    with pytest.raises(InputError, match=": " + message.replace(".", r"\.")) as problem:
        parse(Camera, data, "camera.toml")
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("phase_nm, errors", [(500.0, {}), (0.0, {"coma": 20.0})])
def test_airy_takes_no_phase(da_mobile, phase_nm, errors):
    with pytest.raises(InputError, match=r"diffraction .airy. takes no wavefront_nm and no phase_nm"):
        pointspread.psf(changed(da_mobile, phase_nm, **errors), 0.3, "G", "D65", diffraction="airy")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([{"angle_deg": 5.0}], r"lens\.wavefront_by_field: angle_deg must begin at 0"),
        ([{"angle_deg": 0.0, "coma": 9.0}], r"lens\.wavefront_by_field\.0: coma must be 0 on the axis"),
        (
            [{"angle_deg": 0.0}, {"angle_deg": 9.0, "vertical_coma": 9.0}],
            r"vertical_coma must be 0 of a lens",
        ),
        ([{"angle_deg": 0.0}, {"angle_deg": 9.0, "wavelength_nm": 500.0}], r"must be a table"),
        ([{"angle_deg": 0.0}] * 2, r"must be a table"),
    ],
)
def test_refused_tables(da_mobile, rows, message):
    data = da_mobile.model_dump(mode="json")
    data["lens"]["wavefront_by_field"] = rows
    with pytest.raises(InputError, match=message) as problem:
        parse(Camera, data, "camera.toml")
    assert "\n" not in str(problem.value)


def test_tables_need_centred_stops_and_symmetric_errors(da_mobile):
    data = da_mobile.model_dump(mode="json")
    data["lens"] |= {"wavefront_by_field": [{"angle_deg": 0.0, "spherical": 10.0}], "wavefront_nm": {"coma": 10.0}}
    with pytest.raises(InputError, match="defocus and spherical terms only beside wavefront_by_field"):
        parse(Camera, data, "camera.toml")
    data["lens"]["wavefront_nm"] = {}
    data["stops"][1]["centre_ratio"] = [0.2, 0.0]
    with pytest.raises(InputError, match="all stops must be discs or rings about the axis"):
        parse(Camera, data, "camera.toml")
    data["stops"][1] |= {"centre_ratio": [0.0, 0.0], "wavefront_nm": {"coma": 10.0}}
    with pytest.raises(InputError, match=r"stops: wavefront_nm may have defocus and spherical terms only"):
        parse(Camera, data, "camera.toml")


def test_coefficients_of_a_stop_are_its_own(da_mobile):
    """Expectation: in both stops, they give the kernels of the same coefficients of the lens; in the hole alone, those
    of the lens in infrared, and in green those of no error but for what green sees through the hole.
    """
    errors = {"coma": 40.0, "spherical": -30.0}
    psfs = {}
    for name, on_lens, on_stops in (("none", {}, ({}, {})), ("lens", errors, ({}, {})), ("hole", {}, ({}, errors)),
                                    ("both", {}, (errors, errors))):  # fmt: skip
        data = da_mobile.model_dump(mode="json")
        data["lens"]["wavefront_nm"] = on_lens
        for stop, own in zip(data["stops"], on_stops, strict=True):
            stop["wavefront_nm"] = own
        camera = parse(Camera, data, name)
        psfs[name] = {c: pointspread.psf(camera, 0.3, c, "D65", size=61) for c in ("G", "IR")}
    for channel in ("G", "IR"):
        np.testing.assert_allclose(psfs["both"][channel], psfs["lens"][channel], atol=1e-12)
    moved = np.abs(psfs["lens"]["G"] - psfs["none"]["G"]).max()
    assert np.abs(psfs["hole"]["IR"] - psfs["lens"]["IR"]).max() < 0.05 * np.abs(psfs["lens"]["IR"]).max()
    assert np.abs(psfs["hole"]["IR"] - psfs["none"]["IR"]).max() > 0.05 * np.abs(psfs["none"]["IR"]).max()
    assert np.abs(psfs["hole"]["G"] - psfs["none"]["G"]).max() < 0.2 * moved


def test_table_is_linear_in_angle_and_wavelength(da_mobile):
    """Expectation: halfway between angles and a quarter between wavelengths, the terms' weighted means; on the axis the
    kernel is that of the same coefficients for the whole field.
    """
    data = da_mobile.model_dump(mode="json")
    data["lens"]["wavefront_by_field"] = [
        {"angle_deg": angle, "wavelength_nm": nm, "spherical": 20.0 + nm / 10, "coma": 3.0 * angle}
        for angle in (0.0, 20.0)
        for nm in (450.0, 650.0)
    ]
    camera = parse(Camera, data, "table")
    front = wavefront.of_stop(camera, camera.stops[0], 10.0)
    values = dict(zip(zernike.TERMS, wavefront.coefficients(front, 500.0), strict=True))
    assert values["spherical"] == pytest.approx(70.0) and values["coma"] == pytest.approx(30.0)
    assert wavefront.coefficients(front, 800.0) == wavefront.coefficients(front, 650.0)
    same = changed(da_mobile, spherical=70.0)
    data["lens"]["wavefront_by_field"] = [{"angle_deg": 0.0, "spherical": 70.0}, {"angle_deg": 9.0, "coma": 50.0}]
    np.testing.assert_allclose(dasim_psf(parse(Camera, data, "table"), 0.3, 31), dasim_psf(same, 0.3, 31), atol=1e-12)


def test_one_step_per_camera(da_mobile):
    data = da_mobile.model_dump(mode="json")
    for stop in data["stops"]:
        stop["phase_nm"] = 100.0
    with pytest.raises(InputError, match="one stop may have a phase_nm, these have: open, hole"):
        parse(Camera, data, "camera.toml")


@pytest.mark.parametrize("name", ["defocus", "spherical", "coma"])
def test_a_kernel_is_large_enough_for_the_wavefront_of_a_stop(name: str) -> None:
    """Expectation: the size is that for the same wavefront of the lens, of which the stop is the only one."""
    camera = load_camera("bayer-mobile")
    data = [camera.model_dump(), camera.model_dump()]
    for part in (data[0]["lens"], data[1]["stops"][0]):
        part["wavefront_nm"] = {name: 300.0}
    sizes = [pointspread.kernel_size_px(Camera.model_validate(each), 2.0) for each in data]
    assert sizes[0] == sizes[1] > pointspread.kernel_size_px(camera, 2.0) + 8
