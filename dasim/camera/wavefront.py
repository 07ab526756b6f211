"""Phase of the light across the pupil: aberrations of lens and stops, and the phase step of an opening in a coating.

Visible light passes through the coating of a near-infrared disc in the ring, and through no coating in the hole. If the
hole is not filled with glass of equal optical thickness, the open stop has a phase step at the rim of the hole. The
``phase_nm`` of a stop is the optical path through its opening minus that around it; it acts on the light of the other
stops.

Tested in tests/dasim/camera/test_zernike.py.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import numpy as np

from dasim.camera import distortion, geometry, stops, zernike
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.camera.zernike import Coefficients
from dasim.typing import FloatArray

FIELD_STEP_NM = 15.0  # RMS of the change between two tabulated angles, lambda / 35 of green


class Wavefront(NamedTuple):
    """Deviation of the light through a stop from a sphere about its image, in nanometres of optical path.

    At one angle of the chief ray; off the axis, x is the direction away from it.
    """

    zernike_nm: tuple[Coefficients, ...]  # RMS over the open lens, one for each wavelength
    wavelengths_nm: tuple[float, ...] = (0.0,)
    opening: Stop | None = None  # the part of the pupil that has a step
    step_nm: float = 0.0


class Phase(NamedTuple):
    """The same at one wavelength."""

    turns: Coefficients  # Zernike coefficients in waves
    opening: Stop | None
    step: complex  # mean of exp(i phase) of the step


def is_perfect(camera: Camera) -> bool:
    """Whether lens and stops give a sphere everywhere, with no coefficient other than 0."""
    own = (stop.wavefront_nm for stop in camera.stops)
    return not any(any(row.coefficients()) for row in (camera.lens.wavefront_nm, *camera.lens.wavefront_by_field, *own))


def of_lens(camera: Camera, angle_deg: float = 0.0) -> Wavefront:
    """The wavefront that the lens itself gives at an angle of the chief ray."""
    same = camera.lens.wavefront_nm.coefficients()
    table = zernike.at_angle(camera.lens.wavefront_by_field, angle_deg) or {0.0: (0.0,) * len(same)}
    return Wavefront(_added(tuple(table.values()), same), tuple(table))


def of_stop(camera: Camera, stop: Stop, angle_deg: float = 0.0) -> Wavefront:
    """The wavefront of the light through a stop at an angle of the chief ray."""
    opening = next((other for other in camera.stops if other.phase_nm and other.name != stop.name), None)
    lens = of_lens(camera, angle_deg)
    return lens._replace(
        zernike_nm=_added(lens.zernike_nm, stop.wavefront_nm.coefficients()),
        opening=opening,
        step_nm=opening.phase_nm if opening else 0.0,
    )


def _added(rows: tuple[Coefficients, ...], same: Coefficients) -> tuple[Coefficients, ...]:
    return tuple(tuple(a + b for a, b in zip(row, same, strict=True)) for row in rows)


def over_field(camera: Camera, stop: Stop) -> tuple[float, list[Wavefront]]:
    """Wavefronts of a stop at even steps of the chief ray's angle over the frame, and the step in degrees.

    The steps are so small that the coefficients change by at most ``FIELD_STEP_NM`` RMS from one to the next.
    """
    if not camera.lens.wavefront_by_field:
        return 1.0, [of_stop(camera, stop)]
    height_m = float(np.sqrt(distortion.square_of_pinhole_height_m2(camera).max()))
    corner_deg = float(np.degrees(np.arctan(height_m / geometry.image_distance_m(camera))))
    fine = [np.array(of_lens(camera, angle).zernike_nm) for angle in np.linspace(0, corner_deg, 33)]
    change = 32 * max(float(np.linalg.norm(b - a, axis=-1).max()) for a, b in itertools.pairwise(fine))
    steps = max(1, int(np.ceil(change / FIELD_STEP_NM)))
    return corner_deg / steps, [of_stop(camera, stop, angle) for angle in np.linspace(0, corner_deg, steps + 1)]


def coefficients(wavefront: Wavefront, wavelength_nm: float) -> Coefficients:
    """Zernike coefficients in nm at a wavelength, linear between those that are given and constant beyond."""
    columns = zip(*wavefront.zernike_nm, strict=True)
    return tuple(float(np.interp(wavelength_nm, wavefront.wavelengths_nm, column)) for column in columns)


def has_errors(wavefront: Wavefront) -> bool:
    """Whether any Zernike coefficient differs from 0."""
    return any(value != 0 for row in wavefront.zernike_nm for value in row)


def is_flat(wavefront: Wavefront) -> bool:
    """Whether the light has no phase but that of focus."""
    return not has_errors(wavefront) and wavefront.opening is None


def is_radial(wavefront: Wavefront) -> bool:
    """Whether the phase has rotational symmetry about the axis."""
    ring = None if wavefront.opening is None else stops.ring(wavefront.opening)
    symmetric = wavefront.opening is None or (ring is not None and ring.centre == (0.0, 0.0))
    return symmetric and all(zernike.is_radial(row) for row in wavefront.zernike_nm)


def at(wavefront: Wavefront, wavelength_nm: float, band_nm: float = 0.0) -> Phase | None:
    """The phase at a wavelength, with the step averaged over a band; None where there is none."""
    return None if is_flat(wavefront) else phase(wavefront, wavelength_nm, band_nm)


def phase(wavefront: Wavefront, wavelength_nm: float, band_nm: float = 0.0) -> Phase:
    """The phase at a wavelength, with the step averaged over a band, flat or not.

    The mean of exp(2 pi i s / lambda) over a narrow band is its value at the middle times sinc(s band / lambda^2).
    """
    s = wavefront.step_nm
    step = np.exp(2j * np.pi * s / wavelength_nm) * np.sinc(s * band_nm / wavelength_nm**2)
    turns = tuple(value / wavelength_nm for value in coefficients(wavefront, wavelength_nm))
    return Phase(turns, wavefront.opening, complex(step))


def factor(phase: Phase, y: Any, x: Any) -> FloatArray:
    """exp(i phase) of the aberrations at places of the pupil, complex, without the step."""
    return np.asarray(np.exp(2j * np.pi * zernike.evaluate(phase.turns, y, x)))


def two_parts(phase: Phase, outside: FloatArray, inside: FloatArray) -> FloatArray:
    """Intensity of light from outside and inside the opening, from the amplitudes of both without the step."""
    cross = (np.conj(outside) * inside * phase.step).real
    return np.abs(outside) ** 2 + np.abs(inside) ** 2 + 2 * cross


def displacement_px(errors_nm: Coefficients, f_number: float, pitch_um: float, y: Any, x: Any) -> tuple[Any, Any]:
    """Displacement (y, x) in the picture of the ray through a place of the lens, u = -2 N grad W, in pixels.

    ``f_number`` is the working f-number of the open lens; the gradient is per radius of the lens. A step has no slope.
    """
    scale = -2 * f_number * 1e-3 / pitch_um
    along_y, along_x = zernike.gradient(errors_nm, y, x)
    return scale * along_y, scale * along_x


def steepest(wavefront: Wavefront) -> float:
    """Largest slope of the wavefront over the open lens, in nanometres per radius."""
    if not has_errors(wavefront):
        return 0.0
    rho, theta = np.meshgrid(np.linspace(0, 1, 17), np.linspace(0, 2 * np.pi, 48, endpoint=False))
    y, x = rho * np.sin(theta), rho * np.cos(theta)
    return max(float(np.hypot(*zernike.gradient(row, y, x)).max()) for row in wavefront.zernike_nm)


def reach_px(wavefront: Wavefront, f_number: float, pitch_um: float) -> float:
    """Largest displacement of a ray through the lens, in pixels."""
    return 2 * f_number * 1e-3 / pitch_um * steepest(wavefront)
