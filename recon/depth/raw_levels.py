"""Raw levels of a capture (sec. 5.2-5.3): infrared against green, then red or blue where infrared shows no edge.

Tested in tests/recon/depth/test_tiles.py and tests/recon/depth/test_scores.py.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import Float32Array
from dasim.values import Capture
from recon.depth import tiles
from recon.depth.channels import Also, Channel, Leak
from recon.depth.grid import PLANE_SPACING_PX, window_mean
from recon.picture import infrared, mosaic
from recon.settings import Settings

NOISE_BLUR_PX = 1.5  # plane pixels: the signal that decides the noise is a local mean
FALLBACK_TRUST = 0.25  # of red or blue in place of infrared: their blur differs little (sec. 5.3)


def variances(raw_e: Float32Array, capture: Capture) -> dict[str, Float32Array]:
    """Noise variance of every colour plane's pixels: from the data sheet, raised where the picture shows more noise."""
    found = {}
    for name, plane in mosaic.planes(raw_e, capture.camera).items():
        smooth = cv2.GaussianBlur(plane, (0, 0), NOISE_BLUR_PX)
        variance: Float32Array = mosaic.noise_variance(capture).at(smooth)
        found[name] = variance * mosaic.noise_excess(plane, variance)
    return found


def raw_levels(
    raw_e: Float32Array,
    variances: dict[str, Float32Array],
    saturated: NDArray,
    camera: Camera,
    kernels: NDArray,
    settings: Settings,
    white: NDArray,
) -> tuple[Float32Array, Float32Array]:
    """Eq. (12) for every block of the mosaic, NaN where neither infrared nor red nor blue has an edge; confidence."""
    places, planes = mosaic.phases(camera), mosaic.planes(raw_e, camera)

    def channel(name: str, box: tuple[slice, slice]) -> Channel:
        plane = np.ascontiguousarray(planes[name][box])
        return plane, places[name], variances[name][box], kernels[:, CHANNELS.index(name)]

    leak = _leak("G", camera, white, settings)
    further = ["R"] if settings.score == "bands" and "R" in _fallbacks(camera) else []
    usable = window_mean(mosaic.blocks_any(saturated).astype(np.float32), settings) < settings.saturated_share
    level = np.full(planes["G"].shape, np.nan, np.float32)
    confidence = np.zeros_like(level)
    open_ = usable.copy()  # no channel has shown an edge there yet
    for name in ["IR", *(_fallbacks(camera) if settings.fallback else [])]:
        box = _around(open_, round(settings.window_px / PLANE_SPACING_PX) * 2)
        if box is None:
            break
        also: Also = []
        if name == "IR":
            also = [(channel(n, box), _leak(n, camera, white, settings)) for n in further]
        best, trust, snr, green_snr = tiles.best_levels(
            channel(name, box), channel("G", box), settings, leak if name == "IR" else None, also
        )
        edge = open_[box] & (snr > settings.edge_snr) & (green_snr > settings.edge_snr)
        new = edge & (trust > 0) & (trust >= settings.least_confidence)
        level[box][new] = best[new]
        confidence[box][new] = (trust if name == "IR" else FALLBACK_TRUST * trust)[new]
        open_[box] &= (snr <= settings.edge_snr) & (green_snr > settings.edge_snr)
    return level, confidence


def _around(mask: NDArray, margin: int) -> tuple[slice, slice] | None:
    """The smallest part of a mask [h, w] that holds all of it and a margin; None where it is empty."""
    parts = []
    for axis in (1, 0):
        place = np.flatnonzero(mask.any(axis=axis))
        if not place.size:
            return None
        parts.append(slice(max(int(place[0]) - margin, 0), int(place[-1]) + margin + 1))
    return parts[0], parts[1]


def _leak(name: str, camera: Camera, white: NDArray, settings: Settings) -> Leak:
    """Share of infrared in a channel, measured or from eq. (8), and that of a ``white`` point [channel]."""
    alpha = infrared.crosstalk(camera.sensor, settings.crosstalk)
    own = CHANNELS.index(name)
    return Leak(float(alpha[own]), float(white[CHANNELS.index("IR")] / white[own]))


def _fallbacks(camera: Camera) -> list[str]:
    """Channels that stand in for infrared: those whose planes are sampled, not filled in between."""
    return [name for name in "RB" if mosaic.grids(camera)[name][0].step == 2]
