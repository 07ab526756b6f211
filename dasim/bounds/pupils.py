"""Transfer functions of any defocused pupil, per channel and depth, by FFT of the pupil, and their gradient.

The transfer function of a pupil P(rho) = a(rho) exp(2 pi i W20 rho^2) at f cycles/px is its normalised autocorrelation
at the shift Delta = 2 lambda N f / p, in radii of the lens (Goodman, Introduction to Fourier Optics, sec. 6.4). With
W20 = c p / (8 lambda N), the phase of the product P(rho + Delta/2) P*(rho - Delta/2) is pi c f . rho, which is linear
and the same for all wavelengths.

The pupil is sampled on cells of side h = Delta(f_1) / m, where f_1 is the lowest frequency of the patch, so that every
frequency of the patch is a shift by a whole number of cells. For amplitudes that are constant within cells the
autocorrelation is then exact; the phase within a cell contributes the factor sinc(c f_x h / 2) sinc(c f_y h / 2). Each
wavelength has its own grid, onto which the amplitude is averaged by area.

Coordinates are in camera axes, x right, y down, in radii of the lens. Patches are those of
:mod:`dasim.bounds.cramer_rao`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft
from scipy.interpolate import CubicSpline

from dasim.base.errors import InputError
from dasim.bounds import cramer_rao
from dasim.camera import geometry, pointspread, radiometry, stops, wavefront
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.spectra import grid as spectra
from dasim.spectra import illuminants
from dasim.typing import ComplexArray, FloatArray

BAND_NM = 40.0  # width of the bands that share one grid; lambda changes by 5 %, the phase of c not at all
FINE_CELLS = 96  # fewest cells across the lens; averaging onto these does not blur masks of 48 cells
RING_CELLS = 256  # across the lens for stops other than masks, whose edges cover cells in part
_SUBCELLS = 8  # sampling points along each side of such a cell
_TAIL = 0.01  # share of the light at either end of the spectrum that joins the adjacent band
# Gauss-Legendre nodes of Hopkins's integral, at least, and per wave of defocus: the error is 1e-6 at 10 waves
_NODES, _NODES_PER_WAVE = 32, 4
_RADIAL_FREQUENCIES = 96  # from 0 to the corner of the patch's band, at least


@dataclass(frozen=True)
class Grid:
    """Sampled pupil of one band of wavelengths."""

    weight: FloatArray  # [channel], share of the channel's light through the stop
    average: FloatArray  # [cell, mask cell], area weights along one axis
    phase: ComplexArray  # [blur, y, x], factor of defocus
    factor: FloatArray  # [blur, h, w/2 + 1], sincs of the pixel and of the phase within a cell
    side: float  # of a cell, in radii of the lens
    step: int  # cells per frequency step
    size: int  # of the FFT


@dataclass(frozen=True)
class Pupil:
    """A stop's spectral transmittance in a camera, for any amplitude [y, x] over the square around the lens."""

    grids: tuple[Grid, ...]
    shape: tuple[int, int]
    electrons: FloatArray  # [channel], relative, per unit of open area


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
    """Sampled pupil of a stop: everything that does not depend on the amplitude of its mask.

    Args:
        camera: the camera.
        stop: the stop, of which only the spectral transmittance is used.
        light: name of the illuminant.
        blur_px: visible blurs in px, [blur].
        cells: cells of the mask across the lens.
        shape: [n, n] of the patch, which must be square.
        spacing_px: distance of the patch's samples.
        fine_cells: fewest cells of the sampled pupil across the lens.
    """
    if shape[0] != shape[1]:
        raise ValueError("patches must be square: one cell is the same frequency step along both axes")
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    bands, electrons = _bands(camera, stop, light)
    grids = tuple(
        _grid(band.weight, band.scale_px, blurs + band.colour_px, cells, shape[0], spacing_px, fine_cells)
        for band in bands
    )
    return Pupil(grids, shape, electrons / stops.open_area(stop))


@dataclass(frozen=True)
class _Band:
    """Wavelengths that share one transfer function."""

    weight: FloatArray  # [channel], share of the channel's light through the stop
    scale_px: float  # lambda N / p of the open lens, px
    colour_px: float  # visible blur due to axial colour


def _bands(camera: Camera, stop: Stop, light: str) -> tuple[list[_Band], FloatArray]:
    """Bands of width ``BAND_NM`` of the light through a stop, and its relative electrons, [channel].

    Raises InputError for a lens or stop with a wavefront of its own, which no transfer function here has.
    """
    if not wavefront.is_flat(wavefront.of_stop(camera, stop)):
        raise InputError(
            f"camera '{camera.name}': transfer functions of pupils have neither wavefront_nm nor phase_nm; omit them"
        )
    weights = radiometry.stop_response(camera, stop) * illuminants.illuminant(light)
    total = spectra.integrate(weights)
    f_number, pitch_m = pointspread.working_f_number(camera, 1.0), camera.sensor.pixel_pitch_um * 1e-6
    parts = spectra.bands(weights)
    if not parts:
        raise InputError(f"camera '{camera.name}': no light of {light} passes stop '{stop.name}' to the sensor")
    size = np.array([weight.max() for _, weight in parts])
    cumulative = np.cumsum(size) / size.sum()
    core = [nm for (nm, _), share in zip(parts, cumulative, strict=True) if _TAIL < share < 1 - _TAIL]
    core = core or [parts[int(size.argmax())][0]]
    groups: dict[int, list[tuple[float, FloatArray]]] = {}
    for nm, weight in parts:  # the tails join the adjacent band
        groups.setdefault(int((np.clip(nm, core[0], core[-1]) - core[0]) // BAND_NM), []).append((nm, weight))
    result = []
    for group in groups.values():
        share = np.array([weight for _, weight in group])
        mean_nm = float(np.average([nm for nm, _ in group], weights=share.sum(axis=1)))
        colour = float(np.interp(mean_nm, spectra.WAVELENGTH_NM, geometry.chromatic_blur_px(camera)))
        weight = share.sum(axis=0) / np.where(total > 0, total, 1.0)
        result.append(_Band(weight, mean_nm * 1e-9 * f_number / pitch_m, colour))
    return result, total


def _grid(
    weight: FloatArray, scale_px: float, blurs: FloatArray, cells: int, count: int, spacing_px: float, fine: int
) -> Grid:
    """Sampled pupil of one band of wavelengths.

    Args:
        weight: share of each channel's light, [channel].
        scale_px: lambda N / p of the open lens, in pixels.
        blurs: visible blur diameters, [blur], in pixels.
        cells: cells across the masks that will be placed in this pupil.
        count: samples across the patches.
        spacing_px: distance of the samples.
        fine: least number of cells of the sampled pupil across the lens.
    """
    first = 2 * scale_px / (count * spacing_px)  # shift of the lowest frequency, in radii
    step = max(1, int(np.ceil(fine * first / 2)))
    side = first / step
    across = 2 * int(np.ceil(1 / side)) if side < 1 else 2
    place = (np.arange(across) + 0.5 - across / 2) * side
    edges = (np.arange(across + 1) - across / 2) * side
    cell_edge = np.arange(cells + 1) * 2 / cells - 1
    low, high = np.maximum(edges[:-1, None], cell_edge[None, :-1]), np.minimum(edges[1:, None], cell_edge[None, 1:])
    average = np.clip(high - low, 0.0, None) / side
    defocus = np.exp(2j * np.pi * blurs[:, None] / (8 * scale_px) * place**2)
    fy, fx = cramer_rao.frequencies((count, count), spacing_px)
    cell_factor = np.sinc(blurs[:, None, None] * fy * side / 2) * np.sinc(blurs[:, None, None] * fx * side / 2)
    return Grid(
        weight,
        average,
        defocus[:, :, None] * defocus[:, None, :],
        cell_factor * np.sinc(fy) * np.sinc(fx),
        side,
        step,
        int(fft.next_fast_len(across + step * (count // 2), real=False)),
    )


def transfers(pupil: Pupil, amplitude: FloatArray, area: float | None = None) -> ComplexArray:
    """Transfer functions H of all channels through a pupil, [blur, channel, h, w/2 + 1].

    At frequency 0, which no bound uses, H is below 1 by the energy that averaging onto the grid removes.

    Args:
        pupil: the sampled pupil.
        amplitude: transmitted amplitude 0..1 of each cell of the mask, [y, x].
        area: open area in squared radii of the lens, by default the sum of the squared amplitudes times the area of a
            cell. It is needed for amplitudes averaged over a rim: a cell that is half open transmits half of the light,
            but its mean amplitude of 0.5 gives a quarter.
    """
    total: ComplexArray = np.zeros((), complex)
    for grid in pupil.grids:
        one = _transform(grid, pupil.shape, amplitude, area)[-1]
        total = total + grid.weight[:, None, None] * one[:, None]
    return total


def gradient(pupil: Pupil, amplitude: FloatArray, by_transfer: NDArray) -> FloatArray:
    """Gradient of a real function J of H by the amplitude, [y, x]: the adjoint of :func:`transfers`.

    Args:
        pupil: the sampled pupil.
        amplitude: transmitted amplitude 0..1 of each cell of the mask, [y, x].
        by_transfer: G with dJ = Re sum(conj(G) dH), [blur, channel, h, w/2 + 1].
    """
    total = np.zeros_like(amplitude)
    for grid in pupil.grids:
        averaged, field, energy, transfer = _transform(grid, pupil.shape, amplitude)
        by_one = (grid.weight[:, None, None] * by_transfer).sum(axis=1)
        by_energy = -float((np.conj(by_one) * transfer).real.sum()) / energy
        seed = np.conj(by_one) * grid.factor / energy
        seed[..., 1:] /= 2  # the inverse real transform adds the other half of the plane
        rows, columns = _shifts(grid, pupil.shape)
        spread = np.zeros((len(seed), grid.size, grid.size // 2 + 1), complex)
        spread[:, rows[:, None], columns[None, :]] = seed
        by_intensity = fft.irfft2(spread, (grid.size, grid.size), workers=2)
        count = len(averaged)
        by_field = fft.ifft2(2 * by_intensity * field, workers=2)[:, :count, :count] * grid.size**2
        by_averaged = (np.conj(grid.phase) * by_field).real.sum(axis=0)
        total += grid.average.T @ by_averaged @ grid.average + 2 * amplitude * by_energy * _ratio(grid, amplitude)
    return total


def _transform(
    grid: Grid, shape: tuple[int, int], amplitude: FloatArray, area: float | None = None
) -> tuple[FloatArray, ComplexArray, float, ComplexArray]:
    """Averaged amplitude, FFT of the pupil, energy, and H of one band, [blur, h, w/2 + 1]."""
    averaged = grid.average @ amplitude @ grid.average.T
    field = fft.fft2(averaged * grid.phase, (grid.size, grid.size), workers=2)
    energy = float((amplitude**2).sum()) * _ratio(grid, amplitude) if area is None else area / grid.side**2
    correlation = fft.rfft2(field.real**2 + field.imag**2, workers=2)
    rows, columns = _shifts(grid, shape)
    transfer = np.conj(correlation[:, rows[:, None], columns[None, :]]) / grid.size**2
    return averaged, field, energy, transfer * grid.factor / energy


def _ratio(grid: Grid, amplitude: FloatArray) -> float:
    """Area of a cell of the mask divided by that of a cell of the grid."""
    return (2 / len(amplitude) / grid.side) ** 2


def _shifts(grid: Grid, shape: tuple[int, int]) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Rows and columns of the FFT that hold the frequencies of a patch."""
    rows = np.rint(np.fft.fftfreq(shape[0]) * shape[0]).astype(int) * grid.step
    return rows % grid.size, np.arange(shape[1] // 2 + 1) * grid.step


# --- stops of a camera -------------------------------------------------------------------------


def stop_amplitude(stop: Stop, cells: int = RING_CELLS) -> FloatArray:
    """Transmitted amplitude 0..1 of a stop on a grid over the square around the lens, [y, x].

    A mask has the square root of its transmittance, on its own cells. A disc or ring has the open share of each of
    ``cells`` x ``cells``.
    """
    if isinstance(stop, stops.Mask):
        return np.asarray(np.sqrt(stop.mask))
    ring = stops.ring(stop)
    if ring is None:
        return stops.pupil(stop)[0]
    position = stops.cell_centres(cells * _SUBCELLS)
    radius = np.hypot(position[:, None] - ring.centre[1], position[None, :] - ring.centre[0])
    inside = ((radius < ring.outer) & (radius >= ring.inner)).astype(np.float64)
    return np.asarray(inside.reshape(cells, _SUBCELLS, cells, _SUBCELLS).mean(axis=(1, 3)))


def disc_transfers(
    camera: Camera, stop: stops.Disc, blur_px: FloatArray, light: str, shape: tuple[int, int], spacing_px: float
) -> tuple[NDArray, FloatArray]:
    """Transfer functions H through a disc anywhere in the lens, [blur, channel, h, w/2 + 1], and relative electrons.

    Hopkins's integral (Proc. R. Soc. A 231, 1955) is evaluated at radial frequencies, with a cubic spline between. For
    a disc centred at d, rho^2 = |r|^2 + 2 d . r + |d|^2 with r from its centre: the defocus is the same, and the tilt
    shifts the picture by c d / 2 at all wavelengths. The electrons are [channel].
    """
    bands, electrons = _bands(camera, stop, light)
    fy, fx = cramer_rao.frequencies(shape, spacing_px)
    frequency = np.hypot(fy, fx)
    nodes = cramer_rao.radial_frequencies(float(frequency.max()), float(np.abs(blur_px).max()), _RADIAL_FREQUENCIES)
    blurs = blur_px + np.array([[band.colour_px] for band in bands])  # [band, blur]
    radial = np.empty((*blurs.shape, len(nodes)))
    for number, band in enumerate(bands):
        scale_px = band.scale_px / stop.radius_ratio
        waves = stop.radius_ratio * blurs[number] / (8 * scale_px)
        t, node_weight = _nodes(max(_NODES, 16 * int(np.ceil(_NODES_PER_WAVE * np.abs(waves).max() / 16))))
        v = np.minimum(nodes * scale_px, 1.0)[:, None]
        x = (1 - v) * (1 - t**2)
        kernel = np.sqrt(np.maximum(1 - (x + v) ** 2, 0.0)) * (8 / np.pi * t * node_weight * (1 - v))
        radial[number] = (np.cos(8 * np.pi * waves[:, None, None] * (v * x)) * kernel).sum(axis=-1)
    full: NDArray = CubicSpline(nodes, radial, axis=-1)(frequency.ravel()).reshape(*blurs.shape, *frequency.shape)
    if not stops.is_plain_disc(stop):
        shift = fx * stop.centre_ratio[0] + fy * stop.centre_ratio[1]
        full = full * np.exp(1j * np.pi * blurs[..., None, None] * shift)
    weight = np.array([band.weight for band in bands])
    return np.einsum("kc,kbyx->bcyx", weight, full) * (np.sinc(fy) * np.sinc(fx)), electrons


@cache
def _nodes(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of Gauss-Legendre quadrature on 0..1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
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
    """Transfer functions H of all channels through all stops, and their relative electrons.

    Stops may have any shape. H is the mean of the stops' transfer functions weighted with their electrons.

    Args:
        camera: the camera.
        blur_px: visible blurs in px, [blur].
        light: name of the illuminant.
        shape: [n, n] of the patch.
        spacing_px: distance of the patch's samples.
        fine_cells: fewest cells of a sampled pupil across the lens.

    Returns:
        H, [blur, channel, h, w/2 + 1], and electrons, [channel].
    """
    parts: list[NDArray] = []
    electrons: list[FloatArray] = []
    for stop in camera.stops:
        if isinstance(stop, stops.Disc):
            part, signal = disc_transfers(camera, stop, blur_px, light, shape, spacing_px)
            parts.append(part)
        else:
            amplitude = stop_amplitude(stop)
            sampled = pupil(
                camera, stop, light, blur_px, len(amplitude), shape, spacing_px=spacing_px, fine_cells=fine_cells
            )
            parts.append(transfers(sampled, amplitude, stops.open_area(stop) * np.pi))
            signal = sampled.electrons * stops.open_area(stop)
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
    """H and dH/dc, [blur, channel, h, w/2 + 1], for stops of any shape.

    See :func:`dasim.bounds.cramer_rao.camera_transfers`. A sampled pupil has ``fine_cells`` across the lens at least.
    """
    blurs = np.atleast_1d(np.asarray(blur_px, np.float64))
    both = np.concatenate([blurs - cramer_rao.SLOPE_STEP_PX, blurs + cramer_rao.SLOPE_STEP_PX])
    full, _ = stop_transfers(camera, both, light, shape, spacing_px=spacing_px, fine_cells=fine_cells)
    below, above = np.split(full, 2, axis=0)
    return (below + above) / 2, (above - below) / (2 * cramer_rao.SLOPE_STEP_PX)
