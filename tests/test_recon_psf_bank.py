"""Calibration: kernels measured from noisy mosaic pictures against the camera's own wave-optics kernels."""

import numpy as np
import pytest
import recon_scenes

import recon
from dasim import calibration, pointspread
from dasim.errors import InputError
from dasim.spectra import CHANNELS

# What the picture's fixed pattern of 2 electrons a pixel leaves unknown of a kernel's far field, for the weakest
# picture (infrared near focus, some 300 electrons at its peak), plus the share outside the finite frame.
ENERGY_TOLERANCE = 0.03
WEAK_ENERGY_TOLERANCE = 0.075
CENTRE_TOLERANCE_PX = 0.05  # noise of a centre of mass of a few thousand electrons


def encircled(kernel):
    """Share of the light within whole-pixel radii of the middle."""
    size = len(kernel)
    y, x = np.indices(kernel.shape) - size // 2
    radius = np.hypot(y, x)
    return np.array([kernel[radius <= r + 1e-3].sum() for r in range(1, size // 2 + 1)])


@pytest.mark.parametrize("channel", ["G", "IR"])
@pytest.mark.parametrize("level", [0, 1, 4, 8, 14, 20, 28])
def test_encircled_energy(level, channel):
    bank = recon_scenes.bank()
    measured = bank.kernel[bank.lights.index("D65"), level, CHANNELS.index(channel)]
    size = measured.shape[-1]
    true = pointspread.psf(bank.camera, float(bank.depth_m[level]), channel, "D65", size=size)
    weak = channel == "IR" and level < 8
    error = np.abs(encircled(measured) - encircled(true / true.sum())).max()
    assert error < (WEAK_ENERGY_TOLERANCE if weak else ENERGY_TOLERANCE)


def test_kernels_are_unit_sums_non_negative_and_centred():
    kernel = recon_scenes.bank().kernel.astype(float)
    assert kernel.min() >= 0
    np.testing.assert_allclose(kernel.sum((-1, -2)), 1, atol=1e-5)  # float32
    place = np.arange(kernel.shape[-1]) - kernel.shape[-1] // 2
    for axis in (-1, -2):
        moment = (kernel.sum(axis) * place).sum(-1)
        assert np.abs(moment[:, 2:, CHANNELS.index("G")]).max() < CENTRE_TOLERANCE_PX


def test_signature_is_the_ratio_of_the_channels_responses():
    """The electrons of each channel against green, from the spectra; 6 % covers the tails of weak pictures."""
    bank = recon_scenes.bank()
    for index, light in enumerate(bank.lights):
        _, _, signal = recon_scenes.stop_kernels(light)
        np.testing.assert_allclose(bank.signature[index], signal.sum(0), rtol=0.06)


def test_missing_pictures_are_named():
    camera = recon_scenes.da_mobile(512, 384)
    with pytest.raises(InputError, match="no pictures"):
        recon.calibrate([], camera)
    pictures = [next(calibration.calibration_captures(camera, ("D65",)))]
    with pytest.raises(InputError, match="one period of the mosaic"):
        recon.calibrate(pictures, camera)
