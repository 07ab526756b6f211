"""DNGs that dasim did not write: the forms that TIFF allows, and tags that change what the numbers mean."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tifffile

from dasim.base.errors import InputError
from dasim.camera import specification as cameras
from recon.files import raw
from recon.picture import mosaic

WIDTH, HEIGHT = 64, 48
SHORT, RATIONAL, SRATIONAL = 3, 5, 10
ABOUT = [(33434, RATIONAL, 1, (1, 80), True), (50706, 1, 4, bytes([1, 4, 0, 0]), True)]
FILTERS = [(33421, SHORT, 2, (2, 2), True), (33422, 1, 4, bytes([1, 0, 2, 6]), True)]
BLACK, WHITE = (50714, SHORT, 1, 64, True), (50717, SHORT, 1, 1023, True)


def numbers() -> np.ndarray:
    return np.random.default_rng(3).integers(0, 1024, (HEIGHT, WIDTH)).astype(np.uint16)


def written(folder: Path, *tags, image: np.ndarray | None = None, byteorder: str = "<", big: bool = False, **form):
    """A DNG with a mosaic and tags, in a form of TIFF."""
    with tifffile.TiffWriter(folder / "photo.dng", byteorder=byteorder, bigtiff=big) as file:
        image = numbers() if image is None else image
        own = {tag[0]: tag for tag in (*ABOUT, *tags)}
        file.write(image, photometric=32803, subfiletype=0, extratags=[*own.values()], metadata=None, **form)
    return raw.load_input(folder / "photo.dng", cameras.load_camera("da-mobile"))


@pytest.mark.parametrize(
    "form",
    [
        {"byteorder": ">"},
        {"big": True},
        {"rowsperstrip": 7},
        {"tile": (16, 32)},
        {"tile": (32, 48), "byteorder": ">", "big": True},  # beyond the frame on both sides
        {"image": numbers().astype(np.uint32)},
        {"image": numbers().astype(np.float32), "byteorder": ">"},
    ],
)
def test_forms_of_tiff_hold_the_same_numbers(tmp_path, form):
    back = written(tmp_path, *FILTERS, BLACK, WHITE, **form)
    np.testing.assert_array_equal(back.raw_dn, numbers())
    assert back.raw_dn.dtype == np.uint16 and back.exposure_s == 1 / 80


@pytest.mark.parametrize(
    "tag",
    [
        (50714, RATIONAL, 4, (640, 10) * 4, True),  # BlackLevel as a block of fractions
        (274, SHORT, 1, 6, True),  # Orientation: raw numbers are not turned
        (50711, SHORT, 1, 1, True),  # CFALayout: rows and columns
    ],
)
def test_tags_that_change_nothing(tmp_path, tag):
    own = [(50713, SHORT, 2, (2, 2), True), tag] if tag[0] == 50714 else [BLACK, tag]
    np.testing.assert_array_equal(written(tmp_path, *FILTERS, *own, WHITE).raw_dn, numbers())


def test_pixels_from_the_white_level_on_are_saturated(tmp_path):
    """Rationale: DNG's white level is the number of a full pixel, which may be less than the converter's largest.
    Expectation: the pixels at 900 and above count as saturated; all others keep their numbers.
    """
    back = written(tmp_path, *FILTERS, BLACK, (50717, 4, 1, 900, True))
    _, saturated = mosaic.linearise(back)
    full = numbers() >= 900
    assert 0.05 < full.mean() < 0.2 and saturated[full].all()
    np.testing.assert_array_equal(back.raw_dn[~full], numbers()[~full])


WRONG = {
    "no filters": ([BLACK, WHITE], "states no filters"),
    "no block": ([(33421, SHORT, 2, (0, 0), True), FILTERS[1], BLACK, WHITE], "0 x 0 filters with 4 codes"),
    "short block": ([(33421, SHORT, 2, (2, 4), True), FILTERS[1], BLACK, WHITE], "2 x 4 filters with 4 codes"),
    "black per pixel": (
        [*FILTERS, (50713, SHORT, 2, (2, 2), True), (50714, SHORT, 4, (64, 60, 60, 68), True), WHITE],
        "black levels of 60, 64, 68 for the pixels of its block",
    ),
    "black in words": ([*FILTERS, (50714, "s", 0, "dark", True), WHITE], "cannot be read as DNG"),
    "white in words": ([*FILTERS, BLACK, (50717, "s", 0, "bright", True)], "cannot be read as DNG"),
    "no black": ([*FILTERS, WHITE], "a black level of 0, camera 'da-mobile' has 64"),
    "black per row": ([*FILTERS, BLACK, WHITE, (50716, SRATIONAL, HEIGHT, (2, 1) * HEIGHT, True)], "BlackLevelDeltaV"),
    "black per column": ([*FILTERS, BLACK, WHITE, (50715, SRATIONAL, WIDTH, (2, 1) * WIDTH, True)], "BlackLevelDeltaH"),
    "eight bits": ([*FILTERS, BLACK, (50717, SHORT, 1, 255, True)], "a white level of 255, camera 'da-mobile' has 10"),
    "twelve bits": ([*FILTERS, BLACK, (50717, SHORT, 1, 4095, True)], "a white level of 4095"),
    "linearisation": ([*FILTERS, BLACK, WHITE, (50712, SHORT, 4, (0, 1, 2, 3), True)], "LinearizationTable"),
    "corrections": ([*FILTERS, BLACK, WHITE, (51008, 7, 4, bytes(4), True)], "OpcodeList1"),
    "staggered": ([*FILTERS, BLACK, WHITE, (50711, SHORT, 1, 2, True)], "CFALayout"),
    "odd area": ([*FILTERS, BLACK, WHITE, (50829, SHORT, 4, (1, 1, 42, 60), True)], "not a multiple of the 2 x 2"),
    "no area": ([*FILTERS, BLACK, WHITE, (50829, SHORT, 4, (10, 10, 10, 10), True)], "greater than or equal to 8"),
    "years": ([*FILTERS, BLACK, WHITE, (33434, RATIONAL, 1, (4_000_000_000, 1), True)], "less than or equal to 3600"),
}


@pytest.mark.parametrize("case", WRONG)
def test_numbers_of_another_meaning_are_refused(tmp_path, case):
    """Expectation: one line that names the file and the tag, no numbers that look right."""
    tags, message = WRONG[case]
    with pytest.raises(InputError, match=message) as refused:
        written(tmp_path, *tags)
    assert "\n" not in str(refused.value) and "photo.dng" in str(refused.value)


@pytest.mark.parametrize("form", [{"compression": "zlib"}, {"compression": "zlib", "tile": (16, 16)}])
def test_compressed_mosaics_are_refused(tmp_path, form):
    with pytest.raises(InputError, match=r"is compressed \(ADOBE_DEFLATE\)"):
        written(tmp_path, *FILTERS, BLACK, WHITE, **form)


def test_an_unknown_exposure_time(tmp_path):
    """EXIF writes an unknown fraction as 0 / 0; a time that is given is used instead of that of the file."""
    back = written(tmp_path, *FILTERS, BLACK, WHITE, (33434, RATIONAL, 1, (0, 0), True))
    assert back.exposure_s == raw.DEFAULT_EXPOSURE_S
    camera = cameras.load_camera("da-mobile")
    assert raw.load_input(tmp_path / "photo.dng", camera, exposure_s=0.5).exposure_s == 0.5
