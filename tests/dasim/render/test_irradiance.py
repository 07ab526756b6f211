import numpy as np
import pytest

from dasim.render.irradiance import TILE, in_tile, smoothed
from dasim.typing import FloatArray

SHAPE = 48, 64
SPECTRA = np.ones((1, 431))
APART = 0.0014  # as a tangent: three pixels of da-mobile


def plane(normal: tuple[float, float, float] = (0.0, 0.0, -1.0), vergence: float = 2.0) -> FloatArray:
    """A surface that all nodes see, [y, x, (1/z, normal, known)]."""
    return np.broadcast_to(np.array([vergence, *normal, 1.0]), (*SHAPE, 5)).copy()


def levels(irradiance: FloatArray) -> FloatArray:
    """Of all wavelengths alike, [y, x, light, node]."""
    return np.broadcast_to(irradiance[..., None, None], (*SHAPE, 1, 8)).copy()


def test_noise_of_an_even_wall_falls_to_an_eighth() -> None:
    noise = np.random.default_rng(0).normal(1, 0.01, SHAPE)
    result = smoothed(levels(noise), plane(), SPECTRA, APART)[..., 0, 0]
    middle = result[16:-16, 16:-16]
    assert middle.std() < noise.std() / 8
    assert abs(middle.mean() - 1) < 0.001


def test_linear_light_stays_as_it_is_up_to_the_border() -> None:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    light = 1 + 0.01 * x - 0.008 * y
    assert smoothed(levels(light), plane(), SPECTRA, APART)[..., 0, 0] == pytest.approx(light, abs=1e-12)


def test_light_of_two_surfaces_is_not_mixed() -> None:
    light, surface = np.where(np.arange(SHAPE[1]) < 30, 1.0, 1.1) * np.ones(SHAPE), plane()
    surface[:, 30:, 0] *= 1.5
    assert smoothed(levels(light), surface, SPECTRA, APART)[..., 0, 0] == pytest.approx(light, abs=1e-12)


def test_surface_that_bends_is_averaged_with_its_nearest_nodes_alone() -> None:
    noise, surface = np.random.default_rng(0).normal(1, 0.03, SHAPE), plane()
    turn = np.radians(6) * np.arange(SHAPE[1])
    surface[..., 1], surface[..., 3] = np.sin(turn), -np.cos(turn)
    impulse = noise.copy()
    impulse[24, 32] += 0.01
    difference = smoothed(levels(impulse), surface, SPECTRA, APART) - smoothed(levels(noise), surface, SPECTRA, APART)
    rows, columns = np.nonzero(np.abs(difference[..., 0, 0]) > 1e-9)
    assert set(columns) <= {31, 32, 33}
    assert len(rows) > 1


def test_coarse_grid_is_averaged_with_nearest_nodes_alone() -> None:
    light = 1 + 1e-4 * (np.arange(SHAPE[1]) - 32.0) ** 2 * np.ones(SHAPE)
    fine = smoothed(levels(light), plane(), SPECTRA, APART)[24, 32, 0, 0] - light[24, 32]
    coarse = smoothed(levels(light), plane(), SPECTRA, 10 * APART)[24, 32, 0, 0] - light[24, 32]
    # A kernel [1, 2, 1] / 4 has a variance of half a node, and one with twice the distance four times as much.
    assert coarse == pytest.approx(1e-4 * 0.5, rel=1e-6)
    assert fine == pytest.approx(1e-4 * (0.5 + 2 + 8), rel=1e-6)


def test_steep_shadow_stays() -> None:
    light = np.where(np.arange(SHAPE[1]) < 30, 1.0, 0.4) * np.ones(SHAPE)
    result = smoothed(levels(light), plane(), SPECTRA, APART)[..., 0, 0]
    assert result == pytest.approx(light, abs=1e-12)


def test_nodes_of_a_square_follow_each_other() -> None:
    rows, columns = np.mgrid[:TILE, :TILE]
    number = in_tile(rows, columns)
    assert sorted(number.ravel()) == list(range(TILE**2))
    assert sorted(number[:2, 2:].ravel()) == [4, 5, 6, 7]
    assert in_tile(rows + TILE, columns + 2 * TILE).tolist() == number.tolist()


@pytest.mark.parametrize("shape", [(2, 2), (3, 9), (7, 8), (9, 5)])
def test_grid_smaller_than_the_widest_step(shape: tuple[int, int]) -> None:
    light = np.linspace(1.0, 1.01, shape[1]) * np.ones(shape)
    ratio = np.broadcast_to(light[..., None, None], (*shape, 1, 8))
    surface = np.broadcast_to(np.array([2.0, 0.0, 0.0, -1.0, 1.0]), (*shape, 5))
    assert smoothed(ratio, surface, SPECTRA, APART)[..., 0, 0] == pytest.approx(light, abs=1e-12)
