"""Transforms, compared with explicit sums over the kernel, and padding, with its definition."""

from __future__ import annotations

import numpy as np
import pytest

from recon import fourier

SINGLE = 1e-5  # rounding of 32-bit numbers


@pytest.mark.parametrize("spacing_px", [1, 2])
@pytest.mark.parametrize("size", [5, 17])
def test_transfer_is_the_sum_over_the_kernel(size, spacing_px):
    """Set-up: kernels smaller and larger than the frame. Expectation: the sum of h(y, x) exp(-2 pi i (fy y + fx x))."""
    kernel = np.random.default_rng(0).random((size, size))
    shape = (12, 10)
    transfer = fourier.transfer(kernel, shape, spacing_px)
    place = np.arange(size) - size // 2
    fy, fx = fourier.frequencies(shape, spacing_px)
    expected = np.exp(-2j * np.pi * fy * place) @ kernel @ np.exp(-2j * np.pi * place[:, None] * fx)
    np.testing.assert_allclose(transfer, expected, atol=SINGLE * kernel.sum())


def test_inverse_undoes_forward():
    image = np.random.default_rng(1).random((3, 9, 14)).astype(np.float32)
    np.testing.assert_allclose(fourier.inverse(fourier.forward(image), (9, 14)), image, atol=SINGLE)


def test_padding_keeps_the_frame_and_has_no_step_at_its_edges():
    """Set-up: a ramp. Expectation: the frame is unchanged, and the largest step of the periodic picture is that of a
    blend from end to start over the strip instead of the ramp's full height.
    """
    ramp = np.repeat(np.linspace(0, 1, 40, dtype=np.float32)[None], 30, axis=0)
    padded = fourier.pad_blended(ramp, (40, 60))
    stack = fourier.pad_blended(np.stack([ramp, ramp**2]), (40, 60))
    np.testing.assert_array_equal(stack, [padded, fourier.pad_blended(ramp**2, (40, 60))])
    np.testing.assert_array_equal(padded[:30, :40], ramp)
    steps = np.abs(np.diff(padded, axis=1, append=padded[:, :1]))
    assert steps.max() <= 1 / 21 + 2 / 39 + SINGLE  # the blend's step and that of both mirrored ramps


def test_fast_shapes_are_large_enough_multiples():
    for size in ((100, 131), (97, 64)):
        shape = fourier.fast_shape(size, 30, multiple=4)
        assert all(at >= n + 30 and at % 4 == 0 for at, n in zip(shape, size, strict=True))
        assert all(at < 1.25 * (n + 34) for at, n in zip(shape, size, strict=True))
