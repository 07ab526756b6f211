"""What a captured picture adds to an all-in-focus picture: lost detail, nothing to a picture that explains it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import recon
from recon.sharp import consistency, sharpen
from tests.recon.sharp.test_restoration import exact, gains, scene
from tests.support import recon_scenes

LEVEL = 6
NOISE_E = np.full(4, 4.0)
INNER = (slice(24, -24),) * 2


@pytest.fixture(scope="module")
def captured():
    """A photograph [4, h, w], the same blurred by the kernels of a level, and all kernels."""
    photo = exact(scene())
    sharp = np.concatenate([np.moveaxis(photo, -1, 0), photo.mean(axis=-1)[None]]).astype(np.float32)
    bank = recon_scenes.bank()
    kernels = sharpen.visible_kernels(bank.kernel[0], bank.signature[0], np.eye(3, 4))
    blurred = [
        ndimage.convolve(plane, kernel, mode="mirror") for plane, kernel in zip(sharp, kernels[LEVEL], strict=True)
    ]
    return sharp, np.stack(blurred).astype(np.float32), kernels


def added(picture, captured, level=float(LEVEL), sd=0.01, **others):
    """What is added to colours [3, h, w]."""
    _, blurred, kernels = captured
    result = np.ascontiguousarray(np.moveaxis(picture[:3], 0, -1))
    shape = result.shape[:2]
    levels, deviation = np.full(shape, level, np.float32), np.full(shape, sd, np.float32)
    consistency.add_unexplained(
        result, blurred, levels, consistency.share_of(levels, deviation), kernels, NOISE_E, **others
    )
    return np.moveaxis(result, -1, 0) - picture[:3]


def rms(picture):
    return float(np.sqrt(np.mean(np.square(picture[..., *INNER]))))


def test_detail_that_a_picture_lacks_comes_back(captured):
    """Set-up: a photograph at level 6 without noise; the same smoothed by a Gaussian of 3 px as all-in-focus picture.
    Expectation: the error falls by a quarter, by less than a tenth as much where the level is uncertain by 2 levels.
    """
    sharp, _, _ = captured
    soft = np.stack([ndimage.gaussian_filter(plane, 3.0) for plane in sharp])
    before, more = rms(soft[:3] - sharp[:3]), added(soft, captured)
    assert rms(soft[:3] + more - sharp[:3]) < 0.75 * before
    assert rms(added(soft, captured, sd=2.0)) < 0.1 * rms(more)


def test_a_picture_that_explains_the_capture_stays(captured):
    """Expectation: what is added to the true picture is below a twentieth of the detail that blur takes; the kernels'
    mean over a pixel is twice in the set-up.
    """
    sharp, blurred, _ = captured
    assert rms(added(sharp, captured)) < 0.05 * rms(sharp[:3] - blurred[:3])


def test_in_focus_nothing_is_added(captured):
    sharp, _, _ = captured
    assert not added(sharp, captured, level=0.0).any()


def test_tiles_leave_no_seams(captured):
    """Expectation: with tiles of 96 px as without, within a thousandth of the noise."""
    sharp, _, _ = captured
    soft = np.stack([ndimage.gaussian_filter(plane, 3.0) for plane in sharp])
    whole, tiled = (added(soft, captured, tile_px=tile) for tile in (512, 96))
    assert np.abs(whole - tiled).max() < 1e-3 * NOISE_E[0]


def test_photographs_gain_by_it():
    """Expectation: a photograph at 20 px of blur gains at least 0.05 dB more in every colour."""
    there, best = scene(12.0, "coffee"), recon.PRESETS["best"]
    without, ours = (
        gains(there, recon.reconstruct(there.capture, recon_scenes.bank(), best.model_copy(update=changes)))
        for changes in ({"sharpen_consistency": False}, {})
    )
    assert (ours > without + 0.05).all(), (ours, without)
