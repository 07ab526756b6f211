"""Pinhole pictures on the pixels and on the nodes of a finer grid, from the same rays, in the JIT variants.

The pixel pictures are the truth ``sharp_e`` and the colours of ``sharp_srgb``. The node pictures cover the frame and a
margin: the control variate blurs them (:mod:`dasim.render.control_variate`), and the in-focus picture is convolved from
the nodes (:mod:`dasim.render.focus_pictures`). Rays are traced tile by tile.

Tested in tests/dasim/render/test_ray_loop.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.camera.rings import at_pixels
from dasim.camera.specification import Camera
from dasim.render import backend, plugin
from dasim.render.frozen import frozen
from dasim.render.host_threads import in_threads
from dasim.render.irradiance import Field
from dasim.render.plugin import aligned
from dasim.render.ray_batches import Batch, Sampling, block_of
from dasim.render.ray_block import HERO, aim, lanes_of, wavelength_places
from dasim.render.ray_loop import ratio_of, signals
from dasim.render.ray_pass import Pass, light_of, prepare
from dasim.render.sobol import Sobol
from dasim.render.wavelengths import Responses
from dasim.typing import Float32Array, FloatArray

CELLS = 4  # nodes per pixel along each axis
NODES = CELLS**2
BORDER_CELLS = 2  # nodes per pixel and axis in a border, where ratios from the light of single rays would be 0.1 % off
MOMENTS = 3  # moments of the light of a node: its sum, and its sums weighted by the positions of its rays along x and y
MOST_TILE_PX = 1 << 16  # pixels that are traced at once on a graphics card: the host keeps some 4 KB of each
ORDER_STREAM = 254  # of random numbers, for the shift of the nodes' order
ALONG, DOWN = 5, 7  # shift of the nodes' order from pixel to pixel, odd
EVEN_PX = 9  # side of the square of pixels over which the nodes of each order are averaged, see :func:`without_dither`

Tile = tuple[slice, slice]  # rows and columns of a frame


@dataclass(frozen=True)
class Nodes:
    """Nodes of a pixel in the renderer's memory; numbers are opaque."""

    rays: Any  # of each node
    order: Any  # of their wavelengths, see :func:`_dispersed`
    shift: Any  # of that order in the first pixel


class Pictures(NamedTuple):
    """Pictures through a pinhole of the same rays, by pixels and by the nodes of a finer grid."""

    # [half, h, w, channel] mean electrons per second of two halves of the rays, before the falloff of relative
    # illumination; 0 in a border
    rate: NDArray[np.float32]
    nodes: list[NDArray[np.float32]]  # [y, x, channel] electrons over those of a surface of the lights' radiance


class NodeLight(NamedTuple):
    """Light of the nodes in one channel, each [y, x, node]: sums over the rays, or ``MOMENTS``.

    The moments are these sums and the sums weighted by the rays' positions along x and y, in pixels from the centres of
    the nodes.
    """

    signal: list[Float32Array]  # response x light x radiance
    even: list[Float32Array]  # the same with the radiance of the lights
    halves: Float32Array  # [2, half, y, x] sums of both over the nodes of a pixel, of two halves of the rays


class Collect(Protocol):
    """Callback that receives the light of the nodes of a tile, channel by channel."""

    def __call__(self, tile: Tile, channel: int, light: NodeLight) -> None:
        """Take the light of the nodes of a tile."""


@dataclass(frozen=True)
class Channels:
    """How the channels of a node pass are used, in their order."""

    parts: Sequence[int]  # number of channels of each node picture; these channels come first
    totals: Sequence[Sequence[int]]  # indices of the channels that add up to each channel of the pixel picture
    collected: int = 0  # number of channels after ``parts`` that ``collect`` receives, by their indices among these
    collect: Collect = lambda tile, channel, light: None


def pictures(
    scene: Any,
    camera: Camera,
    sampling: Sampling,
    cells: int,
    field: Field | None,
    responses: Responses,
    channels: Channels,
    border_px: int = 0,
) -> Pictures:
    """Pictures through a pinhole by pixels, and by nodes of ``cells`` x ``cells`` per pixel.

    The wavelengths of the rays of a pixel are evenly spread, and those of each node among them, so that pixels have the
    right colours, and nodes nearly (:func:`without_dither`).

    Args:
        scene: a Mitsuba scene.
        camera: the camera.
        sampling: samples per pixel, a multiple of ``2 * NODES``, and seed.
        cells: nodes per pixel of the pictures by nodes along each axis, a power of two, ``CELLS`` at most.
        field: irradiance that is known beforehand.
        responses: of the channels.
        channels: what is made of them.
        border_px: width of a border of the pictures by nodes alone, with ``NODES`` samples.
    """
    shared = prepare(scene, camera, None, None, field, responses, False, None)
    assert isinstance(sampling.spp, int)
    height, width = responses.place.shape
    signal = responses.mean_signal(light_of(field))
    rate = np.zeros((2, height, width, len(channels.totals)), np.float32)
    nodes = [plugin.aligned_zeros((height * cells, width * cells, count)) for count in channels.parts]
    bands = [picture[..., band] for picture in nodes for band in range(picture.shape[-1])]
    shift = int(np.random.SeedSequence((sampling.seed, ORDER_STREAM)).generate_state(1)[0]) % NODES
    trace, seed = _node_pass(shared, shift), sampling.block_seeds(None)
    pixels = np.arange(height * width).reshape(height, width)
    tiles = list(_tiles(height, width, border_px, sampling.spp))
    with_moments = range(len(bands), len(bands) + channels.collected)

    def keep(tile: Tile, is_border: bool, channel: int, light: NodeLight) -> None:
        if channel < len(bands):
            # Beside the frame there may be infinite light. The control variate has no bias, whatever the nodes are.
            across = min(cells, BORDER_CELLS) if is_border else cells
            ratio = ratio_of(_on_grid(light.signal[0], across), _on_grid(light.even[0], across))
            here = tuple(slice(side.start * cells, side.stop * cells) for side in tile)
            bands[channel][here] = np.kron(np.nan_to_num(ratio, posinf=0.0), np.ones((cells // across,) * 2))
        elif channel in with_moments:
            channels.collect(tile, channel - len(bands), light)

    for number, (rows, columns, is_border) in enumerate(tiles):
        spp, last = (NODES, len(bands)) if is_border else (sampling.spp, responses.channels)
        of_tile = partial(keep, (rows, columns), is_border)
        halves = _node_sums(trace, pixels[rows, columns], spp, seed(number), range(last), with_moments, of_tile)
        if not is_border:
            for channel, parts in enumerate(channels.totals):
                sums = np.sum([halves[part] for part in parts], axis=0, dtype=float)
                electrons = at_pixels(signal[:, list(parts)].sum(axis=1), responses.place[rows, columns])
                rate[:, rows, columns, channel] = electrons * ratio_of(*sums)
        sampling.progress((number + 1) / len(tiles))
    for picture in nodes:
        without_dither(picture, cells, shift, border_px)
    return Pictures(rate, nodes)


def without_dither(picture: NDArray[np.float32], cells: int, shift: int, border_px: int) -> None:
    """Subtract from nodes [y, x, band] the mean error of their few wavelengths, in place, except in the border.

    Rays of few wavelengths give a node an error that depends on the order of its wavelengths among those of its pixel
    (up to a quarter of the light, where reflectance rises within a band). Each pixel has nodes of all orders, and the
    node of an order moves from pixel to pixel. The error of an order is the mean of its nodes over ``EVEN_PX`` pixels
    around, less that of all nodes. Means over a pixel do not change.
    """
    height, width = (length // cells - 2 * border_px for length in picture.shape[:2])
    if min(height, width) < 1:
        return
    row, column = np.ogrid[border_px : border_px + height, border_px : border_px + width]
    orders = cells**2
    # Nodes of ``cells`` per pixel have several of the orders, which leave the same remainder.
    node_of = np.argsort(_dispersed().reshape(CELLS, CELLS)[:: CELLS // cells, :: CELLS // cells].ravel() % orders)
    first = row * (cells * picture.shape[1]) + column * cells  # of each pixel, in the picture
    within = (np.arange(orders) // cells * picture.shape[1] + np.arange(orders) % cells)[node_of]
    shifted = -(shift + ALONG * column + DOWN * row) % orders
    inner = picture[border_px * cells :, border_px * cells :][: height * cells, : width * cells]
    nodes = picture.reshape(-1, picture.shape[-1])
    mean = _around(inner.reshape(height, cells, width, cells, -1).mean(axis=(1, 3)))

    def subtract(order: int) -> None:
        place = first + np.roll(within, -order)[shifted]
        own = nodes[place]
        nodes[place] = own - (_around(own) - mean)

    in_threads(subtract, range(orders))


def _around(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mean over ``EVEN_PX`` pixels around each pixel of an image [h, w, band]."""
    return np.asarray(cv2.blur(np.ascontiguousarray(image), (EVEN_PX, EVEN_PX))).reshape(image.shape)


def _tiles(height: int, width: int, border: int, spp: int) -> Iterator[tuple[slice, slice, bool]]:
    """Rows and columns of tiles of a frame, and whether they are in its border: for ``NODES`` samples, or ``spp``."""
    top, bottom, left, right = border, height - border, border, width - border
    for rows, columns, is_border in (
        ((0, top), (0, width), True),
        ((top, bottom), (0, left), True),
        ((top, bottom), (left, right), False),
        ((top, bottom), (right, width), True),
        ((bottom, height), (0, width), True),
    ):
        most = min(backend.lanes() // (NODES if is_border else spp), MOST_TILE_PX)
        high = rows[1] - rows[0]
        if high and columns[0] < columns[1]:
            across = list(_split(*columns, max(int(np.sqrt(most)), most // high)))
            widest = max(side.stop - side.start for side in across)
            yield from ((part, side, is_border) for part in _split(*rows, most // widest) for side in across)


def _split(first: int, last: int, most: int) -> Iterator[slice]:
    """Parts of about one size, of ``most`` at most, of the numbers from the first to the last."""
    edges = np.linspace(first, last, -((first - last) // most) + 1).astype(int).tolist()
    return (slice(*pair) for pair in itertools.pairwise(edges))


def _on_grid(values: Float32Array, cells: int) -> FloatArray:
    """Sums over the nodes [y, x, node] of each of ``cells`` x ``cells`` squares of the pixels, [y, x]."""
    height, width, within = *values.shape[:2], CELLS // cells
    squares = values.reshape(height, width, cells, within, cells, within).sum(axis=(3, 5), dtype=float)
    return squares.transpose(0, 2, 1, 3).reshape(height * cells, width * cells)


def _node_pass(shared: Pass, shift: int) -> Callable[[Batch, int], tuple[list[Any], Any]]:
    """:func:`_trace_nodes`, by a batch and the rays of a node; ``shift`` is that of :class:`Nodes`."""
    import drjit as dr
    import mitsuba as mi

    trace, order, first = frozen(_trace_nodes), mi.UInt32(aligned(_dispersed())), dr.opaque(mi.UInt32, shift)
    return lambda batch, rays: trace(shared, batch, Nodes(dr.opaque(mi.UInt32, rays), order, first))


def _node_sums(
    trace: Callable[[Batch, int], tuple[list[Any], Any]],
    pixels: NDArray[np.intp],
    spp: int,
    seed: int,
    channels: range,
    with_moments: range,
    keep: Callable[[int, NodeLight], None],
) -> list[Float32Array]:
    """Trace ``spp`` rays for each of some pixels, [h, w]; their halves in some channels, see :class:`NodeLight`.

    ``keep`` gets each channel apart, and several of them at once from as many threads: the light of a tile together
    would take 100 MB.
    """
    rays = spp // NODES
    values, offset = trace(block_of(pixels.ravel(), np.full(pixels.size, spp), seed).batch, rays)
    places = [np.array(along) for along in offset]

    def by_ray(value: NDArray[np.float32]) -> NDArray[np.float32]:
        return value.reshape(*pixels.shape, NODES, rays).transpose(3, 0, 1, 2)

    # Each half of the rays has some of all nodes, and evenly spread wavelengths.
    odd = (_dispersed() % 2).astype(np.float32)
    even = 1 - odd
    read = [np.array(value) for value in values[: 2 * channels.stop]]

    def sums(channel: int) -> Float32Array:
        pair, halves = [], []
        for of_rays in read[2 * channel : 2 * channel + 2]:
            first, second = (_sum(part) for part in np.split(by_ray(of_rays), [rays // 2]))
            halves.append([first @ even + second @ odd, first @ odd + second @ even])
            moments = [_sum(by_ray(of_rays * along)) for along in places if channel in with_moments]
            pair.append([first + second, *moments])
        light = NodeLight(pair[0], pair[1], np.array(halves))
        keep(channel, light)
        return light.halves

    return in_threads(sums, channels)


def _sum(parts: NDArray[np.float32]) -> Float32Array:
    """The sum over the first axis, which is not the last one in memory; faster than NumPy's."""
    total = np.zeros(parts.shape[1:], np.float32)
    for part in parts:
        total += part
    return total


def _trace_nodes(shared: Pass, batch: Batch, nodes: Nodes) -> tuple[list[Any], Any]:
    """Signal and light of rays through a pinhole, alternating by channel, with the rays of a node consecutive; and the
    offsets of the rays from the centres of their nodes, in pixels.
    """
    import drjit as dr
    import mitsuba as mi

    lanes = lanes_of(shared, batch)
    numbers = Sobol(batch.points, lanes.sample, lanes.stream)
    within, aim_at, direction, lobe = numbers.next_2d(), numbers.next_2d(), numbers.next_2d(), numbers.next_1d()
    node = lanes.sample // nodes.rays
    film = (within + mi.Point2f(mi.Float(node % CELLS), mi.Float(node // CELLS))) / CELLS
    number = lanes.sample % nodes.rays
    # Shifted from pixel to pixel: along rows and columns, every node gets all wavelengths.
    column, row = (mi.UInt32(lanes.corner[axis]) for axis in (0, 1))
    order = (dr.gather(mi.UInt32, nodes.order, node) + nodes.shift + ALONG * column + DOWN * row) % NODES
    first = wavelength_places(shared, lanes, number * NODES + order)
    rays = aim(shared, batch, lanes, (film, film, film, first))
    si = shared.scene.ray_intersect(rays.ray, ray_flags=mi.RayFlags.All, coherent=True)
    values = signals(shared, lanes, rays, si, [mi.Float(1.0)] * HERO, (aim_at, direction, lobe))
    offset = (within - 0.5) / CELLS
    dr.eval(*values, offset)
    return values, offset


def _dispersed() -> NDArray[np.uint32]:
    """Order of the nodes of a pixel, row by row, in which the numbers of close nodes differ most.

    The matrix of ordered dither: Bayer, IEEE International Conference on Communications 1973.
    """
    order = np.zeros((1, 1), np.uint32)
    while len(order) < CELLS:
        order = np.block([[4 * order, 4 * order + 2], [4 * order + 3, 4 * order + 1]])
    return order.astype(np.uint32).ravel()
