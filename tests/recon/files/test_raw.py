"""Raw files of real cameras: every format returns the packed numbers, and every mistake gives a message of one line."""

import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile

from dasim.base.errors import InputError
from dasim.camera import specification as cameras
from dasim.files.png import write_png16
from recon.files import raw as raw_files

WIDTH, HEIGHT = 96, 64


@pytest.fixture(scope="module")
def ten():
    return cameras.cropped(cameras.load_camera("da-mobile"), WIDTH, HEIGHT)


@pytest.fixture(scope="module")
def twelve(ten):
    return ten.model_copy(update={"sensor": ten.sensor.model_copy(update={"adc_bits": 12})})


def numbers(bits):
    """Random values of ``bits`` bits, [h, w]."""
    return np.random.default_rng(bits).integers(0, 2**bits, (HEIGHT, WIDTH)).astype(np.uint16)


def bit_packed(raw, bits, group):
    """MIPI CSI-2 packing written bit by bit: the high bytes of a group, then the low bits, those of the first pixel
    lowest.
    """
    data = bytearray()
    for start in range(0, raw.size, group):
        pixels = [int(value) for value in raw.ravel()[start : start + group]]
        data += bytes(value >> (bits - 8) for value in pixels)
        low = sum((value & (2 ** (bits - 8) - 1)) << (place * (bits - 8)) for place, value in enumerate(pixels))
        data += bytes([low])
    return bytes(data)


@pytest.mark.parametrize("suffix", ["png", "tif", "lzw.tif", "deflate.tif", "npy", "float.npy"])
def test_files_with_a_header(tmp_path, ten, suffix):
    raw, path = numbers(10), tmp_path / f"photo.{suffix}"
    if suffix == "png":
        write_png16(path, raw)
    elif suffix == "lzw.tif":
        cv2.imwrite(str(path), raw, [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_LZW])
    elif suffix == "deflate.tif":
        tifffile.imwrite(path, raw, photometric="minisblack", compression="zlib")
    elif suffix == "tif":
        tifffile.imwrite(path, raw, photometric="minisblack")
    else:
        np.save(path, raw.astype(np.float64) if suffix == "float.npy" else raw)
    capture = raw_files.load_raw(path, ten, exposure_s=0.02, gain=2.0)
    np.testing.assert_array_equal(capture.raw_dn, raw)
    assert capture.raw_dn.dtype == np.uint16 and (capture.exposure_s, capture.gain) == (0.02, 2.0)


def tiff(width: int, height: int, kind: int, strip: bytes, *, next_page: int = 0, **changes: int) -> bytes:
    """A TIFF file of one strip of 16 bits, as its specification (revision 6.0, sec. 2 and 8) lays it out.

    ``kind`` is its compression: 1 none, 5 LZW, 8 deflate; ``changes`` are further tags by ``t`` and number.
    """
    about = {256: width, 257: height, 258: 16, 259: kind, 262: 1, 273: 8, 277: 1, 278: height, 279: len(strip)}
    about |= {int(name[1:]): value for name, value in changes.items()}
    place = 8 + len(strip)
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, about[tag]) for tag in sorted(about))
    return (
        struct.pack("<2sHI", b"II", 42, place)
        + strip
        + struct.pack("<H", len(about))
        + entries
        + struct.pack("<I", place if next_page < 0 else next_page)
    )


@pytest.mark.parametrize(
    ("file", "message"),
    [
        (tiff(100_000, 100_000, 8, zlib.compress(bytes(512))), "100000 x 100000 pixels, at most 100 million"),
        (tiff(100_000, 100_000, 1, bytes(512)), "100000 x 100000 pixels, at most 100 million"),
        (tiff(9000, 9000, 5, bytes(512)), "cannot be read"),
        (tiff(9000, 9000, 1, bytes(512)), "cannot be read"),
        (tiff(16, 16, 8, zlib.compress(bytes(512)), t322=60_000, t323=60_000, t324=8, t325=20), "60000 x 60000"),
        (tiff(16, 16, 8, zlib.compress(bytes(512)), t277=60_000), "one number per pixel"),
        (tiff(16, 16, 1, bytes(512), t32997=10**9), "one number per pixel"),
        (tiff(16, 16, 8, zlib.compress(bytes(512)), next_page=-1), "several pictures"),
    ],
    ids=["header", "header-plain", "lzw-short", "short", "tiles", "samples", "depth", "circle"],
)
def test_tiff_bombs_are_refused(tmp_path, ten, file, message, capfd):
    """Set-up: headers that promise far more than the file has, and directories in a circle. The function that writes
    them makes a valid file, too.
    """
    (tmp_path / "a.tif").write_bytes(file)
    with pytest.raises(InputError, match=message):
        raw_files.load_raw(tmp_path / "a.tif", ten)
    assert capfd.readouterr().err == ""
    (tmp_path / "a.tif").write_bytes(tiff(16, 16, 8, zlib.compress(bytes(range(2)) * 256)))
    assert (raw_files.load_raw(tmp_path / "a.tif", ten).raw_dn == 256).all()


def test_the_pictures_own_size_governs(tmp_path):
    """Set-up: a camera file of 2048 x 1536 pixels and a picture of 96 x 64. Expectation: the capture has the picture's
    size.
    """
    np.save(tmp_path / "photo.npy", numbers(10))
    capture = raw_files.load_raw(tmp_path / "photo.npy", cameras.load_camera("da-mobile"))
    assert (capture.camera.sensor.width_px, capture.camera.sensor.height_px) == (WIDTH, HEIGHT)


def test_a_principal_point_is_that_of_one_size(tmp_path):
    """Rationale: in a picture of another size the axis is elsewhere, and nobody knows where."""
    np.save(tmp_path / "photo.npy", numbers(10))
    window = cameras.cropped(cameras.load_camera("da-mobile"), WIDTH, HEIGHT, at_px=(0, 0))
    assert raw_files.load_raw(tmp_path / "photo.npy", window).camera == window
    with pytest.raises(InputError, match="principal_point_px"):
        raw_files.load_raw(tmp_path / "photo.npy", cameras.cropped(window, WIDTH - 8, HEIGHT))


def test_a_picture_below_the_black_level_is_refused(tmp_path, ten):
    """Set-up: numbers of which the black level has been taken away already."""
    np.save(tmp_path / "dark.npy", np.full((HEIGHT, WIDTH), ten.sensor.black_level_dn - 1, np.uint16))
    with pytest.raises(InputError, match="all pixels are below the black level of 64 DN"):
        raw_files.load_raw(tmp_path / "dark.npy", ten)
    np.save(tmp_path / "dark.npy", np.full((HEIGHT, WIDTH), ten.sensor.black_level_dn, np.uint16))
    assert raw_files.load_raw(tmp_path / "dark.npy", ten).raw_dn.min() == 64


@pytest.mark.parametrize("padding", [0, 8])
@pytest.mark.parametrize("kind", ["raw10", "raw12", "raw16"])
def test_packed_pixels(tmp_path, ten, twelve, kind, padding):
    bits = 10 if kind == "raw10" else 12
    raw, camera = numbers(bits), ten if bits == 10 else twelve
    rows = [r.astype("<u2").tobytes() if kind == "raw16" else bit_packed(r, bits, 4 if bits == 10 else 2) for r in raw]
    (tmp_path / "photo.raw").write_bytes(b"".join(row + b"\xff" * padding for row in rows))
    capture = raw_files.load_raw(tmp_path / "photo.raw", camera, kind=kind)
    np.testing.assert_array_equal(capture.raw_dn, raw)


def test_left_aligned_values(tmp_path, ten):
    raw = numbers(10)
    write_png16(tmp_path / "photo.png", raw << 6)
    with pytest.raises(InputError, match="left-aligned: add --format left-aligned"):
        raw_files.load_raw(tmp_path / "photo.png", ten)
    capture = raw_files.load_raw(tmp_path / "photo.png", ten, kind="left-aligned")
    np.testing.assert_array_equal(capture.raw_dn, raw)
    write_png16(tmp_path / "photo.png", raw << 4)
    with pytest.raises(InputError, match="lowest 6 bits are in use"):
        raw_files.load_raw(tmp_path / "photo.png", ten, kind="left-aligned")


WRONG = {
    "nan": (np.full((64, 96), np.nan), "NaN"),
    "fractions": (np.full((64, 96), 70.5), "fractions"),
    "negative": (np.full((64, 96), -1), "values of -1 to -1"),
    "too deep": (np.full((64, 96), 1025, np.uint16), "10 bits, 0 to 1023"),
    "8 bits": (np.full((64, 96), 100, np.uint8), "has 8 bits"),
    "colour": (np.zeros((64, 96, 3), np.uint16), "one number per pixel"),
    "odd": (np.zeros((63, 96), np.uint16), "not a multiple of the 2 x 2 mosaic"),
    "text": (np.full((64, 96), "a"), "integers"),
    "empty": (np.zeros((0, 0), np.uint16), "height_px"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_a_file_must_not_hold(tmp_path, ten, case):
    values, message = WRONG[case]
    np.save(tmp_path / "photo.npy", values)
    with pytest.raises(InputError, match=message) as refused:
        raw_files.load_raw(tmp_path / "photo.npy", ten)
    assert "photo.npy" in str(refused.value) and "\n" not in str(refused.value)


def test_damaged_and_unknown_files(tmp_path, ten):
    write_png16(tmp_path / "whole.png", numbers(10))
    (tmp_path / "cut.png").write_bytes((tmp_path / "whole.png").read_bytes()[:-2000])
    cv2.imwrite(str(tmp_path / "eight.png"), np.full((64, 96), 9, np.uint8))
    (tmp_path / "no.tif").write_bytes(b"no picture")
    (tmp_path / "no.npy").write_bytes(b"no array")
    for name in ("photo.dng", "photo.nef"):
        (tmp_path / name).write_bytes(b"x")
    for name, message in (
        ("cut.png", "truncated"), ("eight.png", "8 bits"), ("no.tif", "cannot be read"), ("no.npy", "cannot be read"),
        ("photo.dng", "cannot be read as DNG"), ("none.png", "no such file"), ("photo.nef", "--format raw10"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=message) as refused:
            raw_files.load_raw(tmp_path / name, ten)
        assert "\n" not in str(refused.value)


def test_packed_files_that_do_not_fit(tmp_path, ten):
    (tmp_path / "photo.raw").write_bytes(bytes(1000))
    for kind, message in (("raw10", "1000 bytes"), ("raw12", "has 12 bits"), ("raw8", "unknown")):
        with pytest.raises(InputError, match=message):
            raw_files.load_raw(tmp_path / "photo.raw", ten, kind=kind)
    narrow = ten.model_copy(update={"sensor": ten.sensor.model_copy(update={"width_px": 98})})
    with pytest.raises(InputError, match="not a multiple of 4"):
        raw_files.load_raw(tmp_path / "photo.raw", narrow, kind="raw10")
    with pytest.raises(InputError, match="gain"):
        raw_files.load_raw(tmp_path / "photo.raw", ten, kind="raw10", gain=-1.0)
