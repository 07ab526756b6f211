"""What all rays of a pass share: the lens, the table of wavelengths, and the depths that the pixels' middles see.

Tested in tests/dasim/render/test_passes.py and tests/dasim/render/test_ray_loop.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dasim.camera import distortion, geometry
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import lamps, pupil, transport, wave
from dasim.render.control_variate import CELLS, Control
from dasim.render.irradiance import Field
from dasim.render.plugin import aligned, texture
from dasim.render.radial_blur import RadialBlur
from dasim.render.wavelengths import Responses, draw_table, frame_density
from dasim.spectra import grid
from dasim.typing import FloatArray

WAVE_BLUR_PX = 150.0  # visible blur up to which weights are tabulated; beyond it, blur is that of the sampled rays
MOST_SLOPE = 0.5  # largest gradient of visible blur over the picture for which rays are aimed, pixels per pixel


@dataclass(frozen=True)
class Undistorted:
    """From a place on the sensor to that in a pinhole's picture, pixels from the axis."""

    per_mm: list[Any]  # coefficients of the distortion
    pitch2: Any  # square of the pixel pitch, mm^2

    def __call__(self, place: Any) -> Any:
        """The place in the pinhole's picture."""
        import drjit as dr

        return place * distortion.factor(self.per_mm, dr.squared_norm(place) * self.pitch2) if self.per_mm else place


@dataclass(frozen=True)
class Pass:
    """What all blocks of a pass share.

    Numbers that change from picture to picture are opaque to the compiler: a kernel is compiled once, and found again.
    """

    scene: Any
    field: Field | None
    emitters: lamps.Chosen
    integrator: Any
    channels: int
    columns: Any  # opaque width of the frame in pixels
    axis: Any  # where it meets the sensor, pixels
    px_per_m: Any  # pixels on the sensor per metre at a distance of one metre
    pinhole: Undistorted
    radius_m: Any  # of the lens
    px_per_vergence: Any  # pixels of visible blur per 1/m
    vergence: Any  # of the focus distance, 1/m
    table: Any  # see ``draw_table``
    rings: Any  # opaque number of rings in the table
    middle_ring: Any  # see :func:`middle_ring`
    place: Any  # fractional ring of each pixel of the frame, row by row
    middle: Any  # inverse depth that the middle of each pixel sees, 1/m; None where it does not matter
    slope: Any  # its change along x and y, 1/m per pixel
    axial_colour: bool
    draw_pupil: pupil.Draw | None  # None for a pinhole and with wave optics
    blur: wave.Blur | None  # None for geometric optics
    aberration: pupil.Aberration | None  # in geometric optics
    in_focus: bool  # whether every depth is, see :func:`dasim.render.ray_loop.render`
    control: Control | None
    cells: Any  # opaque number of cells per pixel along each axis without a control, see :mod:`dasim.render.splitting`

    @property
    def has_single_wavelengths(self) -> bool:
        """Whether all wavelengths of a ray are the same: with axial colour, where the wavelength sets its direction."""
        has_lens = self.draw_pupil is not None or self.blur is not None
        return self.axial_colour and not self.in_focus and has_lens


def prepare(
    scene: Any,
    camera: Camera,
    stop: Stop | None,
    max_blur_px: float | None,
    field: Field | None,
    responses: Responses,
    in_focus: bool,
    control: Control | None,
) -> Pass:
    """Tables and constants of a pass."""
    import drjit as dr
    import mitsuba as mi

    light = light_of(field)
    scale = dr.opaque(mi.Float, px_per_m(camera))
    radius_m = dr.opaque(mi.Float, geometry.aperture_m(camera) / 2)
    density, table = drawn(camera, responses, light)
    mean_nm = float(np.average(grid.WAVELENGTH_NM, weights=density))
    blur = None
    if stop is not None and max_blur_px is not None:
        blur = wave.blur(camera, stop, density, wave.blur_range_px(camera, max_blur_px, WAVE_BLUR_PX))
        if control is not None and isinstance(blur, RadialBlur):
            blur = blur.over_wavelengths()
    pinhole = _to_pinhole(camera)
    axis = mi.Point2f(*(dr.opaque(mi.Float, value) for value in principal_point(camera.sensor)))
    columns = dr.opaque(mi.UInt32, camera.sensor.width_px)
    middle, slope = None, None
    if blur is not None and not in_focus:
        pixels = dr.arange(mi.UInt32, responses.place.size)
        middle = _middle_vergence(scene, pinhole(corner_of(pixels, columns) + 0.5 - axis) / scale)
        steepest = MOST_SLOPE / (px_per_m(camera) * geometry.aperture_m(camera))
        along = _slopes(np.array(middle).reshape(responses.place.shape), steepest)
        slope = mi.Point2f(*(mi.Float(aligned(part)) for part in along))
    return Pass(
        scene=scene,
        field=field,
        emitters=lamps.chosen(scene),
        integrator=transport.path_integrator(),
        channels=responses.channels,
        columns=columns,
        axis=axis,
        px_per_m=scale,
        pinhole=pinhole,
        radius_m=radius_m,
        px_per_vergence=2 * radius_m * scale,
        vergence=dr.opaque(mi.Float, 1.0 / camera.lens.focus_distance_m),
        # The nearest of its many nodes: reading those around, too, took a quarter of the time of a pinhole's rays.
        table=texture(table, filter_mode=dr.FilterMode.Nearest),
        rings=dr.opaque(mi.Float, len(table)),
        middle_ring=dr.opaque(mi.Float, middle_ring(responses)),
        place=mi.Float(aligned(responses.place)),
        middle=middle,
        slope=slope,
        axial_colour=bool(camera.lens.focal_shift_um),
        draw_pupil=None if stop is None or blur is not None else pupil.drawer(stop),
        blur=blur,
        aberration=pupil.aberration(camera, stop, mean_nm) if stop is not None and blur is None else None,
        in_focus=in_focus,
        control=control,
        cells=dr.opaque(mi.Float, CELLS),
    )


def drawn(camera: Camera, responses: Responses, light: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sampling density of the wavelengths of a pass, on the grid, and its :func:`draw_table`."""
    density = frame_density(responses, light)
    return density, draw_table(camera, responses.of_pass, light, density)


def _to_pinhole(camera: Camera) -> Undistorted:
    """The lens's distortion, from pixels to pixels from the axis."""
    import drjit as dr
    import mitsuba as mi

    per_mm = [dr.opaque(mi.Float, value) for value in camera.lens.distortion_per_mm]
    return Undistorted(per_mm, dr.opaque(mi.Float, (camera.sensor.pixel_pitch_um * 1e-3) ** 2))


def px_per_m(camera: Camera) -> float:
    """Pixels on the sensor per metre at a distance of one metre."""
    return geometry.image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)


def middle_ring(responses: Responses) -> int:
    """The ring whose responses stand for the frame's in the control variate."""
    return round(float(np.median(responses.place)))


def light_of(field: Field | None) -> FloatArray:
    """Spectrum by which wavelengths are drawn."""
    return np.ones_like(grid.WAVELENGTH_NM) if field is None else field.light


def corner_of(pixel: Any, columns: Any) -> Any:
    """Corner of a pixel of the frame, by its number row by row."""
    import mitsuba as mi

    row = pixel // columns
    return mi.Point2f(mi.Float(pixel - row * columns), mi.Float(row))


def _middle_vergence(scene: Any, slope: Any) -> Any:
    """Inverse depth that rays through the middle of the lens meet first, 1/m; 0 for nothing."""
    import drjit as dr
    import mitsuba as mi

    ray = mi.Ray3f(mi.Point3f(0.0), mi.Vector3f(slope.x, slope.y, 1.0))
    hit = scene.ray_intersect_preliminary(ray, coherent=True)
    vergence = dr.select(hit.is_valid(), dr.rcp(hit.t), 0.0)  # the direction's z is 1, so t is depth
    dr.eval(vergence)
    return vergence


def _slopes(vergence: NDArray[np.float32], steepest: float) -> tuple[FloatArray, FloatArray]:
    """Gradient of the inverse depth of surfaces along x and y, [h, w] per pixel, without the steps between surfaces.

    It is the smaller of the differences to both neighbours, or 0 if their signs differ, limited to ``steepest``.
    """

    def smaller(axis: int) -> FloatArray:
        step = np.diff(vergence, axis=axis)
        first, last = (np.take(step, [place], axis=axis) for place in (0, -1))
        before, after = np.concatenate([first, step], axis=axis), np.concatenate([step, last], axis=axis)
        least = np.where(np.abs(before) < np.abs(after), before, after)
        return np.clip(np.where(before * after > 0, least, 0.0), -steepest, steepest)

    if min(vergence.shape) < 2:
        return np.zeros(vergence.shape), np.zeros(vergence.shape)
    return smaller(1), smaller(0)
