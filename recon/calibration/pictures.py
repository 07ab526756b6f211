"""Pictures of a point source: average of the frames in electrons, and centre of the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.camera import noise
from dasim.camera.crosstalk import corrected, noise_gains
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera, mosaic_channels
from dasim.typing import FloatArray
from dasim.values import PointPicture

SATURATION_SHARE = 0.9  # share of saturation above which a pixel of a longer exposure is not used
RIM_PX = 3  # distance to the frame's border of the pixels that give the background
CORE_SHARE = 0.02  # share of the peak that bounds the core, from which the centre is measured
CORE_MARGIN_PX = 2
CENTRE_STEPS = 4  # iterations of the window about the centre of mass, which converges in two or three


def averaged(
    group: list[PointPicture], camera: Camera, unit_s: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Mean electrons of every channel without background, their standard deviation, and the mask of sampled pixels.

    All are [channel, h, w]; electrons are those of an exposure of ``unit_s`` seconds. Each pixel sums the exposures
    that do not saturate it, and is corrected for the pixel crosstalk of the data sheet. Temporal noise is independent
    between frames; fixed-pattern noise is the same in all frames of one position of the source.
    """
    sensor = camera.sensor
    height, width = group[0].frames_dn.shape[1:]
    local = camera.model_copy(update={"sensor": sensor.model_copy(update={"height_px": height, "width_px": width})})
    channel = mosaic_channels(local)
    least = min(picture.exposure_s * picture.gain for picture in group)
    shape = (len(channels(sensor)), height, width)
    electrons, variance, exposed = np.zeros((3, *shape))  # sums over all frames that see a pixel
    for shift, pictures in _by_shift(group).items():
        shift_e, shift_variance, shift_s, count = np.zeros((4, height, width))
        for picture in pictures:
            frames = len(picture.frames_dn)
            full_e = noise.collected_e(picture.frames_dn.mean(axis=0), sensor, picture.gain)
            # By the mean of the frames, so that the noise of a single frame does not select pixels.
            usable = full_e < SATURATION_SHARE * noise.saturation_e(sensor, picture.gain)
            usable |= picture.exposure_s * picture.gain == least
            mean_e = full_e - noise.dark_e(sensor, picture.exposure_s)
            temporal = noise.temporal_variance(sensor, picture.exposure_s, picture.gain).at(mean_e)
            shift_e += usable * frames * mean_e
            shift_variance += usable * frames * temporal
            shift_s += usable * frames * picture.exposure_s
            count += usable * frames
        number, seconds = np.maximum(count, 1), np.where(count > 0, shift_s, 1.0)
        fixed = noise.fixed_variance(sensor, 0.0).at(shift_e / number)
        shift_variance += count**2 * (fixed + noise.dark_pattern_e(sensor, shift_s / number) ** 2)
        shift_e = shift_s * corrected(shift_e / seconds, local)
        back = tuple(-s for s in shift or (0, 0))
        for total, part in ((electrons, shift_e), (variance, shift_variance), (exposed, shift_s / unit_s)):
            for index in np.unique(channel):
                total[index] += np.roll(np.where(channel == index, part, 0.0), back, axis=(0, 1))
    sampled = exposed > 0
    exposure = np.where(sampled, exposed, 1.0)
    image, sigma = electrons / exposure, np.sqrt(variance * noise_gains(camera)[:, None, None]) / exposure
    rim = np.ones((height, width), bool)
    rim[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = False
    rim[[0, -1]] = rim[:, [0, -1]] = False  # their crosstalk from pixels outside the frame is unknown
    background = np.array([np.median(plane[rim & here]) for plane, here in zip(image, sampled, strict=True)])
    return np.where(sampled, image - background[:, None, None], 0.0), sigma, sampled


def _by_shift(group: list[PointPicture]) -> dict[tuple[int, int] | None, list[PointPicture]]:
    """Pictures by shift of the source; within a group, a pixel always samples the same part of the image."""
    groups: dict[tuple[int, int] | None, list[PointPicture]] = {}
    for picture in group:
        groups.setdefault(picture.shift_px, []).append(picture)
    return groups


def common_centre(image: FloatArray) -> FloatArray:
    """Centre (y, x) of the point in pixels: centre of mass of the cores of all channels, weighted by their electrons.

    A common centre preserves lateral shifts between the channels. ``image`` is [channel, h, w] electrons.
    """
    total = np.maximum(image, 0).sum(axis=0)
    y, x = np.indices(total.shape)
    core = total > CORE_SHARE * total.max()
    centre = np.array([y[core].mean(), x[core].mean()])
    extent = max(np.hypot(y[core] - centre[0], x[core] - centre[1]).max(), 1.0) + CORE_MARGIN_PX
    extent = min(extent, min(total.shape) / 2 - 2)
    signal = image.sum(axis=0)
    for _ in range(CENTRE_STEPS):
        # A window with a soft rim, so that the centre is a continuous function of the window.
        window = np.clip(extent + 0.5 - np.hypot(y - centre[0], x - centre[1]), 0, 1) * signal
        centre = np.array([(window * y).sum(), (window * x).sum()]) / window.sum()
    return centre
