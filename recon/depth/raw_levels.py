"""Raw blur levels of a capture (sec. 5.2-5.3): infrared against green, or red or blue where infrared has no edge.

Tested also in tests/recon/depth/test_tiles.py and tests/recon/depth/test_scores.py.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import BoolArray, Float32Array
from dasim.values import Capture
from recon.depth import best, scores, surface_net, tiles
from recon.depth.channels import Also, Channel, Leak
from recon.depth.evidence import NODE, SHARE_ROUNDING, Evidence, evidence
from recon.depth.grid import PLANE_SPACING_PX, window_mean
from recon.depth.scores import window_of
from recon.depth.side import probability_behind, signed
from recon.picture import infrared, mosaic
from recon.settings import Settings

NOISE_BLUR_PX = 1.5  # sigma in plane pixels of the local mean that the noise variance is computed from
FALLBACK_TRUST = 0.25  # factor on the confidence of red and blue, whose blur differs little from green's (sec. 5.3)


def variances(
    raw_e: Float32Array, capture: Capture, collected_e: Float32Array | None = None
) -> dict[str, Float32Array]:
    """Noise variance of each colour plane, [h/2, w/2]: from the data sheet, or higher where the picture is noisier.

    ``collected_e`` is by default computed by :func:`recon.picture.mosaic.collected`.
    """
    variances = {}
    if collected_e is None:
        collected_e = mosaic.collected(raw_e, capture.camera)
    collected = mosaic.planes(collected_e, capture.camera)
    for name, plane in mosaic.planes(raw_e, capture.camera).items():
        smooth = cv2.GaussianBlur(collected[name], (0, 0), NOISE_BLUR_PX)
        variance: Float32Array = mosaic.noise_variance(capture, name).at(smooth)
        variances[name] = variance * mosaic.noise_excess(plane, variance)
    return variances


class Frame(NamedTuple):
    """What levels are estimated from."""

    raw_e: Float32Array  # linear mosaic, [h, w] electrons
    variances: dict[str, Float32Array]  # noise variance of each colour plane, [h/2, w/2]
    saturated: BoolArray  # mask of saturated pixels, [h, w]
    camera: Camera  # gives mosaic and response curves
    kernels: Float32Array  # under the light, [level, channel, y, x]
    white: NDArray[np.floating]  # electrons of a white point under the light, [channel]


def raw_levels(frame: Frame, settings: Settings, tile_px: int | None = None) -> tuple[Float32Array, Float32Array]:
    """Level of eq. (12) and its confidence 0..1 for every 2x2 block of the mosaic, [h/2, w/2]; NaN without an edge.

    Scores are computed in tiles of ``tile_px`` raw pixels, if given.
    """
    channels, leaks = _channels(frame, settings)
    fallbacks = _fallbacks(frame.camera)

    def channel(name: str, box: tuple[slice, slice]) -> Channel:
        whole = channels[name]
        return whole._replace(plane=np.ascontiguousarray(whole.plane[box]), variance=whole.variance[box])

    further = ["R"] if settings.score == "bands" and "R" in fallbacks else []
    clipped = mosaic.saturated_blocks(frame.saturated).astype(np.float32)
    level = np.full(clipped.shape, np.nan, np.float32)
    confidence = np.zeros_like(level)
    # Blocks in which no channel has had an edge yet.
    unresolved = window_mean(clipped, window_of(settings)) <= settings.saturated_share + SHARE_ROUNDING
    for name in ["IR", *(fallbacks if settings.fallback else [])]:
        box = _around(unresolved, round(settings.window_px / PLANE_SPACING_PX) * 2)
        if box is None:
            break
        also: Also = []
        if name == "IR":
            also = [(channel(n, box), leaks[n]) for n in further]
        sharpest, trust, snr, green_snr = tiles.best_levels(
            channel(name, box), channel("G", box), settings, leaks["G"] if name == "IR" else None, also,
            size=tiles.TILE if tile_px is None else int(tile_px / PLANE_SPACING_PX),
        )  # fmt: skip
        edge = unresolved[box] & (snr > settings.edge_snr) & (green_snr > settings.edge_snr)
        new = edge & (trust > 0) & (trust >= settings.least_confidence)
        level[box][new] = sharpest[new]
        confidence[box][new] = (trust if name == "IR" else FALLBACK_TRUST * trust)[new]
        unresolved[box] &= (snr <= settings.edge_snr) & (green_snr > settings.edge_snr)
    return level, confidence


def joint_levels(
    frame: Frame, settings: Settings, behind: NDArray | None = None, tile_px: int | None = None
) -> best.Map:
    """Levels of every 2x2 block by the score ``joint``; the network in tiles of ``tile_px`` raw pixels, if given.

    With kernels ``behind`` the focus, from it outwards, levels have a sign, negative behind the focus.
    """
    if behind is not None:
        sides = [frame, frame._replace(kernels=behind)]
        channels, leaks = zip(*(_channels(side, settings) for side in sides), strict=True)
        names = [name for name in "RGB" if name == "G" or name in _fallbacks(frame.camera)]
        near, far = ([of_side[name] for name in [*names, "IR"]] for of_side in channels)
        clipped = mosaic.saturated_blocks(frame.saturated)
        where = probability_behind(near, far, [leaks[0][name] for name in names], clipped, settings.saturated_share)
        maps = [joint_levels(side, settings, tile_px=tile_px) for side in sides]
        return signed(maps[0], maps[1], where)
    found = joint_evidence(frame, settings)
    shape = frame.variances["IR"].shape
    tile = surface_net.TILE if tile_px is None else int(tile_px / PLANE_SPACING_PX / NODE)
    return best.estimate(found, len(frame.kernels) - 1, shape, network=settings.windows == "all", tile=tile)


def joint_evidence(frame: Frame, settings: Settings) -> Evidence:
    """What the windows say of their levels, for the score ``joint``."""
    channels, leaks = _channels(frame, settings)
    # The score ``bands`` compares red too; the joint likelihood does not.
    names = ["G", *(["R"] if "R" in _fallbacks(frame.camera) else [])]

    def bands(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Float32Array:
        infrared, green, *others = (channels[name] for name in ["IR", *names])
        also = [(channel, leaks[name]) for channel, name in zip(others, names[1:], strict=True)]
        score, _ = scores.scores(infrared, green, [], settings, leak=leaks["G"], also=also, at=(rows, columns))
        return np.moveaxis(score, 0, -1)

    clipped = mosaic.saturated_blocks(frame.saturated)
    of_bands = bands if settings.windows == "all" else None
    guides = [channels[name] for name in "RB"] if of_bands else []  # for the network, as the score is
    return evidence(channels["G"], channels["IR"], guides, leaks["G"], clipped, settings.saturated_share, of_bands)


def _channels(frame: Frame, settings: Settings) -> tuple[dict[str, Channel], dict[str, Leak]]:
    """Every channel, and infrared's share in the visible ones, by name."""
    phases = mosaic.phases(frame.camera)
    planes = mosaic.planes(frame.raw_e, frame.camera)
    planes, variances = _with_crosstalk_of_the_axis(planes, frame.variances, frame.camera)
    alpha = infrared.crosstalk(frame.camera, settings.crosstalk)
    channels = {
        name: Channel(
            np.ascontiguousarray(plane), phases[name], variances[name], frame.kernels[:, CHANNELS.index(name)]
        )
        for name, plane in planes.items()
    }
    return channels, {name: _leak(name, alpha, frame.white) for name in "RGB" if name in planes}


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
