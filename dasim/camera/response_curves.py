"""Response curves of a sensor: the bundled synthetic ones, tables from CSV files, and near-infrared crosstalk.

Tested in tests/dasim/camera/test_specification.py.
"""

from __future__ import annotations

import csv
import itertools
import re
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationInfo, model_validator

from dasim.base import untrusted
from dasim.base.toml import Specification, named_file
from dasim.camera.silicon import absorptance
from dasim.spectra import grid
from dasim.spectra.grid import NEAR_INFRARED_NM, WAVELENGTH_NM, long_pass
from dasim.typing import FloatArray

CHANNEL_NAME = re.compile(r"\w{1,16}", re.ASCII)  # also the names of the channels in the truth's EXR file
WIDEST_STEP_NM = 20.0  # between two entries of a response curve; a wider step is refused as a gap


class Curves(Specification):
    """Tabulated quantum efficiency of every channel, electrons per photon, interpolated linearly.

    In TOML, ``file`` names a CSV file: a first column ``wavelength_nm``, then one column per channel, headed by its
    name. The table may extend beyond 400 to 830 nm, the simulated band; entries outside are ignored.
    """

    wavelength_nm: tuple[grid.AnyNm, ...] = Field(min_length=2)
    channels: dict[str, tuple[Annotated[float, Field(ge=0, le=1)], ...]] = Field(min_length=1)

    @model_validator(mode="before")
    @classmethod
    def _read(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or "file" not in data:
            return data
        if len(data) > 1:
            raise ValueError("file and curves both give the response; keep one")
        names, columns = _csv_columns(named_file(data, info))
        columns = _within_band(columns)
        return {"wavelength_nm": columns[0], "channels": dict(zip(names[1:], columns[1:], strict=True))}

    @model_validator(mode="after")
    def _whole(self) -> Curves:
        low, high = grid.WHOLE_GRID_NM
        wavelength = self.wavelength_nm
        if any(b <= a for a, b in itertools.pairwise(wavelength)):
            raise ValueError("wavelength_nm must rise")
        if wavelength[0] < low or wavelength[-1] > high:
            raise ValueError(f"wavelength_nm must lie within {low:g} to {high:g} nm, the simulated band")
        for a, b in itertools.pairwise(wavelength):
            if b - a > WIDEST_STEP_NM:
                raise ValueError(f"wavelength_nm has a gap from {a:g} to {b:g} nm; steps of {WIDEST_STEP_NM:g} at most")
        for name, values in self.channels.items():
            if not CHANNEL_NAME.fullmatch(name):
                raise ValueError(f"channels.{name}: names must be 1 to 16 letters, digits or underscores")
            if len(values) != len(wavelength):
                raise ValueError(f"channels.{name} must have as many values as wavelength_nm")
        return self


def _csv_columns(path: Path) -> tuple[list[str], list[tuple[float, ...]]]:
    """Names and columns of a table of response curves; ValueError names the line that is wrong."""
    try:
        lines = [line for line in untrusted.text(path, f"file {path}").splitlines() if line.strip()]
        rows = list(csv.reader(line for line in lines if not line.startswith("#")))
    except csv.Error as error:
        raise ValueError(f"file {path}: cannot be read as a table ({error})") from None
    names = [name.strip() for name in rows[0]] if rows else []
    if len(names) < 2 or names[0] != "wavelength_nm" or len(set(names)) != len(names) or "" in names:
        raise ValueError(f"file {path}: the first line must be 'wavelength_nm' and one name per channel")
    table = []
    for number, row in enumerate(rows[1:], 2):
        if len(row) != len(names) or any(not item.strip() for item in row):
            raise ValueError(f"file {path}, line {number} of the table: must have {len(names)} numbers")
        table.append([_number(item, f"file {path}, line {number} of the table") for item in row])
    if len(table) < 2:
        raise ValueError(f"file {path}: must have two or more lines of numbers")
    return names, list(zip(*table, strict=True))


def _within_band(columns: list[tuple[float, ...]]) -> list[tuple[float, ...]]:
    """A table's columns, wavelengths first, cropped to the simulated band by linear interpolation at its ends."""
    nm = np.array(columns[0])
    if (np.diff(nm) <= 0).any():
        return columns  # refused by the validator of wavelength_nm
    low, high = (np.clip(end, nm[0], nm[-1]) for end in grid.WHOLE_GRID_NM)
    inside = np.unique([low, *nm[(nm > low) & (nm < high)], high])
    return [tuple(np.interp(inside, nm, column).tolist()) for column in columns]


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f"{where}: '{text.strip()}' is not a number")
    return value


def _bell(centre_nm: float, left_nm: float, right_nm: float) -> FloatArray:
    """Gaussian of height 1 with different standard deviations below and above its centre."""
    sigma = np.where(WAVELENGTH_NM < centre_nm, left_nm, right_nm)
    return np.exp(-0.5 * ((WAVELENGTH_NM - centre_nm) / sigma) ** 2)


@lru_cache(maxsize=8)
def rgb_ir_quantum_efficiency(silicon_um: float | None = None) -> FloatArray:
    """Quantum efficiency of a synthetic RGB-IR sensor, [4 (R, G, B, IR), wavelength], 0..1; not writeable.

    With a thickness of silicon, the clear pixel converts at most what this layer absorbs (:func:`silicon.absorptance`).
    In 3 um, which a front-illuminated pixel of 1.7 um has, the limit begins at 648 nm: 0.37 at 730 nm and 0.23 at
    800 nm instead of 0.52 and 0.44, in all four channels. Without it, the curves are those of a thick pixel (7 um).

    The paper's Fig. 2(d) is not available as numbers, and no measured curve of a complete RGB-IR sensor was found, so
    the curves are parametric: a clear silicon pixel (a broad bell, 0.58 at 610 nm) behind one dye per channel. The
    visible pass bands and near-infrared tails follow the shape of published curves of silicon sensors (the tails of
    green and blue open slowly beyond 700 and 780 nm); red passes nearly all of the near-infrared, as in sec. 4.4. The
    infrared dye opens at 655 nm, so that the infrared pixel sees almost no visible light, as eq. (7) assumes. Green
    peaks at 0.55.

    The areas of the tails over 650-810 nm, relative to a clear pixel, compared with measured sensors (MT9V024 and
    similar ones). Eq. (8) divides by the infrared pixel instead:

    | | R | G | B | IR |
    |---|---|---|---|---|
    | these curves, over the clear pixel | 0.91 | 0.145 | 0.074 | 0.91 |
    | measured, over the clear pixel | 0.55-0.59 | 0.19-0.20 | 0.10 | not measured |
    | these curves, eq. (8) | 0.997 | 0.159 | 0.081 | 1 |

    Green and blue have the order and size of measured dyes, about a quarter lower; red is far higher, because the
    paper's sensor records nearly all of the near-infrared there. The infrared signal times the coefficients of eq. (8)
    is subtracted from R, G and B (eq. (7)); the coefficients are exact for light of equal photon flux at all
    wavelengths of the band, see :func:`ir_crosstalk`.
    """
    clear = 0.58 * _bell(610.0, 221.0, 254.0)
    if silicon_um is not None:
        clear = np.minimum(clear, absorptance(silicon_um))
    red = 0.03 + 0.88 * long_pass(592.0, 30.0)
    green = 0.05 + 0.94 * _bell(540.0, 32.0, 36.0) + 0.28 * long_pass(755.0, 120.0)
    blue = 0.05 + 0.90 * _bell(455.0, 45.0, 33.0) + 0.45 * long_pass(805.0, 45.0)
    infrared = 0.95 * long_pass(655.0, 14.0)
    efficiency = clear * np.stack([red, green, blue, infrared])
    efficiency.flags.writeable = False  # shared by all callers
    return efficiency


def ir_crosstalk(response: FloatArray, band_nm: tuple[float, float] = NEAR_INFRARED_NM) -> FloatArray:
    """Near-infrared crosstalk of R, G and B relative to IR, [3], eq. (8): ratios of areas over 650-810 nm.

    ``response`` is [4, wavelength] in electrons per photon (f_i of the paper), so that the areas are the signals of
    light with the same photon flux at each wavelength. NaN for infrared pixels that record none of the band.
    """
    low, high = band_nm
    nm = np.concatenate([[low], WAVELENGTH_NM[(WAVELENGTH_NM > low) & (WAVELENGTH_NM < high)], [high]])
    areas = [np.trapezoid(np.interp(nm, WAVELENGTH_NM, row), nm) for row in response]
    if not areas[3] > 0:
        return np.full(3, np.nan)
    return np.array(areas[:3]) / areas[3]
