"""Calibration: kernels measured from noisy mosaic pictures, compared with the camera's own wave-optics kernels."""

import dataclasses
import itertools

import numpy as np
import pytest

import recon
from dasim.base.errors import InputError
from dasim.camera import pointspread
from dasim.camera import specification as cameras
from dasim.simulation import calibration
from dasim.spectra.grid import CHANNELS
from dasim.values import Capture
from recon.picture import colour
from tests.support import recon_scenes

# The limit of the claim; photon noise and 1 % of PRNU leave half of it, for infrared under the lamp as well.
ENERGY_TOLERANCE = 0.03
WHITE_TOLERANCE = 0.03  # 1 % of PRNU and what the tails of kernels hold beyond the pictures; the shift is 15 to 20 %
CENTRE_TOLERANCE_PX = 0.05  # noise of a centre of mass of a few thousand electrons


def encircled(kernel):
    """Share of the light within each integer radius (in pixels) of the centre."""
    size = len(kernel)
    y, x = np.indices(kernel.shape) - size // 2
    radius = np.hypot(y, x)
    return np.array([kernel[radius <= r + 1e-3].sum() for r in range(1, size // 2 + 1)])


@pytest.mark.parametrize("channel", ["G", "IR"])
@pytest.mark.parametrize("level", [0, 1, 4, 8, 14, 20, 28])
def test_encircled_energy(level, channel):
    bank = recon_scenes.bank()
    for index, light in enumerate(bank.lights):
        measured = bank.kernel[index, level, CHANNELS.index(channel)]
        true = pointspread.psf(bank.camera, float(bank.depth_m[level]), channel, light, size=measured.shape[-1])
        assert np.abs(encircled(measured) - encircled(true / true.sum())).max() < ENERGY_TOLERANCE


@pytest.mark.slow
def test_bank_of_a_window_off_the_axis_has_its_kernels():
    """Set-up: three levels of a camera whose window lies in the corner of the full frame, 31 degrees off the axis.

    Expectation: encircled energies of the kernels there, those of the axis differ by more; white as on the axis, where
    the coatings have not shifted.
    """
    few = cameras.load_camera("da-mobile").model_copy(update={"levels": cameras.Levels(count=3, max_blur_px=10.0)})
    window = cameras.cropped(few, 64, 48, at_px=(1984, 1488))
    bank = recon.calibrate(calibration.calibration_captures(window, ("D65",)), cache=False)
    assert bank.field_px == (992.0, 744.0)
    np.testing.assert_allclose(bank.signature, colour.signatures(few, bank.lights), rtol=WHITE_TOLERANCE)
    for level, channel in itertools.product(range(3), ("G", "IR")):
        measured = encircled(bank.kernel[0, level, CHANNELS.index(channel)])
        depth_m, size = float(bank.depth_m[level]), bank.kernel.shape[-1]
        true = pointspread.psf(window, depth_m, channel, "D65", size=size)
        axis = pointspread.psf(few, depth_m, channel, "D65", size=size)
        assert np.abs(measured - encircled(true / true.sum())).max() < ENERGY_TOLERANCE
        if (level, channel) == (0, "IR"):
            assert np.abs(measured - encircled(axis / axis.sum())).max() > 3 * ENERGY_TOLERANCE


def test_with_axial_colour_a_bank_has_levels_behind_the_focus():
    """Set-up: three levels on either side, focus at 20 cm, infrared focused farther and blue nearer.

    Expectation: encircled energies of the kernels at the depth of each level; blue behind the focus differs from
    that in front of it by more (0.3; infrared, through the hole, by 0.07 at most). Both sides share the focus, and
    without axial colour there is the near one alone.
    """
    plain = recon_scenes.da_mobile(64, 48).model_copy(update={"levels": cameras.Levels(count=3, max_blur_px=6.0)})
    plain = cameras.refocused(plain, 0.2)
    shift = {"focal_shift_um": ((450.0, -8.0), (550.0, 0.0), (750.0, 15.0))}
    camera = plain.model_copy(update={"lens": plain.lens.model_copy(update=shift)})
    bank = recon.calibrate(calibration.calibration_captures(camera, ("D65",)), cache=False)
    assert bank.behind is not None and len(calibration.calibration_captures(camera, ("D65",))) == 5 * 4 * 3
    np.testing.assert_array_equal(bank.behind.blur_px, -bank.blur_px)
    np.testing.assert_array_equal(bank.behind.kernel[:, 0], bank.kernel[:, 0])
    assert bank.behind.depth_m[0] == bank.depth_m[0] and (np.diff(bank.behind.depth_m) > 0).all()
    for level, channel in itertools.product((1, 2), ("B", "IR")):
        index = CHANNELS.index(channel)
        measured, near = (encircled(side.kernel[0, level, index]) for side in (bank.behind, bank))
        depth_m, size = float(bank.behind.depth_m[level]), bank.kernel.shape[-1]
        true = pointspread.psf(camera, depth_m, channel, "D65", size=size)
        assert np.abs(measured - encircled(true / true.sum())).max() < ENERGY_TOLERANCE
        assert channel == "IR" or np.abs(measured - near).max() > 3 * ENERGY_TOLERANCE
    assert len(calibration.levels_behind(plain)[0]) == 1


def test_a_longer_exposure_tells_what_the_short_one_cannot():
    """Set-up: infrared in focus under a lamp that emits 6 % of it: the automatic exposure gives 60 electrons at the
    peak.

    Expectation: the longer exposures, in which green is saturated, reduce the error of encircled energy to a third.
    """
    camera, light = recon_scenes.da_mobile(64, 48), "energy-saving-3500K"
    pictures = list(itertools.takewhile(lambda p: p.level == 0, calibration.calibration_captures(camera, (light,))))
    errors = []
    for few in (pictures, [p for p in pictures if p.exposure_s == calibration.EXPOSURE_S]):
        bank = recon.calibrate(few, camera)
        measured = bank.kernel[0, 0, CHANNELS.index("IR")]
        true = pointspread.psf(bank.camera, float(bank.depth_m[0]), "IR", light, size=measured.shape[-1])
        errors.append(np.abs(encircled(measured) - encircled(true / true.sum())).max())
    assert errors[0] < min(ENERGY_TOLERANCE, errors[1] / 3)


def test_kernels_are_unit_sums_non_negative_and_centred():
    kernel = recon_scenes.bank().kernel.astype(float)
    assert kernel.min() >= 0
    np.testing.assert_allclose(kernel.sum((-1, -2)), 1, atol=1e-5)  # float32
    place = np.arange(kernel.shape[-1]) - kernel.shape[-1] // 2
    for axis in (-1, -2):
        moment = (kernel.sum(axis) * place).sum(-1)
        assert np.abs(moment[:, 2:, CHANNELS.index("G")]).max() < CENTRE_TOLERANCE_PX


def test_signature_is_the_ratio_of_the_channels_responses():
    """The signature is the ratio of each channel's electrons to those of green, computed from the spectra; a tolerance
    of 6 % covers the tails that weak pictures lose.
    """
    bank = recon_scenes.bank()
    for index, light in enumerate(bank.lights):
        _, _, signal = recon_scenes.stop_kernels(light)
        np.testing.assert_allclose(bank.signature[index], signal.sum(0), rtol=0.06)


def test_missing_pictures_are_named():
    camera = recon_scenes.da_mobile(512, 384)
    with pytest.raises(InputError, match="no pictures"):
        recon.calibrate([], camera)
    pictures = [next(iter(calibration.calibration_captures(camera, ("D65",))))]
    with pytest.raises(InputError, match="one period of the mosaic"):
        recon.calibrate(pictures, camera)


def test_levels_without_the_focus_are_named():
    """Set-up: pictures of two levels behind the focus alone; of the focus alone a bank has kernels, but no depth."""
    camera = recon_scenes.da_mobile(64, 48)
    pictures = list(itertools.takewhile(lambda p: p.level == 0, calibration.calibration_captures(camera, ("D65",))))
    behind = [dataclasses.replace(p, level=level) for level in (-2, -1) for p in pictures]
    with pytest.raises(InputError, match="give all levels from 0 on"):
        recon.calibrate(behind, camera)
    bank = recon.calibrate(pictures, camera)
    capture = Capture(np.full((48, 64), 400, np.uint16), camera, 0.01, 1.0, 0)
    with pytest.raises(InputError, match="bank has only one level"):
        recon.reconstruct(capture, bank)


def test_pictures_of_other_sizes_are_named():
    camera = recon_scenes.da_mobile(64, 48)
    pictures = list(itertools.takewhile(lambda p: p.level == 0, calibration.calibration_captures(camera, ("D65",))))
    odd = [dataclasses.replace(p, frames_dn=p.frames_dn[:, :-1, :-1]) for p in pictures]
    mixed = [dataclasses.replace(pictures[0], frames_dn=pictures[0].frames_dn[:, :-2, :-2]), *pictures[1:]]
    for wrong in (odd, mixed):
        with pytest.raises(InputError, match="need one size, a multiple of the 2 x 2 mosaic"):
            recon.calibrate(wrong, camera)
