"""Layered pictures: energy is conserved, a board is blurred by its kernel, and noise is that of the sensor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

import dasim
from recon.picture import infrared
from tests.support import recon_scenes
from validation.training import layered
from validation.training.layered import MARGIN
from validation.training.rooms import FINE, Room

HEIGHT, WIDTH = 64, 96


@pytest.fixture(scope="module")
def lens():
    bank = recon_scenes.bank()
    return layered.optics(bank, 0, infrared.crosstalk(bank.camera, None).astype(float), HEIGHT, WIDTH)


def fine(image):
    return image.repeat(FINE, -2).repeat(FINE, -1).astype(np.float32)


def test_equal_radiance_stays_equal_whatever_the_depths(lens):
    """Rationale: a white furnace. Expectation: 1 everywhere, at steps and on slopes too; red and blue, for which the
    cover of green is taken, within 2 %.
    """
    shape = (HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN)
    level = np.linspace(0, 10, shape[1])[None] + np.zeros((shape[0], 1))
    level[60:, 80:] = 20
    blurred = layered._blurred(Room(np.ones((4, FINE * shape[0], FINE * shape[1]), np.float32), fine(level)), lens)
    inner = blurred[:, MARGIN:-MARGIN, MARGIN:-MARGIN]
    np.testing.assert_allclose(inner[[1, 3]], 1, atol=2e-3)
    np.testing.assert_allclose(inner, 1, atol=0.02)


def test_a_board_is_convolved_with_the_kernel_of_its_level(lens):
    shape = (HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN)
    pattern = np.random.default_rng(0).uniform(0.2, 1, (4, *shape)).astype(np.float32)
    blurred = layered._blurred(Room(fine(pattern), fine(np.full(shape, 9.0))), lens)
    kernel = recon_scenes.bank().kernel[0, 9, 3]
    expected = signal.convolve(pattern[3], kernel, mode="same")
    inner = (slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))
    np.testing.assert_allclose(blurred[3][inner], expected[inner], atol=2e-3)


def test_a_capture_has_the_electrons_asked_for(lens):
    camera = dasim.cropped(recon_scenes.bank().camera, WIDTH, HEIGHT)
    shape = (4, FINE * (HEIGHT + 2 * MARGIN), FINE * (WIDTH + 2 * MARGIN))
    room = Room(np.ones(shape, np.float32), np.zeros(shape[1:], np.float32))
    capture = layered.photographed(room, lens, camera, 1000.0, 0.03, 3)
    from recon.picture import mosaic

    planes = mosaic.planes(mosaic.linearise(capture)[0], camera)
    assert planes["G"].mean() == pytest.approx(1000, rel=0.01)
    assert planes["IR"].mean() == pytest.approx(1000 * lens.white[3], rel=0.03)
    assert planes["G"].std() == pytest.approx(np.sqrt(1000), rel=0.25)


def test_levels_are_those_of_the_frame():
    level = np.arange(HEIGHT + 2 * MARGIN)[:, None] + np.zeros((1, WIDTH + 2 * MARGIN))
    found = layered.level_of(Room(np.ones((4, 1, 1), np.float32), fine(level)))
    assert found.shape == (HEIGHT, WIDTH)
    np.testing.assert_array_equal(found[:, 0], np.arange(MARGIN, MARGIN + HEIGHT))
