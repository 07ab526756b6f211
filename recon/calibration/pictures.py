"""Pictures of a point source: frames averaged to electrons, and where the source's image lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.camera import noise
from dasim.camera.specification import Camera, channels, mosaic_channels
from dasim.typing import FloatArray
from dasim.values import PointPicture

SATURATION_SHARE = 0.9  # of a pixel: above it, a picture of a longer exposure tells nothing
RIM_PX = 3  # width of the frame's rim that shows background alone
CORE_SHARE = 0.02  # of the peak: a channel's core, where its centre is measured
CORE_MARGIN_PX = 2
CENTRE_STEPS = 4  # the window of the centre of mass follows the centre; converges in two or three


def averaged(
    group: list[PointPicture], camera: Camera, unit_s: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Electrons of every channel at the pixels that see it, less background; their standard deviation; which do.

    All are [channel, h, w], in electrons of an exposure of ``unit_s``. A pixel sums the exposures that do not saturate
    it. Temporal noise of its frames is independent; the fixed patterns are the same in all frames of one position of
    the source and add up there.
    """
    sensor = camera.sensor
    height, width = group[0].frames_dn.shape[1:]
    local = camera.model_copy(update={"sensor": sensor.model_copy(update={"height_px": height, "width_px": width})})
    channel = mosaic_channels(local)
    least = min(picture.exposure_s * picture.gain for picture in group)
    shape = (len(channels(sensor)), height, width)
    electrons, variance, exposed, count = np.zeros((4, *shape))  # sums over all frames that see a pixel
    for shift, pictures in _by_shift(group).items():
        own_e, own_count = np.zeros((2, *shape))
        back = tuple(-s for s in shift or (0, 0))
        for picture in pictures:
            frames = len(picture.frames_dn)
            full_e = noise.collected_e(picture.frames_dn.mean(axis=0), sensor, picture.gain)
            # Judged by the mean of the frames: noise of a single one must not decide whether a pixel counts.
            usable = full_e < SATURATION_SHARE * noise.saturation_e(sensor, picture.gain)
            usable |= picture.exposure_s * picture.gain == least
            mean_e = np.roll(full_e - noise.dark_e(sensor, picture.exposure_s), back, axis=(0, 1))
            temporal = noise.temporal_variance(sensor, picture.exposure_s, picture.gain).at(mean_e)
            for index in np.unique(channel):
                here = np.roll((channel == index) & usable, back, axis=(0, 1))
                own_e[index][here] += frames * mean_e[here]
                variance[index][here] += frames * temporal[here]
                exposed[index][here] += frames * picture.exposure_s / unit_s
                own_count[index][here] += frames
        variance += own_count**2 * noise.fixed_variance(sensor).at(own_e / np.maximum(own_count, 1))
        electrons += own_e
        count += own_count
    seen = count > 0
    known = np.where(seen, exposed, 1.0)
    image, sigma = electrons / known, np.sqrt(variance) / known
    rim = np.ones((height, width), bool)
    rim[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = False
    background = np.array([np.median(plane[rim & here]) for plane, here in zip(image, seen, strict=True)])
    return np.where(seen, image - background[:, None, None], 0.0), sigma, seen


def _by_shift(group: list[PointPicture]) -> dict[tuple[int, int] | None, list[PointPicture]]:
    """Pictures by the source's shift, within which a pixel of the frame sees the same part of the source's image."""
    found: dict[tuple[int, int] | None, list[PointPicture]] = {}
    for picture in group:
        found.setdefault(picture.shift_px, []).append(picture)
    return found


def common_centre(image: FloatArray) -> FloatArray:
    """Centre (y, x) in pixels of the point, from the centres of mass of all channels' cores together.

    Each channel counts with its electrons; one centre for all keeps lateral shifts between channels.
    """
    total = np.maximum(image, 0).sum(axis=0)
    y, x = np.indices(total.shape)
    core = total > CORE_SHARE * total.max()
    centre = np.array([y[core].mean(), x[core].mean()])
    extent = max(np.hypot(y[core] - centre[0], x[core] - centre[1]).max(), 1.0) + CORE_MARGIN_PX
    extent = min(extent, min(total.shape) / 2 - 2)
    signal = image.sum(axis=0)
    for _ in range(CENTRE_STEPS):
        # a soft rim: a pixel that enters or leaves the window must not move the centre by a step
        window = np.clip(extent + 0.5 - np.hypot(y - centre[0], x - centre[1]), 0, 1) * signal
        centre = np.array([(window * y).sum(), (window * x).sum()]) / window.sum()
    return centre
