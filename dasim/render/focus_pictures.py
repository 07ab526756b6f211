"""Pictures with every depth in focus, from rays through a pinhole, in the JIT variants.

In focus, all depths have the same kernel, that of the stop in its focal plane, so the picture is the pinhole picture
convolved with it. Pinhole rays are summed by nodes, a quarter of a pixel wide, and the nodes are convolved: each ray
serves all stops, and all pixels within reach of their kernels. The same number of rays sampled from the kernel,
separately for each stop and pixel, would leave two to four times the noise.

The picture of a channel is a ratio of two convolutions, of response x light x radiance and of response x light, both
with the mean kernel of the channel within ``CORE_PX`` (:meth:`_Core.nodes`). The light beyond that radius and the
deviations of the kernels of single wavelengths from their mean are added from the band pictures of the control variates
(:mod:`dasim.render.control_variate`), convolved with kernels whose sum is 0 (:meth:`_Core.rest`).

Each node is weighted by the mean of the pixel's weight over it, and the moments of its light by the slope of the
weight: edges deviate by less than 0.05 % of their step from those of a continuous picture, wherever they lie within a
node. Off the axis, kernels are wider (:mod:`dasim.render.field_angle`), and distortion stretches them: each tile uses
the kernels of its centre, and the part beyond ``CORE_PX`` uses those of the frame's centre.

Tested in tests/dasim/render/test_focus_pictures.py.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from dasim.camera import distortion
from dasim.camera.rings import at_pixels
from dasim.camera.sensor import channels, principal_point
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.render import control_variate, wave
from dasim.render.control_variate import Fine
from dasim.render.irradiance import Field
from dasim.render.pinhole import CELLS, MOMENTS, NODES, NodeLight, Tile
from dasim.render.radial_blur import RadialBlur, Spectrum, spectrum_of
from dasim.render.ray_loop import ratio_of
from dasim.render.ray_pass import WAVE_BLUR_PX, drawn, light_of, middle_ring, px_per_m
from dasim.render.wavelengths import BANDS, stop_responses
from dasim.typing import Float32Array, FloatArray

FINE = 16  # samples per pixel and axis of the kernels, whose means are the weights of the nodes
CORE_PX = 7.0  # radius of the kernels with which the nodes are convolved
MARGIN_PX = 8  # margin around a tile: the reach of these kernels from the nodes of a pixel
RADIUS_STEP_PX = 0.025  # radial step of the kernels' profiles


@dataclass(frozen=True)
class _Core:
    """The kernels of a stop in focus."""

    blur: RadialBlur
    spectrum: Spectrum
    points: int  # points per pixel of a grid that resolves the kernels

    def nodes(self, towards_axis: FloatArray) -> Float32Array:
        """Weights of the nodes in the mean of a pixel, for their light and for its moments along x and y.

        The axes are [channel, moment, row, column, y, x]: row and column of the node within its pixel, and offset y, x
        of that pixel from -``MARGIN_PX`` to ``MARGIN_PX``. ``towards_axis`` is the matrix of :func:`_towards_axis`.
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
        """Kernels of the bands minus the part that :meth:`nodes` applies, [band, channel, y, x].

        They are sampled on a grid of ``points`` per pixel.
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
        """On-axis kernels at positions [y, x, 2] in pixels, not normalised, [y, x, band, channel].

        With ``whole``, the bands are summed into a single one.
        """
        distance = np.hypot(*np.moveaxis(place, -1, 0))
        radius = np.arange(0.0, distance.max() + 2 * RADIUS_STEP_PX, RADIUS_STEP_PX)
        profiles = self.blur.profiles(self.spectrum, np.zeros(1), radius)
        of_bands = profiles[0].sum(axis=1, keepdims=True) if whole else profiles[0]
        return control_variate.on_grid(of_bands, distance, RADIUS_STEP_PX)


class InFocus:
    """Pictures through some stops with every depth in focus, of rays through a pinhole."""

    def __init__(self, camera: Camera, field: Field | None, max_blur_px: float, margin_px: int) -> None:
        """Prepare the stops whose kernels the nodes resolve: discs and rings without aberrations.

        Args:
            camera: the camera.
            field: irradiance that is known beforehand.
            max_blur_px: largest visible blur of the scene, the same as for its other pictures, so that they share the
                stops' tables.
            margin_px: width of the margin around the frame in which rays are collected.
        """
        cores = {number: _core(camera, stop, field, max_blur_px) for number, stop in enumerate(camera.stops)}
        self._cores = {number: core for number, core in cores.items() if core is not None}
        self._camera, self._margin_px = camera, margin_px
        size = camera.sensor.height_px, camera.sensor.width_px
        self._sums = np.zeros((len(self._cores), len(channels(camera.sensor)), 2, *size), np.float32)
        self._kernels: tuple[Tile | None, Float32Array] = None, np.zeros((), np.float32)
        self._lock = threading.Lock()

    @property
    def stops(self) -> list[Stop]:
        """These stops."""
        return [self._camera.stops[number] for number in self._cores]

    @property
    def count(self) -> int:
        """Number of channels of all of them."""
        return self._sums.shape[0] * self._sums.shape[1]

    def collect(self, tile: Tile, channel: int, light: NodeLight) -> None:
        """Add the light of a tile, see :class:`dasim.render.pinhole.Collect`; channels are those of the stops, one stop
        after the other.
        """
        spread = _convolved(light, self._of_tile(tile)[channel])
        # It reaches the pixels up to MARGIN_PX away.
        size = self._sums.shape[-2:]
        first = [side.start - self._margin_px - MARGIN_PX for side in tile]
        inside = [slice(max(0, -start), max(0, side - start)) for start, side in zip(first, size, strict=True)]
        y, x = (max(0, start) for start in first)
        spread = spread[:, *inside]
        sums = self._sums[divmod(channel, self._sums.shape[1])]
        sums[:, y : y + spread.shape[1], x : x + spread.shape[2]] += spread

    def _of_tile(self, tile: Tile) -> Float32Array:
        """The weights of the nodes for all channels, see :meth:`_Core.nodes`."""
        with self._lock:  # channels come from several threads
            if self._kernels[0] != tile:
                rows, columns = tile
                middle = np.array([columns.start + columns.stop, rows.start + rows.stop]) / 2 - self._margin_px
                towards_axis = _towards_axis(self._camera, middle)
                self._kernels = tile, np.concatenate([core.nodes(towards_axis) for core in self._cores.values()])
            return self._kernels[1]

    def pictures(self, field: Field | None, fine: dict[str, Fine]) -> dict[int, Float32Array]:
        """The pictures by the stops' numbers, [h, w, channel] mean electrons per second, before the falloff of relative
        illumination and glare; ``fine`` are pictures in bands, by the stops' names.
        """
        camera, (height, width) = self._camera, self._sums.shape[-2:]
        of_frame, result = _towards_axis(camera, np.array([width, height]) / 2), {}
        for (number, core), sums in zip(self._cores.items(), self._sums, strict=True):
            stop = camera.stops[number]
            picture = control_variate.convolved(fine[stop.name], core.rest(of_frame), core.points)
            responses = stop_responses(camera, stop)
            signal = responses.mean_signal(light_of(field))
            for channel in range(picture.shape[-1]):  # one by one: all of a large frame take gigabytes
                picture[..., channel] += ratio_of(*sums[channel].astype(float))
                picture[..., channel] *= at_pixels(signal[:, channel], responses.place)
            result[number] = picture
        return result


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


def _towards_axis(camera: Camera, place_px: FloatArray) -> FloatArray:
    """Matrix that maps offsets (x, y) from a position in the frame to offsets in the on-axis pattern, in pixels."""
    place = place_px - principal_point(camera.sensor)
    ends = distortion.to_pinhole_px(camera, place + np.array([[0.5, 0], [-0.5, 0], [0, 0.5], [0, -0.5]]))
    stretch = np.stack([ends[0] - ends[1], ends[2] - ends[3]], axis=-1)
    tangent = distortion.to_pinhole_px(camera, place) / px_per_m(camera)
    square = 1 / (1 + tangent @ tangent)  # of the cosine; as in field_angle.foreshortened
    return np.asarray(np.sqrt(square) * (np.eye(2) - np.outer(tangent, tangent) * square) @ stretch)


def _convolved(light: NodeLight, kernel: Float32Array) -> Float32Array:
    """Signal and light that the nodes of a tile contribute to its pixels and to a margin around it, [2, y, x].

    Args:
        light: moments of the nodes of the tile.
        kernel: weights of the nodes for the channel, from :meth:`_Core.nodes`.
    """
    height, width = (side + 2 * MARGIN_PX for side in light.signal[0].shape[:2])
    shape = tuple(fft.next_fast_len(side, real=True) for side in (height, width))
    spectra = np.zeros((2, shape[0], shape[1] // 2 + 1), np.complex64)
    for number, of_moment in enumerate(kernel.reshape(MOMENTS, NODES, *kernel.shape[3:])):
        # A correlation: the kernel's place is that of the node.
        transfer = control_variate.padded_spectrum(of_moment[:, ::-1, ::-1], shape)
        for spectrum, of in zip(spectra, (light.signal, light.even), strict=True):
            own = control_variate.padded_spectrum(np.moveaxis(of[number], -1, 0), shape)
            spectrum += (own * transfer).sum(axis=0)
    return np.asarray(fft.irfft2(spectra, shape)[:, :height, :width])
