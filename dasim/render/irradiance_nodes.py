"""Nodes of an irradiance field: smoothing of their irradiance, and tests of where it may be interpolated.

Irradiance is relative to the spectrum of its light here, [node, light, wavelength]; ``spectra`` are those of the
lights.

Tested in tests/dasim/render/test_irradiance.py.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dasim.render.light_spectra import NODES
from dasim.typing import Float32Array, FloatArray

AGREEMENT = 0.15  # largest relative difference of irradiance between neighbours
# Likewise for nodes whose irradiance stands for that of a whole side of a crease or of a depth discontinuity, where
# nothing is interpolated: with 0.15, the irradiance in a gap of 4 pixels between two surfaces was 12 % too small.
EVEN = 0.05
SAME_NORMAL = 0.9  # cosine
SAME_DEPTH = 0.02  # largest relative difference of 1/z per node of distance
# By the distance of averaged nodes: least cosine between normals, and largest relative difference between the mean of
# a pair and the node in its middle.
SMOOTHING = {1: (SAME_NORMAL, AGREEMENT), 2: (0.998, 0.02), 4: (0.998, 0.02)}
CERTAIN = 2.0  # standard errors of a difference by which it must exceed these bounds before nodes count as different
DIRECTION_GROUPS = NODES // 4  # of a node: the directions of a group carry the same four wavelengths, evenly spaced
WIDEST = 0.015  # largest distance of averaged nodes beyond neighbours, as a tangent seen from the lens
AROUND = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dy, dx) != (0, 0)]


@dataclass(frozen=True)
class Nodes:
    """Nodes of a regular grid over the frame, some positions of which may be empty."""

    grid: NDArray[np.intp]  # [y, x] index of the node at each position, -1 where there is none
    slope: FloatArray  # [node, 2] x / z and y / z of the point that the node sees
    # [node, 6]: 1/z in 1/m, normal, whether the surface is known, mean inverse distance of the surroundings in 1/m
    surface: FloatArray

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether each node sees a surface whose irradiance is known."""
        return np.asarray(self.surface[:, 4] > 0)

    @property
    def place(self) -> FloatArray:
        """Position of the point that each node sees, [node, 3] in m."""
        z = 1 / np.where(self.known, self.surface[:, 0], 1.0)
        return np.column_stack([self.slope, np.ones(len(z))]) * z[:, None]

    def beside(self, dy: int, dx: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Indices of the nodes of the grid, and of the nodes ``dy`` below and ``dx`` to the right; -1 for none."""
        reach = max(abs(dy), abs(dx))
        there = np.pad(self.grid, reach, constant_values=-1)
        height, width = self.grid.shape
        there = there[reach + dy : reach + dy + height, reach + dx : reach + dx + width]
        return self.grid[self.grid >= 0], there[self.grid >= 0]

    def neighbours(self) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Nodes that have a neighbour on one of eight sides, and this neighbour."""
        for way in AROUND:
            here, there = self.beside(*way)
            yield here[there >= 0], there[there >= 0]

    def corners(self) -> NDArray[np.intp]:
        """Numbers of the four corners of each cell of the grid, row by row, [cell, 4]; all places must have nodes."""
        grid = self.grid
        return np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]], axis=-1).reshape(-1, 4)

    def same_surface(
        self, here: NDArray[np.intp], there: NDArray[np.intp], aligned: float, apart: int = 1
    ) -> NDArray[np.bool_]:
        """Whether pairs of nodes, ``apart`` grid positions from each other, see the same surface: the cosine between
        their normals exceeds ``aligned``, and their depths are close.
        """
        z, normal = self.surface[:, 0], self.surface[:, 1:4]
        same = self.known[here] & self.known[there]
        same &= np.einsum("nk,nk->n", normal[here], normal[there]) > aligned
        return same & (np.abs(z[here] - z[there]) < apart * SAME_DEPTH * z[here])


def smoothed(ratio: Float32Array, nodes: Nodes, spectra: FloatArray, apart: float) -> Float32Array:
    """Irradiance of each node, averaged with neighbours on the same surface that receive nearly the same.

    The noise of a node affects all pixels near it, and more samples per pixel do not reduce it. Each pass uses
    neighbours twice as far away as the previous pass, except where their irradiance or surface differs (edge-avoiding
    a-trous wavelets: Dammertz et al., High Performance Graphics 2010). Differences within their own noise do not count,
    which is estimated from the groups of wavelengths that have directions of their own, and follows the averages from
    pass to pass (Schied et al., High Performance Graphics 2017). Neighbours are used in opposite pairs, whose mean is
    exact where irradiance changes linearly. Elsewhere its error grows with the square of their distance, so coarse
    grids are averaged over direct neighbours only. ``apart`` is the spacing of the nodes, as a tangent seen from the
    lens.
    """
    weight_of_light = spectra.mean(axis=-1) / spectra.mean(axis=-1).sum()
    variance = _variance(ratio, nodes, weight_of_light)
    for step, (aligned, agreement) in SMOOTHING.items():
        if step > 1 and step * apart > WIDEST:
            break
        level, of_level = (ratio.mean(axis=-1) * weight_of_light).sum(axis=-1), variance
        if step == 1:
            level, of_level = _mean_around(level, nodes), variance / (1 + len(AROUND))
        ratio, variance = _averaged(ratio, variance, nodes, (level, np.sqrt(of_level)), step, aligned, agreement)
    return ratio


def _variance(ratio: Float32Array, nodes: Nodes, weight_of_light: FloatArray) -> FloatArray:
    """Variance of the level of each node by the noise of its directions, from the nodes around it."""
    groups = [
        (ratio[..., group::DIRECTION_GROUPS].mean(axis=-1) * weight_of_light).sum(axis=-1)
        for group in range(DIRECTION_GROUPS)
    ]
    own = np.var(groups, axis=0, ddof=1) / DIRECTION_GROUPS
    return _mean_around(_mean_around(own, nodes), nodes)


def _mean_around(level: FloatArray, nodes: Nodes) -> FloatArray:
    """Mean of each node and its neighbours."""
    total, count = level.copy(), np.ones(len(level))
    for here, there in nodes.neighbours():
        total[here] += level[there]
        count[here] += 1
    return total / count


def _averaged(
    ratio: Float32Array,
    variance: FloatArray,
    nodes: Nodes,
    level: tuple[FloatArray, FloatArray],
    step: int,
    aligned: float,
    agreement: float,
) -> tuple[Float32Array, FloatArray]:
    """One pass of :func:`smoothed`: with pairs of neighbours ``step`` nodes away whose levels agree, and whose mean
    level differs from that of the node by less than the share ``agreement``. ``level`` has the levels and their
    standard deviations. Also returns the ``variance`` after the pass.
    """
    weight, pairs = np.full(len(variance), 4.0, np.float32), []
    spread = 16 * variance
    light, noise = level
    for dy, dx in ((0, step), (step, 0), (step, step), (step, -step)):
        here, after = nodes.beside(dy, dx)
        before = nodes.beside(-dy, -dx)[1]
        is_pair = (before >= 0) & (after >= 0)
        here, pair = here[is_pair], (before[is_pair], after[is_pair])
        own, error = light[here], CERTAIN * noise[here]
        # The variances of these differences are 1.5 times and twice that of a node.
        bound = np.maximum(agreement * own, np.sqrt(1.5) * error)
        same = np.abs((light[pair[0]] + light[pair[1]]) / 2 - own) < bound
        bound = np.maximum(AGREEMENT * own, np.sqrt(2.0) * error)
        for there in pair:
            same &= np.abs(light[there] - own) < bound
            same &= nodes.same_surface(here, there, aligned, step)
        share = 1.0 if dy and dx else 2.0
        here, before, after = here[same], pair[0][same], pair[1][same]
        weight[here] += 2 * share
        spread[here] += share**2 * (variance[before] + variance[after])
        pairs.append((share, here, before, after))
    result = np.empty_like(ratio)
    for light_number in range(ratio.shape[1]):  # apart: with several lights, all of a large frame take gigabytes
        of_light = ratio[:, light_number]
        total = 4 * of_light
        for share, here, before, after in pairs:
            total[here] += share * (of_light[before] + of_light[after])
        result[:, light_number] = total / weight[:, None]
    return result, np.asarray(spread / np.square(weight))


def clamped(nodes: Nodes) -> FloatArray:
    """Mean inverse distance of the surroundings of each node, 1/m, raised to the lower bound that its neighbours imply.

    A nearby object may be visible within a narrow angle only, such as the underside of a ball on a table. The
    surroundings of a node are no farther than those of a neighbour plus the distance to that neighbour (Krivanek,
    Bouatouch, Pattanaik and Zara, Eurographics Symposium on Rendering 2006).
    """
    known, place, own = nodes.known, nodes.place, nodes.surface[:, 5]
    near = own.copy()
    for here, there in nodes.neighbours():
        implied = own[there] / (1 + np.linalg.norm(place[there] - place[here], axis=-1) * own[there])
        near[here] = np.where(known[here] & known[there], np.maximum(near[here], implied), near[here])
    return near


def even_nodes(ratio: Float32Array, nodes: Nodes, spectra: FloatArray) -> NDArray[np.bool_]:
    """Nodes whose neighbours on the same surface, two or more, receive nearly the same, in all wavelengths."""
    light, agrees = _bands(ratio, spectra), nodes.known
    count = np.zeros(len(agrees), int)
    for here, there in nodes.neighbours():
        same = nodes.same_surface(here, there, SAME_NORMAL)
        differ = np.abs(light[there] - light[here]) > EVEN * (light[there] + light[here]) / 2
        agrees[here] &= ~(same & differ.any(axis=-1))
        count[here] += same
    return agrees & (count > 1)


def _bands(ratio: Float32Array, spectra: FloatArray) -> FloatArray:
    """Irradiance in four bands, [node, band]: means of eight wavelengths, since single ones are noisier. Lights count
    by their power in each of these bands.
    """
    bands = ratio.reshape(*ratio.shape[:2], 4, -1).mean(axis=-1)[:, : len(spectra)]
    power = np.stack([part.mean(axis=-1) for part in np.array_split(spectra, 4, axis=-1)], axis=-1)
    return np.asarray((bands * (power / power.sum(axis=0))).sum(axis=1))


def agreeing_cells(
    ratio: Float32Array, surface: FloatArray, spectra: FloatArray, corners: NDArray[np.intp], agreement: float
) -> NDArray[np.bool_]:
    """Whether the four corners of each cell, [cell, 4], are all known, face the same way, and receive the same
    irradiance to within the fraction ``agreement`` at all wavelengths.
    """
    of_corners = surface[corners]
    known, normal = of_corners[..., 4].min(axis=1) > 0, of_corners[..., 1:4]
    turned = np.min([np.sum(normal[:, i] * normal[:, j], axis=-1) for i in range(4) for j in range(i)], axis=0)
    light = _bands(ratio, spectra)[corners]
    middle = light.mean(axis=1)
    spread = np.ptp(light, axis=1) / np.where(middle > 0, middle, 1.0)
    return np.asarray(known & (turned > SAME_NORMAL) & (spread.max(axis=-1) < agreement))
