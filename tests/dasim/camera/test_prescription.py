"""Lens prescriptions: Seidel's sums, a stigmatic lens, two apertures one behind the other, real rays, refused files."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.camera import distortion, geometry, prescription, zernike
from dasim.camera.prescription import camera_from_lens
from dasim.camera.specification import Camera

optiland = pytest.mark.skipif(find_spec("optiland") is None, reason="Optiland is not installed (extra lens)")
quiet = pytest.mark.filterwarnings("ignore")  # of Optiland and of what it compiles
INDEX = 1.5
FOCAL_MM = 20.0
STIGMATIC_NM = 0.05
SEIDEL = 0.03  # of the third order: the fifth at f/8, and the fit's
REAL_RAYS = 0.02  # of the range: slopes are small angles
DISTORTION = 3e-4  # the plane of the image is not quite the same
OVERLAP = 0.02  # a polynomial of three powers of r^2
FAR = 1.2  # degrees: where astigmatism is far below coma
PHONE: list[tuple[float, float, tuple[float, float] | None, float, list[float]]] = [
    (1.962, 1.19, (1.471, 76.6), 2.153,
     [-1.895e-2, 2.426e-2, -5.123e-2, 8.371e-4, 7.850e-3, 4.091e-3, -7.732e-3, -4.265e-3]),
    (33.398, 0.93, None, 40.18,
     [-4.966e-3, -1.434e-2, -6.139e-3, -9.284e-5, 6.438e-3, -5.72e-3, -2.385e-2, 1.108e-2]),
    (-2.182, 0.75, (1.603, 27.5), 2.105,
     [-4.388e-2, -2.555e-2, 5.16e-2, -4.307e-2, -2.831e-2, 3.162e-2, 4.630e-2, -4.877e-2]),
    (-6.367, 0.1, None, 3.382,
     [-1.131e-1, -7.863e-2, 1.094e-1, 6.228e-3, -2.216e-2, -5.89e-3, 4.123e-3, 1.041e-3]),
    (5.694, 0.89, (1.510, 56.2), -221.1,
     [-7.876e-2, 7.02e-2, 1.575e-3, -9.958e-3, -7.322e-3, 6.914e-4, 2.54e-3, -7.65e-4]),
    (9.192, 0.16, None, 0.9331,
     [9.694e-3, -2.516e-3, -3.606e-3, -2.497e-4, -6.84e-4, -1.414e-4, 2.932e-4, -7.284e-5]),
    (1.674, 0.85, (1.510, 56.2), -7.617,
     [7.429e-2, -6.933e-2, -5.811e-3, 2.396e-3, 2.100e-3, -3.119e-4, -5.552e-5, 7.969e-6]),
    (1.509, 0.70, None, -2.707,
     [1.767e-3, -4.652e-2, 1.625e-2, -3.522e-3, -7.106e-4, 3.825e-4, 6.271e-5, -2.631e-5]),
    (np.inf, 0.40, (1.516, 64.1), 1.0, []),
    (np.inf, 0.5678, None, 1.0, []),
]  # fmt: skip


def write(path: Path, surfaces: list[dict], aperture_mm: float) -> Path:
    """A prescription in the format of the file's name: object at infinity, surfaces, image."""
    from optiland.fileio import save_optiland_file, save_zemax_file
    from optiland.optic import Optic

    optic = Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    for number, surface in enumerate(surfaces, 1):
        optic.surfaces.add(index=number, **surface)
    optic.surfaces.add(index=len(surfaces) + 1)
    optic.set_aperture("EPD", aperture_mm)
    optic.fields.set_type("angle")
    optic.fields.add(y=0)
    optic.wavelengths.add(value=0.55, is_primary=True)
    (save_zemax_file if path.suffix == ".zmx" else save_optiland_file)(optic, str(path))
    return path


def glass() -> object:
    from optiland.materials import IdealMaterial

    return IdealMaterial(n=INDEX)


def plano_convex(path: Path, aperture_mm: float, conic: float = 0.0) -> Path:
    """Flat side first, 2 mm thick, with the stop there, and the image at the paraxial focus."""
    flat = {"radius": np.inf, "thickness": 2.0, "material": glass(), "is_stop": True}
    curved = {"radius": -FOCAL_MM * (INDEX - 1), "thickness": FOCAL_MM, "conic": conic}
    return write(path, [flat, curved], aperture_mm)


def framed(camera: Camera, corner_deg: float) -> Camera:
    """A square crop whose corner lies at an angle of a lens of 20 mm focal length."""
    half_px = FOCAL_MM * np.tan(np.radians(corner_deg)) / 1.7e-3 / 2**0.5
    return dasim.cropped(camera, *[2 * int(half_px)] * 2)


def rows(camera: Camera, nm: float = 550.0) -> list[dict[str, float]]:
    return [row.model_dump() for row in camera.lens.wavefront_by_field if row.wavelength_nm == nm]


@optiland
@quiet
def test_stigmatic_lens_has_no_error_on_the_axis(tmp_path, da_mobile):
    """Rationale: a plane and a hyperboloid of conic constant -n^2 focus light along the axis in a point (Descartes).

    Expectation: f/3.3, no coefficient on the axis at any wavelength; without dispersion no axial colour; focal length
    and f-number of the prescription.
    """
    path = plano_convex(tmp_path / "hyperbolic.json", 6.0, conic=-(INDEX**2))
    camera = camera_from_lens(path, framed(da_mobile, FAR))
    assert camera.lens.focal_length_mm == pytest.approx(FOCAL_MM)
    assert camera.lens.f_number == pytest.approx(FOCAL_MM / 6)
    for nm in prescription.WAVELENGTHS_NM:
        axis = rows(camera, nm)[0]
        assert max(abs(axis[name]) for name in zernike.TERMS) < STIGMATIC_NM
    assert max(abs(um) for _, um in camera.lens.focal_shift_um) < 0.01
    assert camera.sensor == framed(da_mobile, FAR).sensor and camera.stops == da_mobile.stops


@optiland
@quiet
@pytest.mark.parametrize("aperture_mm", [2.5, 1.25])
def test_singlet_has_the_sums_of_seidel(tmp_path, da_mobile, aperture_mm):
    """Set-up: a plano-convex singlet at f/8 and f/16, traced by y-n-u. Expectation: spherical aberration
    W040 = S_I / 8 = 6 sqrt(5) c, coma W131 = S_II / 2 = 3 sqrt(8) c at the corner, in proportion to the angle.
    """
    path = plano_convex(tmp_path / "singlet.json", aperture_mm)
    camera = camera_from_lens(path, framed(da_mobile, FAR))
    corner = rows(camera)[-1]
    # (height, slope) of the marginal and of the chief ray behind the flat stop; only the curved side adds.
    h, u = aperture_mm / 2, 0.0
    chief_slope = np.tan(np.radians(corner["angle_deg"])) / INDEX
    chief_h = 2.0 * chief_slope
    curvature = -1 / (FOCAL_MM * (INDEX - 1))
    refraction, chief_refraction = INDEX * (h * curvature + u), INDEX * (chief_h * curvature + chief_slope)
    after = INDEX * u - h * curvature * (1 - INDEX)
    change = after / 1.0 - u / INDEX
    spherical_nm = -(refraction**2) * h * change / 8 * 1e6
    coma_nm = -refraction * chief_refraction * h * change / 2 * 1e6
    assert abs(rows(camera)[0]["spherical"]) == pytest.approx(abs(spherical_nm) / (6 * 5**0.5), rel=SEIDEL)
    assert abs(corner["coma"]) == pytest.approx(abs(coma_nm) / (3 * 8**0.5), rel=SEIDEL)
    assert np.sign(corner["coma"]) == np.sign(rows(camera)[0]["spherical"]) * np.sign(-coma_nm * spherical_nm)
    middle = rows(camera)[3]
    assert middle["coma"] == pytest.approx(corner["coma"] * middle["angle_deg"] / corner["angle_deg"], rel=SEIDEL)


@optiland
@quiet
def test_slopes_are_those_of_real_rays(tmp_path, da_mobile):
    """Rationale: sign and direction, by rays. Set-up: the singlet at f/8 and 1.2 degrees. Expectation: rays through the
    pupil meet the image where u = -2 N grad W says, of both signs, up to the tilt that is left out.
    """
    path = plano_convex(tmp_path / "ray.json", 2.5)
    optic = prescription._read(path)
    prescription._prepare(optic, FAR)
    traced = prescription._traced(optic, FAR, path, FAR)
    errors = tuple(traced.coefficients_nm[550.0])
    heights = np.array([-0.9, -0.5, 0.0, 0.5, 0.9])
    real = np.array([float(optic.trace_generic(0.0, 1.0, 0.0, at, 0.55).y[0]) for at in heights]) * 1e3
    # The direction away from the axis is -y of the pupil, and the upright picture is upside down on the sensor.
    slope = np.array([float(zernike.gradient(errors, 0.0, -at)[1]) for at in heights])
    expected = -2 * FOCAL_MM / 2.5 * slope * 1e-3
    np.testing.assert_allclose(real - real.mean(), expected - expected.mean(), atol=REAL_RAYS * np.ptp(real))
    assert np.ptp(expected) > 10


@optiland
@quiet
def test_two_apertures_vignette_by_their_overlap(tmp_path, da_mobile):
    """Set-up: a ring of the stop's radius 8 mm before the stop. Expectation: the share of light that passes both is the
    overlap of two discs displaced by 8 mm tan(angle), beside cos^4.
    """
    ring = {"radius": np.inf, "thickness": 8.0, "aperture": 5.0}
    flat = {"radius": np.inf, "thickness": 2.0, "material": glass(), "is_stop": True, "aperture": 5.0}
    curved = {"radius": -FOCAL_MM * (INDEX - 1), "thickness": FOCAL_MM, "conic": -(INDEX**2)}
    camera = framed(da_mobile, 4.0)
    lens = camera_from_lens(write(tmp_path / "vignette.json", [ring, flat, curved], 5.0), camera).lens
    for angle in (1.5, 3.0, 4.0):
        height = FOCAL_MM * np.tan(np.radians(angle))
        shading = 1 + sum(a * height ** (2 * k) for k, a in enumerate(lens.shading_per_mm, 1))
        half = 8.0 * np.tan(np.radians(angle)) / 2 / 2.5
        overlap = 2 / np.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
        assert shading == pytest.approx(overlap, abs=OVERLAP)


@optiland
@quiet
def test_distortion_puts_chief_rays_where_they_go(tmp_path, da_mobile):
    """Set-up: the singlet with its stop 6 mm before it, up to 5 degrees. Expectation: at
    angles between those that were fitted, the chief ray meets the image where a pinhole's direction is bent to, within
    0.03 %.
    """
    stop = {"radius": np.inf, "thickness": 6.0, "is_stop": True}
    curved = {"radius": FOCAL_MM * (INDEX - 1), "thickness": 2.0, "material": glass()}
    path = write(tmp_path / "bent.json", [stop, curved, {"radius": np.inf, "thickness": FOCAL_MM - 2.0 / INDEX}], 1.25)
    camera = camera_from_lens(path, framed(da_mobile, 5.0))
    optic = prescription._read(path)
    prescription._prepare(optic, 5.0)
    image_mm = geometry.image_distance_m(camera) * 1e3
    angles, ratio = [0.4, 2.0, 3.3, 4.6], []
    for angle in angles:
        chief = optic.trace_generic(0.0, angle / 5.0, 0.0, 0.0, 0.55)
        ratio.append(abs(float(chief.y[0])) / np.tan(np.radians(angle)))
    real = np.array(ratio) / ratio[0]
    heights = image_mm * np.tan(np.radians(angles)) * real
    bent = 1 / distortion.factor(camera.lens.distortion_per_mm, heights**2)
    np.testing.assert_allclose(bent / bent[0], real, rtol=DISTORTION)
    assert abs(real[-1] - 1) > 10 * DISTORTION


@optiland
@quiet
def test_zemax_files_are_read(tmp_path, da_mobile):
    """Expectation: a singlet of N-BK7 from a Zemax file is the camera that Optiland's format gives, with the axial
    colour of the catalogue's glass: f dn / (n - 1) from 550 to 750 nm, n = 1.51852 and 1.51177 (Schott).
    """
    curved = {"radius": -FOCAL_MM * 0.51852, "thickness": FOCAL_MM}
    flat = {"radius": np.inf, "thickness": 1.0, "material": "N-BK7", "is_stop": True}
    small = framed(da_mobile, FAR)
    paths = (write(tmp_path / name, [flat, curved], 1.25) for name in ("bk7.json", "bk7.zmx"))
    lens, same = (camera_from_lens(path, small).lens for path in paths)
    assert same.focal_length_mm == pytest.approx(lens.focal_length_mm, rel=1e-6)
    np.testing.assert_allclose(
        [row.coefficients() for row in same.wavefront_by_field],
        [row.coefficients() for row in lens.wavefront_by_field],
        atol=0.01,
    )
    shift_um = dict(lens.focal_shift_um)[750.0]
    assert shift_um == pytest.approx(FOCAL_MM * 1e3 * (1.51852 - 1.51177) / 0.51852, rel=0.02)


@optiland
@quiet
def test_phone_lens(tmp_path, da_mobile):
    """Set-up: the lens of US patent 7,535,658 (radius, distance, index and Abbe number, 1 + conic constant,
    coefficients of r^3 to r^10), one glass and three plastic elements and a cover glass.

    Expectation: its focal length of 5.555 mm (at 588 nm) and f/3.5; it is diffraction-limited on the axis; the axial
    colour is that which `docs/guides/real-parts.md` states.
    """
    from optiland.materials import AbbeMaterial

    surfaces: list[dict] = [{"radius": np.inf, "thickness": 0.0, "is_stop": True}]
    for radius, thickness, medium, eccentricity, terms in PHONE:
        conic = {"surface_type": "odd_asphere", "conic": eccentricity - 1, "coefficients": [0.0, 0.0, *terms]}
        glass = {"material": AbbeMaterial(*medium, model="polynomial")} if medium else {}
        surfaces.append({"radius": radius, "thickness": thickness} | glass | (conic if terms else {}))
    path = write(tmp_path / "phone.json", surfaces, 5.555 / 3.5)
    lens = camera_from_lens(path, dasim.cropped(da_mobile, 1024, 768)).lens
    assert lens.focal_length_mm == pytest.approx(5.555, abs=0.01)
    assert lens.f_number == pytest.approx(3.5, abs=0.01)
    assert dict(lens.focal_shift_um)[750.0] == pytest.approx(29.5, abs=0.5)
    assert np.linalg.norm(lens.wavefront_by_field[0].coefficients()) < 38.0  # nm


@optiland
@quiet
def test_command_writes_a_camera_file(tmp_path, capsys):
    """Expectation: `dasim lens` writes what `camera_from_lens` returns."""
    from dasim.cli import run

    path = plano_convex(tmp_path / "slow.json", 1.25)
    small = framed(dasim.load_camera("da-mobile"), FAR)
    base = tmp_path / "base.toml"
    from dasim.base.toml import to_toml

    base.write_text(to_toml(small.model_dump(mode="json")))
    assert dasim.load_camera(base) == small
    assert run(["lens", str(path), "--camera", str(base), "--out", str(tmp_path / "new.toml")]) == 0
    assert dasim.load_camera(tmp_path / "new.toml") == camera_from_lens(path, small)
    assert "20 mm f/16" in capsys.readouterr().out


def test_refused_files(tmp_path):
    """Expectation: one line each, without Optiland too."""
    with pytest.raises(InputError, match=r"lens .*none\.zmx: no such file"):
        camera_from_lens(tmp_path / "none.zmx")
    (tmp_path / "lens.seq").write_text("RDY")
    with pytest.raises(InputError, match=r"a Zemax file \(\.zmx\) or one of Optiland"):
        camera_from_lens(tmp_path / "lens.seq")


def test_stops_that_the_table_does_not_allow_are_refused(tmp_path, monkeypatch):
    """Set-up: tracing that finds no error at all, and `bando`, whose discs are displaced. Expectation: the message of a
    camera file with these keys gets, instead of a camera that cannot be rendered.
    """
    axis = SimpleNamespace(geometry=SimpleNamespace(cs=SimpleNamespace(z=0.0)))
    paraxial = SimpleNamespace(f2=lambda: 3.6, FNO=lambda: 2.8)
    optic = SimpleNamespace(object_surface=SimpleNamespace(is_infinite=True), paraxial=paraxial, image_surface=axis)
    terms = {nm: np.zeros(len(zernike.TERMS)) for nm in prescription.WAVELENGTHS_NM}

    def traced(optic, angle_deg, path, corner_deg):
        return prescription._Traced(terms, 3.6 * np.tan(np.radians(angle_deg)), 1.0)

    monkeypatch.setattr(prescription, "_read", lambda path: optic)
    monkeypatch.setattr(prescription, "_prepare", lambda optic, corner_deg: None)
    monkeypatch.setattr(prescription, "_traced", traced)
    assert camera_from_lens(tmp_path / "perfect.json").lens.f_number == 2.8
    with pytest.raises(InputError, match="all stops must be discs or rings about the axis"):
        camera_from_lens(tmp_path / "perfect.json", "bando")


@optiland
@quiet
def test_near_objects_are_refused(tmp_path):
    path = plano_convex(tmp_path / "near.json", 1.25)
    near = tmp_path / "finite.json"
    from optiland.fileio import load_optiland_file, save_optiland_file

    optic = load_optiland_file(str(path))
    optic.set_thickness(80.0, 0)
    save_optiland_file(optic, str(near))
    with pytest.raises(InputError, match=r"finite\.json: its object lies at a finite distance") as problem:
        camera_from_lens(near)
    assert "\n" not in str(problem.value)


@optiland
@quiet
@pytest.mark.parametrize("name", ["lens.zmx", "lens.json"])
def test_damaged_files_are_one_line(tmp_path, name):
    (tmp_path / name).write_text("{}")
    with pytest.raises(InputError) as problem:
        camera_from_lens(tmp_path / name)
    assert "\n" not in str(problem.value)
