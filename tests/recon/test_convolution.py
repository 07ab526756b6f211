"""Layers of networks: the convolution against direct sums, and changes of resolution."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import threadpoolctl
from scipy import ndimage

from recon import convolution


@pytest.mark.parametrize("dilation", [1, 3])
def test_a_dilated_convolution_repeats_the_border(dilation):
    random = np.random.default_rng(0)
    image, kernel = random.normal(size=(9, 11, 2)), random.normal(size=(3, 3, 2, 4))
    net = {"a": kernel.astype(np.float32), "a_bias": np.arange(4, dtype=np.float32)}
    found = convolution.convolved(image.astype(np.float32), net, "a", dilation)
    spread = np.zeros((2 * dilation + 1, 2 * dilation + 1, 2, 4))
    spread[::dilation, ::dilation] = kernel
    for out in range(4):
        expected = out + sum(
            ndimage.correlate(image[..., part], spread[..., part, out], mode="nearest") for part in range(2)
        )
        np.testing.assert_allclose(found[..., out], expected, atol=1e-4)


def test_a_convolution_of_many_channels_keeps_single_precision():
    """Rationale: F(4, 3) multiplies values by up to 8 and divides weights by 24, which costs digits.

    Expectation: errors of at most 2e-5 of the standard deviation of the result, against sums in double precision.
    """
    random = np.random.default_rng(4)
    image = random.normal(size=(12, 21, 96)).astype(np.float32)
    kernel = random.normal(size=(3, 3, 96, 64), scale=(9 * 96) ** -0.5).astype(np.float32)
    found = convolution.convolved(image, {"a": kernel, "a_bias": np.zeros(64, np.float32)}, "a")
    wide = np.pad(image.astype(float), ((1, 1), (1, 1), (0, 0)), mode="edge")
    expected = sum(wide[y : y + 12, x : x + 21] @ kernel[y, x].astype(float) for y in range(3) for x in range(3))
    assert np.abs(found - expected).max() < 2e-5 * np.std(expected)


def test_strips_of_a_convolution_meet_without_a_seam(monkeypatch):
    """Expectation: strips of one row give the same as the whole image."""
    random = np.random.default_rng(1)
    image = random.normal(size=(7, 6, 2)).astype(np.float32)
    net = {"a": random.normal(size=(3, 3, 2, 3)).astype(np.float32), "a_bias": np.zeros(3, np.float32)}
    whole = convolution.convolved(image, net, "a", 2)
    monkeypatch.setattr(convolution, "STRIP", 1)
    np.testing.assert_allclose(convolution.convolved(image, net, "a", 2), whole, atol=1e-6)


@pytest.mark.parametrize("dilation", [1, 2])
def test_a_residual_block_is_its_formula(dilation):
    """Expectation: h + B relu(A * relu(h) + a) + b with the convolution of its own test, in strips that are cut."""
    random = np.random.default_rng(3)
    image = random.normal(size=(301, 40, 3)).astype(np.float32)
    shapes = {"a": (3, 3, 3, 5), "a_bias": (5,), "b": (5, 3), "b_bias": (3,)}
    net = {name: random.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    inner = np.maximum(convolution.convolved(np.maximum(image, 0), net, "a", dilation), 0)
    expected = image + inner.astype(float) @ net["b"] + net["b_bias"]
    before = image.copy()
    np.testing.assert_allclose(convolution.residual(image, net, "a", "b", dilation), expected, atol=1e-4)
    np.testing.assert_array_equal(image, before)


def test_spreading_undoes_gathering():
    image = np.random.default_rng(2).normal(size=(6, 4, 3)).astype(np.float32)
    gathered = convolution.gathered(image)
    assert gathered.shape == (3, 2, 12)
    np.testing.assert_array_equal(np.sort(gathered[1, 1]), np.sort(image[2:4, 2:4].ravel()))
    np.testing.assert_array_equal(convolution.spread(gathered), image)


def test_threads_at_the_same_time_leave_the_products_of_matrices_as_they_were():
    """Set-up: threads that compute layers side by side. Expectation: as many threads of BLAS after them as before."""

    def threads():
        return [library["num_threads"] for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas"]

    net = {"a": np.ones((8, 8), np.float32), "a_bias": np.zeros(8, np.float32)}
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = threads()
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda _: convolution.linear(np.ones((64, 300, 8), np.float32), net, "a"), range(40)))
        assert threads() == before
