"""The camera: a lens, its stops and a sensor, as data; and what follows from them."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from dasim import aperture, datasheet, optics, spectra
from dasim.errors import InputError

CAMERA_DIR = Path(__file__).parent / "cameras"
BLUR_LEVELS = 29  # sec. 6.1
NEAREST_FOCUS = 1.1  # in focal lengths: ten times life size
SMALLEST_FRAME_PX = 8

Model = TypeVar("Model", bound=BaseModel)


class Specification(BaseModel):
    """A frozen value that refuses unknown keys, NaN and infinity."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Lens(Specification):
    """A thin lens; ``focus_distance_m`` is the one place that says where the camera focuses."""

    focal_length_mm: float = Field(gt=0, le=1000)
    f_number: float = Field(gt=0.5, le=64)
    focus_distance_m: float = Field(gt=0, le=1e6)
    transmittance: float = Field(default=1.0, gt=0, le=1)

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
    """An RGB-IR sensor: geometry, mosaic, spectral limits and electrical values (EMVA 1288 terms).

    A table ``emva1288`` gives electrical values as a maker's data sheet does, see :class:`dasim.datasheet.DataSheet`.
    """

    width_px: int = Field(ge=SMALLEST_FRAME_PX, le=20_000)
    height_px: int = Field(ge=SMALLEST_FRAME_PX, le=20_000)
    pixel_pitch_um: float = Field(gt=0.2, le=50)
    mosaic: tuple[tuple[str, ...], ...] = Field(description="rows of channel names, top left of the frame first")
    cutoff_nm: float = Field(default=810.0, ge=500, le=830, description="short-pass filter on the sensor")
    cutoff_width_nm: float = Field(default=8.0, gt=0, le=100)
    full_well_e: float = Field(default=6000.0, gt=0, le=1e9)
    read_noise_e: float = Field(default=3.0, ge=0)
    dark_current_e_s: float = Field(default=10.0, ge=0, description="at 25 C")
    dark_doubling_k: float = Field(default=datasheet.DEFAULT_DARK_DOUBLING_K, ge=1, le=100)
    temperature_c: float = Field(default=25.0, ge=-100, le=150)
    dsnu_e: float = Field(default=2.0, ge=0)
    prnu: float = Field(default=datasheet.DEFAULT_PRNU, ge=0, le=0.5)
    adc_bits: int = Field(default=10, ge=6, le=16)
    black_level_dn: int = Field(default=64, ge=0)
    dn_per_e: float | None = Field(
        default=None, ge=1e-6, le=1e6, description="EMVA 1288's K at gain 1; by default the full well is at full scale"
    )
    quantum_efficiency_scale: float = Field(default=1.0, gt=0, description="factor on the response curves")
    electronic_crosstalk: float = Field(
        default=0.0, ge=0, le=0.2, description="share of a pixel's electrons that each of its four edge neighbours gets"
    )

    @model_validator(mode="before")
    @classmethod
    def _from_data_sheet(cls, data: Any) -> Any:
        return datasheet.translated(data) if isinstance(data, dict) and "emva1288" in data else data

    @model_validator(mode="after")
    def _consistent(self) -> Sensor:
        rows = self.mosaic
        if not 1 <= len(rows) <= 8 or any(len(row) != len(rows[0]) for row in rows) or not 1 <= len(rows[0]) <= 8:
            raise ValueError("mosaic must be 1 to 8 rows of equal length, 1 to 8 channels each")
        for name in {name for row in rows for name in row}:
            if name not in spectra.CHANNELS:
                raise ValueError(f"mosaic channel '{name}' is unknown, allowed are {', '.join(spectra.CHANNELS)}")
        if self.height_px % len(rows) or self.width_px % len(rows[0]):
            raise ValueError(
                f"width_px x height_px = {self.width_px} x {self.height_px} "
                f"is no multiple of the {len(rows[0])} x {len(rows)} mosaic"
            )
        if self.black_level_dn >= 2**self.adc_bits - 1:
            raise ValueError(f"black_level_dn must be below {2**self.adc_bits - 1}")
        peak = self.quantum_efficiency_scale * float(spectra.rgb_ir_quantum_efficiency().max())
        if peak > 1:
            raise ValueError(
                f"the response curves times quantum_efficiency_scale = {self.quantum_efficiency_scale:.4g} "
                f"peak at a quantum efficiency of {peak:.4g}, must be at most 1"
            )
        return self


class Camera(Specification):
    """A lens with its stops, and a sensor."""

    name: str
    description: str = ""
    lens: Lens
    stops: tuple[aperture.Stop, ...] = Field(min_length=1)
    sensor: Sensor


def camera_names() -> list[str]:
    """Names of the bundled cameras."""
    return sorted(path.stem for path in CAMERA_DIR.glob("*.toml"))


def load_camera(name_or_path: str | Path) -> Camera:
    """The camera of a bundled name or a TOML file; InputError names every key that is wrong."""
    return parse_toml(Camera, bundled_or_file(name_or_path, CAMERA_DIR, "camera"))


def bundled_or_file(name_or_path: str | Path, folder: Path, kind: str) -> Path:
    """Path of a bundled TOML file by its name, or of the user's own; InputError where there is neither."""
    path = Path(name_or_path)
    bundled = folder / f"{name_or_path}.toml"
    if path.parent == Path(".") and bundled.is_file():
        return bundled
    if path.is_file():
        return path
    names = ", ".join(sorted(p.stem for p in folder.glob("*.toml")))
    raise InputError(f"{kind} '{name_or_path}' is neither a bundled name ({names}) nor a file")


def parse_toml(model: type[Model], path: Path) -> Model:
    """Read a TOML file into a specification; every problem in one InputError, each with its key."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML ({error})") from None
    return parse(model, data, str(path))


def parse(model: type[Model], data: Any, where: str) -> Model:
    """Validate plain data into a specification; every problem in one InputError, each with its key."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{where}: " + "; ".join(_problem(item) for item in error.errors())) from None


def _problem(item: Any) -> str:
    key = ".".join(str(part) for part in item["loc"])
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        return f"{key}: unknown key"
    if item["type"] == "missing":
        return f"{key}: is missing"
    shown = item.get("input")
    is_now = f" (is {shown!r})" if isinstance(shown, (str, int, float)) else ""
    return (f"{key}: {message}" if key else message) + is_now


def cropped(camera: Camera, width_px: int, height_px: int) -> Camera:
    """The camera with a central crop of its sensor, at unchanged pixel pitch.

    Raises InputError where the crop is larger than the sensor or no multiple of its mosaic.
    """
    sensor = camera.sensor
    low = SMALLEST_FRAME_PX
    if not (low <= width_px <= sensor.width_px and low <= height_px <= sensor.height_px):
        raise InputError(
            f"size {width_px}x{height_px} is not within {low}x{low} to {sensor.width_px}x{sensor.height_px}, "
            f"the sensor of camera '{camera.name}'"
        )
    changed = sensor.model_dump() | {"width_px": width_px, "height_px": height_px}
    return camera.model_copy(update={"sensor": parse(Sensor, changed, f"size {width_px}x{height_px}")})


def refocused(camera: Camera, focus_distance_m: float) -> Camera:
    """The camera focused at another distance; InputError where that is not beyond the focal length."""
    changed = camera.lens.model_dump() | {"focus_distance_m": focus_distance_m}
    return camera.model_copy(update={"lens": parse(Lens, changed, "focus")})


def image_distance_m(camera: Camera) -> float:
    """Distance from lens to sensor."""
    return optics.image_distance_m(camera.lens.focal_length_mm * 1e-3, camera.lens.focus_distance_m)


def aperture_m(camera: Camera) -> float:
    """Diameter of the open lens."""
    return camera.lens.focal_length_mm * 1e-3 / camera.lens.f_number


def blur_px(camera: Camera, depth_m: Any) -> Any:
    """Signed diameter in pixels of the visible (open lens) blur at ``depth_m``; positive nearer than the focus."""
    lens = camera.lens
    blur_m = optics.blur_diameter_m(depth_m, aperture_m(camera), image_distance_m(camera), lens.focus_distance_m)
    return blur_m / (camera.sensor.pixel_pitch_um * 1e-6)


def depth_of_blur_m(camera: Camera, blur_px: Any) -> Any:
    """Depth whose signed visible blur diameter is ``blur_px`` pixels."""
    blur_m = np.asarray(blur_px) * camera.sensor.pixel_pitch_um * 1e-6
    focus = camera.lens.focus_distance_m
    return optics.depth_of_blur_m(blur_m, aperture_m(camera), image_distance_m(camera), focus)


def hole_ratio(camera: Camera) -> float:
    """Radius ratio of the smallest stop, the paper's alpha."""
    return min(stop.radius_ratio for stop in camera.stops)


def level_blur_px(camera: Camera) -> spectra.FloatArray:
    """Visible blur diameters in pixels of the blur levels, shape [BLUR_LEVELS], from 0.

    Level k is the relative diameter (1 - alpha) c = k pixels, which spans the paper's working range of
    5 cm to 2 m in 29 levels with its 3.6 mm lens. A camera with one aperture takes steps of 2 pixels.
    """
    relative = 1.0 - hole_ratio(camera)
    return np.arange(BLUR_LEVELS, dtype=np.float64) * (1.0 / relative if relative > 0 else 2.0)


def intrinsic_matrix(camera: Camera) -> spectra.FloatArray:
    """Pinhole intrinsics K in pixels, [3, 3]; pixel centres at +0.5, the principal point in the frame's centre."""
    focal_px = image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)
    centre = (camera.sensor.width_px / 2, camera.sensor.height_px / 2)
    return np.array([[focal_px, 0, centre[0]], [0, focal_px, centre[1]], [0, 0, 1.0]])


def stop_response(camera: Camera, stop: aperture.Stop) -> spectra.FloatArray:
    """Electrons a second and pixel, per W m^-2 sr^-1 nm^-1 of scene radiance, through one stop.

    Shape [4 (R, G, B, IR), wavelength], on the axis: p^2 pi (r/s)^2 T_lens T_stop T_cutoff QE lambda / (h c),
    the Abbe lens's E = pi L (r/s)^2 with r the stop's radius. Off the axis it falls by cos^4.
    """
    sensor = camera.sensor
    radius_m = stop.radius_ratio * aperture_m(camera) / 2
    etendue = (sensor.pixel_pitch_um * 1e-6) ** 2 * np.pi * (radius_m / image_distance_m(camera)) ** 2
    passed = camera.lens.transmittance * aperture.transmittance(stop)
    passed = passed * spectra.short_pass(sensor.cutoff_nm, sensor.cutoff_width_nm)
    efficiency = sensor.quantum_efficiency_scale * spectra.rgb_ir_quantum_efficiency()
    return etendue * passed * efficiency * spectra.photons_per_joule()


def response(camera: Camera) -> spectra.FloatArray:
    """Spectral response of the whole camera, the sum of :func:`stop_response` over its stops, [4, wavelength]."""
    return np.sum([stop_response(camera, stop) for stop in camera.stops], axis=0)


def mosaic_channels(camera: Camera) -> np.ndarray:
    """Channel index (into ``spectra.CHANNELS``) of every pixel, int [height, width]."""
    sensor = camera.sensor
    block = np.array([[spectra.CHANNELS.index(name) for name in row] for row in sensor.mosaic])
    return np.tile(block, (sensor.height_px // block.shape[0], sensor.width_px // block.shape[1]))
