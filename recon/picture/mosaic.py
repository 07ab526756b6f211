"""The mosaic (sec. 4.3): positions of the channels, linearisation, green replacement, demosaicing."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.base.threads import mapped
from dasim.camera import noise
from dasim.camera.crosstalk import corrected, electronic_crosstalk, noise_gains
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import BoolArray, Float32Array
from dasim.values import Capture
from recon import fourier
from recon.picture import menon

Phase = tuple[int, int]

MANY_SATURATED = 0.05  # share of the pixels
SATURATION_SHARE = 0.98  # of full scale, from which a pixel counts as saturated, with an allowance for noise
STRIP_PX = 256  # rows per strip of the demosaicing, even
EXCESS_PATCH, EXCESS_PERCENTILE = 16, 2.0
DIAGONAL = np.array([[1, 0, 1], [0, 0, 0], [1, 0, 1]], np.float32) / 4
CROSS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float32) / 4
FAR_CROSS = np.zeros((5, 5), np.float32)
FAR_CROSS[[0, 2, 2, 4], [2, 0, 4, 2]] = 1 / 4
WIDE = np.full((7, 7), 1 / 49, np.float32)
SMALLEST = np.float32(1e-6)

PERIOD_PX = 4
# Steps of the grids of each channel, pixels.
PAPER_BLOCK = {name: [2] for name in CHANNELS}
BAYER_BLOCK = {"R": [2], "G": [2, 2], "B": [2]}
SPARSE_BLOCK = {"R": [4, 4], "G": [2, 2], "B": [4, 4], "IR": [2]}


class Grid(NamedTuple):
    """The pixels (row + step i, column + step j). A channel has one such grid, or two in a quincunx."""

    row: int
    column: int
    step: int


def grids(camera: Camera) -> dict[str, tuple[Grid, ...]]:
    """The grids of each channel of the mosaic, in the order of ``camera.channels``; raises InputError for any other
    mosaic.

    Supported are the paper's 2x2 block (Fig. 2(b)), the Bayer block, and the 4x4 block of RGB-IR sensors (green at
    every second pixel, infrared at every fourth, red and blue alternating at the others), shifted or mirrored.
    """
    rows = camera.sensor.mosaic
    by_name: dict[str, list[Grid]] = {}
    if max(len(rows), len(rows[0])) <= PERIOD_PX and PERIOD_PX % len(rows) == 0 == PERIOD_PX % len(rows[0]):
        for y, x in itertools.product((0, 1), repeat=2):
            here = [[rows[(y + dy) % len(rows)][(x + dx) % len(rows[0])] for dx in (0, 2)] for dy in (0, 2)]
            if len({name for row in here for name in row}) == 1:
                by_name.setdefault(here[0][0], []).append(Grid(y, x, 2))
            elif here[0] == here[1][::-1]:
                for dx, name in zip((0, 2), here[0], strict=True):
                    by_name.setdefault(name, []).extend([Grid(y, x + dx, 4), Grid(y + 2, x + 2 - dx, 4)])
    shape = {name: sorted(grid.step for grid in channel) for name, channel in by_name.items()}
    if shape not in (PAPER_BLOCK, BAYER_BLOCK, SPARSE_BLOCK) or not _green_on_a_diagonal(by_name):
        raise InputError(
            f"camera '{camera.name}': the mosaic {[list(row) for row in rows]} cannot be reconstructed; supported are "
            'a 2x2 block of R, G, B, IR with G diagonal to IR, as [["G", "R"], ["B", "IR"]], a Bayer block, or the '
            "4x4 block of camera 'da-4x4'"
        )
    return {name: tuple(by_name[name]) for name in CHANNELS if name in by_name}


def _green_on_a_diagonal(by_name: dict[str, list[Grid]]) -> bool:
    """Whether green, or green and infrared, form a diagonal of each 2x2 block."""
    diagonal = [*by_name["G"], *by_name.get("IR", [])][:2]
    return sum(grid.row + grid.column for grid in diagonal) % 2 == 0 and diagonal[0].row != diagonal[1].row


def phases(camera: Camera) -> dict[str, Phase]:
    """Position (row, column) in the 2x2 block of each channel's half-resolution plane (:func:`planes`)."""
    return {name: (g[0].row % 2, g[0].column % 2) for name, g in grids(camera).items()}


def sole_phases(camera: Camera) -> list[Phase | None]:
    """Position (row, column) in the 2x2 block of each channel that has one pixel in each block; None for others."""
    return [(g[0].row, g[0].column) if len(g) == 1 and g[0].step == 2 else None for g in grids(camera).values()]


def linearise(capture: Capture) -> tuple[Float32Array, BoolArray]:
    """Photo-electrons of a raw picture, float32 [h, w], and the mask of its saturated pixels, [h, w].

    Electrons are (raw - black level) times electrons per digital number, minus the mean dark signal. They are corrected
    for the pixel crosstalk of the data sheet.
    """
    sensor = capture.camera.sensor
    raw = capture.raw_dn
    if raw.shape != (sensor.height_px, sensor.width_px):
        raise InputError(
            f"capture: the raw picture is {raw.shape[1]} x {raw.shape[0]} pixels, "
            f"its camera has {sensor.width_px} x {sensor.height_px}"
        )
    electrons = noise.collected_e(raw.astype(np.float32), sensor, capture.gain)
    electrons -= noise.dark_e(sensor, capture.exposure_s)
    full_dn = noise.saturation_e(sensor, capture.gain) / noise.electrons_per_dn(sensor, capture.gain)
    electrons = np.asarray(corrected(electrons, capture.camera), np.float32)
    return electrons, raw >= sensor.black_level_dn + SATURATION_SHARE * full_dn


def saturation_notes(saturated: BoolArray) -> tuple[str, ...]:
    """A note if more than ``MANY_SATURATED`` of the pixels of a mask [h, w] are saturated."""
    share = float(saturated.mean())
    if share <= MANY_SATURATED:
        return ()
    return (f"{share:.0%} of the pixels are saturated and tell neither depth nor colour; use a shorter exposure",)


def planes(mosaic: NDArray, camera: Camera) -> dict[str, NDArray]:
    """A colour plane of half resolution for each channel, [h/2, w/2], with its pixels at :func:`phases`.

    Of two greens, the plane is the first. Red and blue of the 4x4 block provide every second sample of their plane;
    each sample between them is the mean of its four neighbours.
    """
    result = {}
    for name, channel_grids in grids(camera).items():
        y, x = phases(camera)[name]
        plane = mosaic[y::2, x::2]
        if channel_grids[0].step == PERIOD_PX:
            plane = _filled(plane.astype(np.float32), sites(channel_grids, mosaic.shape)[y::2, x::2])
        result[name] = plane
    return result


def saturated_blocks(saturated: NDArray) -> NDArray:
    """Mask [h/2, w/2] of the 2x2 blocks that contain a saturated pixel, from the mask of pixels [h, w]."""
    return saturated[::2, ::2] | saturated[1::2, ::2] | saturated[::2, 1::2] | saturated[1::2, 1::2]


def sites(channel_grids: tuple[Grid, ...], shape: tuple[int, ...]) -> BoolArray:
    """Mask of the pixels of a channel's grids, [h, w]."""
    mask = np.zeros(shape[:2], bool)
    for row, column, step in channel_grids:
        mask[row::step, column::step] = True
    return mask


def _filled(plane: NDArray, known: BoolArray) -> Float32Array:
    """A plane [h, w] with each unknown sample replaced by the mean of its known neighbours in row and column."""
    return np.where(known, plane, _mean_of_known(plane, known, CROSS))


def _mean_of_known(image: NDArray, known: BoolArray, kernel: NDArray) -> Float32Array:
    """Mean of the known pixels under a kernel, [h, w]; mirrored at the borders, which preserves the grid.

    Without a known pixel under the kernel, as in a corner of the frame, it is the mean over a wider square.
    """
    share = known.astype(np.float32)

    def mean(weights: NDArray) -> tuple[NDArray, NDArray]:
        total, weight = (
            cv2.filter2D(a, -1, weights, borderType=cv2.BORDER_REFLECT_101) for a in (image * share, share)
        )
        return total / np.maximum(weight, SMALLEST), weight

    near, weight = mean(kernel)
    return near if weight.min() > SMALLEST else np.where(weight > SMALLEST, near, mean(WIDE)[0])


def collected(electrons: Float32Array, camera: Camera) -> Float32Array:
    """Electrons that the pixels collected, [h, w], from those of :func:`linearise`: pixel crosstalk is added again.

    The noise model of the data sheet applies to these electrons.
    """
    return np.asarray(electronic_crosstalk(electrons.astype(np.float64), camera), np.float32)


def noise_variance(capture: Capture, channel: str) -> noise.Variance:
    """Noise variance of a channel's pixels in :func:`linearise` by the data sheet, as a function of the mean electrons
    that they :func:`collected`.
    """
    camera = capture.camera
    gain = float(noise_gains(camera)[channels(camera.sensor).index(channel)])
    return noise.Variance(*(gain * term for term in noise.variance(camera.sensor, capture.exposure_s, capture.gain)))


def noise_excess(plane: Float32Array, variance: Float32Array) -> float:
    """Factor of at least 1 by which the noise variance of a colour plane exceeds that of the data sheet.

    It follows from the mean square over patches of the mixed second difference (x00 - x01 - x10 + x11) / 2, which has
    the variance of the noise and is insensitive to slopes. The lowest 2 % of the patches show noise without texture.
    ``variance`` is that of the data sheet, [h, w].
    """
    mixed = (plane[:-1, :-1] - plane[:-1, 1:] - plane[1:, :-1] + plane[1:, 1:]) / 2
    size = (max(plane.shape[1] // EXCESS_PATCH, 1), max(plane.shape[0] // EXCESS_PATCH, 1))
    ratio = cv2.resize(mixed**2 / variance[:-1, :-1], size, interpolation=cv2.INTER_AREA)
    return max(1.0, float(np.percentile(ratio, EXCESS_PERCENTILE)))


def to_bayer(mosaic: Float32Array, infrared: Float32Array | None, camera: Camera, white: NDArray) -> Float32Array:
    """The Bayer mosaic for :func:`demosaic`, [h, w], from any supported mosaic (sec. 4.3).

    ``infrared`` is the interpolated image [h, w], ``white`` the electrons of a white point, [channel].
    """
    channel_grids = grids(camera)
    if infrared is None or "IR" not in channel_grids:
        return mosaic
    if len(channel_grids["G"]) == 1:
        return replace_green(mosaic, infrared, camera)
    return replace_sparse(mosaic, camera, white)


def replace_green(mosaic: Float32Array, infrared: Float32Array, camera: Camera) -> Float32Array:
    """The Bayer mosaic [h, w] in which every infrared pixel is replaced by green, G2 = IR + K, eq. (6).

    K is the mean of G - IR over the four diagonal green pixels; ``infrared`` is the interpolated image [h, w].
    """
    y, x = phases(camera)["IR"]
    difference = cv2.filter2D(mosaic - infrared, -1, DIAGONAL, borderType=cv2.BORDER_REFLECT_101)
    bayer = mosaic.copy()
    bayer[y::2, x::2] += difference[y::2, x::2]
    return np.maximum(bayer, 0, out=bayer)


def replace_sparse(mosaic: Float32Array, camera: Camera, white: NDArray) -> Float32Array:
    """The Bayer mosaic [h, w] of the 4x4 block: infrared pixels become red, and red pixels blue, as in eq. (6).

    Deviation: the paper has no such mosaic. Its green pixels are those of a Bayer mosaic, so the differences R - G and
    B - G are interpolated instead of G - IR, after balancing to ``white`` [channel]: R - G from the two red pixels
    diagonal to an infrared one, B - G from the four blue pixels two pixels from a red one.
    """
    channel_grids = grids(camera)
    red, green, blue, infrared = (sites(channel_grids[name], mosaic.shape) for name in CHANNELS)
    gain = (white[:3] / white[1]).astype(np.float32)
    balanced = mosaic / (gain[0] * red + gain[1] * (green | infrared) + gain[2] * blue)
    full = _green(balanced, green)
    differences = np.asarray(balanced - full, np.float32)
    bayer = balanced.copy()
    bayer[infrared] = (full + _mean_of_known(differences, red, DIAGONAL))[infrared]
    bayer[red] = (full + _mean_of_known(differences, blue, FAR_CROSS))[red]
    y, x = phases(camera)["IR"]
    bayer[y::2, x::2] *= gain[0]
    y, x = phases(camera)["B"]
    bayer[y::2, x::2] *= gain[2]
    return np.maximum(bayer, 0, out=bayer)


def _green(mosaic: NDArray, green: BoolArray) -> Float32Array:
    """Green at every pixel [h, w] from its quincunx, weighted towards row or column by the smaller gradient."""
    wide = np.pad(mosaic, 1, mode="reflect")
    up, down, left, right = wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]
    around = np.full((3, 3), 1 / 9, np.float32)
    steep_y, steep_x = (_mean_of_known(np.abs(a - b), ~green, around) for a, b in ((up, down), (left, right)))
    share = (steep_y + SMALLEST) / (steep_x + steep_y + 2 * SMALLEST)
    between = share * (left + right) / 2 + (1 - share) * (up + down) / 2
    return np.asarray(np.where(green, mosaic, between), np.float32)


def demosaic(bayer: Float32Array, camera: Camera, signature: NDArray) -> Float32Array:
    """Full-resolution colours [h, w, 3] from the Bayer mosaic of :func:`to_bayer`.

    The method is that of Menon et al. 2007 (:mod:`recon.picture.menon`); the paper leaves this block to the camera. The
    method assumes smooth colour differences, so ``signature`` [channel], the electrons of a white point, balances the
    mosaic before it and is reapplied after it.
    """
    letters = bayer_letters(camera)
    white = (signature[:3] / signature[1]).astype(np.float32)
    red = next(place for place, letter in letters.items() if letter == "R")
    image = np.empty((*bayer.shape, 3), np.float32)
    border = menon.REACH_PX
    padded = np.pad(bayer, border, mode="reflect")

    def strip(top: int) -> None:
        part = padded[top : min(top + STRIP_PX, len(bayer)) + 2 * border].copy()
        for (y, x), letter in letters.items():
            part[y::2, x::2] /= white["RGB".index(letter)]
        colours = menon.demosaic(part, red)[border:-border, border:-border]
        np.multiply(colours, white, out=image[top : top + STRIP_PX])

    # in strips: what lies between needs memory, and the compiled functions use one core
    list(mapped(strip, range(0, bayer.shape[0], STRIP_PX), fourier.THREADS))
    return image


def bayer_letters(camera: Camera) -> dict[Phase, str]:
    """Colour at each position (row, column) of the 2x2 block of :func:`to_bayer`."""
    channel_grids = grids(camera)
    letters = {(g.row, g.column): name for name, channel in channel_grids.items() for g in channel if g.step == 2}
    if len(channel_grids["G"]) == 1:
        return letters | {phases(camera)["IR"]: "G"}
    return letters if "IR" not in channel_grids else letters | {phases(camera)["IR"]: "R", phases(camera)["B"]: "B"}
