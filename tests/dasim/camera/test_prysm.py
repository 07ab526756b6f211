"""Kernels of the camera against prysm, an established library for optical propagation (B. Dube, JOSS 2019).

prysm transforms a sampled pupil by a matrix product: no Bessel functions, no radial symmetry. Its transform has the
sign that sends a wavefront's positive slope to positive places. A point nearer than the focus comes together behind
the sensor, so that its ray through rho meets the sensor at + rho c / 2: the phase is + W20 rho^2. That picture
stands on its head; turned by half it is the upright one.
"""

from __future__ import annotations

import numpy as np
import pytest
from prysm.propagation import Wavefront

from dasim import psf
from dasim.base.toml import parse
from dasim.camera import geometry, radiometry
from dasim.camera.specification import Camera
from dasim.spectra import grid as spectra
from dasim.spectra import illuminants

FOCAL_MM, F_NUMBER, FOCUS_MM, PITCH_UM = 3.6, 2.8, 400.0, 1.7  # of da-mobile
IMAGE_MM = 1 / (1 / FOCAL_MM - 1 / FOCUS_MM)
CLOSE_MM = 100.0  # a focus with room behind it
CELLS = 256  # across the lens: pictures repeat after 256 lambda N
FINE = 4  # sub-cells a side, for the share of a cell that is open
PER_PIXEL = 7  # samples of the picture; its finest detail is 0.8 px
SIZE = 65
STEP_NM = 10
ENERGY = 0.01  # reached: 0.002
SHAPE = 0.01  # sum of all pixels' differences; an annulus in focus, with its wide rings, has half of that
NARROW = {"passes_nm": [[550, 558]], "edge_width_nm": 1}
NARROW_UM = 0.554
LETTER_L = ((-0.6, -0.7), (-0.2, -0.7), (-0.2, 0.3), (0.5, 0.3), (0.5, 0.7), (-0.6, 0.7))


def places(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """X and y over the lens, of its radius; prysm's axis lies in the cell after the middle of an even count."""
    axis = (np.arange(cells) - cells // 2) * 2.0 / CELLS
    return np.meshgrid(axis, axis)


def opening(transmitted) -> tuple[np.ndarray, float]:
    """Mean amplitude in each cell, from a function of places (x, y), and the light that passes, in open cells."""
    part = (np.arange(FINE) - (FINE - 1) / 2) / FINE * 2.0 / CELLS
    x, y = places(CELLS + 2)
    light = np.array([transmitted(x + dx, y + dy) for dx in part for dy in part], dtype=float)
    return np.sqrt(light).mean(axis=0), light.sum() / FINE**2


def ring(outer: float, inner: float = 0.0, centre: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, float]:
    def inside(x, y):
        distance = np.hypot(x - centre[0], y - centre[1])
        return (distance <= outer) & (distance >= inner)

    return opening(inside)


def pixels(
    pupil: tuple[np.ndarray, float], blur_px: float, wavelength_um: float, image_mm: float = IMAGE_MM
) -> np.ndarray:
    """Shares of the light in the pixels of the upright picture, by prysm; ``blur_px`` is signed, of the open lens."""
    amplitude, light = pupil
    x, y = places(len(amplitude))
    rim_nm = blur_px * PITCH_UM * 1e3 / (8 * image_mm * F_NUMBER / FOCAL_MM)  # W20, a path
    spacing_mm = FOCAL_MM / F_NUMBER / CELLS
    wave = Wavefront.from_amp_and_phase(amplitude, rim_nm * (x**2 + y**2), wavelength_um, spacing_mm)
    picture = wave.focus_fixed_sampling(image_mm, PITCH_UM / PER_PIXEL, SIZE * PER_PIXEL).intensity.data
    on_sensor = picture.reshape(SIZE, PER_PIXEL, SIZE, PER_PIXEL).sum(axis=(1, 3)) / light
    return on_sensor[::-1, ::-1]


def encircled(kernel: np.ndarray) -> np.ndarray:
    y, x = np.indices(kernel.shape) - len(kernel) // 2
    return np.array([kernel[np.hypot(y, x) <= radius].sum() for radius in range(SIZE // 2)])


def with_stops(camera: Camera, *stops: dict, **lens) -> Camera:
    data = camera.model_dump()
    named = [{"name": f"stop {index}"} | stop for index, stop in enumerate(stops)]
    return parse(Camera, data | {"stops": named, "lens": data["lens"] | lens}, "camera")


@pytest.mark.parametrize("blur_px", [0.0, 3.0, -6.0, 9.0, 16.0, 24.0])
def test_channels_of_da_mobile(da_mobile, blur_px):
    """Rationale: every wave-true picture and every calibrated kernel rests on these.

    Set-up: monochromatic pictures of both stops every 10 nm, weighted with what the channel sees under D65. At 24 px
    green has 3.4 waves of defocus and the hole's near-infrared 0.5. Expectation: encircled energies within 0.01.
    """
    light = illuminants.illuminant("D65")
    expected = np.zeros((2, SIZE, SIZE))
    total = np.zeros(2)
    grid = spectra.WAVELENGTH_NM
    for stop, ratio in zip(da_mobile.stops, (1.0, 0.46), strict=True):
        spectrum = (radiometry.stop_response(da_mobile, stop) * light)[[1, 3]]
        for nm in np.arange(400 + STEP_NM / 2, 830, STEP_NM):
            band = np.abs(grid - nm) <= STEP_NM / 2
            weight = spectrum[:, band].mean(axis=1)
            if (weight > 1e-4 * spectrum.max(axis=1)).any():
                expected += weight[:, None, None] * pixels(ring(ratio), blur_px, nm / 1e3)
                total += weight
    depth_m = float(geometry.depth_of_blur_m(da_mobile, blur_px))
    for index, channel in enumerate(("G", "IR")):
        kernel = psf(da_mobile, depth_m, channel, "D65", size=SIZE)
        difference = encircled(kernel) - encircled(expected[index] / total[index])
        assert np.abs(difference).max() < ENERGY, (channel, difference)


SHAPES = {
    "annulus": ({"shape": "annulus", "inner_ratio": 0.6, "outer_ratio": 0.95}, ring(0.95, 0.6)),
    "displaced disc": ({"shape": "disc", "radius_ratio": 0.3, "centre_ratio": [0.5, -0.3]}, ring(0.3, 0, (0.5, -0.3))),
    "displaced annulus": (
        {"shape": "annulus", "inner_ratio": 0.2, "outer_ratio": 0.4, "centre_ratio": [-0.1, 0.5]},
        ring(0.4, 0.2, (-0.1, 0.5)),
    ),
    "letter L": (
        {"shape": "polygon", "corners_ratio": LETTER_L},
        opening(lambda x, y: (abs(y) <= 0.7) & (x >= -0.6) & ((x <= -0.2) | ((y >= 0.3) & (x <= 0.5)))),
    ),
    "grey mask": (
        {"shape": "mask", "mask": [[0, 0, 0, 0], [0, 1, 0.5, 0], [0, 0, 1, 0], [0, 0, 0, 0]]},
        opening(
            lambda x, y: np.where(
                (abs(x) < 0.5) & (abs(y) < 0.5), np.where(x * y > 0, 1.0, np.where((x > 0) & (y < 0), 0.5, 0.0)), 0.0
            )
        ),
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("blur_px", [0.0, 12.0, -20.0])
def test_stops_of_any_shape(da_mobile, shape, blur_px):
    """Expectation: pixel by pixel the same picture, so that every shape lies where it should, and upside down for
    points nearer than the focus: none of the shapes is its own image turned by half, but the annulus.
    """
    stop, pupil = SHAPES[shape]
    camera = with_stops(da_mobile, stop | NARROW, focus_distance_m=CLOSE_MM / 1e3)
    depth_m = float(geometry.depth_of_blur_m(camera, blur_px))
    expected = pixels(pupil, blur_px, NARROW_UM, 1 / (1 / FOCAL_MM - 1 / CLOSE_MM))
    kernel = psf(camera, depth_m, "G", "D65", size=SIZE)
    assert np.abs(kernel - expected).sum() < SHAPE
    if blur_px and shape != "annulus":
        assert np.abs(kernel[::-1, ::-1] - expected).sum() > 10 * SHAPE


@pytest.mark.parametrize("stop", [{"radius_ratio": 0.3, "centre_ratio": [0.5, -0.3]}, {"radius_ratio": 1.0}])
def test_axial_colour_moves_the_focus_of_each_wavelength(da_mobile, stop):
    """Set-up: a focal length that grows by 40 um from 500 to 600 nm; two narrow bands through one stop, seen by
    green. Blur from 1/f(lambda) - 1/s, written out. Expectation: the weighted sum of prysm's pictures; through a
    displaced disc the two colours part.
    """
    bands = [[510, 518], [580, 588]]
    camera = with_stops(
        da_mobile, stop | {"passes_nm": bands, "edge_width_nm": 1}, focal_shift_um=[[500, -20], [600, 20]]
    )
    depth_mm = 300.0
    spectrum = (radiometry.stop_response(camera, camera.stops[0]) * illuminants.illuminant("D65"))[1]
    pupil = ring(stop["radius_ratio"], 0, tuple(stop.get("centre_ratio", (0, 0))))
    expected, total = np.zeros((SIZE, SIZE)), 0.0
    for low, high in bands:
        nm = (low + high) / 2
        focal_mm = FOCAL_MM + 1e-3 * (-20 + 40 * (nm - 500) / 100)
        diopters = 1 / depth_mm - (1 / focal_mm - 1 / IMAGE_MM)  # 1/mm
        blur_px = FOCAL_MM / F_NUMBER * IMAGE_MM * diopters / (PITCH_UM * 1e-3)
        weight = spectrum[np.abs(spectra.WAVELENGTH_NM - nm) < 20].sum()
        expected += weight * pixels(pupil, blur_px, nm / 1e3)
        total += weight
    kernel = psf(camera, depth_mm / 1e3, "G", "D65", size=SIZE)
    assert np.abs(kernel - expected / total).sum() < SHAPE
