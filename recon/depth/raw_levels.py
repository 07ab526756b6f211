"""Raw blur levels of a capture (sec. 5.2-5.3): infrared against green, or red or blue where infrared has no edge.

Tested also in tests/recon/depth/test_tiles.py and tests/recon/depth/test_scores.py.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import Float32Array
from dasim.values import Capture
from recon.depth import best, tiles
from recon.depth.channels import Also, Channel, Leak
from recon.depth.grid import PLANE_SPACING_PX, window_mean
from recon.depth.scores import window_of
from recon.picture import infrared, mosaic
from recon.settings import Settings

NOISE_BLUR_PX = 1.5  # sigma in plane pixels of the local mean that the noise variance is computed from
FALLBACK_TRUST = 0.25  # factor on the confidence of red and blue, whose blur differs little from green's (sec. 5.3)


def variances(raw_e: Float32Array, capture: Capture) -> dict[str, Float32Array]:
    """Noise variance of each colour plane, [h/2, w/2]: from the data sheet, or higher where the picture is noisier."""
    variances = {}
    collected = mosaic.planes(mosaic.collected(raw_e, capture.camera), capture.camera)
    for name, plane in mosaic.planes(raw_e, capture.camera).items():
        smooth = cv2.GaussianBlur(collected[name], (0, 0), NOISE_BLUR_PX)
        variance: Float32Array = mosaic.noise_variance(capture, name).at(smooth)
        variances[name] = variance * mosaic.noise_excess(plane, variance)
    return variances


def raw_levels(
    raw_e: Float32Array,
    variances: dict[str, Float32Array],
    saturated: NDArray,
    camera: Camera,
    kernels: NDArray,
    settings: Settings,
    white: NDArray,
) -> tuple[Float32Array, Float32Array]:
    """Level of eq. (12) and its confidence 0..1 for every 2x2 block of the mosaic, [h/2, w/2]; NaN without an edge.

    Args:
        raw_e: linear mosaic, [h, w] electrons.
        variances: noise variance of each colour plane, [h/2, w/2].
        saturated: mask of saturated pixels, [h, w].
        camera: gives mosaic and response curves.
        kernels: kernels under the light, [level, channel, y, x].
        settings: score, window and thresholds.
        white: electrons of a white point under the light, [channel].
    """
    phases = mosaic.phases(camera)
    planes, variances = _with_crosstalk_of_the_axis(mosaic.planes(raw_e, camera), variances, camera)
    alpha = infrared.crosstalk(camera, settings.crosstalk)

    def channel(name: str, box: tuple[slice, slice]) -> Channel:
        plane = np.ascontiguousarray(planes[name][box])
        return Channel(plane, phases[name], variances[name][box], kernels[:, CHANNELS.index(name)])

    leak = _leak("G", alpha, white)
    further = ["R"] if settings.score == "bands" and "R" in _fallbacks(camera) else []
    clipped_share = window_mean(mosaic.saturated_blocks(saturated).astype(np.float32), window_of(settings))
    level = np.full(planes["G"].shape, np.nan, np.float32)
    confidence = np.zeros_like(level)
    unresolved = clipped_share < settings.saturated_share  # blocks in which no channel has had an edge yet
    for name in ["IR", *(_fallbacks(camera) if settings.fallback else [])]:
        box = _around(unresolved, round(settings.window_px / PLANE_SPACING_PX) * 2)
        if box is None:
            break
        also: Also = []
        if name == "IR":
            also = [(channel(n, box), _leak(n, alpha, white)) for n in further]
        sharpest, trust, snr, green_snr = tiles.best_levels(
            channel(name, box), channel("G", box), settings, leak if name == "IR" else None, also
        )
        edge = unresolved[box] & (snr > settings.edge_snr) & (green_snr > settings.edge_snr)
        new = edge & (trust > 0) & (trust >= settings.least_confidence)
        level[box][new] = sharpest[new]
        confidence[box][new] = (trust if name == "IR" else FALLBACK_TRUST * trust)[new]
        unresolved[box] &= (snr <= settings.edge_snr) & (green_snr > settings.edge_snr)
    return level, confidence


def joint_levels(
    raw_e: Float32Array,
    variances: dict[str, Float32Array],
    saturated: NDArray,
    camera: Camera,
    kernels: NDArray,
    settings: Settings,
    white: NDArray,
) -> best.Map:
    """Levels of every 2x2 block by the score ``joint``; arguments are those of :func:`raw_levels`."""
    phases = mosaic.phases(camera)
    planes, variances = _with_crosstalk_of_the_axis(mosaic.planes(raw_e, camera), variances, camera)
    alpha = infrared.crosstalk(camera, settings.crosstalk)
    # The score ``bands`` compares red too; the joint likelihood does not.
    names = ["IR", "G", *(["R"] if "R" in _fallbacks(camera) else [])]
    channels = [
        Channel(np.ascontiguousarray(planes[name]), phases[name], variances[name], kernels[:, CHANNELS.index(name)])
        for name in names
    ]
    leaks = [_leak(name, alpha, white) for name in names[1:]]

    def bands(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Float32Array:
        return tiles.scores_at(channels, leaks, settings, rows, columns)

    clipped = mosaic.saturated_blocks(saturated)
    return best.estimate(channels[1], channels[0], leaks[0], clipped, settings.saturated_share, bands)


def _with_crosstalk_of_the_axis(
    planes: dict[str, NDArray], variances: dict[str, Float32Array], camera: Camera
) -> tuple[dict[str, NDArray], dict[str, Float32Array]]:
    """Planes and noise variances of R, G and B, scaled so that alpha of eq. (8) is that of the axis everywhere.

    The scores do not depend on a smooth factor of a channel. The kernels remain those of the bank, for which white has
    the axis' share of infrared.
    """
    relative, place = infrared.crosstalk_over_field(camera)
    if len(relative) == 1:
        return planes, variances
    place = place[::2, ::2]
    for name, row in zip("RGB", relative.T, strict=True):
        factor = np.interp(place, np.arange(len(row)), 1 / row).astype(np.float32)
        planes = planes | {name: planes[name] * factor}
        variances = variances | {name: variances[name] * factor**2}
    return planes, variances


def _around(mask: NDArray, margin: int) -> tuple[slice, slice] | None:
    """The bounding box of a mask [h, w] with a margin, rows and columns; None for an empty mask."""
    parts = []
    for axis in (1, 0):
        index = np.flatnonzero(mask.any(axis=axis))
        if not index.size:
            return None
        parts.append(slice(max(int(index[0]) - margin, 0), int(index[-1]) + margin + 1))
    return parts[0], parts[1]


def _leak(name: str, alpha: NDArray, white: NDArray) -> Leak:
    """Infrared in a visible channel, from ``alpha`` [3] of eq. (8) and the electrons of a ``white`` point [channel]."""
    index = CHANNELS.index(name)
    return Leak(float(alpha[index]), float(white[CHANNELS.index("IR")] / white[index]))


def _fallbacks(camera: Camera) -> list[str]:
    """Channels that replace infrared where it has no edge: those whose planes are fully sampled."""
    return [name for name in "RB" if mosaic.grids(camera)[name][0].step == 2]
