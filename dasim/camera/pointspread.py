"""Point-spread functions of a camera: wave optics per stop and wavelength, integrated over the pixels.

A kernel is the sum over the stops, weighted by the channel's spectral response through each, integrated over square
pixels. On the axis discs and rings are radially symmetric about their own centre and need one profile per wavelength;
other stops, and all off the axis, are transformed on a grid (:mod:`dasim.camera.pupil_pattern`). There are three models
of diffraction:

``wave``  |FT of the defocused pupil|^2, the true kernel (Goodman, Introduction to Fourier Optics, ch. 6)
``airy``  the geometric blur convolved with the in-focus pattern, an approximation
``off``   the geometric blur

A point nearer than the focus projects the pupil upside down: light through the lens at rho is displaced by -rho c / 2,
with c the signed visible blur. Kernels are those of the upright picture, x right, y down; with distortion their lengths
are those of the pinhole's picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from scipy.special import j0

from dasim.base.errors import InputError, kind_of
from dasim.base.suggestions import did_you_mean
from dasim.camera import geometry, glare, radial_pattern, radiometry, stops, wavefront
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.pixel_integral import deposited, pixel_kernels
from dasim.camera.pupil_pattern import pupil_pattern, turned
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.camera.wavefront import Wavefront
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray

Diffraction = Literal["wave", "airy", "off"]
Field = tuple[float, float]  # (x, y) in pixels from the optical axis
AXIS: Field = (0.0, 0.0)
DIFFRACTION_MODELS: tuple[str, ...] = get_args(Diffraction)

RADIAL_STEP_PX = 0.0125  # between which profiles are linear
PIXEL_NODES = 5  # Gauss-Legendre nodes per pixel and axis, at least
# Within lambda N at 400 nm: nodes of the integral over the pixel, where patterns are transformed and where they are
# radial, and radial steps.
NODES_PER_RING, RADIAL_NODES_PER_RING, STEPS_PER_RING = 3.2, 4.0, 50.0
MOST_NODES, MOST_RADII = 2400, 5000  # along a kernel's side and its radius, which bounds time and memory
MOST_WAVES = stops.PUPIL_CELLS / 8  # of defocus: a phase of pi between neighbouring cells of a pupil at its rim
LARGEST_FIELD_DEG = 60.0  # beyond, the foreshortened pupil has less than 32 cells of its grid across


def working_f_number(camera: Camera, radius_ratio: float) -> float:
    """N = s / A of a stop, with A its diameter."""
    return geometry.image_distance_m(camera) / (radius_ratio * geometry.aperture_m(camera))


def finest_ring_px(camera: Camera) -> float:
    """Lambda N of the open lens at the shortest wavelength, in pixels: no kernel has finer structure."""
    return float(grid.WAVELENGTH_NM[0]) * 1e-3 * working_f_number(camera, 1.0) / camera.sensor.pixel_pitch_um


def _nodes(camera: Camera, size: int, diffraction: str) -> int | None:
    """Nodes per pixel and axis of the integral of a radial profile over the pixels of a kernel; None for edges."""
    if diffraction == "off":
        return None
    wanted = int(np.ceil(RADIAL_NODES_PER_RING / finest_ring_px(camera)))
    return max(PIXEL_NODES, min(wanted, MOST_NODES // size))


def check_model(diffraction: str) -> None:
    """InputError where the diffraction model is unknown."""
    if diffraction not in DIFFRACTION_MODELS:
        hint = did_you_mean(diffraction, DIFFRACTION_MODELS)
        raise InputError(f"diffraction '{diffraction}' is unknown; allowed are {', '.join(DIFFRACTION_MODELS)}{hint}")


def radial_profiles(
    camera: Camera,
    blur_px: FloatArray,
    spectrum: FloatArray,
    radius_px: FloatArray,
    diffraction: str = "wave",
    group: Sequence[Stop] | None = None,
    angle_deg: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Radial density of the kernels, [..., blur, channel, radius] per square pixel, before the pixel.

    ``blur_px`` are visible blur diameters, ``spectrum`` the spectral power of one light or several on the wavelength
    grid, [..., wavelength]; ``group`` are discs and rings about one centre, all of the camera's by default,
    ``angle_deg`` is that of the chief ray, for their responses. Each density integrates to 1 over the plane. Also
    returns the electrons of each channel through these stops, relative, [..., channel].
    """
    check_model(diffraction)
    pitch_m = camera.sensor.pixel_pitch_um * 1e-6
    colour_px = geometry.chromatic_blur_px(camera)
    lead = spectrum.shape[:-1]
    count = len(sensors.channels(camera.sensor))
    total = np.zeros((*lead, len(blur_px), count, len(radius_px)))
    signal = np.zeros((*lead, count))
    for stop in camera.stops if group is None else group:
        ring = stops.ring(stop)
        if ring is None:
            raise ValueError(f"stop '{stop.name}' is not radial")
        if not is_radial(camera, stop, diffraction):
            raise InputError(f"camera '{camera.name}': wavefront_nm has terms without rotational symmetry here")
        weights = radiometry.stop_response(camera, stop, angle_deg) * spectrum[..., None, :]
        signal += grid.integrate(weights)
        f_number, inner = working_f_number(camera, ring.outer), ring.inner / ring.outer
        bands = grid.bands(weights)
        wavelengths_nm = np.array([wavelength_nm for wavelength_nm, _ in bands])
        scales_px = wavelengths_nm * 1e-9 * f_number / pitch_m
        moved = np.interp(wavelengths_nm, grid.WAVELENGTH_NM, colour_px)
        own_blur = ring.outer * (np.asarray(blur_px) + moved[:, None])
        front = wavefront.of_stop(camera, stop)
        profiles: Iterable[FloatArray]
        if diffraction == "wave" and wavefront.is_flat(front):
            waves = own_blur / (8 * scales_px[:, None])
            profiles = radial_pattern.wave_profiles(radius_px, scales_px, waves, inner)
        else:
            profiles = (
                _profile(radius_px, own, scale_px, ring, diffraction, wavefront.at(front, wavelength_nm, grid.BAND_NM))
                for own, scale_px, wavelength_nm in zip(own_blur, scales_px, wavelengths_nm, strict=True)
            )
        for (_, weight), profile in zip(bands, profiles, strict=True):
            total += weight[..., None, :, None] * profile[:, None, :]
    return total / np.where(signal > 0, signal, 1.0)[..., None, :, None], signal


def _profile(
    radius_px: FloatArray,
    blur_px: FloatArray,
    scale_px: float,
    ring: stops.Ring,
    diffraction: str,
    phase: wavefront.Phase | None,
) -> FloatArray:
    """Profile of a disc or ring at one wavelength, [blur, radius] per square pixel; ``blur_px`` is of its own rim."""
    inner = ring.inner / ring.outer
    if diffraction == "airy":
        return radial_pattern.airy_profile(radius_px, blur_px, scale_px, inner)
    if diffraction == "off":
        return radial_pattern.geometric_profile(radius_px, blur_px, inner)
    waves = blur_px / (8 * scale_px)
    return radial_pattern.wave_profile(radius_px / scale_px, waves, inner, phase, ring.outer) / scale_px**2


def _pattern_kernel(
    camera: Camera,
    stop: Stop,
    blur_px: float,
    spectrum: FloatArray,
    size: int,
    offset_px: tuple[float, float],
    diffraction: str,
    field_px: Field,
) -> tuple[FloatArray, FloatArray]:
    """Kernel of one stop over the pixels, times the electrons, [..., channel, y, x], and the electrons."""
    if diffraction == "airy":
        raise InputError(f"stop '{stop.name}' is a {stop.shape}; diffraction 'airy' takes discs and rings only")
    angle_deg = geometry.field_angle_deg(camera, field_px)
    # Tabulated aberrations have their x away from the axis.
    turn_rad = float(np.arctan2(field_px[1], field_px[0])) if camera.lens.wavefront_by_field else 0.0
    front = wavefront.of_stop(camera, stop, angle_deg)
    weights = radiometry.stop_response(camera, stop, angle_deg) * spectrum[..., None, :]
    f_number, colour_px = working_f_number(camera, 1.0), geometry.chromatic_blur_px(camera)
    oblique = None if field_px == AXIS else geometry.foreshortening(camera, field_px)
    nodes, share = radial_pattern.unit_nodes(max(PIXEL_NODES, int(np.ceil(NODES_PER_RING / finest_ring_px(camera)))))
    fine = (np.arange(size)[:, None] + nodes).ravel() - size / 2
    total = np.zeros((*weights.shape[:-1], size, size))
    for wavelength_nm, weight in grid.bands(weights):
        blur = blur_px + float(np.interp(wavelength_nm, grid.WAVELENGTH_NM, colour_px))
        scale = wavelength_nm * 1e-3 * f_number / camera.sensor.pixel_pitch_um
        if diffraction == "wave" and abs(blur) / (8 * scale) <= MOST_WAVES:
            y, x = ((fine - at) / scale for at in offset_px)
            phase = wavefront.at(front, wavelength_nm, grid.BAND_NM)
            density = pupil_pattern(stop, blur / (8 * scale), y, x, phase, oblique, turn_rad) / scale**2
            density = density.reshape(size, len(share), size, len(share))
            kernel = np.einsum("iajb,a,b", density, share, share)
        else:
            transmitted, place = stops.pupil(stop)
            pupil = place[:, None], place[None, :]
            errors_nm = wavefront.coefficients(front, wavelength_nm)
            along = turned(*pupil, turn_rad)
            moved = wavefront.displacement_px(errors_nm, f_number, camera.sensor.pixel_pitch_um, *along)
            moved = turned(*moved, -turn_rad)
            rows, columns = (at - rho * blur / 2 + by for at, rho, by in zip(offset_px, pupil, moved, strict=True))
            side = abs(blur) * (place[1] - place[0]) / 2
            kernel = deposited(rows + size / 2, columns + size / 2, transmitted / transmitted.sum(), side, size)
        total += weight[..., None, None] * kernel
    return total, grid.integrate(weights)


def kernels(
    camera: Camera,
    blur_px: Sequence[float] | FloatArray,
    spectrum: FloatArray,
    size: int,
    diffraction: str = "wave",
    field_px: Field = AXIS,
) -> Callable[[int, tuple[float, float], Any], tuple[FloatArray, FloatArray]]:
    """The camera's kernels for visible blurs, as a function of (index of the blur, offset (y, x) in pixels, light).

    The function gives kernels [..., channel, size, size] (see :func:`psf`), for ``spectrum`` [..., wavelength],
    and the electrons of each channel, relative, [..., channel]; ``light`` is an index into the leading axes of the
    spectrum, ``...`` for all. What all blurs share is computed once. ``field_px`` is the place of the point's image,
    (x, y) from the axis; the shape of off-axis diffraction is that of ``wave`` alone.
    """
    check_model(diffraction)
    angle_deg = _checked_angle_deg(camera, field_px)
    fronts = [wavefront.of_stop(camera, stop, angle_deg) for stop in camera.stops]
    if diffraction == "airy" and not all(wavefront.is_flat(front) for front in fronts):
        raise InputError(
            f"camera '{camera.name}': diffraction 'airy' takes no wavefront_nm and no phase_nm; 'wave' does"
        )
    blurs = np.asarray(blur_px, dtype=np.float64)
    about: dict[tuple[stops.Point, float, float], list[Stop]] = {}
    others: list[Stop] = []
    for stop, front in zip(camera.stops, fronts, strict=True):
        ring = stops.ring(stop)
        off_axis = diffraction == "wave" and field_px != AXIS
        if ring is None or off_axis or not is_radial(camera, stop, diffraction, front):
            others.append(stop)
        else:
            about.setdefault((ring.centre, *_veil(camera, stop)), []).append(stop)
    largest = float(np.abs(blurs).max() + np.abs(geometry.chromatic_blur_px(camera)).max())
    farthest = max((float(np.hypot(*centre)) for centre, *_ in about), default=0.0) * largest / 2
    nodes, end = _nodes(camera, size, diffraction), size * 0.75 + 2 + farthest
    radius = np.arange(0, end, min(RADIAL_STEP_PX, max(finest_ring_px(camera) / STEPS_PER_RING, end / MOST_RADII)))
    groups = [
        (
            np.array(centre[::-1]),
            veil,
            colour_px,
            *radial_profiles(camera, blurs, part, radius, diffraction, group, angle_deg),
        )
        for (centre, *veil), group in about.items()
        for colour_px, part in _moved_alike(camera, centre, spectrum)
    ]

    def at(index: int, offset_px: tuple[float, float], light: Any) -> tuple[FloatArray, FloatArray]:
        total: FloatArray = np.zeros(())
        signal: FloatArray = np.zeros(())
        for centre, veil, colour_px, profiles, electrons in groups:
            y, x = np.array(offset_px) - centre * (blurs[index] + colour_px) / 2
            shares = electrons[light]
            part = pixel_kernels(profiles[..., index, :, :][light], radius, size, (float(y), float(x)), nodes)
            part = _veiled(part, np.ones_like(shares), veil, offset_px)
            total, signal = total + part * shares[..., None, None], signal + shares
        for stop in others:
            part, electrons = _pattern_kernel(
                camera, stop, float(blurs[index]), spectrum[light], size, offset_px, diffraction, field_px
            )
            part = _veiled(part, electrons, _veil(camera, stop), offset_px)
            total, signal = total + part, signal + electrons
        return total / np.where(signal > 0, signal, 1.0)[..., None, None], signal

    return at


def pair(name: str, value: Any) -> tuple[float, float]:
    """Two finite numbers from what a user gives for ``name``, or InputError."""
    try:
        first, second = (float(number) for number in value)
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be two numbers of pixels, not {value!r}") from None
    if not np.isfinite([first, second]).all():
        raise InputError(f"{name}: must be two finite numbers of pixels, not {value!r}")
    return first, second


def _checked_angle_deg(camera: Camera, field_px: Field) -> float:
    """Angle of the chief ray to a place of the field; InputError where kernels cannot be computed."""
    angle_deg = geometry.field_angle_deg(camera, field_px)
    if angle_deg > LARGEST_FIELD_DEG:
        raise InputError(
            f"field_px {field_px[0]:g}, {field_px[1]:g}: lies at {angle_deg:.4g} degrees from the axis of camera "
            f"'{camera.name}'; kernels are computed up to {LARGEST_FIELD_DEG:g} degrees"
        )
    return angle_deg


def is_radial(camera: Camera, stop: Stop, diffraction: str = "wave", front: Wavefront | None = None) -> bool:
    """Whether the kernel of a stop is radially symmetric about the image through the stop's centre.

    ``front`` is the wavefront, by default that on the axis.
    """
    ring, front = stops.ring(stop), front or wavefront.of_stop(camera, stop)
    if ring is None:
        return False
    if diffraction != "wave":  # a phase step does not deflect rays
        return not wavefront.has_errors(front)
    return wavefront.is_flat(front) or (ring.centre == (0.0, 0.0) and wavefront.is_radial(front))


def _veil(camera: Camera, stop: Stop) -> tuple[float, float]:
    """Share and radius (px) of a stop's veiling glare; zeros where it has none."""
    return (stop.glare_share, glare.radius_px(camera, stop)) if stop.glare_share else (0.0, 0.0)


def _veiled(
    kernels: FloatArray, light: FloatArray, veil: Sequence[float], offset_px: tuple[float, float]
) -> FloatArray:
    """Kernels [..., y, x] of total ``light`` [...] with a share of it spread over the veil."""
    share, radius = veil
    if share == 0:
        return kernels
    place = np.arange(kernels.shape[-1]) - kernels.shape[-1] // 2
    distance = np.hypot(place[:, None] - offset_px[0], place[None, :] - offset_px[1])
    return (1 - share) * kernels + share * light[..., None, None] * glare.veil(distance, radius)


def _moved_alike(camera: Camera, centre: stops.Point, spectrum: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Parts of a spectrum whose kernels share a centre for a stop about ``centre``, each with its axial colour, px.

    For a displaced stop, axial colour shifts the kernels of different wavelengths apart: one part for each band.
    """
    if centre == (0.0, 0.0) or not camera.lens.focal_shift_um:
        yield 0.0, spectrum
        return
    colour_px, index = geometry.chromatic_blur_px(camera), grid.band_index()
    for band in range(index[-1] + 1):
        inside = index == band
        yield float(colour_px[inside].mean()), np.where(inside, spectrum, 0.0)


def kernel_size_px(camera: Camera, blur_px: float, field_px: Field = AXIS) -> int:
    """Odd frame size that holds a kernel of a visible blur with its diffraction tail, at a place of the field."""
    angle_deg = geometry.field_angle_deg(camera, field_px)
    widest = max(working_f_number(camera, stops.breadth(stop)) for stop in camera.stops)
    widest /= np.cos(np.radians(angle_deg)) ** 3
    tail_px = 3 * 0.7e-6 * widest / (camera.sensor.pixel_pitch_um * 1e-6)  # three rings at 700 nm
    colour_px = float(np.abs(geometry.chromatic_blur_px(camera)).max())
    f_number, pitch_um = working_f_number(camera, 1.0), camera.sensor.pixel_pitch_um
    fronts = [wavefront.of_stop(camera, stop, angle_deg) for stop in camera.stops]
    moved_px = max(wavefront.reach_px(front, f_number, pitch_um) for front in fronts)
    return 2 * int(np.ceil((abs(blur_px) + colour_px) / 2 + moved_px + tail_px)) + 1


def psf(
    camera: Camera | str | Path,
    depth_m: float,
    channel: str,
    illuminant: str,
    *,
    offset_px: tuple[float, float] = (0.0, 0.0),
    size: int | None = None,
    diffraction: str = "wave",
    field_px: Field | None = None,
) -> FloatArray:
    """Point-spread function of a channel for a white point, [size, size] in pixels, y down, x right.

    Each value is the share of the point's light in that pixel; the sum is 1 minus the share of the light that falls
    outside the array.

    Args:
        camera: a Camera, a bundled name or a path; its own focus is used
        depth_m: distance of the point from the lens plane, above 0
        channel: a name of the mosaic, such as ``"G"`` or ``"IR"``
        illuminant: the spectrum of the point's light, such as ``"D65"``
        offset_px: (y, x), unlike ``field_px``, from the centre of the middle pixel to the point's image, which is where
            the ray through the middle of the lens meets the sensor
        size: odd number of pixels per side; by default large enough for the blur and its diffraction tail
        diffraction: ``wave``, ``airy`` or ``off``; where ``wave`` transforms a sampled pupil (polygons, masks,
            aberrations without symmetry, places off the axis), defocus beyond
            ``dasim.camera.pointspread.MOST_WAVES`` waves is computed as ``off``
        field_px: (x, y) of the point's image from the optical axis, which widens the pattern of ``wave``; by default
            the middle of the camera's frame, which is on the axis unless ``sensor.principal_point_px`` is elsewhere
    """
    camera = cameras.as_camera(camera)
    field_px = geometry.frame_field_px(camera) if field_px is None else pair("field_px", field_px)
    offset_px = pair("offset_px", offset_px)
    names = sensors.channels(camera.sensor)
    if channel not in names:
        raise InputError(f"channel '{channel}' is unknown; allowed are {', '.join(names)}")
    if not isinstance(depth_m, (int, float, np.number)) or not depth_m > 0:
        raise InputError(f"depth_m: must be a distance above 0, in metres, not {kind_of(depth_m)}")
    blur = float(geometry.blur_px(camera, depth_m))
    if size is None:
        _checked_angle_deg(camera, field_px)
        size = kernel_size_px(camera, blur, field_px)
    elif not isinstance(size, (int, np.integer)) or size < 1 or size % 2 == 0:
        raise InputError(f"size: must be an odd number of pixels per side, such as 31, not {size!r}")
    at = kernels(camera, [blur], illuminants.illuminant(illuminant), size, diffraction, field_px)
    return at(0, offset_px, ...)[0][names.index(channel)]


def airy_errors(camera: Camera, illuminant: str) -> tuple[FloatArray, FloatArray]:
    """Largest errors of ``airy`` against ``wave``, of encircled energy and of MTF, each [level, channel]."""
    blurs = geometry.level_blur_px(camera)
    step = RADIAL_STEP_PX
    radius = np.arange(0.0, blurs[-1] / 2 + 40, step)
    wave, airy = (
        radial_profiles(camera, blurs, illuminants.illuminant(illuminant), radius, model)[0]
        for model in ("wave", "airy")
    )
    ring = 2 * np.pi * radius * step
    energy = np.abs(np.cumsum((airy - wave) * ring, axis=-1)).max(axis=-1)
    frequency = np.linspace(0.02, 0.5, 49)
    hankel = ring[:, None] * j0(2 * np.pi * np.outer(radius, frequency)) * np.sinc(frequency)
    return energy, np.abs(np.abs(airy @ hankel) - np.abs(wave @ hankel)).max(axis=-1)
