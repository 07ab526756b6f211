"""Figures of the claim ``rivals`` on boards of Fourier optics, with the lens of each design and with a wrong one."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

import dasim
from dasim.camera import geometry, noise, radiometry
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.spectra import grid, illuminants
from dasim.values import Capture, Truth
from validation.claims.depth import rivals
from validation.rivals import designs, likelihood
from validation.rivals.designs import DESIGNS

SIZE_PX = (128, 96)
FINE = 4  # samples of the texture per pixel and axis
GRID, EVERY = 384, 6  # samples of the pupil, per side; every sixth wavelength, 12 nm apart
BLUR_PX = np.arange(4.0, 15.0)  # that are tried
BOARD_PX = 9.0  # blur of the open lens
MEAN_E = 1200.0
TIME_S = 0.01
BY_NAME = {design.name: design for design in DESIGNS}
Pupil = Callable[[np.ndarray, np.ndarray], np.ndarray]  # transmittance at x, y in radii of the open lens


class Lens(NamedTuple):
    """A lens: its pupil for each picture, for other wavelengths another one, and its axial colour."""

    pupils: tuple[Pupil, ...]
    other: Pupil | None = None
    band_nm: tuple[float, float] = (0, 0)  # which passes ``other``
    shift_um: float = 0.0  # of the focal length at 630 nm, and the negative at 450 nm
    sweep_um: tuple[float, ...] = (0.0,)  # of all focal lengths, during the exposure


def disc(ratio: float) -> Pupil:
    return lambda x, y: (np.hypot(x, y) <= ratio).astype(float)


def left(x, y):
    return disc(1.0)(x, y) * (x < 0)


def right(x, y):
    return disc(1.0)(x, y) * (x > 0)


def coded(x, y):
    """The 7 x 7 modified uniformly redundant array in the square inscribed in the lens, from its formula: closed in the
    first row; open in the first column; else open where the Legendre symbols of row and column modulo 7 are equal.
    """
    squares = {1, 2, 4}
    array = [[i > 0 and (j == 0 or (i in squares) == (j in squares)) for j in range(7)] for i in range(7)]
    row, column = (np.floor((axis * np.sqrt(2) + 1) / 2 * 7).astype(int) for axis in (y, x))
    inside = (row >= 0) & (row < 7) & (column >= 0) & (column < 7)
    return inside * np.array(array, float)[np.clip(row, 0, 6), np.clip(column, 0, 6)]


@cache
def known(name: str) -> likelihood.Model:
    return likelihood.model(cameras(name), "D65", BLUR_PX, BY_NAME[name].sweep_um)


def cameras(name: str):
    scene = dasim.load_scene("desk").model_copy(update={"focus_cm": 80.0})
    return designs.cameras(BY_NAME[name], SIZE_PX, scene)


def texture(random: np.random.Generator) -> np.ndarray:
    """A periodic grey texture of 1/f^2 with a contrast of 0.15 per octave and mean 1, at ``FINE`` samples per pixel."""
    height, width = FINE * SIZE_PX[1], FINE * SIZE_PX[0]
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    radius[0, 0] = np.inf
    white = np.fft.fft2(random.standard_normal((height, width)))
    return 1 + 0.15 * np.fft.ifft2(white * np.sqrt(1 / (2 * np.pi * np.log(2))) / radius).real


def pixels(image: np.ndarray) -> np.ndarray:
    return image.reshape(SIZE_PX[1], FINE, SIZE_PX[0], FINE).mean(axis=(1, 3))


def kernels(camera, lens: Lens, number: int) -> np.ndarray:
    """Point-spread functions of a board, [channel, y, x] at ``FINE`` samples per pixel, by Fourier optics.

    At the edge of the pupil, of radius a, a wave is off by W = a^2 / 2 (1/d + 1/s - 1/f) (Goodman, Introduction to
    Fourier Optics, sec. 6.4). The sensor has the square of the transform of the pupil, at steps of lambda s over the
    width of the grid. The upright picture is turned by 180 degrees against the sensor.
    """
    radius_m, image_m = geometry.aperture_m(camera) / 2, geometry.image_distance_m(camera)
    sample_m = camera.sensor.pixel_pitch_um * 1e-6 / FINE
    vergence = 1 / geometry.depth_of_blur_m(camera, BOARD_PX) + 1 / image_m
    weights = radiometry.response(camera) * illuminants.illuminant("D65")
    total = np.zeros((len(weights), GRID, GRID))
    every = EVERY if len(lens.sweep_um) == 1 else 4 * EVERY
    for index, moved_um in itertools.product(range(0, len(grid.WAVELENGTH_NM), every), lens.sweep_um):
        nm, low, high = grid.WAVELENGTH_NM[index], *lens.band_nm
        place = np.fft.fftfreq(GRID) * nm * 1e-9 * image_m / sample_m / radius_m
        x, y = np.meshgrid(place, place)
        pupil = (lens.other if lens.other and low <= nm < high else lens.pupils[number])(x, y)
        shift_um = np.interp(nm, [450, 630], [-lens.shift_um, lens.shift_um])
        focal_m = camera.lens.focal_length_mm * 1e-3 + (shift_um + moved_um) * 1e-6
        error_m = radius_m**2 / 2 * (vergence - 1 / focal_m)
        wave = np.fft.fft2(pupil * np.exp(2j * np.pi * error_m / (nm * 1e-9) * (x**2 + y**2)))
        total += weights[:, index, None, None] * (np.abs(wave) ** 2 / (np.abs(pupil) ** 2).sum())
    sensor = total / total.sum(axis=(1, 2), keepdims=True)
    return np.roll(np.flip(sensor, (1, 2)), (1, 1), (1, 2))


def through(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """A picture [h, w, channel] of a texture through kernels [channel, y, x] about the first sample."""
    height, width = image.shape
    signed = np.rint(np.fft.fftfreq(GRID) * GRID).astype(int)
    seen = []
    for one in kernel:
        whole = np.zeros(image.shape)
        np.add.at(whole, (signed[:, None] % height, signed[None] % width), one)
        seen.append(pixels(np.fft.ifft2(np.fft.fft2(image) * np.fft.fft2(whole)).real))
    return np.stack(seen, -1)


def measured(name: str, lens: Lens) -> rivals.Measured:
    """What the claim measures with the cameras of a design, on a board that was taken through a lens."""
    sharp = texture(np.random.default_rng(4))
    captures = []
    for number, camera in enumerate(cameras(name)):
        mean = noise.mosaic(MEAN_E * through(sharp, kernels(camera, lens, number)), camera)
        raw, _ = noise.expose(electronic_crosstalk(mean, camera), camera.sensor, TIME_S, number)
        captures.append(Capture(raw, camera, TIME_S, 1.0, number))
    depth = np.full(SIZE_PX[::-1], geometry.depth_of_blur_m(captures[0].camera, BOARD_PX), np.float32)
    green = np.repeat(pixels(sharp)[..., None], 4, -1)
    truth = Truth.of_parts({"depth_m": depth, "valid": np.ones(depth.shape, bool), "sharp_e": green})
    return rivals.measured(captures, [SimpleNamespace(truth=truth)], known(name))


def test_windows_of_all_photographs_count():
    """Expectation: the windows of both, in order."""
    first, second = (rivals.Measured(*(np.full(count, count + field) for field in range(4))) for count in (2, 3))
    found = rivals.pooled([first, second])
    np.testing.assert_array_equal(found.error, [2, 2, 3, 3, 3])
    np.testing.assert_array_equal(found.after, [5, 5, 6, 6, 6])


OPEN = Lens((disc(1.0),))
SLOW = pytest.mark.slow  # point-spread functions of stops that are not round


@pytest.mark.parametrize(
    ("name", "own", "wrong"),
    [
        ("dual-aperture", Lens((disc(1.0),), disc(0.46), (650, 900)), OPEN),
        ("green-stop", Lens((disc(1.0),), disc(0.59), (496, 590)), OPEN),
        ("axial-colour", Lens((disc(1.0),), shift_um=12.0), OPEN),
        ("open-lens", OPEN, Lens((coded,))),
        pytest.param("dual-pixel", Lens((left, right)), Lens((right, left)), marks=SLOW),
        pytest.param("coded-aperture", Lens((coded,)), OPEN, marks=SLOW),
    ],
)
def test_a_lens_that_is_not_the_design_shows_in_depth_and_sharpness(name, own, wrong):
    """Rationale: the claim knows the point-spread functions of each camera file; were an aperture left out, halves
    exchanged or a band put through the wrong stop, its figures must show it.

    Set-up: a board at one depth, of a texture as the model has it, through the lens that the design describes and
    through a wrong one. Expectation: with its own lens the error is that of the noise, up to four bounds; with the
    other it is four times that at least, and the texture's error more than 1.4 times as large.
    """
    right_one, wrong_one = measured(name, own), measured(name, wrong)
    error, off = (float(np.median(np.abs(found.error))) for found in (right_one, wrong_one))
    assert len(right_one.error) == len(wrong_one.error) == 15
    assert error < 4 * np.median(right_one.bound)
    assert off > 4 * error
    assert np.median(wrong_one.after) > 1.4 * np.median(right_one.after)


def test_a_focus_that_stays_shows_in_a_sweep():
    """Rationale: a sweep blurs all depths alike (Nagahara et al. 2008), so that it is sharpened without knowing them.

    Expectation: in the middle of the spectrum, its power changes by less than a fifth between 4 and 14 px of nominal
    blur, where an open lens loses more than nine tenths; so the bound on depth is five times as large. A board whose
    focus did not move has a texture error 1.4 times as large, at least.
    """
    swept, still = (
        known(name).covariance[:, likelihood.rings() == 4, 0, 0].real for name in ("focal-sweep", "open-lens")
    )
    change = [power.mean(axis=1).min() / power.mean(axis=1).max() for power in (swept, still)]
    assert change[0] > 0.8 and change[1] < 0.1
    own = measured("focal-sweep", Lens((disc(1.0),), sweep_um=BY_NAME["focal-sweep"].sweep_um))
    stays = measured("focal-sweep", OPEN)
    assert np.median(stays.after) > 1.4 * np.median(own.after)
    assert np.median(own.bound) > 5 * np.median(measured("open-lens", OPEN).bound)


def test_light_of_the_designs():
    """Expectation: the share of the lens that is open to green by areas of discs, halves and the 24 open cells of 49,
    each a tenth of the lens wide; green electrons of white paper go with it, but for the bands of the stops.
    """
    figures = {figure.id: figure.value for design in DESIGNS for figure in rivals._light_figures(design)}
    cells = 24 * 0.2**2 / np.pi  # in radii
    shares = {"dual-aperture": 1, "green-stop": 0.59**2, "axial-colour": 1, "dual-pixel": 1, "coded-aperture": cells}
    for name, share in shares.items():
        assert figures[f"{name}.open"] == pytest.approx(share, rel=1e-3)
    white = {name: figures[f"{name}.green"] / figures["open-lens.green"] for name in shares}
    for name in ("axial-colour", "dual-pixel", "coded-aperture"):
        assert white[name] == pytest.approx(shares[name], rel=2e-3)
    assert 0.3 < white["green-stop"] < 0.5 and 1 < white["dual-aperture"] < 1.3
