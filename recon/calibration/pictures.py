"""Pictures of a point source: frames averaged to electrons, and where the source's image lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dasim.camera.noise import electrons_per_dn, saturation_e
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
    """Electrons of every channel at the pixels that see it, [channel, h, w], without background; noise; which do.

    In the electrons of an exposure of ``unit_s``; of several exposures every pixel has the sum of
    those that it stands.
    """
    sensor = camera.sensor
    height, width = group[0].frames_dn.shape[1:]
    local = camera.model_copy(update={"sensor": sensor.model_copy(update={"height_px": height, "width_px": width})})
    channel = mosaic_channels(local)
    least = min(picture.exposure_s * picture.gain for picture in group)
    shape = (len(channels(sensor)), height, width)
    electrons, variance, frames_s, count = np.zeros((4, *shape))  # sums over all frames that see a pixel
    seen = np.zeros(shape, bool)
    for picture in group:
        frames = picture.frames_dn.astype(np.float64)
        mean_e = (frames.mean(axis=0) - sensor.black_level_dn) * electrons_per_dn(sensor, picture.gain)
        # A pixel that saturates in the longer exposures counts in the shorter alone; not by its noise in one frame.
        usable = mean_e < SATURATION_SHARE * saturation_e(sensor, picture.gain)
        usable |= picture.exposure_s * picture.gain == least
        back = tuple(-s for s in picture.shift_px or (0, 0))
        for index in np.unique(channel):
            here = np.roll((channel == index) & usable, back, axis=(0, 1))
            seen[index] |= here
            value = np.roll(mean_e, back, axis=(0, 1))[here]
            electrons[index][here] += len(frames) * value
            variance[index][here] += len(frames) * (np.maximum(value, 0) + sensor.read_noise_e**2)
            frames_s[index][here] += len(frames) * picture.exposure_s / unit_s
            count[index][here] += len(frames)
    known = np.where(seen, frames_s, 1.0)
    image, noise = electrons / known, np.sqrt(variance + (sensor.dsnu_e * count) ** 2) / known
    rim = np.ones((height, width), bool)
    rim[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = False
    background = np.array([np.median(plane[rim & here]) for plane, here in zip(image, seen, strict=True)])
    return np.where(seen, image - background[:, None, None], 0.0), noise, seen


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
