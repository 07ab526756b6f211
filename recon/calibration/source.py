"""Detection of a point source in a raw picture: position, saturation and signal-to-noise ratio.

Tested in tests/recon/files/test_point_pictures.py.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera, mosaic_channels
from dasim.typing import FloatArray
from dasim.values import Capture, PointPicture
from recon.calibration.pictures import RIM_PX, SATURATION_SHARE

LEAST_SNR = 20.0  # electrons of the source in a channel over their noise
LEAST_CONTRAST = 10.0  # mean of a window about the source over the noise of such means elsewhere
SATURATED_SHARE = 0.97  # share of saturation from which a pixel is saturated; automatic exposures reach 85 %
HOT_RATIO = 20.0  # ratio of a hot pixel to the brightest of its eight neighbours; no lens images such a point
MARGIN_PX = 18  # around the widest blur, for its diffraction tail and the background
SEARCH_STEPS = 5
MANY_WINDOWS = 16  # windows per frame from which the spread of their means is measured


def window_half_px(blur_px: float) -> int:
    """Half the side in pixels of the window for a visible blur, its tail and background."""
    return int(np.ceil(blur_px / 2)) + MARGIN_PX


def check(capture: Capture, camera: Camera, blur_px: float, *, shortest: bool) -> None:
    """Raise InputError if a picture has no source, or one that is cut off or, in the shortest exposure, saturated.

    ``blur_px`` is the diameter of the visible blur; ``shortest`` tells whether the exposure is the shortest one.
    """
    electrons, sigma_e = _electrons(capture)
    centre, ratio = _locate(electrons, sigma_e, camera, blur_px)
    if ratio < LEAST_CONTRAST:
        raise InputError(
            f"shows no point source (the brightest spot exceeds its surroundings by {max(ratio, 0):.2g} standard "
            f"deviations, {LEAST_CONTRAST:g} are needed)"
        )
    room = min(*centre, *(np.array(electrons.shape) - 1 - centre))
    needed = blur_px / 2 + RIM_PX
    if room < needed:
        raise InputError(
            f"the source at row {centre[0]:.0f}, column {centre[1]:.0f} is cut off at the edge: its blur needs "
            f"{needed:.0f} pixels on each side, the frame has {max(room, 0):.0f}"
        )
    if shortest:
        raw = without_hot_pixels(capture)
        sensor = camera.sensor
        full_dn = noise.saturation_e(sensor, capture.gain) / noise.electrons_per_dn(sensor, capture.gain)
        count = int(np.count_nonzero(raw >= sensor.black_level_dn + SATURATED_SHARE * full_dn))
        if count:
            raise InputError(
                f"{count} pixel{'s are' if count > 1 else ' is'} saturated in the shortest exposure of this "
                f"position ({capture.exposure_s:g} s); add a shorter one"
            )


def window(captures: Sequence[Capture], camera: Camera, blur_px: float, half_px: int) -> tuple[slice, slice]:
    """The window about the source in pictures of one position, aligned to the period of the mosaic."""
    least = min(capture.exposure_s * capture.gain for capture in captures)
    shortest = [_electrons(c) for c in captures if c.exposure_s * c.gain <= least]
    electrons = np.mean([part[0] for part in shortest], axis=0)
    centre, _ = _locate(electrons, np.mean([part[1] for part in shortest], axis=0), camera, blur_px)
    spans = []
    for middle, size, period in zip(centre, electrons.shape, _period(camera), strict=True):
        side = min(-(-2 * half_px // period) * period, size // period * period)
        start = int(np.clip(round(middle - side / 2), 0, size - side)) // period * period
        spans.append(slice(start, start + side))
    return spans[0], spans[1]


def without_hot_pixels(capture: Capture) -> NDArray[np.uint16]:
    """The raw picture with hot pixels replaced by the median of their neighbours of the same colour, [h, w]."""
    electrons, sigma_e = _electrons(capture)
    hot = _hot(electrons, sigma_e)
    if not hot.any():
        return capture.raw_dn
    rows, columns = _period(capture.camera)
    ring = np.zeros((2 * rows + 1, 2 * columns + 1), bool)
    ring[::rows, ::columns] = True
    ring[rows, columns] = False
    return np.where(hot, ndimage.median_filter(capture.raw_dn, footprint=ring, mode="mirror"), capture.raw_dn)


def signal_to_noise(pictures: Sequence[PointPicture], camera: Camera, blur_px: float) -> tuple[float, str]:
    """Lowest signal-to-noise ratio of the source among the channels, and the name of that channel."""
    sensor = camera.sensor
    names = channels(sensor)
    square = np.zeros(len(names))
    for picture in pictures:
        frames, height, width = picture.frames_dn.shape
        local = camera.model_copy(update={"sensor": sensor.model_copy(update={"height_px": height, "width_px": width})})
        channel = mosaic_channels(local)
        temporal = noise.temporal_variance(sensor, picture.exposure_s, picture.gain)
        fixed = noise.fixed_variance(sensor, picture.exposure_s)
        full_e = noise.collected_e(picture.frames_dn.mean(axis=0), sensor, picture.gain)
        mean_e = full_e - noise.dark_e(sensor, picture.exposure_s)
        y, x = np.indices(mean_e.shape)
        near = np.hypot(y - (height - 1) / 2, x - (width - 1) / 2) < blur_px / 2 + 2 * RIM_PX
        near &= full_e < SATURATION_SHARE * noise.saturation_e(sensor, picture.gain)
        for index in range(len(names)):
            pixels = channel == index
            used = near & pixels
            signal = np.sum(mean_e[used] - np.median(mean_e[pixels]))
            variance = np.sum(temporal.at(mean_e[used]) / frames + fixed.at(mean_e[used]))
            if signal > 0 and variance > 0:
                square[index] += signal**2 / variance
    lowest = int(square.argmin())
    return float(np.sqrt(square[lowest])), names[lowest]


def _period(camera: Camera) -> tuple[int, int]:
    """Period of the mosaic in rows and columns."""
    return len(camera.sensor.mosaic), len(camera.sensor.mosaic[0])


def _electrons(capture: Capture) -> tuple[FloatArray, FloatArray]:
    """Electrons above the background, and the standard deviation of the background, both [h, w].

    The background is the median over the frame's border, for each position in the mosaic. The whole frame would not
    do: a long exposure may saturate most of a frame that is little larger than the blur.
    """
    sensor = capture.camera.sensor
    variance = noise.variance(sensor, capture.exposure_s, capture.gain)
    electrons = noise.collected_e(capture.raw_dn.astype(np.float64), sensor, capture.gain)
    electrons -= noise.dark_e(sensor, capture.exposure_s)
    sigma_e = np.empty_like(electrons)
    rows, columns = _period(capture.camera)
    border = np.ones(electrons.shape, bool)
    border[rows:-rows, columns:-columns] = False
    for row in range(rows):
        for column in range(columns):
            part = (slice(row, None, rows), slice(column, None, columns))
            background = np.median(electrons[part][border[part]])
            electrons[part] -= background
            sigma_e[part] = np.sqrt(variance.at(background))
    return electrons, sigma_e


def _hot(electrons: FloatArray, sigma_e: FloatArray) -> NDArray[np.bool_]:
    """Mask of pixels that exceed all eight neighbours by ``HOT_RATIO``, [h, w]."""
    around = np.ones((3, 3), bool)
    around[1, 1] = False
    brightest = ndimage.maximum_filter(electrons, footprint=around, mode="mirror")
    return np.asarray(electrons > HOT_RATIO * np.maximum(brightest, sigma_e))


def _locate(electrons: FloatArray, sigma_e: FloatArray, camera: Camera, blur_px: float) -> tuple[FloatArray, float]:
    """Centre (y, x) of the source in pixels, and its mean over a window of the blur's width, relative to the noise."""
    period = max(_period(camera))
    width = max(2 * period + 1, int(blur_px) // 2 * 2 + 1)
    cold = np.where(_hot(electrons, sigma_e), 0.0, electrons)
    mean = ndimage.uniform_filter(cold, width, mode="constant")
    peak = np.unravel_index(int(mean.argmax()), mean.shape)
    noise_e = float(np.sqrt(np.mean(sigma_e**2))) / width
    elsewhere_e = 0.0
    disjoint = mean[width // 2 :: width, width // 2 :: width]
    if disjoint.size >= MANY_WINDOWS:  # includes the spread of uneven light
        elsewhere_e = float(np.median(disjoint))
        noise_e = max(noise_e, 1.4826 * float(np.median(np.abs(disjoint - elsewhere_e))))
    centre = np.array(peak, float)
    y, x = np.indices(mean.shape)
    for _ in range(SEARCH_STEPS):
        near = np.maximum(cold, 0) * (np.hypot(y - centre[0], x - centre[1]) < width / 2 + period)
        if near.sum() > 0:
            centre = np.array([(near * y).sum(), (near * x).sum()]) / near.sum()
    return centre, (float(mean[peak]) - elsewhere_e) / noise_e
