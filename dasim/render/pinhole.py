"""Pictures through a pinhole of the same rays, by pixels and by the nodes of a finer grid, in the JIT variants.

Those by pixels are the truth ``sharp_e`` and the colours of ``sharp_srgb``; those by nodes, of a frame with a margin,
are what the control variate blurs (:mod:`dasim.render.control_variate`).

Tested in tests/dasim/render/test_ray_loop.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera.rings import at_pixels
from dasim.camera.specification import Camera
from dasim.render import plugin
from dasim.render.frozen import frozen
from dasim.render.irradiance import Field
from dasim.render.plugin import aligned
from dasim.render.ray_block import HERO, Batch, Block, aim, lanes_of, wavelength_places
from dasim.render.ray_loop import Sampling, blocks, ratio_of, signals
from dasim.render.ray_pass import Pass, light_of, prepare
from dasim.render.sobol import Sobol
from dasim.render.wavelengths import Responses
from dasim.typing import Float32Array, FloatArray

ORDER_STREAM = 254  # of random numbers, see :data:`dasim.render.ray_block.WAVELENGTH_STREAM`
ALONG, DOWN = 5, 7  # shift of the nodes' order from pixel to pixel, odd


@dataclass(frozen=True)
class Nodes:
    """Nodes of a pixel in the renderer's memory; numbers are opaque."""

    rays: Any  # of each node
    across: Any  # nodes per pixel along each axis
    count: Any  # of nodes
    order: Any  # of their wavelengths, see :func:`_dispersed`


class Pictures(NamedTuple):
    """Pictures through a pinhole of the same rays, by pixels and by the nodes of a finer grid."""

    rate: FloatArray  # [h, w, channel] mean electrons per second, before the falloff of relative illumination
    nodes: list[NDArray[np.float32]]  # [y, x, channel] electrons over those of a surface of the lights' radiance


class NodePass(NamedTuple):
    """What the batches of a pass by nodes share."""

    shared: Pass
    nodes: Nodes
    frozen: Callable[[Pass, Batch, Nodes], list[Any]]

    def trace(self, batch: Batch) -> list[Any]:
        """Signal and control of rays through a pinhole, alternating by channel, those of a node behind each other."""
        return self.frozen(self.shared, batch, self.nodes)

    def places(self, batch: Batch) -> Any:
        """Places of these rays in their nodes, 0 to 1, not evaluated."""
        lanes = lanes_of(self.shared, batch)
        return Sobol(batch.points, lanes.sample, lanes.stream).next_2d()


def pictures(
    scene: Any,
    camera: Camera,
    sampling: Sampling,
    cells: int,
    field: Field | None,
    responses: Responses,
    parts: Sequence[int],
) -> Pictures:
    """Pictures through a pinhole by pixels, and by nodes of ``cells`` x ``cells`` per pixel.

    The wavelengths of the rays of a pixel are evenly spread, and those of each node among them, so that pixels have the
    right colours, and nodes nearly.

    Args:
        scene: a Mitsuba scene.
        camera: the camera.
        sampling: samples per pixel, a multiple of the nodes per pixel, and seed.
        cells: nodes per pixel along each axis, a power of two.
        field: irradiance that is known beforehand.
        responses: of the channels.
        parts: how many of the first channels each picture by nodes has; the others are those of ``rate``.
    """
    height, width = responses.place.shape
    shared = prepare(scene, camera, None, None, field, responses, False, None)
    assert isinstance(sampling.spp, int)
    mean_signal = responses.mean_signal(light_of(field))[:, sum(parts) :]
    rate = np.zeros((height * width, mean_signal.shape[1]))
    nodes = [plugin.aligned_zeros((height * cells, width * cells, count)) for count in parts]
    by_pixel = [picture.reshape(height, cells, width, cells, -1) for picture in nodes]
    columns = [picture[..., band] for picture in by_pixel for band in range(picture.shape[-1])]
    place = responses.place.ravel()
    by_nodes = node_pass(shared, sampling.spp, cells)
    for block in blocks(shared, sampling, None):
        row, column = np.divmod(np.arange(height * width)[block.pixels], width)
        pairs = _node_sums(by_nodes, block, cells)
        for of_band, (signal, light) in zip(columns, pairs, strict=False):
            # Beside the frame there may be infinite light. The control variate has no bias, whatever the nodes are.
            of_band[row, :, column] = np.nan_to_num(
                ratio_of(signal.astype(float), light.astype(float)), posinf=0.0
            ).reshape(-1, cells, cells)
        for channel, pair in enumerate(pairs[len(columns) :]):
            electrons = at_pixels(mean_signal[:, channel], place[block.pixels])
            rate[block.pixels, channel] = electrons * ratio_of(*(part.sum(axis=1, dtype=float) for part in pair))
    return Pictures(rate.reshape(height, width, -1), nodes)


def _node_sums(by_nodes: NodePass, block: Block, cells: int) -> list[tuple[Float32Array, Float32Array]]:
    """Sums of signal and of control over the rays of each node through a pinhole, per channel [pixel, node]."""
    sums = read_sums(by_nodes.trace(block.batch), int(block.counts[0]) // cells**2, cells**2)
    return list(zip(sums[::2], sums[1::2], strict=True))


def node_pass(shared: Pass, rays: int, cells: int) -> NodePass:
    """A pass by nodes of ``cells`` x ``cells`` per pixel, with so many rays of each pixel."""
    import drjit as dr
    import mitsuba as mi

    each, across, count = (dr.opaque(mi.UInt32, value) for value in (rays // cells**2, cells, cells**2))
    return NodePass(shared, Nodes(each, across, count, mi.UInt32(aligned(_dispersed(cells)))), frozen(_trace_nodes))


def _trace_nodes(shared: Pass, batch: Batch, nodes: Nodes) -> list[Any]:
    """See :meth:`NodePass.trace`."""
    import drjit as dr
    import mitsuba as mi

    lanes = lanes_of(shared, batch)
    numbers = Sobol(batch.points, lanes.sample, lanes.stream)
    film, aim_at, direction, lobe = numbers.next_2d(), numbers.next_2d(), numbers.next_2d(), numbers.next_1d()
    node = lanes.sample // nodes.rays
    film = (film + mi.Point2f(mi.Float(node % nodes.across), mi.Float(node // nodes.across))) / mi.Float(nodes.across)
    number = lanes.sample % nodes.rays
    # Shifted from pixel to pixel: along rows and columns, every node gets all wavelengths.
    column, row = (mi.UInt32(lanes.corner[axis]) for axis in (0, 1))
    shift = mi.sample_tea_32(batch.seed, ORDER_STREAM)[0] + ALONG * column + DOWN * row
    order = (dr.gather(mi.UInt32, nodes.order, node) + shift) % nodes.count
    first = wavelength_places(shared, lanes, number * nodes.count + order)
    rays = aim(shared, batch, lanes, (film, film, film, first))
    si = shared.scene.ray_intersect(rays.ray, ray_flags=mi.RayFlags.All, coherent=True)
    values = signals(shared, lanes, rays, si, [mi.Float(1.0)] * HERO, (aim_at, direction, lobe))
    dr.eval(*values)
    return values


def read_sums(values: Sequence[Any], rays: int, nodes: int) -> list[Float32Array]:
    """Sums of so many consecutive rays each, [pixel, node]."""
    import drjit as dr

    return [np.array(dr.block_sum(value, rays) if rays > 1 else value).reshape(-1, nodes) for value in values]


def _dispersed(cells: int) -> NDArray[np.uint32]:
    """Numbers 0 to ``cells``^2 - 1 of the nodes of a pixel, row by row, of which near ones differ most.

    The matrix of ordered dither: Bayer, IEEE International Conference on Communications 1973.
    """
    order = np.zeros((1, 1), np.uint32)
    while len(order) < cells:
        order = np.block([[4 * order, 4 * order + 2], [4 * order + 3, 4 * order + 1]])
    return order.astype(np.uint32).ravel()
