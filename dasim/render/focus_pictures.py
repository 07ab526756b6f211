"""Pictures with every depth in focus, from rays through a pinhole, in the JIT variants.

In focus all depths have one kernel, that of the stop in its focal plane, so that the picture is the pinhole's convolved
with it. Rays through the pinhole are summed by nodes, a quarter of a pixel each, and the nodes are convolved: a ray
serves all stops, and all pixels that their kernels reach. As many rays that are drawn from the kernel, stop by stop and
pixel by pixel, leave two to four times the noise.

The picture of a channel is a ratio of two convolutions, of response x light x radiance and of response x light, each
with the mean kernel of the channel within ``CORE_PX`` (:meth:`_Core.nodes`). What lies beyond, and what the kernels of
wavelengths differ from their mean by, comes from the pictures in bands that control variates use
(:mod:`dasim.render.control_variate`), convolved with kernels of the sum 0 (:meth:`_Core.rest`).

A node counts with the mean of the pixel's weight over it, and the moments of its light with the slope of the weight:
edges are within 0.05 % of their step of those of a continuous picture, wherever they lie in a node. Off the axis
kernels are wider (:mod:`dasim.render.field_angle`), and distortion stretches them: each tile has those of its middle,
and what lies beyond ``CORE_PX`` those of the middle of the frame.

Tested in tests/dasim/render/test_focus_pictures.py.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from dasim.camera import distortion
from dasim.camera.rings import at_pixels
from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import backend, control_variate, wave
from dasim.render.control_variate import Fine
from dasim.render.irradiance import Field
from dasim.render.pinhole import NodePass, node_pass, read_sums
from dasim.render.radial_blur import RadialBlur, Spectrum, spectrum_of
from dasim.render.ray_block import block_of
from dasim.render.ray_loop import Sampling, ratio_of
from dasim.render.ray_pass import WAVE_BLUR_PX, drawn, light_of, middle_ring, prepare, px_per_m
from dasim.render.wavelengths import BANDS, separate_stop_responses, stop_responses
from dasim.typing import Float32Array, FloatArray

CELLS = 4  # nodes per pixel along each axis
NODES = CELLS**2  # rays of a layer, one per node
FINE = 16  # points per pixel along each axis of the kernels that weights of nodes are means of
MOMENTS = 3  # of the light of a node: its sum, and its sums times the places of its rays along x and y
CORE_PX = 7.0  # radius of the kernels that nodes are convolved with
MARGIN_PX = 8  # around a tile: what these kernels reach from the nodes of a pixel
TILE_PX = 160  # largest side of what is convolved at once
RADIUS_STEP_PX = 0.025  # of the kernels' profiles


class Pictures(NamedTuple):
    """Pictures in mean electrons per second, before the falloff of relative illumination and glare."""

    sharp: FloatArray  # [h, w, channel] through a pinhole, of the camera and then of another one
    of_stops: list[FloatArray]  # [h, w, channel] of each stop, every depth in focus


@dataclass(frozen=True)
class _Core:
    """The kernels of a stop in focus."""

    blur: RadialBlur
    spectrum: Spectrum
    points: int  # of a grid per pixel that has all of them

    def nodes(self, towards_axis: FloatArray) -> Float32Array:
        """Weights of the nodes around a pixel in its mean: for their light, and for its moments along x and y.

        [channel, moment, row, column, y, x] by row and column of a node in its pixel and by that pixel's place, from
        -``MARGIN_PX`` to ``MARGIN_PX``; ``towards_axis`` is that of :func:`_towards_axis`.
        """
        side = 2 * MARGIN_PX + 1
        at = np.arange(side * FINE + FINE - 1) / FINE - (side + 1) / 2 + 1 / FINE
        place = np.stack(np.meshgrid(at, at), axis=-1)
        kernel = self._at(place @ towards_axis.T, whole=True)[..., 0, :]
        kernel *= (np.hypot(*np.moveaxis(place, -1, 0)) <= CORE_PX)[..., None]
        inside = slice(FINE // 2, side * FINE + FINE // 2)
        for axis in (0, 1):  # the mean over the pixel
            kernel = ndimage.uniform_filter1d(kernel, FINE, axis=axis)
        kernel = kernel[inside, inside]
        cells = FINE // CELLS
        kernel = kernel.reshape(side, CELLS, cells, side, CELLS, cells, -1).transpose(6, 1, 4, 0, 3, 2, 5)
        offset = (np.arange(cells) + 0.5) / FINE - 0.5 / CELLS
        slope = offset / np.sum(offset**2) / cells
        moments = [kernel.mean(axis=(-2, -1)), (kernel @ slope).sum(axis=-1), (slope @ kernel).sum(axis=-1)]
        total = moments[0].sum(axis=(1, 2, 3, 4))
        return np.ascontiguousarray(np.stack(moments, axis=1) / total[:, None, None, None, None, None], np.float32)

    def rest(self, towards_axis: FloatArray) -> Float32Array:
        """What the kernels of the bands have besides the share of :meth:`nodes`, [band, channel, y, x], on a grid of
        ``points`` per pixel.
        """
        widest = 1 / np.linalg.svd(towards_axis, compute_uv=False).min()
        half = int(np.ceil(widest * self.blur.extent_px(self.spectrum) * self.points))
        at = np.arange(-half, half + 1) / self.points
        place = np.stack(np.meshgrid(at, at), axis=-1)
        whole = self._at(place @ towards_axis.T)
        whole /= whole.sum(axis=(0, 1, 2))
        core = whole.sum(axis=2) * (np.hypot(*np.moveaxis(place, -1, 0)) <= CORE_PX)[..., None]
        core /= core.sum(axis=(0, 1))
        rest = whole - core[..., None, :] * whole.sum(axis=(0, 1))
        return np.ascontiguousarray(np.moveaxis(rest, (0, 1), (2, 3)), np.float32)

    def _at(self, place: FloatArray, whole: bool = False) -> FloatArray:
        """The kernels at places [y, x, 2] on the axis in pixels, of any scale, [y, x, band, channel]; of all bands
        together, as one, if ``whole``.
        """
        distance = np.hypot(*np.moveaxis(place, -1, 0))
        radius = np.arange(0.0, distance.max() + 2 * RADIUS_STEP_PX, RADIUS_STEP_PX)
        profiles = self.blur.profiles(self.spectrum, np.zeros(1), radius)
        of_bands = profiles[0].sum(axis=1, keepdims=True) if whole else profiles[0]
        return control_variate.on_grid(of_bands, distance, RADIUS_STEP_PX)


def convolvable(camera: Camera, field: Field | None, fine: dict[str, Fine] | None, max_blur_px: float) -> list[int]:
    """Numbers of the stops whose pictures :func:`pictures` makes: discs and rings without aberrations, of wave optics,
    whose kernels the nodes have. For the arguments see there.
    """
    if fine is None:
        return []
    cores = [_core(camera, stop, field, max_blur_px) for stop in camera.stops]
    return [number for number, core in enumerate(cores) if core is not None]


def pictures(
    scene: Any,
    camera: Camera,
    numbers: Sequence[int],
    sampling: Sampling,
    field: Field | None,
    fine: dict[str, Fine],
    also: Camera,
    max_blur_px: float,
) -> Pictures:
    """Pictures through some stops with every depth in focus, and those of the same rays through a pinhole.

    Args:
        scene: a Mitsuba scene.
        camera: the camera.
        numbers: of its stops, from :func:`convolvable`.
        sampling: rays of each pixel, [h, w], rounded down to a multiple of ``NODES``, and seed.
        field: irradiance that is known beforehand.
        fine: pictures in bands, by the stops' names.
        also: another camera behind the same lens, whose pinhole picture is made, too.
        max_blur_px: largest visible blur of the scene, by which other pictures have found the stops' tables.
    """
    stops = [camera.stops[number] for number in numbers]
    found = [_core(camera, stop, field, max_blur_px) for stop in stops]
    cores = [core for core in found if core is not None]
    wide = control_variate.wider(camera, MARGIN_PX)
    responses = separate_stop_responses(wide, stops, also)
    shared = prepare(scene, wide, None, None, field, responses, False, None)
    height, width = camera.sensor.height_px, camera.sensor.width_px
    result = np.empty((height, width, responses.channels))
    layers = np.pad(np.asarray(sampling.spp) // NODES, MARGIN_PX, mode="edge")
    tiles = list(_tiles(height, width))
    by_nodes = node_pass(shared, NODES, CELLS)
    for number, (rows, columns) in enumerate(tiles):
        seed = int(np.random.SeedSequence((sampling.seed, number)).generate_state(1)[0])
        middle = np.array([columns.start + columns.stop, rows.start + rows.stop]) / 2
        kernels = np.concatenate([core.nodes(_towards_axis(camera, middle)) for core in cores])
        moments, sums = _summed(by_nodes, (rows, columns), layers, seed, len(kernels))
        result[rows, columns, : len(kernels)] = _convolved(moments, kernels)
        by_pixel = sums[..., MARGIN_PX:-MARGIN_PX, MARGIN_PX:-MARGIN_PX]
        result[rows, columns, len(kernels) :] = np.moveaxis(ratio_of(by_pixel[:, 0], by_pixel[:, 1]), 0, -1)
        sampling.progress((number + 1) / len(tiles))
    *of_stops, sharp = _parts(result, cores)
    of_frame = _towards_axis(camera, np.array([width, height]) / 2)
    for stop, core, part in zip(stops, cores, of_stops, strict=True):
        part += control_variate.convolved(fine[stop.name], core.rest(of_frame), core.points)
    inside, signal = slice(MARGIN_PX, -MARGIN_PX), responses.mean_signal(light_of(field))
    for channel in range(responses.channels):
        result[..., channel] *= at_pixels(signal[:, channel], responses.place[inside, inside])
    return Pictures(sharp, of_stops)


def _core(camera: Camera, stop: Stop, field: Field | None, max_blur_px: float) -> _Core | None:
    """The kernels of a stop; None for one that is not radial, or too fine for the nodes."""
    responses, light = stop_responses(camera, stop), light_of(field)
    if responses.mean_signal(light).max() <= 0:
        return None
    density, table = drawn(camera, responses, light)
    blur = wave.blur(camera, stop, density, wave.blur_range_px(camera, max_blur_px, WAVE_BLUR_PX))
    if not isinstance(blur, RadialBlur) or blur.aberrated is not None:
        return None
    nodes = table[middle_ring(responses)]
    in_focus = np.zeros(len(nodes))
    spectrum = spectrum_of(nodes[:, 0], nodes[:, 2:-1] * nodes[:, -1:], in_focus, BANDS)
    points = blur.points(spectrum, CELLS)
    return None if points is None else _Core(blur, spectrum, points)


def _parts(picture: FloatArray, cores: Sequence[_Core]) -> Iterator[FloatArray]:
    """The channels of each stop, and the others, of a picture."""
    count = cores[0].spectrum.weight.shape[-1]
    for number in range(len(cores)):
        yield picture[..., number * count : (number + 1) * count]
    yield picture[..., len(cores) * count :]


def _tiles(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of tiles of about one size."""
    edges = [np.linspace(0, size, -(-size // TILE_PX) + 1).astype(int).tolist() for size in (height, width)]
    across, along = ([slice(*pair) for pair in itertools.pairwise(of)] for of in edges)
    return itertools.product(across, along)


def _towards_axis(camera: Camera, place_px: FloatArray) -> FloatArray:
    """Matrix from offsets (x, y) about a place of the frame to those of the pattern on the axis, in pixels."""
    place = place_px - principal_point(camera.sensor)
    ends = distortion.to_pinhole_px(camera, place + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    stretch = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=-1)
    tangent = distortion.to_pinhole_px(camera, place) / px_per_m(camera)
    square = 1 / (1 + tangent @ tangent)  # of the cosine; as in field_angle.foreshortened
    return np.asarray(np.sqrt(square) * (np.eye(2) - np.outer(tangent, tangent) * square) @ stretch)


def _summed(
    by_nodes: NodePass, tile: tuple[slice, slice], layers: NDArray[np.int64], seed: int, kept: int
) -> tuple[Float32Array, FloatArray]:
    """Moments of signal and light over the nodes of a tile and its margin, [channel, 2, moment, y, x, node], of the
    first ``kept`` channels, and the sums of the others over pixels, [channel, 2, y, x].

    ``layers`` are the rays per node of each pixel of the frame and its margin, [h, w].
    """
    rows, columns = (np.arange(side.start, side.stop + 2 * MARGIN_PX) for side in tile)
    counts = layers[rows[:, None], columns].ravel()
    pixel = (rows[:, None] * layers.shape[1] + columns).ravel()
    moments = np.zeros((kept, 2, MOMENTS, len(pixel), NODES), np.float32)
    sums = np.zeros((by_nodes.shared.channels - kept, 2, len(pixel)))
    of_layers = [np.flatnonzero(counts > number) for number in range(counts.max())]
    own, layer = np.concatenate(of_layers), np.repeat(np.arange(len(of_layers)), [len(of) for of in of_layers])
    most = max(1, backend.lanes() // NODES)
    for first in range(0, len(own), most):
        part = slice(first, first + most)
        of_nodes, of_pixels, offset = _layer_sums(by_nodes, pixel[own[part]], layer[part], (seed + first) % 2**32, kept)
        for number in np.unique(layer[part]):  # each pixel once
            here = np.flatnonzero(layer[part] == number)
            rays, at = slice(here[0], here[-1] + 1), _consecutive(own[part][here])
            for planes, values in zip(moments.reshape(-1, MOMENTS, len(pixel), NODES), of_nodes, strict=True):
                total, *firsts = planes
                total[at] += values[rays]
                for first_moment, places in zip(firsts, offset, strict=True):
                    first_moment[at] += values[rays] * places[rays]
            for plane, values in zip(sums.reshape(-1, len(pixel)), of_pixels, strict=True):
                plane[at] += values[rays, 0]
    moments /= counts[:, None].astype(np.float32)
    size = len(rows), len(columns)
    return moments.reshape(kept, 2, MOMENTS, *size, NODES), sums.reshape(-1, 2, *size)


def _consecutive(numbers: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Ascending numbers, as a slice where none is left out."""
    is_whole = numbers[-1] - numbers[0] + 1 == len(numbers)
    return slice(int(numbers[0]), int(numbers[-1]) + 1) if is_whole else numbers


def _layer_sums(
    by_nodes: NodePass, pixel: NDArray[np.intp], layer: NDArray[np.intp], seed: int, kept: int
) -> tuple[list[Float32Array], list[Float32Array], list[Float32Array]]:
    """Signal and light, alternating by channel, of one ray per node of some pixels.

    Those of the first ``kept`` channels are by nodes, [pixel, node]; the others are sums, [pixel, 1]. Beside them are
    the places of the rays about the middles of their nodes, along x and y, in pixels. A pixel may be there several
    times, each time with another ``layer``, which has random numbers of its own.
    """
    block = block_of(pixel, np.full(len(pixel), NODES), seed, layer)
    values, within = by_nodes.trace(block.batch), by_nodes.places(block.batch)
    offsets = read_sums([(place - 0.5) / CELLS for place in (within.x, within.y)], 1, NODES)
    of_nodes, of_pixels = values[: 2 * kept], values[2 * kept :]
    return read_sums(of_nodes, 1, NODES), read_sums(of_pixels, NODES, 1), offsets


def _convolved(sums: Float32Array, kernels: Float32Array) -> FloatArray:
    """Ratios of signal to light of the pixels of a tile, after convolution, [y, x, channel].

    Args:
        sums: moments of the nodes of a tile and its margin, [channel, 2, moment, y, x, node].
        kernels: as of :meth:`_Core.nodes`.
    """
    height, width = sums.shape[3:5]
    shape = tuple(fft.next_fast_len(side, real=True) for side in (height, width))
    inside = slice(2 * MARGIN_PX, height), slice(2 * MARGIN_PX, width)
    result = np.empty((height - 2 * MARGIN_PX, width - 2 * MARGIN_PX, len(sums)))
    for channel, (pair, kernel) in enumerate(zip(sums, kernels, strict=True)):
        # A correlation: the kernel's place is that of the node.
        spectra = np.zeros((2, shape[0], shape[1] // 2 + 1), np.complex64)
        for moment, of_moment in enumerate(kernel.reshape(MOMENTS, NODES, *kernel.shape[3:])):
            transfer = control_variate.padded_spectrum(of_moment[:, ::-1, ::-1], shape)
            for spectrum, part in zip(spectra, pair[:, moment], strict=True):
                spectrum += (fft.rfft2(np.moveaxis(part, -1, 0), shape) * transfer).sum(axis=0)
        signal, light = (fft.irfft2(spectrum, shape)[inside].astype(float) for spectrum in spectra)
        result[..., channel] = ratio_of(signal, light)
    return result
