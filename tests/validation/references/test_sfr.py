"""The slanted-edge measurement and the closed forms it is compared with."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from validation.references import transfer
from validation.references.sfr import slanted_edge_sfr, windowed_response

FREQUENCY = np.linspace(0.05, 0.4, 15)
CLOSED_FORM = 0.005  # what is left: straight lines, bins that few pixels fall into
WIDE = 400  # px: the Hamming window lowers nothing beyond the limit there


def blurred_edge(sigma_px: float, turn_deg: float, width: int, *, height: int = 64) -> np.ndarray:
    """An edge blurred by a Gaussian, exactly, sampled at pixel centres; off the middle, black level not 0."""
    turn = np.radians(turn_deg)
    y, x = np.indices((height, width))
    across = (x - width / 2 + 0.7) * np.cos(turn) - (y - height / 2) * np.sin(turn)
    return 30 + 100 * (1 + erf(across / sigma_px / np.sqrt(2))) / 2


@pytest.mark.parametrize("sigma_px", [0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("turn_deg", [5.0, -7.0])
def test_sfr_of_a_gaussian_edge(sigma_px, turn_deg):
    """Expectation: exp(-2 (pi sigma f)^2), for edges that lean to either side."""
    sfr = slanted_edge_sfr(blurred_edge(sigma_px, turn_deg, WIDE), FREQUENCY, blur_px=4 * sigma_px)
    np.testing.assert_allclose(sfr, np.exp(-2 * (np.pi * sigma_px * FREQUENCY) ** 2), atol=CLOSED_FORM)


def test_sfr_does_not_depend_on_contrast_or_side():
    """Expectation: the same for the negative, and for twice the light."""
    edge = blurred_edge(1.0, 5.0, 128)
    curves = [slanted_edge_sfr(image, FREQUENCY) for image in (edge, 200 - edge, 2 * edge)]
    np.testing.assert_allclose(curves[1], curves[0], atol=1e-9)
    np.testing.assert_allclose(curves[2], curves[0], atol=1e-9)


def test_window_of_a_narrow_frame_is_known():
    """Rationale: in a narrow frame the standard's window raises the SFR of a wide blur; theory gets the same window."""
    sigma, step = 7.0, 1 / 512
    sfr = slanted_edge_sfr(blurred_edge(sigma, 5.0, 128), FREQUENCY, blur_px=28)
    grid = np.arange(0, 1, step)
    mtf = np.exp(-2 * (np.pi * sigma * grid) ** 2)
    expected = windowed_response(mtf, step, (64, 128), np.tan(np.radians(5)), FREQUENCY)
    np.testing.assert_allclose(sfr, expected, atol=1e-4)
    assert np.abs(sfr - np.interp(FREQUENCY, grid, mtf)).max() > CLOSED_FORM


def test_hopkins_in_focus_is_the_closed_form():
    """Expectation: (2 / pi) (acos v - v sqrt(1 - v^2)), and nothing beyond v = 1."""
    v = np.linspace(0, 1, 101)
    expected = 2 / np.pi * (np.arccos(v) - v * np.sqrt(1 - v**2))
    np.testing.assert_allclose(transfer.hopkins_otf(v, 0.0), expected, atol=1e-12)
    np.testing.assert_allclose(transfer.hopkins_otf(np.array([1.0, 1.5]), 3.0), 0, atol=1e-12)


def test_hopkins_far_out_of_focus_is_the_geometric_disc():
    """Expectation: at 25 waves and low frequencies 2 J1(pi c f) / (pi c f), with c f = 8 W20 v."""
    v = np.linspace(0, 0.02, 41)
    np.testing.assert_allclose(transfer.hopkins_otf(v, 25.0), transfer.disc_transfer(8 * 25 * v), atol=0.015)


def test_hopkins_is_the_kernel_of_the_pupil():
    """Rationale: an integral over the pupil's overlap against the pupil's own Fourier transform, the other way round.

    Expectation: the discrete autocorrelation of a sampled pupil of 3 waves, within its sampling of 1 / 200.
    """
    size, waves = 512, 3.0
    axis = (np.arange(size) - size / 2) / 100
    rho2 = axis[:, None] ** 2 + axis[None, :] ** 2
    pupil = np.where(rho2 <= 1, np.exp(2j * np.pi * waves * rho2), 0)
    otf = np.fft.ifft2(np.abs(np.fft.fft2(pupil)) ** 2)[0, :200].real
    np.testing.assert_allclose(otf / otf[0], transfer.hopkins_otf(np.arange(200) / 200, waves), atol=0.005)
