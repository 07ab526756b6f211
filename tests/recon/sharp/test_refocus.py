"""Refocusing: closed forms for one plane, conservation of light, and occlusion at edges."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy import signal

import recon
from dasim.base.errors import InputError
from dasim.files.banks import bank_identity
from dasim.values import Reconstruction
from recon.picture import infrared
from recon.settings import PAPER
from recon.sharp import layers, sharpen
from recon.sharp.refocus import KERNEL_SHARE, colour_kernels, layered
from tests.support import recon_scenes

SINGLE = 2e-4  # of the value: sums of some thousand terms in float32
PIXEL_SHARE = 0.02  # of a kernel's light that its non-negative form without the pixel's area misplaces
BLEED = 2e-3  # of the brighter side's light: float32, and a kernel's tail that is cut
MOMENT = 0.03  # of a diameter: noise of a measured kernel's tail, and its cut
PASSED = 0.01  # of a point's light
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
    return colour_kernels(scene(np.zeros((8, 8, 3)), np.zeros((8, 8))), recon_scenes.bank())[0]


def test_each_side_of_the_focus_has_kernels_of_its_own():
    """Set-up: two points, one on either side of the focus, and kernels of different width per side."""
    sharp, steps = np.zeros((40, 80, 3), np.float32), np.full((40, 80), 3.0)
    sharp[20, [20, 60]] = 1000
    steps[:, 40:] = -3
    narrow, wide = kernels(), kernels()[np.minimum(2 * np.arange(len(kernels())), len(kernels()) - 1)]
    alike, apart = layered(sharp, steps, narrow), layered(sharp, steps, narrow, wide)
    np.testing.assert_allclose(apart[:, :30], alike[:, :30], atol=1e-2)
    assert apart[20, 60, 1] < 0.8 * alike[20, 60, 1]


def test_blur_that_no_kernel_holds_is_refused():
    with pytest.raises(InputError, match="at most 401 px"):
        layered(np.ones((32, 32, 3), np.float32), np.full((32, 32), 400.0), kernels())


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


def uneven_levels():
    """Level maps [64, 96] by name: a step, a slant, noise from pixel to pixel, and thin bars in front of a wall."""
    columns, rows = np.arange(96), np.arange(64)[:, None]
    return {
        "step": np.where(columns < 48, 3.0, 14.0)[None].repeat(64, 0),
        "slant": recon_scenes.slanted(64, 96, 0.0, 20.0),
        "noise": np.random.default_rng(2).uniform(0, 20, (64, 96)),
        "bars": np.where((columns % 9 < 2) | (rows % 31 < 3), 17.0, 1.5),
    }


@pytest.mark.parametrize("level", uneven_levels().values(), ids=uneven_levels())
@pytest.mark.parametrize("stops", [0.5, 1.0, 2.0])
def test_an_even_light_stays_even(level, stops):
    """A world of uniform radiance stays uniform for any layout of depths: coverage adds up to one everywhere."""
    image, f_number = np.full((64, 96, 3), 700, np.float32), stops * recon_scenes.bank().camera.lens.f_number
    for focus in (3.0, 14.0):
        result = recon.refocus(scene(image, level), recon_scenes.bank(), depth_of(focus), f_number)
        np.testing.assert_allclose(result, 700, rtol=SINGLE)


def point(level, focus):
    """Picture of a point of light in the middle of one surface, as a share of its light, [161, 161]."""
    image = np.zeros((161, 161, 3), np.float32)
    image[80, 80] = 1000
    return recon.refocus(scene(image, np.full((161, 161), level)), recon_scenes.bank(), depth_of(focus))[..., 1] / 1000


@pytest.mark.parametrize(("level", "focus"), [(14.0, 2.0), (2.0, 14.0), (20.0, 0.0), (0.0, 20.0)])
def test_a_point_looks_as_the_kernel_on_either_side_of_the_focus(level, focus):
    picture, kernel = point(level, focus), layers.cut(kernels()[int(abs(level - focus))], KERNEL_SHARE)[1]
    half = kernel.shape[-1] // 2
    np.testing.assert_allclose(picture[80 - half : 81 + half, 80 - half : 81 + half], kernel, atol=SINGLE)
    assert picture.sum() == pytest.approx(1, rel=SINGLE)


@pytest.mark.parametrize("blur", [8, 12, 16])
@pytest.mark.parametrize("stops", [1.0, 0.5])
def test_the_size_of_a_point_is_that_of_a_thin_lens(blur, stops):
    """A disc of diameter c has the second moment c^2 / 8 about its centre. That of the lens in focus is added to it, by
    diffraction, less the 1/6 of a pixel.
    """
    bank = recon_scenes.bank()
    separation = infrared.separation(bank.camera, "D65", PAPER)
    in_focus = layers.cut(sharpen.visible_kernels(bank.kernel[0], bank.signature[0], separation)[0, :3], KERNEL_SHARE)

    def moment(image):
        y, x = np.indices(image.shape) - image.shape[0] // 2
        return np.sum((x**2 + y**2) * image)

    level = blur * stops
    image = np.zeros((161, 161, 3), np.float32)
    image[80, 80] = 1
    for own, focus in ((level, 0.0), (0.0, level)):  # in front of and behind the focus
        result = recon.refocus(
            scene(image, np.full((161, 161), own)), bank, depth_of(focus), stops * bank.camera.lens.f_number
        )
        diameter = blur * float(bank.blur_px[1])
        measured = np.sqrt(8 * (moment(result[..., 1]) - moment(in_focus[1]) + 1 / 6))
        assert measured == pytest.approx(diameter, rel=MOMENT)


def edge(near_e, far_e):
    """A near surface on the left at level 12 and a far one on the right at level 2."""
    left = np.arange(160) < 80
    image = np.where(left, near_e, far_e)[None, :, None].repeat(64, 0).repeat(3, 2).astype(np.float32)
    return scene(image, np.where(left, 12.0, 2.0)[None].repeat(64, 0))


@pytest.mark.parametrize(("near_e", "far_e"), [(1000, 0), (100, 1000)])
@pytest.mark.parametrize("focus", [0.0, 2.0, 7.0, 12.0])
def test_a_silhouette_is_the_edge_of_the_near_kernel(near_e, far_e, focus):
    """At any focus, a sensor pixel sees of two even surfaces as much of the near one as that covers of the aperture:
    bright or dark, its blur spreads over the far one as the edge-spread of its own kernel, and the far one adds none.
    """
    result = recon.refocus(edge(near_e, far_e), recon_scenes.bank(), depth_of(focus))
    profile = np.cumsum(kernels()[int(12 - focus), 1].sum(axis=0))[::-1]  # share of the near side, by distance
    half = kernels().shape[-1] // 2
    columns = np.arange(80 - 20, 80 + 20)
    cover = profile[np.clip(columns - 80 + half + 1, 0, 2 * half)]
    np.testing.assert_allclose(result[32, columns, 1], near_e * cover + far_e * (1 - cover), atol=1000 * BLEED)


def disc(diameter_px, size=41, finer=8):
    """Even disc of unit sum, averaged over pixels, [size, size]; a point if it is smaller than a pixel."""
    if diameter_px < 1:
        diameter_px = 0.5
    place = (np.arange(size * finer) + 0.5) / finer - size / 2
    inside = np.hypot(*np.meshgrid(place, place)) <= diameter_px / 2
    return inside.reshape(size, finer, size, finer).mean(axis=(1, 3)) / (inside.sum() / finer**2)


def passed(distance_px, blur_levels):
    """Share of a disc-shaped aperture through which a point is seen past a rim at a distance from its centre."""
    reach = distance_px / (blur_levels * float(recon_scenes.bank().blur_px[1]) / 2)
    reach = min(reach, 1.0)
    return 0.5 + (np.arcsin(reach) + reach * np.sqrt(1 - reach**2)) / np.pi


@pytest.mark.parametrize("focus", [2.0, 12.0])
@pytest.mark.parametrize("beyond_px", [1, 3, 6, 14])
def test_a_point_beside_a_near_surface_is_hidden_in_part(focus, beyond_px):
    """The near surface hides a segment of the aperture from a point behind its rim; a disc without diffraction
    is the kernel. Expectation: the light of the point that is left is that of the free part of the disc.
    """
    discs = np.stack([disc(level * float(recon_scenes.bank().blur_px[1])) for level in range(13)])
    image = edge(0, 0).sharp_e.copy()
    image[32, 80 + beyond_px] = 1000
    result = layered(image, edge(0, 0).level - np.float32(focus), discs[:, None].repeat(3, 1))
    share = result[..., 1].sum() / 1000
    assert share == pytest.approx(passed(beyond_px + 0.5, 10), abs=PASSED)


def test_a_point_on_the_near_surface_keeps_its_light():
    """A point at the rim of the near surface loses nothing to the far one, in focus or out of it."""
    image = edge(0, 0).sharp_e.copy()
    image[32, 78] = 1000
    for focus in (2.0, 7.0, 12.0):
        result = recon.refocus(replace(edge(0, 0), sharp_e=image), recon_scenes.bank(), depth_of(focus))
        assert result[..., 1].sum() == pytest.approx(1000, rel=PASSED)


def test_each_depth_in_focus_is_the_all_in_focus_picture():
    """Set-up: a wall and two plates in front of it. Expectation: focused on each, what lies there is the sharp
    picture, the plates up to their rim, the wall away from the blur of the plates.
    """
    image = texture(160, 200)
    level = np.full(image.shape[:2], 1.0)
    level[20:70, 20:80], level[80:150, 120:190] = 6.0, 13.0
    for focus in (1.0, 6.0, 13.0):
        result = recon.refocus(scene(image, level), recon_scenes.bank(), depth_of(focus))
        nearer = (level > focus).astype(np.uint8)
        reach = layers.cut(kernels()[12], KERNEL_SHARE).shape[-1] // 2
        free = (level == focus) & (cv2.dilate(nearer, np.ones((2 * reach + 1,) * 2)) == 0)
        np.testing.assert_allclose(result[free], image[free], rtol=BLEED, atol=BLEED * image.max())
        assert free.sum() > 1000


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


def test_a_bank_that_the_reconstruction_accepts_is_accepted():
    """Set-up: a focus half a per cent away, and another distortion, on which kernels do not depend."""
    bank = recon_scenes.bank()
    lens = bank.camera.lens
    moved = lens.model_copy(update={"focus_distance_m": 1.005 * lens.focus_distance_m, "distortion_per_mm": (0.01,)})
    other = replace(bank, camera=bank.camera.model_copy(update={"lens": moved}))
    picture = edge(2, 2)
    found = recon.refocus(picture, other, depth_of(2.0))
    np.testing.assert_allclose(found, recon.refocus(picture, bank, depth_of(2.0)), rtol=1e-5)


@pytest.mark.parametrize("change", ["levels", "lights"])
def test_a_bank_of_other_levels_or_lights_is_refused(change):
    bank = recon_scenes.bank()
    whole = replace(edge(2, 2), bank=bank_identity(bank))
    other = {
        "levels": replace(bank, kernel=bank.kernel[:, ::2], depth_m=bank.depth_m[::2], blur_px=bank.blur_px[::2]),
        "lights": replace(bank, kernel=bank.kernel[1:], signature=bank.signature[1:], lights=bank.lights[1:]),
    }[change]
    with pytest.raises(InputError, match="give the bank of the reconstruction"):
        recon.refocus(whole, other, depth_of(2.0))
