"""A camera from a lens prescription: wavefront by field and wavelength, axial colour, distortion, vignetting.

Optiland (extra ``lens``) reads the file and traces rays from infinity. The sensor is moved to where the on-axis
wavefront has no defocus at ``PRIMARY_NM``, as an autofocus would; the defocus of other wavelengths there becomes axial
colour. The remaining wavefront error is fitted by the Zernike terms of :mod:`dasim.camera.zernike` at each angle and
wavelength, without piston and tilt, relative to the sphere about the chief ray's image. The pupil stays round:
vignetting only reduces the light.

Optiland's rays of a positive field run towards +y, from an object below the axis. The direction away from the axis in
the upright picture is therefore -y of its pupil.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry, specification, zernike
from dasim.camera.lens import Lens
from dasim.camera.specification import Camera, as_camera
from dasim.typing import FloatArray

PRIMARY_NM = 550.0
WAVELENGTHS_NM = (450.0, PRIMARY_NM, 650.0, 750.0)
ANGLES = 7  # of the field, from the axis to the corner of the frame
PUPIL_RAYS = 32  # across the pupil
POWERS = 3  # of r^2 in the polynomials of vignetting and distortion
_ROUNDED = 4  # digits of what is written


class _Traced(NamedTuple):
    """Results of tracing rays through a prescription at one angle."""

    coefficients_nm: dict[float, FloatArray]  # by wavelength, in the order of zernike.TERMS
    height_mm: float  # absolute image height of the chief ray
    passed: float  # share of the rays that reach the sensor


def camera_from_lens(path: str | Path, camera: Camera | str | Path = "da-mobile") -> Camera:
    """The camera with focal length, f-number, wavefront errors, axial colour, distortion and vignetting of a lens
    prescription.

    Stops, sensor and focus distance are those of ``camera``; the lens is traced from infinity, out to the corner of the
    camera's frame. Raises InputError if the file cannot be read or the lens does not cover the frame.

    Args:
        path: a Zemax file (.zmx) or Optiland's own format (.json).
        camera: a Camera, a bundled name or a path.
    """
    camera, path = as_camera(camera), Path(path)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # of Optiland and of what it compiles
        optic = _read(path)
        if not optic.object_surface.is_infinite:
            raise InputError(f"lens {path}: its object lies at a finite distance; it must lie at infinity")
        focal_mm, f_number = abs(float(optic.paraxial.f2())), abs(float(optic.paraxial.FNO()))
        if not (np.isfinite(focal_mm) and np.isfinite(f_number) and focal_mm > 0):
            raise InputError(f"{path}: has no finite focal length and f-number at infinity")
        ideal = {"focal_length_mm": focal_mm, "f_number": f_number, "focal_shift_um": (), "shading_per_mm": ()}
        ideal["distortion_per_mm"] = ()
        ideal |= {"wavefront_nm": {}, "wavefront_by_field": ()}
        changed = camera.lens.model_dump() | ideal
        camera = camera.model_copy(update={"lens": parse(Lens, changed, str(path))})
        corner_deg = _corner_deg(camera)
        angles = np.linspace(0.0, corner_deg, ANGLES)
        _prepare(optic, corner_deg)
        axis = _defocus_um(_traced(optic, 0.0, path, corner_deg), f_number)
        optic.image_surface.geometry.cs.z = optic.image_surface.geometry.cs.z + axis[PRIMARY_NM] * 1e-3
        traced = [_traced(optic, float(angle), path, corner_deg) for angle in angles]
    lens = changed | _keys(camera, angles, traced, f_number)
    return parse(Camera, camera.model_dump() | {"lens": lens}, str(path))


def _read(path: Path) -> Any:
    """The prescription as an ``Optic``; InputError for what is no prescription."""
    if not path.is_file():
        raise InputError(f"lens {path}: no such file")
    if path.suffix.lower() not in (".zmx", ".json"):
        raise InputError(f"lens {path}: must be a Zemax file (.zmx) or one of Optiland (.json)")
    try:
        from optiland import fileio
    except ImportError:
        raise InputError(
            "reading a lens prescription requires Optiland: pip install -c constraints.txt -e '.[lens]'"
        ) from None
    load = fileio.load_zemax_file if path.suffix.lower() == ".zmx" else fileio.load_optiland_file
    try:
        return load(str(path))
    except Exception as error:  # Optiland raises whatever its parser meets
        what = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"lens {path}: Optiland cannot read it ({what})") from None


def _corner_deg(camera: Camera) -> float:
    """Angle of the chief ray to the pixel farthest from the axis."""
    height_m = float(np.sqrt(specification.square_of_image_height_m2(camera).max()))
    return float(np.degrees(np.arctan(height_m / geometry.image_distance_m(camera))))


def _prepare(optic: Any, corner_deg: float) -> None:
    """Object at infinity, fields by angle."""
    optic.fields.fields.clear()
    optic.fields.set_type("angle")
    for angle in (0.0, corner_deg):
        optic.fields.add(y=angle)


def _traced(optic: Any, angle_deg: float, path: Path, corner_deg: float) -> _Traced:
    """Zernike coefficients by wavelength, image height and transmitted share at an angle."""
    from optiland.wavefront import Wavefront

    place = angle_deg / corner_deg
    coefficients = {}
    passed = 1.0
    for nm in WAVELENGTHS_NM:
        try:
            front = Wavefront(
                optic, fields=[(0.0, place)], wavelengths=[nm * 1e-3], num_rays=PUPIL_RAYS, distribution="uniform"
            )
        except ValueError as error:
            raise InputError(
                f"lens {path}: cannot be traced at {angle_deg:.3g} degrees and {nm:g} nm ({error})"
            ) from None
        data = front.get_data((0.0, place), nm * 1e-3)
        opd, light = np.asarray(data.opd, dtype=np.float64), np.asarray(data.intensity, dtype=np.float64)
        good = np.isfinite(opd) & (light > 0)
        if np.count_nonzero(good) < len(opd) / 4:
            raise InputError(f"lens {path}: rays at {angle_deg:.3g} degrees do not reach the image; crop the sensor")
        y, x = np.asarray(front.distribution.x)[good], -np.asarray(front.distribution.y)[good]
        terms = [zernike.polynomial(n, m, y, x) for n, m in zernike.TERMS.values()]
        fit = np.linalg.lstsq(np.stack([np.ones_like(x), y, x, *terms], axis=1), -opd[good] * nm, rcond=None)[0]
        coefficients[nm] = fit[3:]
        if nm == PRIMARY_NM:
            passed = float(np.where(good, light, 0.0).mean())
    chief = optic.trace_generic(0.0, place, 0.0, 0.0, PRIMARY_NM * 1e-3)
    return _Traced(coefficients, abs(float(np.ravel(chief.y)[0])), passed)


def _defocus_um(traced: _Traced, f_number: float) -> dict[float, float]:
    """Distance in um behind the sensor at which each wavelength focuses on the axis: 8 N^2 W20, W20 = 2 sqrt(3) c."""
    term = list(zernike.TERMS).index("defocus")
    return {
        nm: float(16 * np.sqrt(3) * f_number**2 * values[term] * 1e-3) for nm, values in traced.coefficients_nm.items()
    }


def _keys(camera: Camera, angles_deg: FloatArray, traced: list[_Traced], f_number: float) -> dict[str, Any]:
    """Keys of ``[lens]`` from what was traced at each angle."""
    shift = _defocus_um(traced[0], f_number)
    names = list(zernike.TERMS)
    rows = []
    for angle, at in zip(angles_deg, traced, strict=True):
        for nm, values in at.coefficients_nm.items():
            own = values.copy()
            own[names.index("defocus")] -= traced[0].coefficients_nm[nm][names.index("defocus")]
            kept = {
                name: round(float(value), _ROUNDED)
                for name, value, (_, m) in zip(names, own, zernike.TERMS.values(), strict=True)
                if m == 0 or (m > 0 and angle > 0)  # the others are rounding errors by symmetry
            }
            rows.append({"angle_deg": round(float(angle), _ROUNDED), "wavelength_nm": nm} | kept)
    image_mm = geometry.image_distance_m(camera) * 1e3
    pinhole_mm = image_mm * np.tan(np.radians(angles_deg))
    height_mm = np.array([at.height_mm for at in traced]) * image_mm / camera.lens.focal_length_mm
    bend = _polynomial(height_mm[1:], pinhole_mm[1:] / height_mm[1:])
    passed = np.array([at.passed for at in traced]) / traced[0].passed
    return {
        "focal_shift_um": [[nm, round(um - shift[PRIMARY_NM], _ROUNDED)] for nm, um in shift.items()],
        "wavefront_by_field": rows,
        "distortion_per_mm": bend,
        "shading_per_mm": _polynomial(height_mm, passed * _area(bend, height_mm)),
    }


def _polynomial(height_mm: FloatArray, values: FloatArray) -> list[float]:
    """The a_k of 1 + sum a_k r^(2k) for values in proportion to it, by least squares."""
    powers = np.stack([height_mm ** (2 * k) for k in range(POWERS + 1)], axis=1)
    fit = np.linalg.lstsq(powers, values, rcond=None)[0]
    return [round(float(value / fit[0]), 2 * _ROUNDED) for value in fit[1:]]


def _area(bend: list[float], height_mm: FloatArray) -> FloatArray:
    """Area in a pinhole's picture per area in the lens's picture, d(r_p^2) / d(r^2).

    Light from a uniform plane enters the pupil with the cos^4 falloff that every camera has; the light that passes the
    lens falls on an area that depends on the distortion.
    """
    square = np.polynomial.Polynomial([0.0, 1.0])
    stretched = square * np.polynomial.Polynomial([1.0, *bend]) ** 2
    return np.asarray(stretched.deriv()(height_mm**2))
