"""The mosaic (sec. 4.3): raw numbers to electrons, green replacement, and the unchanged demosaic block."""

from __future__ import annotations

import warnings

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera import Camera
from dasim.errors import InputError
from dasim.sensor import electrons_per_dn
from dasim.spectra import CHANNELS
from dasim.values import Capture

Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
Phase = tuple[int, int]

SATURATION_SHARE = 0.98  # of full scale above black: noise and rounding can lower a full pixel by that much
BORDER_PX = 8  # even, so that mirroring keeps the mosaic's phase; more than the demosaic's filters reach
EXCESS_PATCH, EXCESS_PERCENTILE = 16, 10.0
DIAGONAL = np.array([[1, 0, 1], [0, 0, 0], [1, 0, 1]], np.float32) / 4


def phases(camera: Camera) -> dict[str, Phase]:
    """Position (row, column) of each channel in the 2x2 block; InputError for any other mosaic.

    The pipeline needs one R, G, B and IR pixel each, green on the diagonal of infrared (Fig. 2(b)).
    """
    rows = camera.sensor.mosaic
    place = {name: (y, x) for y, row in enumerate(rows) for x, name in enumerate(row)}
    fits = len(rows) == 2 and len(rows[0]) == 2 and set(place) == set(CHANNELS)
    if not fits or abs(place["G"][0] - place["IR"][0]) + abs(place["G"][1] - place["IR"][1]) != 2:
        raise InputError(
            f"camera '{camera.name}': the mosaic {[list(row) for row in rows]} cannot be reconstructed; "
            'a 2x2 block of R, G, B, IR with G diagonal to IR is needed, as [["G", "R"], ["B", "IR"]]'
        )
    return place


def linearise(capture: Capture) -> tuple[Float32Array, BoolArray]:
    """Photo-electrons of a raw picture, float32 [h, w], and its saturated pixels.

    (raw - black level) times the electrons of a digital number, the mean dark signal taken away.
    """
    sensor = capture.camera.sensor
    raw = capture.raw_dn
    if raw.shape != (sensor.height_px, sensor.width_px):
        raise InputError(
            f"capture: the raw picture is {raw.shape[1]} x {raw.shape[0]} pixels, "
            f"its camera has {sensor.width_px} x {sensor.height_px}"
        )
    heat = 2.0 ** ((sensor.temperature_c - 25.0) / sensor.dark_doubling_k)
    dark_e = sensor.dark_current_e_s * heat * capture.exposure_s
    scale = electrons_per_dn(sensor, capture.gain)
    electrons = (raw.astype(np.float32) - sensor.black_level_dn) * scale - dark_e
    full = min(2**sensor.adc_bits - 1 - sensor.black_level_dn, sensor.full_well_e / scale)
    top = sensor.black_level_dn + SATURATION_SHARE * full
    return electrons.astype(np.float32), raw >= top


def planes(mosaic: NDArray, camera: Camera) -> dict[str, NDArray]:
    """The colour planes at half resolution, a view [h/2, w/2] for each channel."""
    return {name: mosaic[y::2, x::2] for name, (y, x) in phases(camera).items()}


def noise_variance(electrons: NDArray, capture: Capture) -> NDArray:
    """Variance in electrons^2 of a pixel whose mean is ``electrons``: shot, dark, read, DSNU, PRNU, rounding."""
    floor, shot, relative = noise_coefficients(capture)
    mean = np.maximum(electrons, 0)
    return floor + shot * mean + relative * mean**2


def noise_coefficients(capture: Capture) -> tuple[float, float, float]:
    """The noise variance a + b x + c x^2 of the sensor's data sheet, (a, b, c), for x electrons."""
    sensor = capture.camera.sensor
    heat = 2.0 ** ((sensor.temperature_c - 25.0) / sensor.dark_doubling_k)
    dark_e = sensor.dark_current_e_s * heat * capture.exposure_s
    rounding = electrons_per_dn(sensor, capture.gain) ** 2 / 12
    return sensor.read_noise_e**2 + sensor.dsnu_e**2 + dark_e + rounding, 1.0, sensor.prnu**2


def noise_excess(plane: Float32Array, variance: Float32Array) -> float:
    """Factor of at least 1 by which a colour plane's noise exceeds the variance that the data sheet tells.

    Mean square of the mixed second difference (x00 - x01 - x10 + x11) / 2, which has the noise's own variance and
    sees no slopes, over patches; the quietest tenth of them shows the noise, not texture.
    """
    mixed = (plane[:-1, :-1] - plane[:-1, 1:] - plane[1:, :-1] + plane[1:, 1:]) / 2
    size = (max(plane.shape[1] // EXCESS_PATCH, 1), max(plane.shape[0] // EXCESS_PATCH, 1))
    ratio = cv2.resize(mixed**2 / variance[:-1, :-1], size, interpolation=cv2.INTER_AREA)
    return max(1.0, float(np.percentile(ratio, EXCESS_PERCENTILE)))


def replace_green(mosaic: Float32Array, infrared: Float32Array, camera: Camera) -> Float32Array:
    """A Bayer mosaic [h, w]: every infrared pixel becomes green, G2 = IR + K, eq. (6).

    K is the mean over the four diagonal green pixels of G - IR, ``infrared`` the interpolated image [h, w].
    """
    y, x = phases(camera)["IR"]
    difference = cv2.filter2D(mosaic - infrared, -1, DIAGONAL, borderType=cv2.BORDER_REFLECT_101)
    bayer = mosaic.copy()
    bayer[y::2, x::2] += difference[y::2, x::2]
    return np.maximum(bayer, 0, out=bayer)


def demosaic(bayer: Float32Array, camera: Camera, signature: NDArray) -> Float32Array:
    """Full-resolution [h, w, 3] from a Bayer mosaic whose infrared pixels are green by now.

    Menon et al. 2007 (directional filtering, a posteriori decision), from colour-demosaicing: the paper keeps
    this block as the camera has it. ``signature`` [channel], the electrons of a white point, balances the
    mosaic beforehand, because the method assumes that colour differences are smooth; undone afterwards.
    """
    with warnings.catch_warnings():  # the library imports from a deprecated scipy namespace
        warnings.simplefilter("ignore", DeprecationWarning)
        from colour_demosaicing import demosaicing_CFA_Bayer_Menon2007

    place = phases(camera)
    letters = {position: ("G" if name == "IR" else name) for name, position in place.items()}
    pattern = "".join(letters[y, x] for y in (0, 1) for x in (0, 1))
    white = signature[:3] / signature[1]
    balanced = bayer.astype(np.float64)
    for (y, x), letter in letters.items():
        balanced[y::2, x::2] /= white["RGB".index(letter)]
    padded = np.pad(balanced, BORDER_PX, mode="reflect")
    image = demosaicing_CFA_Bayer_Menon2007(padded, pattern) * white
    inner = slice(BORDER_PX, -BORDER_PX)
    return np.ascontiguousarray(image[inner, inner], np.float32)
