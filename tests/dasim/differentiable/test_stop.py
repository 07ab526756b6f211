"""A free stop has the kernels of the simulator and of the search for shapes, and its gradients are slopes. Skipped
without the extra ``learn``.
"""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.bounds import pupils

torch = pytest.importorskip("torch", reason="PyTorch is not installed; it comes with the extra 'learn'")
from dasim.differentiable import stop as stops  # noqa: E402 - needs PyTorch

LIGHT, SIDE, CELLS = "D65", 32, 16


@pytest.fixture(scope="module")
def hole(da_mobile):
    return da_mobile.stops[1]


def disc(cells, radius):
    place = (np.arange(cells) + 0.5) * 2 / cells - 1
    return torch.tensor((np.hypot(place[:, None], place) < radius).astype(float))


def test_kernels_are_those_of_the_simulator(da_mobile, hole):
    """Rationale: ``dasim.psf`` sums Fourier-Bessel profiles of many wavelengths, this squares transforms of a sampled
    pupil in bands of 40 nm. Limit: encircled energy within 0.02, as far as bands and cells of the disc's rim explain.
    """
    blur = 12.0
    free = stops.free_stop(da_mobile, hole, LIGHT, [blur], 128, 64, dtype=torch.float64)
    found = stops.kernels(stops.transfers(free, disc(128, hole.radius_ratio)))[0, 3].numpy()
    only = da_mobile.model_copy(update={"stops": (hole,)})
    depth_m = 1 / (1 / only.lens.focus_distance_m + blur / dioptre_px(only))
    expected = dasim.psf(only, depth_m, "IR", LIGHT)
    centre = expected.shape[0] // 2
    for radius in (2, 4, 6, 9):
        assert encircled(found, 32, radius) == pytest.approx(encircled(expected, centre, radius), abs=0.02)


def dioptre_px(camera):
    from dasim.camera import geometry

    near = camera.lens.focus_distance_m / 2
    return float(geometry.blur_px(camera, near)) / (1 / near - 1 / camera.lens.focus_distance_m)


def encircled(kernel, centre, radius):
    y, x = np.indices(kernel.shape) - centre
    return kernel[np.hypot(y, x) <= radius].sum() / kernel.sum()


def test_gradients_are_finite_differences(da_mobile, hole):
    """PyTorch's comparison in double precision, of kernels, their light and the amplitude of every cell."""
    free = stops.free_stop(da_mobile, hole, LIGHT, [3.0, 9.0], 6, 8, fine_cells=8, dtype=torch.float64)
    amplitude = torch.rand((6, 6), generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    amplitude.requires_grad_()

    def light(of):
        return stops.kernels(stops.transfers(free, of)) * stops.electrons(free, of)[:, None, None]

    assert torch.autograd.gradcheck(light, amplitude)


def test_gradients_are_those_of_the_adjoint(da_mobile, hole):
    """Rationale: the search for shapes has an adjoint derived by hand. Expectation: the same numbers."""
    free = stops.free_stop(da_mobile, hole, LIGHT, [3.0, 9.0], CELLS, SIDE, dtype=torch.float64)
    sampled = pupils.pupil(da_mobile, hole, LIGHT, [3.0, 9.0], CELLS, (SIDE, SIDE))
    random = np.random.default_rng(0)
    amplitude = random.uniform(size=(CELLS, CELLS))
    transfer = pupils.transfers(sampled, amplitude)
    by_transfer = random.standard_normal(transfer.shape) + 1j * random.standard_normal(transfer.shape)
    cells = torch.tensor(amplitude, requires_grad=True)
    found = stops.transfers(free, cells)
    np.testing.assert_allclose(found.detach().numpy(), transfer, atol=1e-12)
    (torch.tensor(by_transfer).conj() * found).real.sum().backward()
    np.testing.assert_allclose(cells.grad.numpy(), pupils.gradient(sampled, amplitude, by_transfer), atol=1e-9)


def test_fixed_stops_have_the_light_of_free_ones(da_mobile, hole):
    """Expectation: a hole of as many cells passes the electrons of the exact disc; the cells of its rim explain 2 %."""
    free = stops.free_stop(da_mobile, hole, LIGHT, [4.0], 128, SIDE, dtype=torch.float64)
    only = da_mobile.model_copy(update={"stops": (hole,)})
    transfer, electrons = stops.fixed_stops(only, LIGHT, [4.0], SIDE, dtype=torch.float64)
    amplitude = disc(128, hole.radius_ratio)
    torch.testing.assert_close(stops.electrons(free, amplitude)[3], electrons[3], rtol=0.02, atol=0)
    torch.testing.assert_close(stops.transfers(free, amplitude)[0, 3], transfer[0, 3], rtol=0, atol=0.02)
