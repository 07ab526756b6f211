"""Transfer functions of any pupil with defocus, per channel and depth, by FFT of the pupil; and their adjoint.

The transfer function of a pupil P(rho) = a(rho) exp(2 pi i W20 rho^2) at f cycles/px is its autocorrelation at the
shift Delta = 2 lambda N f / p, in radii of the lens (Goodman, Introduction to Fourier Optics, sec. 6.4), and since
W20 = c p / (8 lambda N), the phase of the product is pi c f . rho at the middle of the two: linear, and the same for
all wavelengths. A grid of cells of Delta(f_1) / m, f_1 the patch's lowest frequency, makes every frequency of the patch
a shift by whole cells: for amplitudes that are constant in cells the autocorrelation is then exact, with
sinc(c f_x h / 2) sinc(c f_y h / 2) for the phase within a cell of side h. Each wavelength has a grid of its own, onto
which the amplitude is averaged by area.

Places are in camera axes, x right, y down, in radii of the lens; patches as in :mod:`validation.bounds`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from dasim import aperture, illuminants, pointspread, spectra
from dasim import camera as cameras
from dasim.aperture import Stop
from dasim.camera import Camera
from validation import bounds

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

BAND_NM = 40.0  # wavelengths that share one grid: lambda changes by 5 %, the transfer function of c not at all
FINE_CELLS = 96  # across the lens at least, so that averaging onto a wavelength's grid blurs no mask of 48 cells
RING_CELLS = 256  # across the lens for stops that are drawn: a rim is drawn with the share of each cell it covers
_DRAWN = 8  # points across such a cell
_TAIL = 0.01  # of the light, at either end of the band


@dataclass(frozen=True)
class Grid:
    """One band of wavelengths: its cells, phases and factors."""

    weight: FloatArray  # [channel], share of the channel's light through the stop
    average: FloatArray  # [cell, mask's cell]
    phase: ComplexArray  # [blur, y, x]
    factor: FloatArray  # [blur, h, w/2 + 1], pixel and phase within a cell
    step: int  # cells a frequency step
    size: int  # of the transform


@dataclass(frozen=True)
class Pupil:
    """A stop of given spectral transmittance in a camera, whose amplitude [y, x] over the square is still free."""

    grids: tuple[Grid, ...]
    shape: tuple[int, int]
    electrons: FloatArray  # [channel], per unit of open area


def pupil(
    camera: Camera,
    stop: Stop,
    light: str,
    blur_px: ArrayLike,
    cells: int,
    shape: tuple[int, int],
    *,
    spacing_px: float = 1.0,
    fine_cells: int = FINE_CELLS,
) -> Pupil:
    """What does not change with the amplitude, for visible blurs ``blur_px`` and masks of ``cells`` across.

    Of ``stop`` only the bands count. Patches are square, [n, n].
    """
    if shape[0] != shape[1]:
        raise ValueError("patches must be square: one shift is one frequency step along both axes")
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    weights = cameras.stop_response(camera, stop) * illuminants.illuminant(light)
    weights = weights / aperture.open_area(stop)
    total = spectra.integrate(weights)
    f_number, pitch_m = pointspread.working_f_number(camera, 1.0), camera.sensor.pixel_pitch_um * 1e-6
    groups: dict[int, list[tuple[float, FloatArray]]] = {}
    parts = pointspread.bands(weights)
    passed = np.cumsum([weight.max() for _, weight in parts])
    core = [nm for (nm, _), share in zip(parts, passed / passed[-1], strict=True) if _TAIL < share < 1 - _TAIL]
    for nm, weight in parts:  # an edge's tail goes with what lies beside it
        groups.setdefault(int((np.clip(nm, core[0], core[-1]) - core[0]) // BAND_NM), []).append((nm, weight))
    grids = []
    for group in groups.values():
        share = np.array([weight for _, weight in group])
        mean_nm = float(np.average([nm for nm, _ in group], weights=share.sum(axis=1)))
        scale_px = mean_nm * 1e-9 * f_number / pitch_m
        seen = blurs + float(np.interp(mean_nm, spectra.WAVELENGTH_NM, cameras.chromatic_blur_px(camera)))
        weight = share.sum(axis=0) / np.where(total > 0, total, 1.0)
        grids.append(_grid(weight, scale_px, seen, cells, shape[0], spacing_px, fine_cells))
    return Pupil(tuple(grids), shape, total)


def _grid(
    weight: FloatArray, scale_px: float, blurs: FloatArray, cells: int, count: int, spacing_px: float, fine: int
) -> Grid:
    first = 2 * scale_px / (count * spacing_px)  # shift of the lowest frequency, in radii
    step = max(1, int(np.ceil(fine * first / 2)))
    side = first / step
    across = 2 * int(np.ceil(1 / side)) if side < 1 else 2
    place = (np.arange(across) + 0.5 - across / 2) * side
    edges = (np.arange(across + 1) - across / 2) * side
    own = np.arange(cells + 1) * 2 / cells - 1
    low, high = np.maximum(edges[:-1, None], own[None, :-1]), np.minimum(edges[1:, None], own[None, 1:])
    average = np.clip(high - low, 0.0, None) / side
    defocus = np.exp(2j * np.pi * blurs[:, None] / (8 * scale_px) * place**2)
    fy, fx = bounds.frequencies((count, count), spacing_px)
    within = np.sinc(blurs[:, None, None] * fy * side / 2) * np.sinc(blurs[:, None, None] * fx * side / 2)
    return Grid(
        weight,
        average,
        defocus[:, :, None] * defocus[:, None, :],
        within * np.sinc(fy) * np.sinc(fx),
        step,
        int(fft.next_fast_len(across + step * (count // 2), real=False)),
    )


def transfers(made: Pupil, amplitude: FloatArray) -> ComplexArray:
    """H of every channel's light through the pupil, [blur, channel, h, w/2 + 1]; 1 at frequency 0."""
    total: ComplexArray = np.zeros((), complex)
    for grid in made.grids:
        one = _transform(grid, made.shape, amplitude)[-1]
        total = total + grid.weight[:, None, None] * one[:, None]
    return total


def gradient(made: Pupil, amplitude: FloatArray, wanted: NDArray) -> FloatArray:
    """Gradient by the amplitude, [y, x], of a real number J with dJ = Re sum of conj(wanted) dH; adjoint of above."""
    total = np.zeros_like(amplitude)
    for grid in made.grids:
        averaged, field, energy, found = _transform(grid, made.shape, amplitude)
        to_one = (grid.weight[:, None, None] * wanted).sum(axis=1)
        to_energy = -float((np.conj(to_one) * found).real.sum()) / energy
        seed = np.conj(to_one) * grid.factor / energy
        seed[..., 1:] /= 2  # the other half of the plane comes with the real transform
        rows, columns = _shifts(grid, made.shape)
        spread = np.zeros((len(seed), grid.size, grid.size // 2 + 1), complex)
        spread[:, rows[:, None], columns[None, :]] = seed
        to_intensity = fft.irfft2(spread, (grid.size, grid.size), workers=2)
        count = len(averaged)
        back = fft.ifft2(2 * to_intensity * field, workers=2)[:, :count, :count] * grid.size**2
        own = (np.conj(grid.phase) * back).real.sum(axis=0) + 2 * averaged * to_energy
        total += grid.average.T @ own @ grid.average
    return total


def _transform(
    grid: Grid, shape: tuple[int, int], amplitude: FloatArray
) -> tuple[FloatArray, ComplexArray, float, ComplexArray]:
    """Averaged amplitude, its field, its energy, and H of one band, [blur, h, w/2 + 1]."""
    averaged = grid.average @ amplitude @ grid.average.T
    field = fft.fft2(averaged * grid.phase, (grid.size, grid.size), workers=2)
    energy = float((averaged**2).sum())
    both = fft.rfft2(field.real**2 + field.imag**2, workers=2)
    rows, columns = _shifts(grid, shape)
    found = np.conj(both[:, rows[:, None], columns[None, :]]) / grid.size**2
    return averaged, field, energy, found * grid.factor / energy


def _shifts(grid: Grid, shape: tuple[int, int]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Places of the patch's frequencies in the transform."""
    rows = np.rint(np.fft.fftfreq(shape[0]) * shape[0]).astype(int) * grid.step
    return rows % grid.size, np.arange(shape[1] // 2 + 1) * grid.step


# --- stops of a camera -------------------------------------------------------------------------


def drawn(stop: Stop, cells: int = RING_CELLS) -> FloatArray:
    """Amplitude of a stop on a grid over the square around the lens, [y, x]: shares of cells, roots of masks."""
    if isinstance(stop, aperture.Mask):
        return np.asarray(np.sqrt(stop.mask))
    ring = aperture.ring(stop)
    if ring is None:
        return aperture.pupil(stop)[0]
    place = aperture.cell_centres(cells * _DRAWN)
    radius = np.hypot(place[:, None] - ring.centre[1], place[None, :] - ring.centre[0])
    inside = ((radius < ring.outer) & (radius >= ring.inner)).astype(np.float64)
    return np.asarray(inside.reshape(cells, _DRAWN, cells, _DRAWN).mean(axis=(1, 3)))


def stop_transfers(
    camera: Camera, blur_px: FloatArray, light: str, shape: tuple[int, int], *, spacing_px: float = 1.0
) -> tuple[ComplexArray, FloatArray]:
    """H of every channel through all stops, of any shape, [blur, channel, h, w/2 + 1], and its electrons, relative.

    Discs and rings about the axis by their radial profiles, all others by their pupils.
    """
    round_ones, parts, electrons = [], [], []
    for stop in camera.stops:
        ring = aperture.ring(stop)
        if ring is not None and ring.centre == (0.0, 0.0):
            round_ones.append(stop)
            continue
        amplitude = drawn(stop)
        made = pupil(camera, stop, light, blur_px, len(amplitude), shape, spacing_px=spacing_px)
        parts.append(transfers(made, amplitude))
        electrons.append(made.electrons * aperture.open_area(stop))
    if round_ones:
        spectrum = illuminants.illuminant(light)
        part, signal = bounds.round_transfers(
            camera, blur_px, spectrum, shape, spacing_px=spacing_px, stops=round_ones
        )
        parts.append(part.astype(complex))
        electrons.append(signal)
    total = np.sum(electrons, axis=0)
    shares = np.array(electrons) / np.where(total > 0, total, 1.0)
    full = np.sum([share[:, None, None] * part for share, part in zip(shares, parts, strict=True)], axis=0)
    return full, total


def camera_transfers(
    camera: Camera, blur_px: ArrayLike, light: str, shape: tuple[int, int], *, spacing_px: float = 1.0
) -> tuple[ComplexArray, ComplexArray]:
    """As :func:`validation.bounds.camera_transfers`, for stops of any shape: H and dH/dc, [blur, channel, h, w/2 + 1]."""
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    both = np.concatenate([blurs - bounds.SLOPE_STEP_PX, blurs + bounds.SLOPE_STEP_PX])
    full, _ = stop_transfers(camera, both, light, shape, spacing_px=spacing_px)
    below, above = np.split(full, 2, axis=0)
    return (below + above) / 2, (above - below) / (2 * bounds.SLOPE_STEP_PX)
