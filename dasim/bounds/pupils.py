"""Transfer functions of any pupil with defocus, per channel and depth, by FFT of the pupil; and their adjoint.

The transfer function of a pupil P(rho) = a(rho) exp(2 pi i W20 rho^2) at f cycles/px is its autocorrelation at the
shift Delta = 2 lambda N f / p, in radii of the lens (Goodman, Introduction to Fourier Optics, sec. 6.4), and since
W20 = c p / (8 lambda N), the phase of the product is pi c f . rho at the middle of the two: linear, and the same for
all wavelengths. A grid of cells of Delta(f_1) / m, f_1 the patch's lowest frequency, makes every frequency of the patch
a shift by whole cells: for amplitudes that are constant in cells the autocorrelation is then exact, with
sinc(c f_x h / 2) sinc(c f_y h / 2) for the phase within a cell of side h. Each wavelength has a grid of its own, onto
which the amplitude is averaged by area.

Places are in camera axes, x right, y down, in radii of the lens; patches as in :mod:`dasim.bounds.cramer_rao`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.interpolate import CubicSpline

from dasim.bounds import cramer_rao
from dasim.camera import geometry, pointspread, radiometry, stops
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.spectra import grid as spectra
from dasim.spectra import illuminants
from dasim.typing import ComplexArray, FloatArray

BAND_NM = 40.0  # wavelengths that share one grid: lambda changes by 5 %, the transfer function of c not at all
FINE_CELLS = 96  # across the lens at least, so that averaging onto a wavelength's grid blurs no mask of 48 cells
RING_CELLS = 256  # across the lens for stops that are drawn: a rim is drawn with the share of each cell it covers
_DRAWN = 8  # points across such a cell
_TAIL = 0.01  # of the light, at either end of the band
_NODES = 32  # Gauss-Legendre nodes of Hopkins's integral: 1e-6 of a transfer function at 10 waves
_RADIAL_FREQUENCIES = 96  # from 0 to the corner of the patch's band


@dataclass(frozen=True)
class Grid:
    """One band of wavelengths: its cells, phases and factors."""

    weight: FloatArray  # [channel], share of the channel's light through the stop
    average: FloatArray  # [cell, mask's cell]
    phase: ComplexArray  # [blur, y, x]
    factor: FloatArray  # [blur, h, w/2 + 1], pixel and phase within a cell
    side: float  # of a cell
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
    found, electrons = _bands(camera, stop, light)
    grids = tuple(
        _grid(band.weight, band.scale_px, blurs + band.colour_px, cells, shape[0], spacing_px, fine_cells)
        for band in found
    )
    return Pupil(grids, shape, electrons / stops.open_area(stop))


@dataclass(frozen=True)
class _Band:
    """Wavelengths that share one transfer function."""

    weight: FloatArray  # [channel], share of the channel's light through the stop
    scale_px: float  # lambda N of the open lens
    colour_px: float  # what axial colour adds to the blur


def _bands(camera: Camera, stop: Stop, light: str) -> tuple[list[_Band], FloatArray]:
    """Bands of ``BAND_NM`` of the light through a stop, and its electrons, relative, [channel]."""
    weights = radiometry.stop_response(camera, stop) * illuminants.illuminant(light)
    total = spectra.integrate(weights)
    f_number, pitch_m = pointspread.working_f_number(camera, 1.0), camera.sensor.pixel_pitch_um * 1e-6
    parts = pointspread.bands(weights)
    passed = np.cumsum([weight.max() for _, weight in parts])
    core = [nm for (nm, _), share in zip(parts, passed / passed[-1], strict=True) if _TAIL < share < 1 - _TAIL]
    groups: dict[int, list[tuple[float, FloatArray]]] = {}
    for nm, weight in parts:  # an edge's tail goes with what lies beside it
        groups.setdefault(int((np.clip(nm, core[0], core[-1]) - core[0]) // BAND_NM), []).append((nm, weight))
    found = []
    for group in groups.values():
        share = np.array([weight for _, weight in group])
        mean_nm = float(np.average([nm for nm, _ in group], weights=share.sum(axis=1)))
        colour = float(np.interp(mean_nm, spectra.WAVELENGTH_NM, geometry.chromatic_blur_px(camera)))
        weight = share.sum(axis=0) / np.where(total > 0, total, 1.0)
        found.append(_Band(weight, mean_nm * 1e-9 * f_number / pitch_m, colour))
    return found, total


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
    fy, fx = cramer_rao.frequencies((count, count), spacing_px)
    within = np.sinc(blurs[:, None, None] * fy * side / 2) * np.sinc(blurs[:, None, None] * fx * side / 2)
    return Grid(
        weight,
        average,
        defocus[:, :, None] * defocus[:, None, :],
        within * np.sinc(fy) * np.sinc(fx),
        side,
        step,
        int(fft.next_fast_len(across + step * (count // 2), real=False)),
    )


def transfers(made: Pupil, amplitude: FloatArray, area: float | None = None) -> ComplexArray:
    """H of every channel's light through the pupil, [blur, channel, h, w/2 + 1].

    ``area`` is the open area in squared radii, by default the sum of the squared amplitudes: a cell that a rim covers
    by half passes half the light, and a quarter by its mean amplitude. At frequency 0 H falls short of 1 by what
    averaging takes from fine masks; no bound looks there.
    """
    total: ComplexArray = np.zeros((), complex)
    for grid in made.grids:
        one = _transform(grid, made.shape, amplitude, area)[-1]
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
        own = (np.conj(grid.phase) * back).real.sum(axis=0)
        total += grid.average.T @ own @ grid.average + 2 * amplitude * to_energy * _ratio(grid, amplitude)
    return total


def _transform(
    grid: Grid, shape: tuple[int, int], amplitude: FloatArray, area: float | None = None
) -> tuple[FloatArray, ComplexArray, float, ComplexArray]:
    """Averaged amplitude, its field, its energy, and H of one band, [blur, h, w/2 + 1]."""
    averaged = grid.average @ amplitude @ grid.average.T
    field = fft.fft2(averaged * grid.phase, (grid.size, grid.size), workers=2)
    energy = float((amplitude**2).sum()) * _ratio(grid, amplitude) if area is None else area / grid.side**2
    both = fft.rfft2(field.real**2 + field.imag**2, workers=2)
    rows, columns = _shifts(grid, shape)
    found = np.conj(both[:, rows[:, None], columns[None, :]]) / grid.size**2
    return averaged, field, energy, found * grid.factor / energy


def _ratio(grid: Grid, amplitude: FloatArray) -> float:
    """Area of a cell of the mask over that of the grid."""
    return (2 / len(amplitude) / grid.side) ** 2


def _shifts(grid: Grid, shape: tuple[int, int]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Places of the patch's frequencies in the transform."""
    rows = np.rint(np.fft.fftfreq(shape[0]) * shape[0]).astype(int) * grid.step
    return rows % grid.size, np.arange(shape[1] // 2 + 1) * grid.step


# --- stops of a camera -------------------------------------------------------------------------


def drawn(stop: Stop, cells: int = RING_CELLS) -> FloatArray:
    """Amplitude of a stop on a grid over the square around the lens, [y, x]: shares of cells, roots of masks."""
    if isinstance(stop, stops.Mask):
        return np.asarray(np.sqrt(stop.mask))
    ring = stops.ring(stop)
    if ring is None:
        return stops.pupil(stop)[0]
    place = stops.cell_centres(cells * _DRAWN)
    radius = np.hypot(place[:, None] - ring.centre[1], place[None, :] - ring.centre[0])
    inside = ((radius < ring.outer) & (radius >= ring.inner)).astype(np.float64)
    return np.asarray(inside.reshape(cells, _DRAWN, cells, _DRAWN).mean(axis=(1, 3)))


def disc_transfers(
    camera: Camera, stop: stops.Disc, blur_px: FloatArray, light: str, shape: tuple[int, int], spacing_px: float
) -> tuple[NDArray, FloatArray]:
    """H through a disc anywhere in the lens, [blur, channel, h, w/2 + 1], and its electrons, relative, [channel].

    Hopkins's integral (Proc. R. Soc. A 231, 1955), as in :func:`validation.references.transfer.hopkins_otf`, at radial
    frequencies with a spline between. A disc about d sees rho^2 = |r|^2 + 2 d . r + |d|^2, r from its own middle: the
    same defocus, and a tilt that moves the picture by c d / 2, for all wavelengths alike.
    """
    found, electrons = _bands(camera, stop, light)
    fy, fx = cramer_rao.frequencies(shape, spacing_px)
    wanted = np.hypot(fy, fx)
    known = np.linspace(0, float(wanted.max()), _RADIAL_FREQUENCIES)
    t, node = _nodes()
    blurs = blur_px + np.array([[band.colour_px] for band in found])  # [band, blur]
    along = np.empty((*blurs.shape, len(known)))
    for number, band in enumerate(found):
        scale_px = band.scale_px / stop.radius_ratio
        v = np.minimum(known * scale_px, 1.0)[:, None]
        x = (1 - v) * (1 - t**2)
        kernel = np.sqrt(np.maximum(1 - (x + v) ** 2, 0.0)) * (8 / np.pi * t * node * (1 - v))
        waves = stop.radius_ratio * blurs[number] / (8 * scale_px)
        along[number] = (np.cos(8 * np.pi * waves[:, None, None] * (v * x)) * kernel).sum(axis=-1)
    full: NDArray = CubicSpline(known, along, axis=-1)(wanted.ravel()).reshape(*blurs.shape, *wanted.shape)
    if not stops.is_plain_disc(stop):
        shift = fx * stop.centre_ratio[0] + fy * stop.centre_ratio[1]
        full = full * np.exp(1j * np.pi * blurs[..., None, None] * shift)
    weight = np.array([band.weight for band in found])
    return np.einsum("kc,kbyx->bcyx", weight, full) * (np.sinc(fy) * np.sinc(fx)), electrons


@cache
def _nodes() -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    return (nodes + 1) / 2, weights / 2


def stop_transfers(
    camera: Camera,
    blur_px: FloatArray,
    light: str,
    shape: tuple[int, int],
    *,
    spacing_px: float = 1.0,
    fine_cells: int = FINE_CELLS,
) -> tuple[ComplexArray, FloatArray]:
    """H of every channel through all stops, of any shape, [blur, channel, h, w/2 + 1], and its electrons, relative."""
    parts: list[NDArray] = []
    electrons: list[FloatArray] = []
    for stop in camera.stops:
        if isinstance(stop, stops.Disc):
            part, signal = disc_transfers(camera, stop, blur_px, light, shape, spacing_px)
            parts.append(part)
        else:
            amplitude = drawn(stop)
            made = pupil(
                camera, stop, light, blur_px, len(amplitude), shape, spacing_px=spacing_px, fine_cells=fine_cells
            )
            parts.append(transfers(made, amplitude, stops.open_area(stop) * np.pi))
            signal = made.electrons * stops.open_area(stop)
        electrons.append(signal)
    total = np.sum(electrons, axis=0)
    shares = np.array(electrons) / np.where(total > 0, total, 1.0)
    full = np.sum([share[:, None, None] * part for share, part in zip(shares, parts, strict=True)], axis=0)
    return full.astype(complex), total


def camera_transfers(
    camera: Camera,
    blur_px: ArrayLike,
    light: str,
    shape: tuple[int, int],
    *,
    spacing_px: float = 1.0,
    fine_cells: int = FINE_CELLS,
) -> tuple[ComplexArray, ComplexArray]:
    """H and dH/dc as of :func:`dasim.bounds.cramer_rao.camera_transfers`, for stops of any shape."""
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    both = np.concatenate([blurs - cramer_rao.SLOPE_STEP_PX, blurs + cramer_rao.SLOPE_STEP_PX])
    full, _ = stop_transfers(camera, both, light, shape, spacing_px=spacing_px, fine_cells=fine_cells)
    below, above = np.split(full, 2, axis=0)
    return (below + above) / 2, (above - below) / (2 * cramer_rao.SLOPE_STEP_PX)
