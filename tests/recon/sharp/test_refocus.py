"""Refocusing: closed forms for one plane, conservation of light, and occlusion at edges."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy import signal

import recon
from dasim.base.errors import InputError
from dasim.values import Reconstruction
from recon.picture import infrared
from recon.settings import PAPER
from recon.sharp import layers, sharpen
from recon.sharp.refocus import KERNEL_SHARE, colour_kernels
from tests.support import recon_scenes

SINGLE = 2e-4  # of the value: sums of some thousand terms in float32
PIXEL_SHARE = 0.02  # of a kernel's light that its non-negative form without the pixel's area misplaces
BLEED = 2e-3  # of the brighter side's light: float32, and a kernel's tail that is cut
BELOW = 0.01  # of the stripes: what of their blur of two levels that nobody asked for would exceed


def depth_of(level):
    bank = recon_scenes.bank()
    return float(1 / np.interp(level, np.arange(len(bank.depth_m)), 1 / bank.depth_m.astype(np.float64)))


def scene(sharp_e, level):
    """A reconstruction with a given all-in-focus picture and level map."""
    height, width = level.shape
    nothing = np.zeros((height, width), np.float32)
    return Reconstruction(
        rgb=sharp_e,
        sharp_rgb=sharp_e,
        linear_e=sharp_e,
        sharp_e=sharp_e.astype(np.float32),
        ir_e=nothing,
        level_raw=nothing,
        level=level.astype(np.float32),
        depth_m=nothing,
        confidence=nothing,
        camera=recon_scenes.bank().camera,
        light="D65",
        settings=PAPER.model_dump(),
        timings_s={},
    )


@cache
def kernels():
    return colour_kernels(scene(np.zeros((8, 8, 3)), np.zeros((8, 8))), recon_scenes.bank())


def texture(height=96, width=128):
    return 1000 * recon_scenes.textures(height, width)[0][..., :3].astype(np.float32)


def convolved(image, level):
    """The blurred image by direct sums, mirrored at the border."""
    kernel = layers.cut(kernels()[level], KERNEL_SHARE)
    half = kernel.shape[-1] // 2
    padded = np.pad(image, ((half, half), (half, half), (0, 0)), "symmetric").astype(np.float64)
    planes = [signal.oaconvolve(padded[..., c], kernel[c].astype(np.float64), "valid") for c in range(3)]
    return np.stack(planes, axis=-1)


def test_kernels_lose_the_pixels_area_alone():
    """The kernel with the pixel's area removed, multiplied by the transfer function of a pixel, is
    the measured kernel.
    """
    bank = recon_scenes.bank()
    one = np.zeros((8, 8, 3)), np.zeros((8, 8))
    measured = sharpen.visible_kernels(
        bank.kernel[0], bank.signature[0], infrared.separation(scene(*one).camera, "D65", PAPER)
    )
    for level in (2, 6, 14):
        wide = np.zeros((256, 256))
        size = measured.shape[-1]
        wide[:size, :size] = kernels()[level, 1]
        f = np.fft.fftfreq(256)
        again = np.fft.ifft2(np.fft.fft2(wide) * np.sinc(f)[:, None] * np.sinc(f)).real[:size, :size]
        assert np.abs(again - measured[level, 1]).sum() < PIXEL_SHARE


def test_a_plane_in_focus_is_the_sharp_picture():
    """A single depth in focus is not blurred."""
    image = texture()
    result = recon.refocus(scene(image, np.full(image.shape[:2], 6.0)), recon_scenes.bank(), depth_of(6.0))
    np.testing.assert_allclose(result, image, rtol=SINGLE, atol=SINGLE * image.max())


@pytest.mark.parametrize(("own_level", "focus", "blur"), [(0.0, 4.0, 4), (9.0, 4.0, 5), (14.0, 2.0, 12)])
def test_a_plane_out_of_focus_is_convolved_with_its_levels_kernel(own_level, focus, blur):
    image = texture()
    result = recon.refocus(scene(image, np.full(image.shape[:2], own_level)), recon_scenes.bank(), depth_of(focus))
    np.testing.assert_allclose(result, convolved(image, blur), rtol=0, atol=SINGLE * image.max())


def test_blur_is_as_one_over_the_f_number():
    """At half the aperture, eight levels blur as four."""
    image, lens = texture(), recon_scenes.bank().camera.lens
    result = recon.refocus(
        scene(image, np.full(image.shape[:2], 8.0)), recon_scenes.bank(), depth_of(0.0), 2 * lens.f_number
    )
    np.testing.assert_allclose(result, convolved(image, 4), rtol=0, atol=SINGLE * image.max())


def test_a_wider_aperture_than_the_banks_blurs_further():
    """A point at level 20, seen through twice the aperture, has twice the blur diameter of the bank's level 20."""
    image = np.zeros((201, 201, 3), np.float32)
    image[100, 100] = 1000
    lens = recon_scenes.bank().camera.lens
    around = np.hypot(*(np.indices((201, 201)) - 100))
    width = []
    for f_number in (lens.f_number, lens.f_number / 2):
        result = recon.refocus(scene(image, np.full((201, 201), 20.0)), recon_scenes.bank(), depth_of(0.0), f_number)
        width.append(np.sum(around * result[..., 1]) / np.sum(result[..., 1]))
    assert width[1] / width[0] == pytest.approx(2, rel=0.05)  # diffraction is a small part of either


def test_light_is_conserved():
    """Points of light in the middle of one surface, flat or slanted, keep their sum at any focus."""
    image = np.zeros((160, 160, 3), np.float32)
    image[70:90:4, 70:90:4] = (300, 500, 900)
    flat, slanted = np.full((160, 160), 8.0), recon_scenes.slanted(160, 160, 6.0, 8.0)
    for level, bound in ((flat, SINGLE), (slanted, 0.02)):  # a slant has kernels of unequal size side by side
        result = recon.refocus(scene(image, level), recon_scenes.bank(), depth_of(1.0))
        np.testing.assert_allclose(result.sum((0, 1)), image.sum((0, 1)), rtol=bound)


def test_an_even_light_stays_even():
    """A world of uniform radiance stays uniform for any layout of depths: coverage adds up to one everywhere."""
    image = np.full((96, 128, 3), 700, np.float32)
    step = np.where(np.arange(128) < 64, 3.0, 14.0)[None].repeat(96, 0)
    for level in (step, recon_scenes.slanted(96, 128, 0.0, 20.0)):
        for focus in (0.0, 3.0, 14.0):
            result = recon.refocus(scene(image, level), recon_scenes.bank(), depth_of(focus))
            np.testing.assert_allclose(result, 700, rtol=SINGLE)


def edge(near_e, far_e):
    """A near surface on the left at level 12 and a far one on the right at level 2."""
    left = np.arange(160) < 80
    image = np.where(left, near_e, far_e)[None, :, None].repeat(64, 0).repeat(3, 2).astype(np.float32)
    return scene(image, np.where(left, 12.0, 2.0)[None].repeat(64, 0))


def test_a_blurred_near_surface_spreads_over_the_background():
    """With the focus behind, light of the near surface spreads over the far side as a straight edge seen through the
    near kernel.
    """
    result = recon.refocus(edge(1000, 0), recon_scenes.bank(), depth_of(2.0))
    profile = np.cumsum(kernels()[10, 1].sum(axis=0))[::-1]  # share of the near side at distances from the edge
    half = kernels().shape[-1] // 2
    columns = np.arange(80 - 20, 80 + 20)
    expected = 1000 * profile[np.clip(columns - 80 + half + 1, 0, 2 * half)]
    np.testing.assert_allclose(result[32, columns, 1], expected, atol=1000 * BLEED)
    assert result[32, 85, 1] > 50


def test_the_background_does_not_bleed_onto_a_near_surface_in_focus():
    """With the focus on the near surface, that surface receives no light of the background, up to its last pixel."""
    result = recon.refocus(edge(0, 1000), recon_scenes.bank(), depth_of(12.0))
    assert np.abs(result[:, :80]).max() < 1000 * BLEED
    np.testing.assert_allclose(result[:, 80:], 1000, rtol=BLEED)  # nor does the near one darken what is behind it


def test_what_a_blurred_surface_uncovers_is_filled_from_behind():
    """Set-up: a striped background continues behind a dark near surface, whose blurred edge is translucent.
    Expectation: the stripes are visible on the near side too.
    """
    stripes = np.where(np.arange(64) // 4 % 2 == 0, 1000, 0)[:, None, None]
    left = (np.arange(160) < 80)[None, :, None]
    image = np.where(left, 0, stripes).repeat(3, 2).astype(np.float32)
    both = replace(edge(0, 0), sharp_e=image)
    result = recon.refocus(both, recon_scenes.bank(), depth_of(2.0))[..., 1]
    stripe = result[:, 76].reshape(-1, 4).mean(axis=1)  # on the near side
    cover = np.cumsum(kernels()[10, 1].sum(axis=0))[::-1][kernels().shape[-1] // 2 + 77 - 80]
    np.testing.assert_allclose(stripe[::2], 1000 * (1 - cover), atol=1000 * BELOW)
    np.testing.assert_allclose(stripe[1::2], 0, atol=1000 * BELOW)


@pytest.mark.parametrize(("depth_m", "f_number", "message"), [
    (0.003, None, "depth 0.003 m is not allowed; give more than the focal length, 0.0036 m"),
    (float("nan"), None, "depth nan m"),
    (0.2, 0.0, "f-number 0 is not allowed; give more than 0"),
])  # fmt: skip
def test_impossible_requests_are_refused(depth_m, f_number, message):
    with pytest.raises(InputError, match=message):
        recon.refocus(edge(0, 0), recon_scenes.bank(), depth_m, f_number)


def test_a_bank_of_another_focus_is_refused():
    bank = recon_scenes.bank()
    lens = bank.camera.lens.model_copy(update={"focus_distance_m": 1.0})
    with pytest.raises(InputError, match="focused at 1 m"):
        recon.refocus(edge(0, 0), replace(bank, camera=bank.camera.model_copy(update={"lens": lens})), depth_of(2.0))
