"""The mosaic of an uncompressed DNG, of dasim or of another camera, and the tags that describe it.

Tested in tests/recon/files/test_dng.py and tests/recon/files/test_foreign_dng.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from dasim.base import untrusted
from dasim.base.errors import InputError, one_line
from dasim.base.toml import Specification, parse
from dasim.camera.specification import Camera
from recon.files.dng import CFA, FILTERS, PRIVATE, RATIONAL

_LETTERS = "RGBCMYW"  # of the codes of CFAPattern
_NOT_APPLIED = {  # tags that change the numbers before or with the black level
    50712: "a table of linearisation (LinearizationTable)",
    50715: "a black level per column (BlackLevelDeltaH)",
    50716: "a black level per row (BlackLevelDeltaV)",
    51008: "corrections (OpcodeList1)",
}


class _Private(Specification):
    """What the ``DNGPrivateData`` of dasim says: the camera and the exposure."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    camera: Camera
    exposure_s: float = Field(gt=0, le=1e10)
    gain: float = Field(ge=1e-6, le=1e6)
    diffraction: Literal["wave", "airy", "off"] | None = None


@dataclass(frozen=True)
class Mosaic:
    """The raw picture of a DNG."""

    raw: NDArray[Any]  # [h, w] the active area
    pattern: NDArray[np.int64]  # [rows, columns] codes of the filters, top left of the picture first
    black_dn: tuple[float, ...]  # of the pixels of a repeated block
    white_dn: float | None
    exposure_s: float | None
    private: _Private | None


def read_mosaic(path: Path) -> Mosaic:
    """The mosaic of a DNG and its tags; InputError where it holds none, or is compressed, too large or damaged."""
    import tifffile

    where = f"raw picture {path}"
    untrusted.check_file(path, where)
    try:
        with untrusted.quiet(), tifffile.TiffFile(path) as file:
            page = _raw_page(file, where)
            tags = {tag.code: tag for tag in page.tags}
            for code, name in _NOT_APPLIED.items():
                if code in tags:
                    raise InputError(f"{where}: has {name}, which is not applied here; convert it to plain raw values")
            if 50711 in tags and _values(tags[50711]) != [1]:
                raise InputError(f"{where}: its pixels are staggered (CFALayout); only rows and columns can be read")
            if page.compression != tifffile.COMPRESSION.NONE:
                raise InputError(
                    f"{where}: is compressed ({page.compression.name}); convert it to an uncompressed DNG first"
                )
            pattern = _pattern(tags, where)
            image = np.asarray(page.asarray())
            first = {tag.code: tag for tag in file.pages.first.tags}
            return Mosaic(
                raw=_active(image, tags),
                pattern=pattern,
                black_dn=tuple(map(float, _values(tags[50714]) if 50714 in tags else ())) or (0.0,),
                white_dn=float(max(_values(tags[50717]))) if 50717 in tags else None,
                exposure_s=_exposure_s(first | tags),
                private=_private(first, where),
            )
    except InputError:
        raise
    except Exception as error:  # the library raises many types for damaged files
        text = one_line(str(error)) or type(error).__name__
        raise InputError(f"{where}: cannot be read as DNG ({type(error).__name__}: {text})") from None


def check_fits(found: Mosaic, camera: Camera, where: str) -> None:
    """Raise InputError where a DNG and a camera disagree on filters, black level or bits; any code is infrared."""
    sensor = camera.sensor
    rows, columns = len(sensor.mosaic), len(sensor.mosaic[0])
    height, width = np.lcm(found.pattern.shape, (rows, columns))
    for y, x in np.ndindex(int(height), int(width)):
        name, code = (
            sensor.mosaic[y % rows][x % columns],
            found.pattern[y % len(found.pattern), x % found.pattern[0].size],
        )
        if name != "IR" and FILTERS.get(name) != code:
            has = " / ".join(" ".join(_letter(code) for code in row) for row in found.pattern)
            wants = " / ".join(" ".join(row) for row in sensor.mosaic)
            raise InputError(
                f"{where}: has the filters {has}, camera '{camera.name}' has {wants}; give the right camera"
            )
    levels = sorted(set(found.black_dn))
    if len(levels) > 1:
        raise InputError(
            f"{where}: has black levels of {', '.join(f'{level:g}' for level in levels)} for the pixels of its block, "
            "a camera has one for all; subtract the difference, and give the numbers as PNG, TIFF or NPY"
        )
    if levels != [sensor.black_level_dn]:
        raise InputError(
            f"{where}: has a black level of {levels[0]:g}, camera '{camera.name}' has {sensor.black_level_dn}; "
            "correct black_level_dn of the camera"
        )
    least = 0 if found.private else 2 ** (sensor.adc_bits - 1)  # dasim's gain may be low, so that few numbers are used
    if found.white_dn is not None and not least <= found.white_dn < 2**sensor.adc_bits:
        raise InputError(
            f"{where}: has a white level of {found.white_dn:g}, camera '{camera.name}' has {sensor.adc_bits} bits; "
            "correct adc_bits of the camera"
        )


def with_saturation(raw: NDArray[np.uint16], found: Mosaic, camera: Camera) -> NDArray[np.uint16]:
    """Raw numbers [h, w] in which those from the white level on are the camera's largest: the pixel was saturated."""
    if found.white_dn is None or found.private is not None:
        return raw
    return np.where(raw >= found.white_dn, np.uint16(2**camera.sensor.adc_bits - 1), raw)


def _pattern(tags: dict[int, Any], where: str) -> NDArray[np.int64]:
    """Codes of the filters, [rows, columns]."""
    if not (33421 in tags and 33422 in tags):
        raise InputError(f"{where}: states no filters (CFARepeatPatternDim, CFAPattern); convert it to a complete DNG")
    rows, columns = (int(value) for value in _values(tags[33421]))
    codes = _values(tags[33422])
    if not 0 < rows * columns == len(codes):
        raise InputError(f"{where}: states a block of {rows} x {columns} filters with {len(codes)} codes")
    return np.array(codes, np.int64).reshape(rows, columns)


def _letter(code: int) -> str:
    return _LETTERS[code] if 0 <= code < len(_LETTERS) else str(code)


def _raw_page(file: Any, where: str) -> Any:
    """The first full-size page with a mosaic, at the top or below another page."""
    for page in file.pages:
        for candidate in (page, *(page.pages or ())):
            if candidate.photometric == CFA and not candidate.subfiletype & 1:
                untrusted.check_pixels((candidate.imagewidth, candidate.imagelength), where)
                return candidate
    raise InputError(f"{where}: holds no mosaic; give the raw DNG, not a linear or converted one")


def _values(tag: Any) -> list[float]:
    """Numbers of a tag of any count; fractions are divided."""
    value = tag.value
    numbers = list(value) if isinstance(value, (tuple, bytes, list)) else [value]
    if int(tag.dtype) == RATIONAL:
        return [above / below for above, below in zip(numbers[::2], numbers[1::2], strict=True)]
    return numbers


def _active(image: NDArray[Any], tags: dict[int, Any]) -> NDArray[Any]:
    """The picture within ActiveArea, where the pattern of the filters begins."""
    if 50829 not in tags:
        return image
    top, left, bottom, right = (int(value) for value in _values(tags[50829]))
    return image[top:bottom, left:right]


def _exposure_s(tags: dict[int, Any]) -> float | None:
    """ExposureTime, in the page itself or in its EXIF table; None where it is 0 / 0, which means unknown."""
    exif = tags[34665].value if 34665 in tags else {}
    above, below = tags[33434].value if 33434 in tags else exif.get("ExposureTime", (0, 0))
    return above / below if below else None


def _private(tags: dict[int, Any], where: str) -> _Private | None:
    """The private data of dasim; None in files of others."""
    content = bytes(tags[50740].value) if 50740 in tags else b""
    if not content.startswith(PRIVATE):
        return None
    return parse(_Private, untrusted.json_values(content.removeprefix(PRIVATE), where), f"{where}: DNGPrivateData")
