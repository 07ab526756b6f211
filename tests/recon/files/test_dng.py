"""Captures as DNG: what other libraries read in them, and what they must not hold."""

from __future__ import annotations

import struct
import warnings

import numpy as np
import pytest
import tifffile

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import noise, radiometry
from dasim.camera import specification as cameras
from dasim.spectra import colour as colours
from dasim.spectra import colour_checker, grid
from dasim.values import Capture, Developed
from recon.files import dng, raw
from recon.picture import colour
from recon.picture.infrared import light_power

WIDTH, HEIGHT = 64, 48
ALL = ("da-mobile", "bayer-mobile", "da-4x4")


def camera_of(name: str):
    return cameras.cropped(cameras.load_camera(name), WIDTH, HEIGHT)


def capture_of(name: str, **changes) -> Capture:
    """Random numbers in all the range of the converter."""
    numbers = np.random.default_rng(3).integers(0, 1024, (HEIGHT, WIDTH)).astype(np.uint16)
    fields = {"exposure_s": 0.0125, "gain": 2.0, "seed": 7, "illuminant": "A", "provenance": {"diffraction": "off"}}
    return Capture(numbers, camera_of(name), **{**fields, **changes})


def developed_of(name: str, light: str = "D65") -> Developed:
    """Smooth colours through the matrix of a light, in electrons, with an infrared plane where the camera has one."""
    camera = camera_of(name)
    y, x = np.mgrid[:HEIGHT, :WIDTH] / (HEIGHT, WIDTH)[0]
    srgb = np.stack([0.2 + 0.5 * x / x.max(), 0.3 + 0.4 * y, 0.6 - 0.3 * y], -1)
    matrix = colour.colour_matrix(camera, light) / 2000
    linear = (srgb @ np.linalg.inv(matrix).T).astype(np.float32)
    ir = linear[..., 1] / 3 if name != "bayer-mobile" else None
    return Developed(srgb.astype(np.float32), linear, ir, matrix, camera, light, {}, {})


@pytest.mark.parametrize("name", ALL)
def test_what_dasim_writes_it_reads(tmp_path, name):
    """Expectation: numbers, camera, exposure and gain come back without a camera file; scene, light and seed do not."""
    shot = capture_of(name)
    dng.write_dng(tmp_path / "photo.dng", shot)
    back = raw.load_input(tmp_path / "photo.dng")
    np.testing.assert_array_equal(back.raw_dn, shot.raw_dn)
    assert back.camera == shot.camera and (back.exposure_s, back.gain) == (0.0125, 2.0)
    assert back.illuminant is None and back.provenance == {"diffraction": "off"}
    given = raw.load_input(tmp_path / "photo.dng", cameras.load_camera(name), exposure_s=0.5, gain=1.0)
    assert (given.exposure_s, given.gain, given.provenance) == (0.5, 1.0, {"raw_file": "photo.dng"})


def test_a_low_gain_needs_few_numbers(tmp_path):
    """Set-up: a gain at which the full well is a quarter of the converter's range. Expectation: it comes back."""
    shot = capture_of("da-mobile", gain=0.25)
    dng.write_dng(tmp_path / "photo.dng", shot)
    np.testing.assert_array_equal(raw.load_input(tmp_path / "photo.dng").raw_dn, shot.raw_dn)


@pytest.mark.parametrize("name", ALL)
def test_tags_of_the_mosaic(tmp_path, name):
    """Expectation: tifffile finds the pattern with infrared as white, the levels and the exposure; DNG wants a plane
    per colour (CFAPlaneColor) and as many rows in its matrices.
    """
    shot = capture_of(name)
    dng.write_dng(tmp_path / "photo.dng", shot)
    with tifffile.TiffFile(tmp_path / "photo.dng") as file:
        (page,) = file.pages
        tags = {tag.code: tag.value for tag in page.tags}
        np.testing.assert_array_equal(page.asarray(), shot.raw_dn)
    mosaic = shot.camera.sensor.mosaic
    assert tags[262] == 32803 and tags[33421] == (len(mosaic), len(mosaic[0]))
    letters = {0: "R", 1: "G", 2: "B", 6: "IR"}
    assert [letters[code] for code in tags[33422]] == [name for row in mosaic for name in row]
    planes = 3 if name == "bayer-mobile" else 4
    assert list(tags[50710]) == [0, 1, 2, 6][:planes] and len(tags[50721]) == len(tags[50722]) == 2 * 3 * planes
    assert (tags[50714], tags[50717]) == (64, 1023) and len(tags[50728]) == 2 * planes
    above, below = tags[33434]
    assert above / below == pytest.approx(0.0125, rel=1e-8)


def test_noise_profile_is_that_of_a_flat_field(tmp_path):
    """Rationale: S x + O must be the variance that frames of the sensor have, in units of white minus black.

    Set-up: uniform light at two levels, a sensor without PRNU, 256 x 192 pixels. A variance of n normal values has a
    standard deviation of sqrt(2 / n); dark current's mean is in the signal, not in x.
    """
    data = cameras.cropped(cameras.load_camera("da-mobile"), 256, 192).model_dump()
    data["sensor"] |= {"prnu": 0.0, "hot_pixel_share": 0.0}
    camera = parse(cameras.Camera, data, "camera")
    sensor = camera.sensor
    for share in (0.05, 0.5):
        mean_e = np.full((192, 256), share * noise.full_scale_e(sensor, 2.0))
        frame, _ = noise.expose(mean_e, sensor, 0.0125, seed=5, gain=2.0)
        shot = Capture(frame, camera, 0.0125, 2.0, 0)
        dng.write_dng(tmp_path / "flat.dng", shot)
        with tifffile.TiffFile(tmp_path / "flat.dng") as file:
            slope, offset = file.pages.first.tags[51041].value
        x = (frame - 64.0) / (1023 - 64)
        assert x.var() == pytest.approx(slope * share + offset, rel=5 * np.sqrt(2 / frame.size))


def test_colour_matrix_maps_xyz_to_the_camera():
    """Expectation: by XYZ from the library colour-science, the matrix gives the camera's response to the patches of the
    ColorChecker within a few percent of white (colours of the visible channels; the coatings are no colorimeter), and
    white almost exactly.
    """
    colour_science = pytest.importorskip("colour")
    camera, power = camera_of("bayer-mobile"), light_power("D65")
    matrix = colours.fitted_from_xyz(radiometry.response(camera), power)
    patches = np.vstack([colour_checker.iso_17321_curves(), np.ones_like(grid.WAVELENGTH_NM)])
    electrons = grid.integrate(patches[:, None, :] * radiometry.response(camera) * power)
    shape = colour_science.SpectralShape(400, 780, 5)
    spectra = (colour_science.SpectralDistribution(patch * power, grid.WAVELENGTH_NM) for patch in patches)
    with warnings.catch_warnings(action="ignore"):  # of tables aligned to each other
        xyz = np.array([colour_science.sd_to_XYZ(spectrum.align(shape)) for spectrum in spectra])
    xyz /= xyz[-1, 1]
    error = xyz @ matrix.T - electrons / electrons[-1].max()
    assert np.abs(error[-1]).max() < 0.05 and np.sqrt((error**2).mean()) < 0.03


@pytest.mark.parametrize("name", ["da-mobile", "bayer-mobile"])
def test_libraw_reads_the_mosaic(tmp_path, name):
    """Expectation: LibRaw, which raw developers use, finds the same numbers, levels and sites of the colours."""
    rawpy = pytest.importorskip("rawpy", reason="rawpy is not installed")
    shot = capture_of(name)
    dng.write_dng(tmp_path / "photo.dng", shot)
    with rawpy.imread(str(tmp_path / "photo.dng")) as photo:
        np.testing.assert_array_equal(photo.raw_image_visible, shot.raw_dn)
        assert set(photo.black_level_per_channel) == {64} and photo.white_level == 1023
        order = ["R", "G", "B", "IR" if name == "da-mobile" else "G"]
        assert [[order[index] for index in row] for row in photo.raw_pattern] == [
            list(row) for row in shot.camera.sensor.mosaic
        ]


@pytest.mark.parametrize("name", ["da-mobile", "bayer-mobile"])
def test_libraw_develops_the_linear_file(tmp_path, name):
    """Rationale: another implementation of DNG's colour model must arrive at the colours of the development.

    Set-up: smooth colours under D65, for which LibRaw's model has no approximation. Expectation: linear sRGB is that of
    the development times one factor, to 1/256 of white.
    """
    rawpy = pytest.importorskip("rawpy", reason="rawpy is not installed")
    developed = developed_of(name)
    dng.write_linear_dng(tmp_path / "linear.dng", capture_of(name), developed)
    with rawpy.imread(str(tmp_path / "linear.dng")) as photo:
        options = {"use_camera_wb": True, "no_auto_bright": True, "output_bps": 16, "gamma": (1, 1), "user_flip": 0}
        picture = photo.postprocess(**options) / 65535
    expected = developed.linear_e @ developed.matrix.T
    factor = (picture * expected).sum() / (expected**2).sum()
    assert np.abs(picture - factor * expected).max() < 1 / 256 and picture.max() < 1


def test_linear_pages_are_electrons(tmp_path):
    """Expectation: a page of three colours, and one of infrared that is no raw picture; both on the stated scale."""
    developed = developed_of("da-mobile")
    dng.write_linear_dng(tmp_path / "linear.dng", capture_of("da-mobile"), developed)
    with tifffile.TiffFile(tmp_path / "linear.dng") as file:
        first, second = file.pages
        assert first.photometric == 34892 and second.photometric == 1 and second.subfiletype == 2
        rgb, ir, text = first.asarray(), second.asarray(), second.description
    scale = float(text.split("black, ")[1].split()[0])
    for page, electrons in ((rgb, developed.linear_e), (ir, developed.ir_e)):
        assert np.abs((page - 1024.0) / scale - electrons).max() < 0.5001 / scale + 1e-5 * electrons.max()


def changed(path, code: int, value: bytes | int) -> None:
    """Overwrite a tag of the first page: the 4 bytes of its value, or its content elsewhere."""
    content = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        tag = file.pages.first.tags[code]
        data = value if isinstance(value, bytes) else struct.pack("<H" if tag.dtype == 3 else "<I", value)
        content[tag.valueoffset : tag.valueoffset + len(data)] = data
    path.write_bytes(content)


WRONG = {
    "pattern": (33422, bytes([0, 1, 1, 2]), "filters R G / G B, camera 'da-mobile' has G R / B IR"),
    "black": (50714, 512, "black level of 512, camera 'da-mobile' has 64"),
    "white": (50717, 4095, "white level of 4095, camera 'da-mobile' has 10 bits"),
    "compression": (259, 7, "is compressed"),
    "linear": (262, 34892, "holds no mosaic"),
    "preview": (254, 1, "holds no mosaic"),
    "width": (256, 2**16 - 1, "cannot be read|pixels"),
    "private": (50740, b"dasim\0{}", "DNGPrivateData|JSON"),
    "others": (50740, b"other\0", "not a DNG that dasim wrote; give its camera with --camera"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_a_dng_must_not_hold(tmp_path, case):
    code, value, message = WRONG[case]
    path = tmp_path / "photo.dng"
    dng.write_dng(path, capture_of("da-mobile"))
    changed(path, code, value)
    with pytest.raises(InputError, match=message) as refused:
        raw.load_input(path)
    assert "\n" not in str(refused.value) and "photo.dng" in str(refused.value)


def test_a_dng_of_another_camera(tmp_path):
    """Set-up: the raw page below a preview, with a border outside ActiveArea, as many cameras write it; its infrared
    has another code. Expectation: the active area, and the exposure time of the file.
    """
    camera, shot = cameras.load_camera("da-mobile"), capture_of("da-mobile")
    whole = np.pad(shot.raw_dn, ((4, 2), (6, 0)))
    levels = [(50714, 5, 1, (64, 1), True), (50829, 4, 4, (4, 6, 4 + HEIGHT, 6 + WIDTH), True)]
    filters = [(33421, 3, 2, (2, 2), True), (33422, 1, 4, bytes([1, 0, 2, 3]), True)]
    with tifffile.TiffWriter(tmp_path / "photo.dng") as file:
        about = [(33434, 5, 1, (1, 80), True), (50706, 1, 4, bytes([1, 4, 0, 0]), True)]
        file.write(np.zeros((8, 8, 3), np.uint8), photometric="rgb", subfiletype=1, subifds=1, extratags=about)
        file.write(whole, photometric=32803, subfiletype=0, extratags=[*filters, *levels], metadata=None)
    back = raw.load_input(tmp_path / "photo.dng", camera)
    np.testing.assert_array_equal(back.raw_dn, shot.raw_dn)
    assert back.exposure_s == 1 / 80 and back.provenance == {"raw_file": "photo.dng"}
    with pytest.raises(InputError, match="--camera"):
        raw.load_input(tmp_path / "photo.dng")


def test_a_channel_without_a_code(tmp_path):
    camera = camera_of("da-mobile")
    data = camera.model_dump(mode="json")
    wavelength_nm = [float(nm) for nm in range(400, 831, 10)]
    curves = {name: [0.5] * len(wavelength_nm) for name in ("R", "G", "B", "W")}
    data["sensor"] |= {
        "mosaic": [["G", "R"], ["B", "W"]],
        "quantum_efficiency": {"wavelength_nm": wavelength_nm, "channels": curves},
    }
    four = parse(cameras.Camera, data, "camera")
    shot = Capture(capture_of("da-mobile").raw_dn, four, 0.01, 1.0, 0)
    with pytest.raises(InputError, match="no filter for channel W"):
        dng.write_dng(tmp_path / "photo.dng", shot)
    assert not list(tmp_path.iterdir())
