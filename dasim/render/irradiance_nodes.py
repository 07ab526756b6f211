"""The nodes of an irradiance field: what they receive is smoothed, and where it may be interpolated.

``ratio`` is the irradiance of each light over its spectrum, [y, x, light, wavelength]; ``surface`` what the nodes see,
[y, x, (1/z in 1/m, normal, known, mean inverse distance of the surroundings in 1/m)]; ``spectra`` those of the lights.

Tested in tests/dasim/render/test_irradiance.py.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dasim.typing import FloatArray

AGREEMENT = 0.15  # largest relative difference of irradiance between neighbours
SAME_NORMAL = 0.9  # cosine
SAME_DEPTH = 0.02  # largest relative difference of 1/z per node of distance
# Distance of averaged nodes: least cosine between their normals, largest relative difference of a pair from the middle.
SMOOTHING = {1: (SAME_NORMAL, AGREEMENT), 2: (0.998, 0.02), 4: (0.998, 0.02)}
WIDEST = 0.015  # largest distance of averaged nodes beyond neighbours, as a tangent seen from the lens


def smoothed(ratio: FloatArray, surface: FloatArray, spectra: FloatArray, apart: float) -> FloatArray:
    """Irradiance of each node [y, x, light, node], averaged with neighbours on the same surface that receive nearly the
    same.

    The noise of a node affects all pixels near it, and more samples per pixel do not reduce it. Each pass takes
    neighbours twice as far away as the one before, unless light or surface tell them apart (edge-avoiding a-trous
    wavelets: Dammertz et al., High Performance Graphics 2010). They come in opposite pairs, whose mean has no error
    where irradiance changes linearly. Its error elsewhere grows with the square of their distance: nodes are ``apart``
    (as a tangent seen from the lens), and coarse grids are averaged over neighbours only.
    """
    weight_of_light = spectra.mean(axis=-1) / spectra.mean(axis=-1).sum()
    for step, (aligned, agreement) in SMOOTHING.items():
        if step > 1 and step * apart > WIDEST:
            break
        level = (ratio.mean(axis=-1) * weight_of_light).sum(axis=-1)
        if step == 1:
            level = ndimage.uniform_filter(level, 3)
        ratio = _averaged(ratio, surface, level, step, aligned, agreement)
    return ratio


def _averaged(
    ratio: FloatArray, surface: FloatArray, level: FloatArray, step: int, aligned: float, agreement: float
) -> FloatArray:
    """One pass of :func:`smoothed`: with pairs of neighbours ``step`` nodes away whose levels agree, and whose mean
    level differs from that of the node by less than the share ``agreement``.
    """
    total, weight = 4 * ratio, np.full(level.shape, 4.0)
    for dy, dx in ((0, step), (step, 0), (step, step), (step, -step)):
        inside = tuple(
            slice(abs(d), max(abs(d), extent - abs(d))) for d, extent in zip((dy, dx), level.shape, strict=True)
        )
        pair = [
            tuple(
                slice(part.start + d, part.stop + d) for part, d in zip(inside, sign * np.array((dy, dx)), strict=True)
            )
            for sign in (-1, 1)
        ]
        here = surface[inside]
        same = here[..., 4] > 0
        for there in pair:
            other = surface[there]
            same &= other[..., 4] > 0
            same &= np.abs(level[there] - level[inside]) < AGREEMENT * level[inside]
            same &= np.sum(here[..., 1:4] * other[..., 1:4], axis=-1) > aligned
            same &= np.abs(here[..., 0] - other[..., 0]) < step * SAME_DEPTH * here[..., 0]
        same &= np.abs((level[pair[0]] + level[pair[1]]) / 2 - level[inside]) < agreement * level[inside]
        share = same * (1.0 if dy and dx else 2.0)
        total[inside] += share[..., None, None] * (ratio[pair[0]] + ratio[pair[1]])
        weight[inside] += 2 * share
    return total / weight[..., None, None]


def clamped(surface: FloatArray, slope: FloatArray) -> FloatArray:
    """Mean inverse distance of the surroundings of each node [y, x], 1/m, at least what its neighbours imply.

    What stands close by may be seen in a narrow angle alone, as the lower side of a ball on a table. The surroundings
    are no farther than those of a neighbour and the way to it (Krivanek, Bouatouch, Pattanaik and Zara, Eurographics
    Symposium on Rendering 2006). ``slope`` is x / z and y / z.
    """
    known = surface[..., 4] > 0
    z = 1 / np.where(known, surface[..., 0], 1.0)
    place, near = np.dstack([slope, np.ones_like(z)]) * z[..., None], surface[..., 5].copy()
    for inside, there in _neighbours(z.shape):
        way = np.linalg.norm(place[there] - place[inside], axis=-1)
        implied = surface[there][..., 5] / (1 + way * surface[there][..., 5])
        near[inside] = np.where(known[inside] & known[there], np.maximum(near[inside], implied), near[inside])
    return near


def even_nodes(ratio: FloatArray, surface: FloatArray, spectra: FloatArray) -> NDArray[np.bool_]:
    """Nodes [y, x] whose neighbours on the same surface, two or more, receive nearly the same, in all wavelengths."""
    light, known = _bands(ratio, spectra), surface[..., 4] > 0
    agrees, count = known.copy(), np.zeros(known.shape, int)
    for inside, there in _neighbours(known.shape):
        here, other = surface[inside], surface[there]
        same = known[inside] & known[there] & (np.sum(here[..., 1:4] * other[..., 1:4], axis=-1) > SAME_NORMAL)
        same &= np.abs(here[..., 0] - other[..., 0]) < SAME_DEPTH * here[..., 0]
        differ = np.abs(light[there] - light[inside]) > AGREEMENT * (light[there] + light[inside]) / 2
        agrees[inside] &= ~(same & differ.any(axis=-1))
        count[inside] += same
    return agrees & (count > 1)


def _neighbours(shape: tuple[int, ...]) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Places of the nodes of a grid [y, x] that have a neighbour on one of eight sides, and of that neighbour."""
    for turn in range(9):
        step = turn // 3 - 1, turn % 3 - 1
        if step != (0, 0):
            inside, there = (
                tuple(slice(max(0, d), extent + min(0, d)) for d, extent in zip(way, shape, strict=True))
                for way in ((-step[0], -step[1]), step)
            )
            yield inside, there  # type: ignore[misc]


def _bands(ratio: FloatArray, spectra: FloatArray) -> FloatArray:
    """Irradiance in four bands, [y, x, band]: means of eight wavelengths, since single ones are noisier. Lights count
    by their power in each of these bands.
    """
    bands = ratio.reshape(*ratio.shape[:3], 4, -1).mean(axis=-1)[:, :, : len(spectra)]
    power = np.stack([part.mean(axis=-1) for part in np.array_split(spectra, 4, axis=-1)], axis=-1)
    return np.asarray((bands * (power / power.sum(axis=0))).sum(axis=2))


def agreeing_cells(ratio: FloatArray, surface: FloatArray, spectra: FloatArray) -> NDArray[np.bool_]:
    """Cells [y, x] whose four corners are known, face one way and receive nearly the same, in all wavelengths."""

    def corners(values: np.ndarray) -> np.ndarray:
        return np.stack([values[:-1, :-1], values[:-1, 1:], values[1:, :-1], values[1:, 1:]])

    known = corners(surface[..., 4]).min(axis=0) > 0
    normal = corners(surface[..., 1:4])
    turned = np.min([np.sum(normal[i] * normal[j], axis=-1) for i in range(4) for j in range(i)], axis=0)
    light = corners(_bands(ratio, spectra))
    middle = light.mean(axis=0)
    spread = (light.max(axis=0) - light.min(axis=0)) / np.where(middle > 0, middle, 1.0)
    return known & (turned > SAME_NORMAL) & (spread.max(axis=-1) < AGREEMENT)
