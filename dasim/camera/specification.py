"""The camera as data: a lens, its stops and a sensor; loading, cropping and focusing."""

from __future__ import annotations

import itertools
import zlib
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from dasim.base.errors import InputError, kind_of
from dasim.base.toml import Specification, bundled_or_file, parse, parse_toml
from dasim.camera import coatings, datasheet, diffusion, response_curves, stops, zernike
from dasim.camera.response_curves import Curves
from dasim.camera.stops import Stop
from dasim.camera.zernike import FieldWavefront, Wavefront
from dasim.spectra import grid
from dasim.typing import FloatArray

CAMERA_DIR = Path(__file__).parents[1] / "cameras"
BLUR_LEVELS = 29  # sec. 6.1
NEAREST_FOCUS = 1.1  # in focal lengths: a magnification of 10
SMALLEST_GLARE_PX = 3.0
SMALLEST_FRAME_PX = 8
SILICON_UM = 3.0  # thickness of the silicon that crosstalk assumes, unless silicon_um says otherwise
MOST_NOISE_E = 1e6  # electrons; sensors have 0.2 to 100
MOST_DARK_E_S = 1e9  # electrons per second
LARGEST_FOCAL_SHIFT = 0.1  # of the focal length; more is not a thin lens

Shift = Annotated[float, Field(ge=-1e5, le=1e5)]  # LARGEST_FOCAL_SHIFT of the longest lens, micrometres
Coefficient = Annotated[float, Field(ge=-1e6, le=1e6)]  # of a power of millimetres
Offset = Annotated[float, Field(ge=-40_000, le=40_000)]  # pixels, a multiple of the largest sensor


class Lens(Specification):
    """A thin lens; ``focus_distance_m`` is the only place that holds the camera's focus."""

    focal_length_mm: float = Field(gt=0, le=1000)
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
    depletion_um: float = Field(default=2.0, ge=0, le=1000, description="depth from which a pixel loses no electrons")

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
            if name not in known:
                raise ValueError(f"mosaic channel '{name}' is unknown, allowed are {', '.join(known)}")
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


class Levels(Specification):
    """The blur levels at which a bank is calibrated: evenly spaced in visible blur, from 0."""

    count: int = Field(default=BLUR_LEVELS, ge=2, le=400)
    max_blur_px: float = Field(gt=0, le=500, description="diameter of the visible blur of the last level")


class Camera(Specification):
    """A lens with its stops, a sensor, and the blur levels at which it is calibrated."""

    name: str
    description: str = ""
    lens: Lens
    stops: tuple[Stop, ...] = Field(min_length=1)
    sensor: Sensor
    levels: Levels | None = Field(default=None, description="by default the paper's levels, see level_blur_px")

    @model_validator(mode="before")
    @classmethod
    def _own_sensor(cls, data: Any) -> Any:
        if not isinstance(data, dict) or not isinstance(data.get("name"), str):
            return data
        seed, sensor = zlib.crc32(data["name"].encode()), data.get("sensor")
        if isinstance(sensor, dict) and sensor.get("sensor_seed") is None:
            return data | {"sensor": sensor | {"sensor_seed": seed}}
        if isinstance(sensor, Sensor) and sensor.sensor_seed is None:
            return data | {"sensor": sensor.model_copy(update={"sensor_seed": seed})}
        return data

    @field_validator("stops", mode="before")
    @classmethod
    def _discs_by_default(cls, stops: Any) -> Any:
        if not isinstance(stops, (list, tuple)):
            return stops
        return [{"shape": "disc"} | stop if isinstance(stop, dict) else stop for stop in stops]

    @field_validator("stops")
    @classmethod
    def _unique_names(cls, stops: tuple[Stop, ...]) -> tuple[Stop, ...]:
        names = [stop.name for stop in stops]
        if len(set(names)) != len(names):
            raise ValueError(f"names must be unique, they are {', '.join(names)}")
        steps = [stop.name for stop in stops if stop.phase_nm]
        if len(steps) > 1:
            raise ValueError(f"one stop may have a phase_nm, these have: {', '.join(steps)}")
        return stops

    @model_validator(mode="after")
    def _light_everywhere(self) -> Camera:
        rings = [stops.ring(stop) for stop in self.stops]
        if self.lens.wavefront_by_field and any(ring is None or ring.centre != (0.0, 0.0) for ring in rings):
            raise ValueError("lens.wavefront_by_field: all stops must be discs or rings about the axis")
        for number, stop in enumerate(self.stops):
            radius_px = (stop.glare_radius_mm or np.inf) * 1e3 / self.sensor.pixel_pitch_um
            if radius_px < SMALLEST_GLARE_PX:
                raise ValueError(
                    f"stops.{number}.glare_radius_mm: must be at least {SMALLEST_GLARE_PX:g} pixels "
                    f"(is {radius_px:.2g}); narrower veils are not resolved by the sensor"
                )
        if self.lens.distortion_per_mm and not _one_to_one(self):
            raise ValueError("lens.distortion_per_mm: two places of the frame show the same direction")
        if self.lens.shading_per_mm and shading(self).min() <= 0:
            raise ValueError("lens.shading_per_mm: falls to zero or below within the frame")
        return self

    def __repr__(self) -> str:
        lens, sensor = self.lens, self.sensor
        return (
            f"<Camera '{self.name}': {lens.focal_length_mm:g} mm f/{lens.f_number:g} focused at "
            f"{lens.focus_distance_m * 1e2:g} cm, stops {', '.join(stop.name for stop in self.stops)}, "
            f"{sensor.width_px}x{sensor.height_px} pixels of {sensor.pixel_pitch_um:g} um, "
            f"mosaic {' / '.join(' '.join(row) for row in sensor.mosaic)}>"
        )

    __str__ = __repr__


def camera_names() -> list[str]:
    """Names of the bundled cameras, sorted; each is accepted wherever a camera is."""
    return sorted(path.stem for path in CAMERA_DIR.glob("*.toml"))


def load_camera(name_or_path: str | Path) -> Camera:
    """The camera of a bundled name (see :func:`camera_names`) or of a TOML file; InputError lists every wrong key."""
    if not isinstance(name_or_path, (str, Path)):
        raise InputError(f"camera: the name of a bundled camera or a path is needed, not {kind_of(name_or_path)}")
    return parse_toml(Camera, bundled_or_file(name_or_path, CAMERA_DIR, "camera"))


def as_camera(camera: Camera | str | Path) -> Camera:
    """The camera itself, or the one that a name or path stands for; raises InputError for anything else."""
    if isinstance(camera, Camera):
        return camera
    if isinstance(camera, (str, Path)):
        return load_camera(camera)
    raise InputError(f"camera: a Camera, a bundled name or a path is needed, not {kind_of(camera)}")


def cropped(
    camera: Camera | str | Path, width_px: int, height_px: int, *, at_px: tuple[int, int] | None = None
) -> Camera:
    """The camera with a part of its sensor, at unchanged pixel pitch and with the optical axis where it was.

    Args:
        camera: a Camera, a bundled name or a path
        width_px: a multiple of the mosaic's width, at least 8 and at most the sensor's; InputError otherwise
        height_px: a multiple of the mosaic's height, within the same limits
        at_px: (x, y) of the part's top left pixel, multiples of the mosaic's width and height; by default the part is
            central
    """
    camera = as_camera(camera)
    sensor = camera.sensor
    low = SMALLEST_FRAME_PX
    for name, pixels in (("width_px", width_px), ("height_px", height_px)):
        if not isinstance(pixels, (int, np.integer)):
            raise InputError(f"{name}: a whole number of pixels is needed, not {kind_of(pixels)}")
    if not (low <= width_px <= sensor.width_px and low <= height_px <= sensor.height_px):
        raise InputError(
            f"size {width_px}x{height_px} is not within {low}x{low} to {sensor.width_px}x{sensor.height_px}, "
            f"the sensor of camera '{camera.name}'"
        )
    axis_px = sensor.principal_point_px
    if at_px is not None:
        _check_window(camera, (width_px, height_px), at_px)
        x, y = principal_point(sensor)
        axis_px = (x - at_px[0], y - at_px[1])
    elif axis_px is not None:
        axis_px = (axis_px[0] - (sensor.width_px - width_px) / 2, axis_px[1] - (sensor.height_px - height_px) / 2)
    changed = sensor.model_dump() | {"width_px": width_px, "height_px": height_px, "principal_point_px": axis_px}
    return camera.model_copy(update={"sensor": parse(Sensor, changed, f"size {width_px}x{height_px}")})


def _check_window(camera: Camera, size_px: tuple[int, int], at_px: tuple[int, int]) -> None:
    """Raise InputError if a window is not within the sensor or would begin within a cell of the mosaic."""
    sensor = camera.sensor
    cell = len(sensor.mosaic[0]), len(sensor.mosaic)
    full = sensor.width_px, sensor.height_px
    if any(not isinstance(value, (int, np.integer)) for value in at_px):
        raise InputError(f"at_px: two whole numbers of pixels are needed, not {at_px}")
    if any(
        not 0 <= at <= whole - part or at % step
        for at, whole, part, step in zip(at_px, full, size_px, cell, strict=True)
    ):
        raise InputError(
            f"at_px {at_px[0]}, {at_px[1]}: on the sensor of camera '{camera.name}', a window of "
            f"{size_px[0]}x{size_px[1]} begins at multiples of {cell[0]}, {cell[1]} "
            f"from 0, 0 to {full[0] - size_px[0]}, {full[1] - size_px[1]}"
        )


def refocused(camera: Camera | str | Path, focus_distance_m: float) -> Camera:
    """The camera focused at a distance in metres from the lens, at least 1.1 focal lengths; InputError otherwise.

    ``camera`` may be a bundled name or a path.
    """
    camera = as_camera(camera)
    changed = camera.lens.model_dump() | {"focus_distance_m": focus_distance_m}
    return camera.model_copy(update={"lens": parse(Lens, changed, "focus")})


def shading(camera: Camera) -> FloatArray:
    """Transmittance of the lens at each pixel relative to the axis, without cos^4, [h, w]: 1 + sum a_k r^(2k)."""
    return np.asarray(
        np.polynomial.Polynomial((1.0, *camera.lens.shading_per_mm))(square_of_image_height_m2(camera) * 1e6)
    )


def _one_to_one(camera: Camera) -> bool:
    """Whether the pinhole's image height rises with the lens's over the frame."""
    height_mm = np.linspace(0.0, float(np.sqrt(square_of_image_height_m2(camera).max())) * 1e3, 513)
    ratio = np.polynomial.Polynomial((1.0, *camera.lens.distortion_per_mm))(height_mm**2)
    return bool((np.diff(height_mm * ratio) > 0).all())


def square_of_image_height_m2(camera: Camera) -> FloatArray:
    """Square of each pixel's distance from the optical axis, m^2, [h, w]."""
    sensor = camera.sensor
    pitch_m = sensor.pixel_pitch_um * 1e-6
    axis_x, axis_y = principal_point(sensor)
    x = (np.arange(sensor.width_px) + 0.5 - axis_x) * pitch_m
    y = (np.arange(sensor.height_px) + 0.5 - axis_y) * pitch_m
    return np.asarray(x[None, :] ** 2 + y[:, None] ** 2)


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


def crosstalk(camera: Camera, angle_deg: float = 0.0) -> FloatArray:
    """Shares alpha of the IR channel's near-infrared signal in R, G and B, eq. (8), [3], at a chief ray's angle.

    The areas are those of the sensor's response behind its cut-off filter, so that light blocked by the filter does
    not count. Off the axis, the near-infrared band starts and ends where the shifted coatings of disc and filter do.
    """
    curves = quantum_efficiency(camera.sensor) * cutoff(camera.sensor, angle_deg)
    names = channels(camera.sensor)
    band_nm = near_infrared_nm(camera, angle_deg)
    return response_curves.ir_crosstalk(curves[[names.index(name) for name in grid.CHANNELS]], band_nm)


def near_infrared_nm(camera: Camera, angle_deg: float = 0.0) -> tuple[float, float]:
    """Ends of the near-infrared band at a chief ray's angle: 650 and 810 nm, shifted as the coatings that set them."""
    low_nm, high_nm = grid.NEAR_INFRARED_NM
    lens, sensor = camera.lens, camera.sensor
    return (
        low_nm * coatings.edge_factor(lens.coating_index, angle_deg),
        high_nm * coatings.edge_factor(sensor.coating_index, angle_deg),
    )


def mosaic_channels(camera: Camera) -> NDArray[np.int_]:
    """Channel index (into :func:`channels`) of every pixel, int [height, width]."""
    sensor = camera.sensor
    block = channel_block(sensor)
    return np.tile(block, (sensor.height_px // block.shape[0], sensor.width_px // block.shape[1]))


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
