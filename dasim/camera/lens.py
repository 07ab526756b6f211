"""A camera's lens: focal length, focus, shading, distortion and aberrations.

Tested in tests/dasim/camera/test_specification.py.
"""

from __future__ import annotations

import itertools
from typing import Annotated

from pydantic import Field, field_validator, model_validator

from dasim.base.toml import Specification
from dasim.camera import coatings, zernike
from dasim.camera.zernike import FieldWavefront, Wavefront
from dasim.spectra import grid

NEAREST_FOCUS = 1.1  # in focal lengths: a magnification of 10
LARGEST_FOCAL_SHIFT = 0.1  # of the focal length; more is not a thin lens
Shift = Annotated[float, Field(ge=-1e5, le=1e5)]  # LARGEST_FOCAL_SHIFT of the longest lens, micrometres
Coefficient = Annotated[float, Field(ge=-1e6, le=1e6)]  # of a power of millimetres


class Lens(Specification):
    """A thin lens; ``focus_distance_m`` is the only place that holds the camera's focus."""

    focal_length_mm: float = Field(ge=0.1, le=1000)
    f_number: float = Field(gt=0.5, le=64)
    focus_distance_m: float = Field(gt=0, le=1e6)
    transmittance: float = Field(default=1.0, gt=0, le=1)
    shading_per_mm: tuple[Coefficient, ...] = Field(
        default=(), max_length=6, description="a_k of 1 + sum a_k r^(2k), r in mm on the sensor, times cos^4"
    )
    distortion_per_mm: tuple[Coefficient, ...] = Field(
        default=(),
        max_length=6,
        description="a_k of 1 + sum a_k r^(2k), r in mm on the sensor: a pinhole's image height over the lens's",
    )
    focal_shift_um: tuple[tuple[grid.AnyNm, Shift], ...] = Field(
        default=(), description="axial colour: [nm, um added to the focal length], linear between, constant beyond"
    )
    wavefront_nm: Wavefront = Field(default=Wavefront(), description="Zernike coefficients, RMS over the open lens")
    wavefront_by_field: tuple[FieldWavefront, ...] = Field(
        default=(), description="further coefficients by angle and wavelength, relative to the direction off the axis"
    )
    coating_index: coatings.Index = Field(
        default=coatings.DEFAULT_INDEX, description="effective index of the stops' coatings; 0: edges do not move"
    )

    @field_validator("focal_shift_um")
    @classmethod
    def _rising(cls, curve: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        low, high = grid.WHOLE_GRID_NM
        if any(not low <= nm <= high for nm, _ in curve):
            raise ValueError(f"wavelengths must lie within {low:g} to {high:g} nm")
        if any(b <= a for (a, _), (b, _) in itertools.pairwise(curve)):
            raise ValueError("wavelengths must rise")
        return curve

    @field_validator("wavefront_by_field")
    @classmethod
    def _is_table(cls, rows: tuple[FieldWavefront, ...]) -> tuple[FieldWavefront, ...]:
        zernike.check_table(rows)
        return rows

    @model_validator(mode="after")
    def _one_frame(self) -> Lens:
        if self.wavefront_by_field and not zernike.is_radial(self.wavefront_nm.coefficients()):
            raise ValueError("wavefront_nm may have defocus and spherical terms only beside wavefront_by_field")
        return self

    @model_validator(mode="after")
    def _shift_is_small(self) -> Lens:
        if any(abs(shift) > LARGEST_FOCAL_SHIFT * 1e3 * self.focal_length_mm for _, shift in self.focal_shift_um):
            raise ValueError(f"focal_shift_um must stay within {LARGEST_FOCAL_SHIFT:.0%} of the focal length")
        return self

    @model_validator(mode="after")
    def _focus_beyond_focal_length(self) -> Lens:
        nearest_m = NEAREST_FOCUS * self.focal_length_mm * 1e-3
        if self.focus_distance_m < nearest_m:
            raise ValueError(
                f"focus_distance_m is {self.focus_distance_m:g} m, must be at least {nearest_m:g} m, "
                f"{NEAREST_FOCUS:g} times the focal length"
            )
        return self
