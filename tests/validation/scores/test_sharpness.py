"""Gains of the all-in-focus picture, widths of edges and halos have the values that made-up pictures are given."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from dasim.camera import specification
from tests.support import surfaces
from validation.scores import sharpness
from validation.scores.pictures import references

SIZE = (120, 160)
EXACT = 1e-6
WIDTH_TOLERANCE_PX = 0.1  # a fifth of the step of the Gaussians' widths
NOISY_TOLERANCE_PX = 0.3  # with noise of a tenth of the texture's contrast, and 2,000 edge pixels
PIXELATED = 0.03  # relative: a disc of 20 px of whole pixels, and gradients over two of them
ROUNDING_DB = 0.01  # pictures are held in single precision
MEAN_E = np.array([800.0, 1500.0, 700.0, 600.0])


@pytest.fixture(scope="module")
def texture():
    """Coarse random texture, [h, w], mean 1."""
    noise = np.random.default_rng(1).standard_normal(SIZE)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.0)
    return 1 + 0.2 * smooth / smooth.std()


@pytest.fixture(scope="module")
def scene(texture):
    """Ground truth of five walls, one in each interval of blur, and a reconstruction that knows its depth."""
    camera = specification.cropped(specification.load_camera("da-mobile"), SIZE[1], SIZE[0])
    px_per_level = surfaces.geometry.level_blur_px(camera)[1]
    level = np.repeat([0.5, 2.0, 5.0, 14.0, 25.0], SIZE[1] // 5)[None].repeat(SIZE[0], axis=0) / px_per_level
    truth = surfaces.truth(camera, level, MEAN_E * texture[..., None])
    truth = dataclasses.replace(truth, focus_e=truth.sharp_e)
    return truth, dataclasses.replace(surfaces.exact_reconstruction(truth, camera), light="D65")


# --- regions and gains ---------------------------------------------------------------------------


def test_regions_are_intervals_of_blur_and_three_pixels_on_either_side_of_a_step(scene):
    """Expectation: walls 32 px wide each in its own interval; the steps of more than a level have 6 px each."""
    truth, _ = scene
    regions = sharpness.regions(truth)
    assert tuple(regions) == sharpness.REGIONS
    for number, name in enumerate(sharpness.BINS_PX):
        assert np.flatnonzero(regions[name][0]).tolist() == list(range(32 * number, 32 * number + 32))
    steps = [32 * number for number in range(1, 5) if np.diff(truth.level[0])[32 * number - 1] > 1]
    assert len(steps) >= 3
    wanted = [x for step in steps for x in range(step - 3, step + 3)]
    assert np.flatnonzero(regions["boundary"][60]).tolist() == wanted


def test_boundaries_are_in_no_interval_and_what_is_not_seen_in_no_region(scene):
    truth = dataclasses.replace(scene[0], boundary=np.ones(SIZE, bool))
    assert not any(sharpness.regions(truth)[name].any() for name in sharpness.BINS_PX)
    nothing = dataclasses.replace(scene[0], valid=np.zeros(SIZE, bool))
    assert not any(region.any() for region in sharpness.regions(nothing).values())


def test_half_the_error_gains_six_decibels_everywhere(scene):
    """Expectation: 20 log10 2 in each region; errors of display values fall as well."""
    truth, result = scene
    exact = references(result, truth)["-focus"]
    error = 0.05 * exact.mean() * np.random.default_rng(2).standard_normal(exact.shape)
    result = dataclasses.replace(result, linear_e=np.float32(exact + error), sharp_e=np.float32(exact + error / 2))
    found = sharpness.sharpness(result, truth)
    for region in sharpness.REGIONS:
        for quantity in ("gain", "gain-sharp"):
            assert found.gains[f"{quantity}.{region}"] == pytest.approx(20 * np.log10(2), abs=ROUNDING_DB)
        assert found.gains[f"ssim.{region}"] > 0 and found.gains[f"ciede2000.{region}"] > 0


def test_a_sharper_picture_gains_width(scene):
    """Expectation: of a picture that was blurred, and is no longer, that blur's width."""
    truth, result = scene
    exact = references(result, truth)["-focus"].astype(np.float32)
    result = dataclasses.replace(result, linear_e=cv2.GaussianBlur(exact, (0, 0), 2.0), sharp_e=exact)
    gains = sharpness.sharpness(result, truth).gains
    assert gains["width.all"] == pytest.approx(2.0 * sharpness.WIDTH_PER_SIGMA, abs=WIDTH_TOLERANCE_PX)
    assert gains["gain.3-8"] > 60, "rounding to single precision is what remains"


def test_a_region_with_too_few_pixels_has_no_value(scene):
    truth, result = scene
    valid = np.ones(SIZE, bool)
    valid[:, 33:64] = False  # of the second wall, one column in 160 is left
    result = dataclasses.replace(result, linear_e=0 * result.linear_e, sharp_e=0 * result.sharp_e)
    gains = sharpness.sharpness(result, dataclasses.replace(truth, valid=valid)).gains
    assert np.isnan(gains["gain.1-3"]) and gains["gain.3-8"] == 0


# --- width of edges ------------------------------------------------------------------------------


@pytest.mark.parametrize("sigma", [0.6, 1.0, 2.2, 5.0])
def test_the_width_of_a_gaussian_blur_is_found(texture, sigma):
    """Expectation: the 10-90 % width of its edge-spread function, twice 1.2816 standard deviations."""
    blurred = sharpness.blurred_gradients(texture)
    where = np.ones(SIZE, bool)
    picture = cv2.GaussianBlur(texture.astype(np.float32), (0, 0), sigma)
    assert sharpness.edge_width(picture, blurred, where) == pytest.approx(2 * 1.2816 * sigma, abs=WIDTH_TOLERANCE_PX)
    noisy = picture + 0.02 * np.random.default_rng(3).standard_normal(SIZE)
    assert sharpness.edge_width(noisy, blurred, where) == pytest.approx(2 * 1.2816 * sigma, abs=NOISY_TOLERANCE_PX)


def test_the_width_of_a_disc_is_that_of_the_gaussian_as_steep():
    """Expectation: a step blurred by a disc of diameter d is 4 / (pi d) steep, as by a Gaussian of 0.313 d."""
    step = np.repeat([1.0, 2.0], 80)[None].repeat(120, axis=0)
    y, x = np.mgrid[-12:13, -12:13]
    disc = (np.hypot(x, y) <= 10.0).astype(float)
    picture = cv2.filter2D(step, -1, disc / disc.sum(), borderType=cv2.BORDER_REPLICATE)
    where = np.zeros(step.shape, bool)
    where[:, 60:100] = True
    found = sharpness.edge_width(picture, sharpness.blurred_gradients(step), where)
    assert found == pytest.approx(sharpness.WIDTH_PER_SIGMA * np.sqrt(np.pi / 32) * 20, rel=PIXELATED)


def test_the_truth_has_no_width_to_add_and_an_empty_mask_none(texture):
    blurred = sharpness.blurred_gradients(texture)
    assert sharpness.edge_width(texture, blurred, np.ones(SIZE, bool)) == 0
    texture = texture.copy()
    texture[SIZE[0] // 2] = np.nan
    assert np.isnan(sharpness.edge_width(texture, blurred, np.ones(SIZE, bool))), "a broken picture is not sharp"
    assert np.isnan(sharpness.edge_width(texture, blurred, np.zeros(SIZE, bool)))


# --- halos ---------------------------------------------------------------------------------------


@pytest.fixture
def step():
    """A silhouette: levels, and a picture that is brighter on the near side, of 200 on 100."""
    level = np.repeat([2.0, 8.0], 60)[None].repeat(100, axis=0)
    return level, np.where(level > 5, 200.0, 100.0)


SEEN = np.ones((100, 120), bool)


def unsharp(image, strength, radius=2):
    """The image plus its difference from the mean of 2 radius + 1 columns."""
    return image + strength * (image - cv2.blur(image, (2 * radius + 1, 1), borderType=cv2.BORDER_REPLICATE))


def test_neither_the_truth_nor_its_blur_has_a_halo(step):
    level, exact = step
    assert sharpness.halo(exact, exact, level, SEEN) == 0
    assert sharpness.halo(cv2.GaussianBlur(exact, (0, 0), 3), exact, level, SEEN) < EXACT


@pytest.mark.parametrize("strength", [0.1, 0.5])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_unsharp_mask_has_its_overshoot(step, strength, sign):
    """Expectation: beside a step, the mean of 5 columns holds 2 of the other side: strength x 2 / 5 of the step."""
    level, exact = step
    exact = 150 + sign * (exact - 150)
    assert sharpness.halo(unsharp(exact, strength), exact, level, SEEN) == pytest.approx(strength * 2 / 5, rel=EXACT)


def test_a_halo_on_one_side_counts_and_one_within_the_range_of_the_truth_does_not(step):
    level, exact = step
    picture = exact.copy()
    picture[:, 57:60] -= 10  # of a step of 100, on the dark side
    assert sharpness.halo(picture, exact, level, SEEN) == pytest.approx(0.1, rel=EXACT)
    picture[:, 57:60] += 20
    assert sharpness.halo(picture, exact, level, SEEN) == 0


def test_fine_noise_is_averaged_along_the_silhouette(step):
    """Expectation: noise of a tenth of the step is no halo of a tenth; means over 33 px have a sixth of it."""
    level, exact = step
    noisy = exact + 10 * np.random.default_rng(4).standard_normal(exact.shape)
    assert 0 < sharpness.halo(noisy, exact, level, SEEN) < 0.06


def test_faint_silhouettes_and_pictures_without_any_are_not_judged(step):
    level, exact = step
    faint = np.where(level > 5, 110.0, 100.0)
    assert np.isnan(sharpness.halo(unsharp(faint, 1.0), faint, level, SEEN))
    assert np.isnan(sharpness.halo(exact, exact, np.full_like(level, 3.0), SEEN))
