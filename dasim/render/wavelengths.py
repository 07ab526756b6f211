"""Wavelengths of a pass: the responses on the rings of the field, and how densely wavelengths are drawn for them.

Tested in tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera import geometry, radiometry
from dasim.camera.rings import rings
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.camera.stops import Stop
from dasim.spectra import grid
from dasim.typing import FloatArray

DRAW_NODES = 4096  # of the table that turns a uniform number into a wavelength
BANDS = 3  # of the control variate's spectra, at equal steps of probability of a stop's wavelengths
EVEN_SHARE = 0.1  # fraction of the wavelengths that is sampled as under a light of constant spectrum


class Responses(NamedTuple):
    """Electrons per second per unit of spectral radiance on the rings of a frame (:mod:`dasim.camera.rings`)."""

    of_pass: FloatArray  # [ring, channel, wavelength]
    of_camera: FloatArray  # [ring, channel, wavelength] all stops together
    place: FloatArray  # [h, w] fractional ring of each pixel

    @property
    def channels(self) -> int:
        """Number of channels."""
        return self.of_pass.shape[1]

    def mean_signal(self, light: FloatArray) -> FloatArray:
        """Electrons on each ring for a radiance of spectrum ``light`` [wavelength], [ring, channel]."""
        return np.asarray(grid.integrate_product(self.of_pass, light))


def stop_responses(camera: Camera, stop: Stop) -> Responses:
    """Responses of a pass through one stop."""
    angles, place = rings(camera)
    whole = np.stack([radiometry.response(camera, angle) for angle in angles])
    return Responses(np.stack([radiometry.stop_response(camera, stop, angle) for angle in angles]), whole, place)


def pinhole_responses(camera: Camera, also: Camera | None = None) -> Responses:
    """Responses of a pass through a pinhole: those of all stops, followed by those of another camera's sensor."""
    cameras = (camera,) if also is None else (camera, also)
    angles, place = rings(*cameras)
    whole = np.stack([np.concatenate([radiometry.response(each, angle) for each in cameras]) for angle in angles])
    return Responses(whole, whole, place)


def separate_responses(
    camera: Camera, also: Camera, light: FloatArray, densities: Sequence[FloatArray], stops: Sequence[Stop]
) -> tuple[Responses, list[list[int]]]:
    """Responses of a pass through a pinhole, and the indices of those that add up to each channel of the camera and of
    ``also``.

    The responses are the bands of each stop, then the camera's channels through each of ``stops``, then the camera's
    own channels (unless ``stops`` are all of its stops) and those of ``also``. The bands are those of :func:`tents`
    under ``light``, for the ``densities`` of the stops' wavelengths on the grid.
    """
    whole = pinhole_responses(camera, also)
    bands = np.concatenate([tents(_cumulative(density)).T * density / light for density in densities])
    count = len(channels(camera.sensor))
    rest = slice(count if len(stops) == len(camera.stops) else 0, None)
    of_pass, of_camera = [], []
    for angle, part in zip(rings(camera, also).angle_deg, whole.of_pass, strict=True):
        through = [radiometry.stop_response(camera, stop, angle) for stop in stops]
        of_pass.append(np.concatenate([bands, *through, part[rest]]))
        of_camera.append(np.concatenate([bands, *[part[:count]] * len(stops), part[rest]]))
    first = len(bands) + count * len(stops)
    totals = [list(range(len(bands) + channel, first, count)) for channel in range(rest.start)]
    totals += [[channel] for channel in range(first, len(of_pass[0]))]
    return Responses(np.stack(of_pass), np.stack(of_camera), whole.place), totals


def tents(place: FloatArray) -> FloatArray:
    """Weights of linear interpolation between ``BANDS`` nodes, evenly spaced over 0..1, at positions, [..., band]."""
    return np.asarray(np.maximum(1 - np.abs(place[..., None] * (BANDS - 1) - np.arange(BANDS)), 0.0))


def at_bands(means: NDArray[np.float32]) -> None:
    """Convert means of a function that is linear between the band nodes, weighted by :func:`tents`, to its values at
    the nodes, in place.

    ``means`` is [y, x, band]; each mean is over evenly spaced positions.
    """
    places = (np.arange(512) + 0.5) / 512
    shares = tents(places)
    inverse = np.linalg.inv(shares.T @ shares / shares.sum(axis=0)[:, None]).astype(np.float32)
    for row in means:  # apart: those of a large frame take gigabytes
        row[:] = row @ inverse.T


def _cumulative(density: FloatArray) -> FloatArray:
    """Probability of a shorter wavelength than each of the grid; zeros for no light at all."""
    inside = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    return np.asarray(inside / inside[-1] if inside[-1] > 0 else inside)


def draw_density(whole: FloatArray, response: FloatArray, light: FloatArray | None = None) -> FloatArray:
    """Relative sampling density of wavelengths on the grid: the sum over channels of signal over the whole signal.

    A channel that receives little light through a stop gets few samples there, because it needs few.

    Args:
        whole: response [channel, wavelength] of all stops together.
        response: response [channel, wavelength] of the stop.
        light: spectrum on the grid; even if None.
    """
    light = np.ones_like(grid.WAVELENGTH_NM) if light is None else light
    total = grid.integrate(whole * light)
    share = response / np.where(total > 0, total, 1.0)[:, None]
    density = np.sum(share * light, axis=0)
    # Wavelengths that the lights' common spectrum hardly has may still come from one of them.
    even = np.sum(share, axis=0) * light.mean()
    density = (1 - EVEN_SHARE) * density + EVEN_SHARE * even
    density[density < 1e-4 * density.max()] = 0.0
    return density


def frame_density(responses: Responses, light: FloatArray) -> FloatArray:
    """Relative sampling density of wavelengths for all rings of a frame, [wavelength].

    It is the maximum of the densities of the rings, each weighted by its largest share in any pixel, so that a small
    frame about the axis is sampled as for the axis. A sum would give too few samples at the ends of the near-infrared,
    which only the rings near the axis see: under incandescent light the noise of blue on the axis was 2.5 times as
    large.
    """
    nearest = np.array([np.abs(responses.place - number).min() for number in range(len(responses.of_pass))])
    weighted = [
        share * draw_density(whole, response, light)
        for share, whole, response in zip(
            np.maximum(1 - nearest, 0.0), responses.of_camera, responses.of_pass, strict=True
        )
    ]
    return np.asarray(np.max(weighted, axis=0))


def draw_table(camera: Camera, response: FloatArray, light: FloatArray, density: FloatArray) -> FloatArray:
    """What depends on a drawn wavelength, at equal steps of probability, [ring, DRAW_NODES, 3 + channel].

    ``response`` is [ring, channel, wavelength]. Columns are the wavelength in nm, its focus vergence in 1/m,
    response / density of each channel, and the light's spectrum.
    """
    fine = np.linspace(grid.WAVELENGTH_NM[0], grid.WAVELENGTH_NM[-1], 20_001)
    step = fine[1] - fine[0]
    pdf = np.interp(fine, grid.WAVELENGTH_NM, density)
    cdf = np.concatenate([[0.0], np.cumsum((pdf[1:] + pdf[:-1]) / 2 * step)])
    total = cdf[-1]
    nodes = (np.arange(DRAW_NODES) + 0.5) / DRAW_NODES
    wavelength = np.interp(nodes, cdf / total, fine)

    def drawn(curve: FloatArray) -> FloatArray:
        return np.interp(wavelength, grid.WAVELENGTH_NM, curve)

    weight = total / drawn(density)
    focus, lit = drawn(geometry.focus_vergence(camera)), drawn(light)
    return np.stack(
        [np.stack([wavelength, focus, *(drawn(row) * weight for row in ring), lit], axis=-1) for ring in response]
    )
