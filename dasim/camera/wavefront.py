"""The phase of the light across the pupil: aberrations of the lens, and the phase step of an opening in a coating.

Visible light crosses the coating of a near-infrared disc in the ring and no coating in the hole. If the hole is not
filled with glass of equal optical thickness, the open stop has a step of phase at the rim of the hole. A stop's
``phase_nm`` is the optical path through its opening less that around it; it acts on the light of the other stops.

Tested in tests/dasim/camera/test_zernike.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dasim.camera import stops, zernike
from dasim.camera.stops import Stop
from dasim.camera.zernike import Coefficients
from dasim.typing import FloatArray

if TYPE_CHECKING:
    from dasim.camera.specification import Camera


class Wavefront(NamedTuple):
    """Deviation of the light through a stop from a sphere about its image, in nanometres of optical path."""

    zernike_nm: Coefficients  # RMS over the open lens
    opening: Stop | None = None  # the part of the pupil that has a step
    step_nm: float = 0.0


class Phase(NamedTuple):
    """The same at one wavelength."""

    turns: Coefficients  # Zernike coefficients in waves
    opening: Stop | None
    step: complex  # mean of exp(i phase) of the step


def of_stop(camera: Camera, stop: Stop) -> Wavefront:
    """The wavefront of the light through a stop, on the axis."""
    opening = next((other for other in camera.stops if other.phase_nm and other.name != stop.name), None)
    return Wavefront(camera.lens.wavefront_nm.coefficients(), opening, opening.phase_nm if opening else 0.0)


def is_flat(wavefront: Wavefront) -> bool:
    """Whether the light has no phase but that of focus."""
    return not any(wavefront.zernike_nm) and wavefront.opening is None


def is_radial(wavefront: Wavefront) -> bool:
    """Whether the phase has rotational symmetry about the axis."""
    ring = None if wavefront.opening is None else stops.ring(wavefront.opening)
    symmetric = wavefront.opening is None or (ring is not None and ring.centre == (0.0, 0.0))
    return symmetric and zernike.is_radial(wavefront.zernike_nm)


def at(wavefront: Wavefront, wavelength_nm: float, band_nm: float = 0.0) -> Phase | None:
    """The phase at a wavelength, with the step averaged over a band; None where there is none.

    The mean of exp(2 pi i s / lambda) over a narrow band is its value at the middle times sinc(s band / lambda^2).
    """
    if is_flat(wavefront):
        return None
    s = wavefront.step_nm
    step = np.exp(2j * np.pi * s / wavelength_nm) * np.sinc(s * band_nm / wavelength_nm**2)
    return Phase(tuple(value / wavelength_nm for value in wavefront.zernike_nm), wavefront.opening, complex(step))


def factor(phase: Phase, y: Any, x: Any) -> FloatArray:
    """exp(i phase) of the aberrations at places of the pupil, complex, without the step."""
    return np.asarray(np.exp(2j * np.pi * zernike.evaluate(phase.turns, y, x)))


def two_parts(phase: Phase, outside: FloatArray, inside: FloatArray) -> FloatArray:
    """Intensity of light from outside and inside the opening, from the amplitudes of both without the step."""
    cross = (np.conj(outside) * inside * phase.step).real
    return np.abs(outside) ** 2 + np.abs(inside) ** 2 + 2 * cross


def displacement_px(wavefront: Wavefront, f_number: float, pitch_um: float, y: Any, x: Any) -> tuple[Any, Any]:
    """Displacement (y, x) in the picture of the ray through a place of the lens, u = -2 N grad W, in pixels.

    ``f_number`` is the working f-number of the open lens; the gradient is per radius of the lens. A step has no slope.
    """
    scale = -2 * f_number * 1e-3 / pitch_um
    along_y, along_x = zernike.gradient(wavefront.zernike_nm, y, x)
    return scale * along_y, scale * along_x


def steepest(wavefront: Wavefront) -> float:
    """Largest slope of the wavefront over the open lens, in nanometres per radius."""
    if not any(wavefront.zernike_nm):
        return 0.0
    rho, theta = np.meshgrid(np.linspace(0, 1, 17), np.linspace(0, 2 * np.pi, 48, endpoint=False))
    slope = zernike.gradient(wavefront.zernike_nm, rho * np.sin(theta), rho * np.cos(theta))
    return float(np.hypot(*slope).max())


def reach_px(wavefront: Wavefront, f_number: float, pitch_um: float) -> float:
    """Largest displacement of a ray through the lens, in pixels."""
    return 2 * f_number * 1e-3 / pitch_um * steepest(wavefront)
