"""The data sheet of a sensor by EMVA 1288 (release 4.0), translated into the fields of ``camera.sensor.Sensor``.

A camera's TOML file takes it as a table ``[sensor.emva1288]`` beside the geometry, the converter and the mosaic.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydantic import BaseModel, Field, model_validator
from scipy.special import ndtr

from dasim.base.toml import Specification
from dasim.spectra import grid

# Defaults of the fields of Sensor where a camera's file gives neither the field nor the figure of the data sheet.
DEFAULT_PRNU = 0.01
DEFAULT_DARK_DOUBLING_K = 7.0

# The variance's peak is looked for from this share of the full well to the full well.
_LOWEST_PEAK = 0.05
_PEAK_POINTS = 2001


class DataSheet(Specification):
    """Figures of an EMVA 1288 data sheet in the sheet's units, and the field of ``Sensor`` that each one sets.

    | figure | becomes |
    |---|---|
    | overall system gain K | ``dn_per_e``; without it, the full well is at the converter's full scale |
    | temporal dark noise sigma_d | ``read_noise_e``; both are for zero exposure time and without rounding |
    | saturation capacity mu_e.sat | ``full_well_e``, by :func:`full_well_of_capacity_e` |
    | DSNU1288, PRNU1288 | ``dsnu_e``, ``prnu``, taken as white patterns: ``row_noise_e``, ``column_noise_e`` are 0 |
    | dark current mu_I, at ``dark_current_temperature_c`` | ``dark_current_e_s``, converted to 25 C |
    | doubling temperature T_d | ``dark_doubling_k`` |
    | quantum efficiency of green, at ``wavelength_nm`` or its peak | ``quantum_efficiency_scale``, for all curves |

    Quantum efficiency is measured under uniform light. The measured value excludes electrons that a pixel loses to its
    neighbours and includes those that it gains from them, so the curves are scaled to what green pixels collect. If the
    camera's file has a table ``quantum_efficiency``, its curves are used relative to each other, and the sheet sets
    their height.
    """

    overall_system_gain_dn_per_e: float | None = Field(default=None, ge=1e-6, le=1e6)
    temporal_dark_noise_e: float | None = Field(default=None, ge=0, le=1e6)
    saturation_capacity_e: float | None = Field(default=None, gt=0, le=1e8)
    dsnu1288_e: float | None = Field(default=None, ge=0, le=1e6)
    prnu1288_percent: float | None = Field(default=None, ge=0, le=50)
    dark_current_e_s: float | None = Field(default=None, ge=0, le=1e9)
    dark_current_temperature_c: float | None = Field(default=None, ge=-100, le=150, description="25 by default")
    doubling_temperature_k: float | None = Field(default=None, ge=1, le=100)
    quantum_efficiency_percent: float | None = Field(default=None, gt=0, le=100)
    wavelength_nm: float | None = Field(default=None, ge=float(grid.WAVELENGTH_NM[0]), le=float(grid.WAVELENGTH_NM[-1]))

    @model_validator(mode="after")
    def _conditions_have_their_figure(self) -> DataSheet:
        for condition, figure in (
            ("dark_current_temperature_c", "dark_current_e_s"),
            ("wavelength_nm", "quantum_efficiency_percent"),
        ):
            if getattr(self, condition) is not None and getattr(self, figure) is None:
                raise ValueError(f"{condition} says nothing without {figure}")
        return self


class Green(NamedTuple):
    """What a data sheet says of the quantum efficiency of green pixels."""

    share: float  # electrons per photon
    wavelength_nm: float | None  # None: at the peak


class _Table(BaseModel):
    """Gives the errors of the data sheet their path."""

    emva1288: DataSheet


# The sheet's figure and the field of Sensor that says the same.
_FIELD = {
    "overall_system_gain_dn_per_e": "dn_per_e",
    "temporal_dark_noise_e": "read_noise_e",
    "saturation_capacity_e": "full_well_e",
    "dsnu1288_e": "dsnu_e",
    "prnu1288_percent": "prnu",
    "dark_current_e_s": "dark_current_e_s",
    "doubling_temperature_k": "dark_doubling_k",
    "quantum_efficiency_percent": "quantum_efficiency_scale",
}


def translated(data: dict[str, Any]) -> tuple[dict[str, Any], Green | None]:
    """Plain data of a sensor with its table ``emva1288`` replaced by the fields of ``Sensor``, see `DataSheet`.

    The quantum efficiency, if the sheet has one, is returned separately, because its field depends on the whole sensor.
    Raises ValueError (pydantic's own for single keys) for unknown keys and for a quantity that is given in both places.
    """
    sheet = _Table(emva1288=data["emva1288"]).emva1288
    others = {key: value for key, value in data.items() if key != "emva1288"}
    values = {key: value for key, value in sheet.model_dump().items() if value is not None}
    both = [f"emva1288.{key} and {_FIELD[key]}" for key in values if _FIELD.get(key) in others]
    if both:
        raise ValueError(f"{'; '.join(both)}: one quantity in two spellings, give one of them")
    percent = values.pop("quantum_efficiency_percent", None)
    fields = {_FIELD[key]: value for key, value in values.items() if key in _FIELD}
    if "prnu" in fields:
        fields["prnu"] /= 100
    if "dsnu_e" in fields:  # which holds the offsets of rows and columns
        fields |= {name: 0.0 for name in ("row_noise_e", "column_noise_e") if name not in others}
    if "full_well_e" in fields:
        prnu = _number(fields | others, "prnu", DEFAULT_PRNU)
        fields["full_well_e"] = full_well_of_capacity_e(fields["full_well_e"], min(max(prnu, 0.0), 0.5))
    if sheet.dark_current_temperature_c is not None:
        doubling_k = max(_number(fields | others, "dark_doubling_k", DEFAULT_DARK_DOUBLING_K), 1.0)
        fields["dark_current_e_s"] *= 2.0 ** ((25.0 - sheet.dark_current_temperature_c) / doubling_k)
    return others | fields, None if percent is None else Green(percent / 100, sheet.wavelength_nm)


def _number(data: dict[str, Any], key: str, default: float) -> float:
    """A number from data that are not yet validated; a value of another type gives ``default``, and its field refuses
    it later.
    """
    value = data.get(key, default)
    return float(value) if isinstance(value, (int, float)) and np.isfinite(value) else default


def saturation_capacity_e(full_well_e: float, prnu: float) -> float:
    """EMVA 1288's saturation capacity mu_e.sat of a pixel with a full well: where the temporal variance peaks.

    A pixel of mean m collects Poisson electrons and keeps at most F = ``full_well_e``; its variance is m g(x) with x =
    (F - m) / sqrt(m) and g the variance of a normal variable cut off above x: g = Phi + x^2 Q - x phi - (x Q - phi)^2,
    Q = 1 - Phi. The variance of the camera is the mean over pixels of mean m (1 + PRNU z), with z normal. It peaks
    about three standard deviations below F, at 0.956 F for 6,000 electrons and 1 %. (The normal law replaces the
    Poisson law, which is accurate for wells of some hundred electrons and more.)
    """
    mean_e = np.linspace(_LOWEST_PEAK, 1.0, _PEAK_POINTS) * full_well_e
    z, weight = np.polynomial.hermite_e.hermegauss(31)
    pixel_e = np.maximum(mean_e[:, None] * (1.0 + prnu * z), 1e-6)
    x = (full_well_e - pixel_e) / np.sqrt(pixel_e)
    density = np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)
    below, above = ndtr(x), ndtr(-x)
    variance = pixel_e * (below + x**2 * above - x * density - (x * above - density) ** 2)
    return float(mean_e[np.argmax(variance @ weight)])


def full_well_of_capacity_e(capacity_e: float, prnu: float) -> float:
    """Full well whose :func:`saturation_capacity_e` is ``capacity_e``."""
    from scipy.optimize import brentq  # takes a third of a second to import; only data sheets need it

    largest_e = capacity_e / _LOWEST_PEAK * 1.001
    return float(brentq(lambda well_e: saturation_capacity_e(well_e, prnu) - capacity_e, capacity_e, largest_e))
