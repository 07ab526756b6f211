"""The camera as data: a lens, its stops and a sensor; loading, cropping and focusing."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from dasim.base.errors import InputError, kind_of
from dasim.base.toml import Specification, bundled_or_file, parse, parse_toml
from dasim.camera import coatings, response_curves, stops, zernike
from dasim.camera.lens import Lens
from dasim.camera.sensor import (
    SMALLEST_FRAME_PX,
    Sensor,
    channel_block,
    channels,
    cutoff,
    principal_point,
    quantum_efficiency,
)
from dasim.camera.stops import Stop
from dasim.spectra import grid
from dasim.typing import FloatArray

CAMERA_DIR = Path(__file__).parents[1] / "cameras"
BLUR_LEVELS = 29  # sec. 6.1
SMALLEST_GLARE_PX = 3.0


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
        if self.lens.wavefront_by_field and not all(
            zernike.is_radial(stop.wavefront_nm.coefficients()) for stop in self.stops
        ):
            raise ValueError(
                "stops: wavefront_nm may have defocus and spherical terms only beside lens.wavefront_by_field"
            )
        for stop in self.stops:
            radius_px = (stop.glare_radius_mm or np.inf) * 1e3 / self.sensor.pixel_pitch_um
            if radius_px < SMALLEST_GLARE_PX:
                raise ValueError(
                    f"stops.{stop.name}.glare_radius_mm: must be at least {SMALLEST_GLARE_PX:g} pixels "
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
        raise InputError(f"camera: must be the name of a bundled camera or a path, not {kind_of(name_or_path)}")
    return parse_toml(Camera, bundled_or_file(name_or_path, CAMERA_DIR, "camera"))


def as_camera(camera: Camera | str | Path) -> Camera:
    """The camera itself, or the one that a name or path stands for; raises InputError for anything else."""
    if isinstance(camera, Camera):
        return camera
    if isinstance(camera, (str, Path)):
        return load_camera(camera)
    raise InputError(f"camera: must be a Camera, a bundled name or a path, not {kind_of(camera)}")


def cropped(
    camera: Camera | str | Path, width_px: int, height_px: int, *, at_px: tuple[int, int] | None = None
) -> Camera:
    """The camera with a part of its sensor, at unchanged pixel pitch and with the optical axis where it was.

    Args:
        camera: a Camera, a bundled name or a path
        width_px: in pixels, a multiple of the mosaic's width, at least 8 and at most the sensor's; InputError otherwise
        height_px: a multiple of the mosaic's height, within the same limits
        at_px: (x, y) of the part's top left pixel, multiples of the mosaic's width and height; by default the part is
            central, rounded down to whole blocks of the mosaic
    """
    camera = as_camera(camera)
    sensor = camera.sensor
    low = SMALLEST_FRAME_PX
    for name, pixels in (("width_px", width_px), ("height_px", height_px)):
        if not isinstance(pixels, (int, np.integer)):
            raise InputError(f"{name}: must be a whole number of pixels, not {kind_of(pixels)}")
    if not (low <= width_px <= sensor.width_px and low <= height_px <= sensor.height_px):
        raise InputError(
            f"size {width_px}x{height_px} is not within {low}x{low} to {sensor.width_px}x{sensor.height_px}, "
            f"the sensor of camera '{camera.name}'"
        )
    if at_px is None:
        cell = len(sensor.mosaic[0]), len(sensor.mosaic)
        around = sensor.width_px - width_px, sensor.height_px - height_px
        at_px = (around[0] // (2 * cell[0]) * cell[0], around[1] // (2 * cell[1]) * cell[1])
    else:
        _check_window(camera, (width_px, height_px), at_px)
    x, y = principal_point(sensor)
    axis_px: tuple[float, float] | None = (x - at_px[0], y - at_px[1])
    if axis_px == (width_px / 2, height_px / 2):
        axis_px = None
    changed = sensor.model_dump() | {"width_px": width_px, "height_px": height_px, "principal_point_px": axis_px}
    return camera.model_copy(update={"sensor": parse(Sensor, changed, f"size {width_px}x{height_px}")})


def _check_window(camera: Camera, size_px: tuple[int, int], at_px: tuple[int, int]) -> None:
    """Raise InputError if a window is not within the sensor or would begin within a cell of the mosaic."""
    sensor = camera.sensor
    cell = len(sensor.mosaic[0]), len(sensor.mosaic)
    full = sensor.width_px, sensor.height_px
    pair = isinstance(at_px, (tuple, list, np.ndarray)) and len(at_px) == 2
    if not pair or any(not isinstance(value, (int, np.integer)) for value in at_px):
        raise InputError(f"at_px: must be two whole numbers of pixels, not {at_px!r}")
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
