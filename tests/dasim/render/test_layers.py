"""Layers of pixels that see several depths: how rays are split, and the algebra of what each layer takes."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.render import layers


@pytest.fixture
def sums():
    """Signal, control and control beyond of three layers for 50 pixels; nothing is beyond the last."""
    random = np.random.default_rng(3)
    signal, control, beyond = random.uniform(0.1, 2.0, (3, 3, 50))
    beyond[2] = 0
    return signal, control, beyond


def test_shares_sum_to_one(sums):
    """Expectation: where all layers have one radiance, so has the pixel, whatever their weights."""
    _, control, beyond = sums
    np.testing.assert_allclose(layers.front_to_back(0.7 * control, control, beyond), 0.7, rtol=1e-12)


def test_one_layer_is_the_ratio(sums):
    signal, control, _ = sums
    value = layers.front_to_back(signal[:1], control[:1], np.zeros((1, 50)))
    np.testing.assert_allclose(value, signal[0] / control[0], rtol=1e-12)


def test_the_nearest_takes_its_share_by_reciprocity_and_the_farthest_the_rest(sums):
    """Expectation: two layers are C / (C + B) of the near radiance and B / (C + B) of the far one, whose own weights
    do not count.
    """
    signal, control, beyond = sums
    for scale in (1.0, 5.0):
        near, far = control[0] / (control[0] + beyond[0]), signal[2] / control[2]
        value = layers.front_to_back(
            [signal[0], scale * signal[2]], [control[0], scale * control[2]], [beyond[0], np.zeros(50)]
        )
        expected = near * signal[0] / control[0] + (1 - near) * far
        np.testing.assert_allclose(value, expected, rtol=1e-12)


def test_a_surface_cut_into_layers_is_one_layer():
    """Rationale: the blur of a slanted surface changes slowly, so that its weights are about those of one depth.

    Expectation: with the same weights at all depths, any cut gives the ratio of the whole.
    """
    random = np.random.default_rng(4)
    control = random.uniform(0.1, 1.0, (5, 40))
    signal = control * random.uniform(0.0, 2.0, (5, 40))
    beyond = np.flip(np.cumsum(np.flip(control, 0), axis=0), 0) - control
    whole = signal.sum(axis=0) / control.sum(axis=0)
    np.testing.assert_allclose(layers.front_to_back(signal, control, beyond), whole, rtol=1e-12)


def test_light_that_no_weight_takes_is_not_lost():
    """Set-up: the only rays of the far layer have no weight. Expectation: the near radiance alone."""
    zero, one = np.zeros(1), np.ones(1)
    assert layers.front_to_back([0.4 * one, zero], [one, zero], [0.1 * one, zero]) == pytest.approx(0.4)
    assert layers.front_to_back([zero, zero], [zero, zero], [zero, zero]) == 0


def test_layers_are_ordered_near_to_far_on_both_sides_of_the_focus():
    """Set-up: rays at 17, 6, -1 and -9 px of visible blur, in any order."""
    blur = np.array([[-1.0, 17.0, 6.1, -9.0, 6.0, 17.2, -1.2, -9.1]])
    np.testing.assert_array_equal(layers.split(blur), [[2, 0, 1, 3, 1, 0, 2, 3]])


def test_a_slanted_surface_is_one_layer_and_the_wall_behind_it_another():
    """Set-up: a surface from 20 to 8 px in steps of 0.4 px, and a wall 3 px farther."""
    blur = np.concatenate([np.arange(20.0, 7.9, -0.4), np.full(10, 5.0)])
    shuffled = np.random.default_rng(5).permutation(len(blur))
    layer = layers.split(blur[None, shuffled])[0]
    np.testing.assert_array_equal(layer, (blur[shuffled] < 6).astype(int))


def test_more_depths_than_layers_are_joined_where_they_are_closest():
    """Set-up: twelve depths, every second gap wider. Expectation: pairs, as many as the allowed layers."""
    depths = np.cumsum([0.0, 1, 4, 1, 4, 1, 4, 1, 4, 1, 4, 1])
    layer = layers.split(-depths[None])[0]
    np.testing.assert_array_equal(layer, np.repeat(np.arange(layers.MOST_LAYERS), 2))


def test_one_ray_is_one_layer():
    np.testing.assert_array_equal(layers.split(np.array([[3.0], [-2.0]])), 0)
