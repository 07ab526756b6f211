"""Diffusion between pixels by absorption depth: the transfer function, random walks, and what a pixel collects."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate

from dasim.camera import diffusion, silicon
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.spectra import grid

WALKS = 200_000  # electrons of the random walk: a share of 5 % is known to 1 %
SILICON = {"pitch_um": 1.7, "thickness_um": 3.0, "depletion_um": 2.0}


def test_transfer_function_is_the_integral_over_depth():
    """Expectation: at several frequencies the closed form is the quadrature of what it stands for; at 0 it is the share
    of light that is absorbed below the depleted layer.
    """
    alpha, thickness, depletion = 0.3, 3.0, 2.0
    w = thickness - depletion
    total = 1 - np.exp(-alpha * thickness)
    for q in (0.0, 0.05, 0.3, 1.0, 4.0):

        def arriving(h, q=q):
            return alpha * np.exp(-alpha * (depletion + h)) * np.cosh(q * (w - h)) / np.cosh(q * w)

        expected = integrate.quad(arriving, 0, w)[0] / total
        value = diffusion.transfer_below(np.array([[q]]), alpha, thickness, depletion)[0, 0]
        assert value == pytest.approx(expected, rel=1e-5)
    below = (np.exp(-alpha * depletion) - np.exp(-alpha * thickness)) / total
    assert diffusion.transfer_below(np.zeros((1, 1)), alpha, thickness, depletion)[0, 0] == pytest.approx(below)


def test_shares_are_those_of_electrons_that_walk_at_random():
    """Rationale: diffusion is the random walk of single electrons; no formula is shared.

    Set-up: 200,000 electrons at 730 nm start on the pixel's axis at depths drawn from the absorption law, and walk in
    steps of 0.05 um in each direction, reflected at 3 um, until they reach the depleted layer at 2 um. Expectation:
    the shares of edge and corner neighbours, what goes further shared out in proportion. A share of 8 % of the
    electrons is known to 0.8 %, an edge neighbour's to 1.6 %, a corner's to 3 %; the finite step takes the
    electrons 0.58 of itself beyond the absorbing plane on average, so that it stands as much higher here. Limit: 5 and
    10 %.
    """
    rng = np.random.default_rng(2)
    alpha = float(np.interp(730.0, grid.WAVELENGTH_NM, silicon.absorption_per_um()))
    depth = -np.log1p(-rng.random(WALKS) * -np.expm1(-3 * alpha)) / alpha
    step = 0.05
    depth = depth[depth > 2.0] - 2.0
    place = np.zeros((2, depth.size))
    moving = np.arange(depth.size)
    while moving.size:
        depth[moving] += step * rng.standard_normal(moving.size)
        over = depth[moving] > 1.0
        depth[moving] = np.where(over, 2.0 - depth[moving], depth[moving])
        place[:, moving] += step * rng.standard_normal((2, moving.size))
        moving = moving[depth[moving] > 0.5826 * step]
    pixel = np.abs(np.rint(place / 1.7)).astype(int)
    away = pixel.sum(axis=0) > 0
    edge = (pixel.sum(axis=0) == 1).sum()
    corner = ((pixel[0] == 1) & (pixel[1] == 1)).sum()
    leaving = away.sum() / WALKS
    expected = leaving / 4 * np.array([edge, corner]) / (edge + corner)
    shares = diffusion.by_depth(**SILICON)
    ours = [float(np.interp(730.0, grid.WAVELENGTH_NM, share)) for share in shares]
    assert ours[0] == pytest.approx(expected[0], rel=0.05)
    assert ours[1] == pytest.approx(expected[1], rel=0.10)


def test_shares_grow_with_wavelength_and_fall_with_pitch_and_depletion():
    """Expectation: 0.2, 5, 8 and 10 % leave their pixel at 450, 550, 650 and 730 nm; fewer at a larger pitch and with a
    deeper depletion; none where all silicon is depleted.
    """

    def leaving(**changes):
        edge, corner = diffusion.by_depth(**SILICON | changes)
        return 4 * edge + 4 * corner

    ours = leaving()
    for nm, share in ((450, 0.002), (550, 0.05), (650, 0.083), (730, 0.097)):
        assert np.interp(nm, grid.WAVELENGTH_NM, ours) == pytest.approx(share, abs=0.0007)
    assert (np.diff(ours) > 0).all()
    seen = ours > 1e-4
    assert (leaving(pitch_um=3.4) < 0.6 * ours)[seen].all() and (leaving(depletion_um=2.5) < ours)[seen].all()
    assert (leaving(depletion_um=3.0) == 0).all()


@pytest.mark.parametrize(("name", "value"), [("da-mobile", "silicon"), ("da-4x4", "silicon"), ("bayer-mobile", 0.05)])
def test_a_pixel_collects_what_an_even_frame_shows_there(name, value):
    """Set-up: a frame of the camera under even light of one wavelength, electrons moved from pixel to pixel.
    Expectation: the mean of each channel, away from the border.
    """
    camera = cameras.cropped(cameras.load_camera(name), 24, 24)
    sensor = camera.sensor.model_copy(update={"electronic_crosstalk": value})
    channel = cameras.mosaic_channels(camera)
    for nm in (450.0, 530.0, 730.0):
        index = int(np.argmin(np.abs(grid.WAVELENGTH_NM - nm)))
        shares = (np.full(channel.shape, share[index]) for share in sensors.spectral_shares(sensor))
        frame = diffusion.spread(sensors.quantum_efficiency(sensor)[channel, index], *shares)
        inner = np.s_[4:-4, 4:-4]
        expected = [frame[inner][channel[inner] == number].mean() for number in np.unique(channel)]
        np.testing.assert_allclose(sensors.collected_efficiency(sensor)[:, index], expected, rtol=1e-12)
