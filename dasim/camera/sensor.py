"""A camera's sensor: size, mosaic, response curves and electrical values, and the quantities derived from them.

Tested in tests/dasim/camera/test_specification.py and tests/dasim/camera/test_datasheet.py.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, ValidationInfo, model_validator

from dasim.base.toml import Specification
from dasim.camera import coatings, datasheet, diffusion, response_curves
from dasim.camera.response_curves import Curves
from dasim.spectra import grid
from dasim.typing import FloatArray

SMALLEST_FRAME_PX = 8
SILICON_UM = 3.0  # thickness of the silicon that crosstalk assumes, unless silicon_um says otherwise
MOST_NOISE_E = 1e6  # electrons; sensors have 0.2 to 100
MOST_DARK_E_S = 1e9  # electrons per second
Offset = Annotated[float, Field(ge=-40_000, le=40_000)]  # pixels, a multiple of the largest sensor


class Sensor(Specification):
    """A sensor: geometry, mosaic, spectral limits and electrical values (in the terms of EMVA 1288).

    The response curves default to ``response_curves.rgb_ir_quantum_efficiency``. A table ``emva1288`` gives the
    electrical values in the form of a data sheet, see :class:`dasim.camera.datasheet.DataSheet`.
    """

    width_px: int = Field(ge=SMALLEST_FRAME_PX, le=20_000)
    height_px: int = Field(ge=SMALLEST_FRAME_PX, le=20_000)
    pixel_pitch_um: float = Field(gt=0.2, le=50)
    principal_point_px: tuple[Offset, Offset] | None = Field(
        default=None, description="(x, y) of the optical axis, in or outside of the frame; by default its middle"
    )
    mosaic: tuple[tuple[str, ...], ...] = Field(description="rows of channel names, top left of the frame first")
    quantum_efficiency: Curves | None = None
    silicon_um: float | None = Field(
        default=None, gt=0.1, le=1000, description="thickness of silicon that limits the bundled response curves"
    )
    cutoff_nm: float = Field(default=810.0, ge=500, le=830, description="short-pass filter on the sensor")
    cutoff_width_nm: float = Field(default=8.0, gt=0, le=100)
    coating_index: coatings.Index = Field(
        default=coatings.DEFAULT_INDEX, description="effective index of the short-pass filter; 0: it does not move"
    )
    full_well_e: float = Field(default=6000.0, ge=1, le=1e9)
    read_noise_e: float = Field(default=3.0, ge=0, le=MOST_NOISE_E)
    dark_current_e_s: float = Field(default=10.0, ge=0, le=MOST_DARK_E_S, description="at 25 C")
    dark_doubling_k: float = Field(default=datasheet.DEFAULT_DARK_DOUBLING_K, ge=1, le=100)
    dark_current_spread: float = Field(
        default=0.1, ge=0, le=10, description="standard deviation of the pixels' dark current over its mean"
    )
    hot_pixel_share: float = Field(default=1e-5, ge=0, le=0.1, description="share of the pixels that are hot")
    hot_pixel_e_s: float = Field(
        default=500.0, ge=0, le=MOST_DARK_E_S, description="mean dark current of hot pixels at 25 C"
    )
    temperature_c: float = Field(default=25.0, ge=-100, le=150)
    dsnu_e: float = Field(default=2.0, ge=0, le=MOST_NOISE_E)
    row_noise_e: float = Field(
        default=0.2, ge=0, le=MOST_NOISE_E, description="standard deviation of the offsets of rows"
    )
    column_noise_e: float = Field(
        default=0.3, ge=0, le=MOST_NOISE_E, description="standard deviation of the offsets of columns"
    )
    prnu: float = Field(default=datasheet.DEFAULT_PRNU, ge=0, le=0.5)
    sensor_seed: int | None = Field(
        default=None, ge=0, lt=2**63, description="of the fixed pattern; by default it follows from the camera's name"
    )
    adc_bits: int = Field(default=10, ge=6, le=16)
    black_level_dn: int = Field(default=64, ge=0, lt=2**16)
    dn_per_e: float | None = Field(
        default=None, ge=1e-6, le=1e6, description="EMVA 1288's K at gain 1; by default, full well gives full scale"
    )
    quantum_efficiency_scale: float = Field(default=1.0, gt=0, le=1e6, description="factor on the response curves")
    electronic_crosstalk: Annotated[float, Field(ge=0, le=diffusion.LARGEST_EDGE_SHARE)] | Literal["silicon"] | None = (
        Field(
            default=None,
            description="share of a pixel's electrons that each edge neighbour receives, or 'silicon': by absorption "
            "depth, the default; with a table of response curves 0, since those of a sensor hold its crosstalk",
        )
    )
    depletion_um: float = Field(
        default=2.0,
        ge=0,
        le=1000,
        description="depth of the depleted layer; electrons released in it stay in their pixel",
    )

    @model_validator(mode="before")
    @classmethod
    def _from_data_sheet(cls, data: Any, info: ValidationInfo) -> Any:
        if not isinstance(data, dict) or "emva1288" not in data:
            return data
        fields, green = datasheet.translated(data)
        if green is None:
            return fields
        try:
            unscaled = cls.model_validate(fields, context=info.context)
        except ValidationError:
            return fields  # whose own validation reports it
        return fields | {"quantum_efficiency_scale": green.share / _green_efficiency(unscaled, green.wavelength_nm)}

    @model_validator(mode="after")
    def _consistent(self) -> Sensor:
        rows = self.mosaic
        if not 1 <= len(rows) <= 8 or any(len(row) != len(rows[0]) for row in rows) or not 1 <= len(rows[0]) <= 8:
            raise ValueError("mosaic must be 1 to 8 rows of equal length, 1 to 8 channels each")
        curves = self.quantum_efficiency
        if curves is not None and self.silicon_um is not None:
            raise ValueError(
                "silicon_um limits the bundled response curves, but quantum_efficiency gives others; keep one of them"
            )
        known = grid.CHANNELS if curves is None else tuple(curves.channels)
        for name in sorted({name for row in rows for name in row}):
            if name not in known and curves is not None:
                raise ValueError(
                    f"mosaic channel '{name}' has no curve in quantum_efficiency, which has {', '.join(known)}; add one"
                )
            if name not in known:
                raise ValueError(
                    f"mosaic channel '{name}' is unknown, bundled curves are those of {', '.join(known)}; give others "
                    "with quantum_efficiency"
                )
        first_nm, last_nm = grid.WHOLE_GRID_NM
        last_nm = min(last_nm, self.cutoff_nm + 2 * self.cutoff_width_nm)
        if curves is not None and (curves.wavelength_nm[0] > first_nm or curves.wavelength_nm[-1] < last_nm):
            raise ValueError(
                f"quantum_efficiency.wavelength_nm must reach from {first_nm:g} to {last_nm:g} nm, past the cut-off"
            )
        if self.height_px % len(rows) or self.width_px % len(rows[0]):
            raise ValueError(
                f"width_px x height_px = {self.width_px} x {self.height_px} "
                f"is not a multiple of the {len(rows[0])} x {len(rows)} mosaic"
            )
        if self.black_level_dn >= 2**self.adc_bits - 1:
            raise ValueError(f"black_level_dn must be below {2**self.adc_bits - 1}")
        edge = float(spectral_shares(self).edge.max())
        if edge > diffusion.LARGEST_EDGE_SHARE:
            raise ValueError(
                f"silicon of {self.silicon_um or SILICON_UM:g} um that is depleted to depletion_um = "
                f"{self.depletion_um:g} loses up to {edge:.2g} of a pixel's electrons to each edge neighbour, must be "
                f"at most {diffusion.LARGEST_EDGE_SHARE:g}; deplete it deeper, or give electronic_crosstalk"
            )
        peak = float(quantum_efficiency(self).max())
        if peak > 1:
            raise ValueError(
                f"the response curves times quantum_efficiency_scale = {self.quantum_efficiency_scale:.4g} "
                f"peak at a quantum efficiency of {peak:.4g}, must be at most 1"
            )
        return self


def principal_point(sensor: Sensor) -> tuple[float, float]:
    """Where the optical axis meets the sensor, (x, y) in pixels from the frame's top left corner."""
    return sensor.principal_point_px or (sensor.width_px / 2, sensor.height_px / 2)


def channels(sensor: Sensor) -> tuple[str, ...]:
    """Names of the mosaic's channels: those of R, G, B, IR that it has, then others in the order of their curves."""
    used = {name for row in sensor.mosaic for name in row}
    others = () if sensor.quantum_efficiency is None else tuple(sensor.quantum_efficiency.channels)
    return tuple(name for name in dict.fromkeys((*grid.CHANNELS, *others)) if name in used)


def cutoff(sensor: Sensor, angle_deg: float = 0.0) -> FloatArray:
    """Transmittance of the filter on the sensor for light at an angle, [wavelength]."""
    factor = coatings.edge_factor(sensor.coating_index, angle_deg)
    return grid.short_pass(sensor.cutoff_nm * factor, sensor.cutoff_width_nm)


def channel_block(sensor: Sensor) -> NDArray[np.int_]:
    """Channel index (into :func:`channels`) of every pixel of a period of the mosaic, [row, column]."""
    names = channels(sensor)
    return np.array([[names.index(name) for name in row] for row in sensor.mosaic])


def quantum_efficiency(sensor: Sensor) -> FloatArray:
    """Electrons per photon of each of :func:`channels`, [channel, wavelength], without the cut-off filter."""
    curves = sensor.quantum_efficiency
    if curves is None:
        curves_of_four = response_curves.rgb_ir_quantum_efficiency(sensor.silicon_um)
        bundled = dict(zip(grid.CHANNELS, curves_of_four, strict=True))
        selected = [bundled[name] for name in channels(sensor)]
    else:
        nm = curves.wavelength_nm
        selected = [np.interp(grid.WAVELENGTH_NM, nm, curves.channels[n], right=0.0) for n in channels(sensor)]
    return sensor.quantum_efficiency_scale * np.stack(selected)


def collected_efficiency(sensor: Sensor) -> FloatArray:
    """Electrons per photon that pixels collect under even light, [channel, wavelength], without the cut-off filter.

    It is :func:`quantum_efficiency` after crosstalk between pixels, and what a measurement of the sensor shows.
    """
    return diffusion.collected_evenly(quantum_efficiency(sensor), channel_block(sensor), spectral_shares(sensor))


def pixel_crosstalk(sensor: Sensor) -> float | Literal["silicon"]:
    """The crosstalk between pixels: ``electronic_crosstalk``, or the default of the sensor's response curves."""
    if sensor.electronic_crosstalk is None:
        return "silicon" if sensor.quantum_efficiency is None else 0.0
    return sensor.electronic_crosstalk


def spectral_shares(sensor: Sensor) -> diffusion.Shares:
    """Shares of the electrons of a pixel that its neighbours receive, [wavelength].

    A number for ``electronic_crosstalk`` is the share of each edge neighbour at all wavelengths.
    """
    crosstalk_of_pixels = pixel_crosstalk(sensor)
    if crosstalk_of_pixels != "silicon":
        none = np.zeros(grid.WAVELENGTH_NM.shape)
        return diffusion.Shares(none + crosstalk_of_pixels, none)
    return diffusion.by_depth(sensor.pixel_pitch_um, sensor.silicon_um or SILICON_UM, sensor.depletion_um)


def _green_efficiency(sensor: Sensor, wavelength_nm: float | None) -> float:
    """Electrons per photon that green pixels collect at a wavelength, by default that of the peak of their own curve;
    ValueError where there are none.
    """
    if "G" not in channels(sensor):
        raise ValueError("emva1288.quantum_efficiency_percent is that of green pixels, but the mosaic has no channel G")
    index = channels(sensor).index("G")
    if wavelength_nm is None:
        wavelength_nm = float(grid.WAVELENGTH_NM[np.argmax(quantum_efficiency(sensor)[index])])
    efficiency = float(np.interp(wavelength_nm, grid.WAVELENGTH_NM, collected_efficiency(sensor)[index]))
    if not efficiency > 0:
        raise ValueError(f"emva1288.quantum_efficiency_percent: green is 0 at {wavelength_nm:g} nm")
    return efficiency
