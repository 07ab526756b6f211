"""The mosaic (sec. 4.3): where its channels lie, raw numbers to electrons, green replacement, demosaicing."""

from __future__ import annotations

import itertools
import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import BoolArray, Float32Array
from dasim.values import Capture

Phase = tuple[int, int]

SATURATION_SHARE = 0.98  # of full scale above black: noise and rounding can lower a full pixel by that much
STRIP_PX = 256  # even, rows that are demosaiced at a time
BORDER_PX = 8  # even, so that mirroring keeps the mosaic's phase; more than the demosaic's filters reach
EXCESS_PATCH, EXCESS_PERCENTILE = 16, 2.0
DIAGONAL = np.array([[1, 0, 1], [0, 0, 0], [1, 0, 1]], np.float32) / 4
CROSS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.float32) / 4
FAR_CROSS = np.zeros((5, 5), np.float32)
FAR_CROSS[[0, 2, 2, 4], [2, 0, 4, 2]] = 1 / 4
WIDE = np.full((7, 7), 1 / 49, np.float32)
SMALLEST = np.float32(1e-6)

PERIOD_PX = 4
# Steps of the grids of each channel.
PAPER_BLOCK = {name: [2] for name in CHANNELS}
BAYER_BLOCK = {"R": [2], "G": [2, 2], "B": [2]}
SPARSE_BLOCK = {"R": [4, 4], "G": [2, 2], "B": [4, 4], "IR": [2]}


class Grid(NamedTuple):
    """Pixels (row + step i, column + step j) of the frame: a channel is one such grid, or two in a quincunx."""

    row: int
    column: int
    step: int


def grids(camera: Camera) -> dict[str, tuple[Grid, ...]]:
    """The grids of each channel of the mosaic, in the order of ``camera.channels``; InputError for any other mosaic.

    Known are the paper's 2x2 block (Fig. 2(b)), Bayer's, and the 4x4 block of RGB-IR sensors: green on every
    second pixel, infrared on every fourth, red and blue in turns on the rest; each shifted or mirrored.
    """
    rows = camera.sensor.mosaic
    place: dict[str, list[Grid]] = {}
    if max(len(rows), len(rows[0])) <= PERIOD_PX and PERIOD_PX % len(rows) == 0 == PERIOD_PX % len(rows[0]):
        for y, x in itertools.product((0, 1), repeat=2):
            here = [[rows[(y + dy) % len(rows)][(x + dx) % len(rows[0])] for dx in (0, 2)] for dy in (0, 2)]
            if len({name for row in here for name in row}) == 1:
                place.setdefault(here[0][0], []).append(Grid(y, x, 2))
            elif here[0] == here[1][::-1]:
                for dx, name in zip((0, 2), here[0], strict=True):
                    place.setdefault(name, []).extend([Grid(y, x + dx, 4), Grid(y + 2, x + 2 - dx, 4)])
    shape = {name: sorted(grid.step for grid in found) for name, found in place.items()}
    if shape not in (PAPER_BLOCK, BAYER_BLOCK, SPARSE_BLOCK) or not _green_on_a_diagonal(place):
        raise InputError(
            f"camera '{camera.name}': the mosaic {[list(row) for row in rows]} cannot be reconstructed; needed is "
            'a 2x2 block of R, G, B, IR with G diagonal to IR, as [["G", "R"], ["B", "IR"]], a Bayer block, or the '
            "4x4 block of camera 'da-4x4'"
        )
    return {name: tuple(place[name]) for name in CHANNELS if name in place}


def _green_on_a_diagonal(place: dict[str, list[Grid]]) -> bool:
    """Whether green has a diagonal of each 2x2 block, alone or with infrared in the place of one green."""
    diagonal = [*place["G"], *place.get("IR", [])][:2]
    return sum(grid.row + grid.column for grid in diagonal) % 2 == 0 and diagonal[0].row != diagonal[1].row


def phases(camera: Camera) -> dict[str, Phase]:
    """Position (row, column) in the 2x2 block of each channel's half-resolution plane (:func:`planes`)."""
    return {name: (found[0].row % 2, found[0].column % 2) for name, found in grids(camera).items()}


def sole_phases(camera: Camera) -> list[Phase | None]:
    """Position (row, column) in the 2x2 block of each channel that has one pixel in each block; None for others."""
    return [(g[0].row, g[0].column) if len(g) == 1 and g[0].step == 2 else None for g in grids(camera).values()]


def linearise(capture: Capture) -> tuple[Float32Array, BoolArray]:
    """Photo-electrons of a raw picture, float32 [h, w], and its saturated pixels.

    (raw - black level) times the electrons per digital number, less the mean dark signal.
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
    return electrons, raw >= sensor.black_level_dn + SATURATION_SHARE * full_dn


def planes(mosaic: NDArray, camera: Camera) -> dict[str, NDArray]:
    """A colour plane of half resolution for each channel, [h/2, w/2], its pixels at :func:`phases`.

    Of two greens it is the first. Red and blue of the 4x4 block have every second sample of it; each sample between
    them is the mean of its four neighbours.
    """
    found = {}
    for name, own in grids(camera).items():
        y, x = phases(camera)[name]
        plane = mosaic[y::2, x::2]
        if own[0].step == PERIOD_PX:
            plane = _filled(plane.astype(np.float32), sites(own, mosaic.shape)[y::2, x::2])
        found[name] = plane
    return found


def saturated_blocks(saturated: NDArray) -> NDArray:
    """Mask [h/2, w/2] of the 2x2 blocks that contain a saturated pixel, from the mask of pixels [h, w]."""
    return saturated[::2, ::2] | saturated[1::2, ::2] | saturated[::2, 1::2] | saturated[1::2, 1::2]


def sites(own: tuple[Grid, ...], shape: tuple[int, ...]) -> BoolArray:
    """The pixels of a channel's grids, bool [h, w]."""
    mask = np.zeros(shape[:2], bool)
    for row, column, step in own:
        mask[row::step, column::step] = True
    return mask


def _filled(plane: NDArray, known: BoolArray) -> Float32Array:
    """A plane whose unknown samples are the mean of their known neighbours in row and column."""
    return np.where(known, plane, _mean_of_known(plane, known, CROSS))


def _mean_of_known(image: NDArray, known: BoolArray, kernel: NDArray) -> Float32Array:
    """Mean of the known pixels under a kernel; mirrored at the borders, which keeps the grid.

    Where no known pixel lies under the kernel, as in a corner of the frame, the mean of a wider square is used.
    """
    share = known.astype(np.float32)

    def mean(weights: NDArray) -> tuple[NDArray, NDArray]:
        total, weight = (
            cv2.filter2D(a, -1, weights, borderType=cv2.BORDER_REFLECT_101) for a in (image * share, share)
        )
        return total / np.maximum(weight, SMALLEST), weight

    near, weight = mean(kernel)
    return near if weight.min() > SMALLEST else np.where(weight > SMALLEST, near, mean(WIDE)[0])


def noise_variance(capture: Capture) -> noise.Variance:
    """Variance of a capture's pixels by the sensor's data sheet, as a function of their mean electrons."""
    return noise.variance(capture.camera.sensor, capture.exposure_s, capture.gain)


def noise_excess(plane: Float32Array, variance: Float32Array) -> float:
    """Factor of at least 1 by which a colour plane's noise exceeds the variance of the data sheet.

    Mean square of the mixed second difference (x00 - x01 - x10 + x11) / 2, which has the noise's own variance and
    sees no slopes, over patches; the quietest 2 % of them show noise, not texture.
    """
    mixed = (plane[:-1, :-1] - plane[:-1, 1:] - plane[1:, :-1] + plane[1:, 1:]) / 2
    size = (max(plane.shape[1] // EXCESS_PATCH, 1), max(plane.shape[0] // EXCESS_PATCH, 1))
    ratio = cv2.resize(mixed**2 / variance[:-1, :-1], size, interpolation=cv2.INTER_AREA)
    return max(1.0, float(np.percentile(ratio, EXCESS_PERCENTILE)))


def to_bayer(mosaic: Float32Array, infrared: Float32Array | None, camera: Camera, white: NDArray) -> Float32Array:
    """A Bayer mosaic [h, w], the one that :func:`demosaic` takes: sec. 4.3 for each kind of mosaic.

    ``infrared`` is the interpolated image [h, w], ``white`` the electrons of a white point in the channels' order.
    """
    own = grids(camera)
    if infrared is None or "IR" not in own:
        return mosaic
    if len(own["G"]) == 1:
        return replace_green(mosaic, infrared, camera)
    return replace_sparse(mosaic, camera, white)


def replace_green(mosaic: Float32Array, infrared: Float32Array, camera: Camera) -> Float32Array:
    """A Bayer mosaic [h, w]: every infrared pixel becomes green, G2 = IR + K, eq. (6).

    K is the mean over the four diagonal green pixels of G - IR, ``infrared`` the interpolated image [h, w].
    """
    y, x = phases(camera)["IR"]
    difference = cv2.filter2D(mosaic - infrared, -1, DIAGONAL, borderType=cv2.BORDER_REFLECT_101)
    bayer = mosaic.copy()
    bayer[y::2, x::2] += difference[y::2, x::2]
    return np.maximum(bayer, 0, out=bayer)


def replace_sparse(mosaic: Float32Array, camera: Camera, white: NDArray) -> Float32Array:
    """A Bayer mosaic [h, w] of the 4x4 block: infrared pixels become red, red ones blue, in the manner of eq. (6).

    Deviation: the paper has no such mosaic. Its green lies as Bayer's already, so green, not infrared, is the image
    whose differences K = R - G and B - G to a ``white`` of grey are interpolated: from the two red pixels diagonal
    to an infrared one, from the four blue ones two pixels off a red one.
    """
    own = grids(camera)
    red, green, blue, infrared = (sites(own[name], mosaic.shape) for name in CHANNELS)
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
    """Green at every pixel [h, w] from its quincunx: along the row or the column, whichever changes less."""
    wide = np.pad(mosaic, 1, mode="reflect")
    up, down, left, right = wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:]
    around = np.full((3, 3), 1 / 9, np.float32)
    steep_y, steep_x = (_mean_of_known(np.abs(a - b), ~green, around) for a, b in ((up, down), (left, right)))
    share = (steep_y + SMALLEST) / (steep_x + steep_y + 2 * SMALLEST)
    between = share * (left + right) / 2 + (1 - share) * (up + down) / 2
    return np.asarray(np.where(green, mosaic, between), np.float32)


def demosaic(bayer: Float32Array, camera: Camera, signature: NDArray) -> Float32Array:
    """Full-resolution [h, w, 3] from the Bayer mosaic of :func:`to_bayer`.

    Menon et al. 2007 (directional filtering, a posteriori decision), from colour-demosaicing: the paper keeps
    this block as the camera has it. ``signature`` [channel], the electrons of a white point, balances the
    mosaic beforehand, because the method assumes that colour differences are smooth; undone afterwards.
    """
    with warnings.catch_warnings():  # the library imports from a deprecated scipy namespace
        warnings.simplefilter("ignore", DeprecationWarning)
        from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007

    letters = bayer_letters(camera)
    white = signature[:3] / signature[1]
    balanced = bayer.astype(np.float64)
    for (y, x), letter in letters.items():
        balanced[y::2, x::2] /= white["RGB".index(letter)]
    padded = np.pad(balanced, BORDER_PX, mode="reflect")
    pattern = "".join(letters[y, x] for y in (0, 1) for x in (0, 1))
    image = np.empty((*bayer.shape, 3), np.float32)

    def strip(top: int) -> None:
        rows = slice(top, min(top + STRIP_PX, bayer.shape[0]))
        own = padded[rows.start : rows.stop + 2 * BORDER_PX]
        colours = demosaicing_CFA_Bayer_Menon2007(own, pattern)[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
        image[rows] = colours * white

    # in strips: a whole frame of 50 Mpx would take 10 GB, and the library works on one core
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(strip, range(0, bayer.shape[0], STRIP_PX)))
    return image


def bayer_letters(camera: Camera) -> dict[Phase, str]:
    """Colour at each place of the 2x2 block of :func:`to_bayer`."""
    own = grids(camera)
    letters = {(grid.row, grid.column): name for name, found in own.items() for grid in found if grid.step == 2}
    if len(own["G"]) == 1:
        return letters | {phases(camera)["IR"]: "G"}
    return letters if "IR" not in own else letters | {phases(camera)["IR"]: "R", phases(camera)["B"]: "B"}
