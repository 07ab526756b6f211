"""The bound of windows: the strength of a known texture, the bound's closed form, and what makes windows tell less."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.bounds import cramer_rao
from dasim.camera import geometry, specification
from dasim.camera import sensor as sensors
from dasim.simulation.exposure import Shot
from dasim.values import Capture
from tests.support import surfaces
from validation.studies import criteria
from validation.subjects import window_bound
from validation.subjects.texture import noise_variance

SIZE = (192, 256)
CONTRAST = 0.1  # per octave
MEAN_E = np.array([800.0, 1500.0, 700.0, 600.0])
INNER = (slice(48, -48), slice(48, -48))
CONTRAST_MISFIT = 0.1  # of one realisation: some 250 independent samples of the band


@pytest.fixture(scope="module")
def texture():
    """Natural texture of a contrast of 1 per octave, [h, w]."""
    random = np.random.default_rng(5)
    power = cramer_rao.natural_power(SIZE, contrast=1.0)
    return np.fft.irfft2(np.fft.rfft2(random.standard_normal(SIZE)) * np.sqrt(power), SIZE)


def shot(texture, level, *, camera="da-mobile", mean_e=MEAN_E, contrast=CONTRAST) -> Shot:
    cropped = specification.cropped(specification.load_camera(camera), SIZE[1], SIZE[0])
    picture = mean_e * (1 + contrast * texture[..., None])
    truth = surfaces.truth(cropped, np.full(SIZE, float(level)), picture)
    return Shot(Capture(np.zeros(SIZE, np.uint16), cropped, 0.02, 1.0, 0, "D65"), truth)


def bound(*arguments, **options) -> float:
    where = np.zeros(SIZE, bool)
    where[INNER] = True
    return float(np.median(window_bound.level_bounds(shot(*arguments, **options), where)))


def test_the_contrast_of_a_texture_is_found(texture):
    power = window_bound.octave_power(1000 * (1 + CONTRAST * texture), np.ones(SIZE, bool))
    assert np.sqrt(power[INNER].mean()) == pytest.approx(1000 * CONTRAST, rel=CONTRAST_MISFIT)


def test_a_boundary_is_no_texture(texture):
    """Set-up: a bright object in the corner, with its outline left out. Expectation: the power of the texture."""
    inner = np.ones(SIZE, bool)
    inner[:110, :140] = False
    picture = 1000 * (1 + CONTRAST * texture)
    picture[:100, :130] += 5000
    with_object, without = (window_bound.octave_power(p, inner) for p in (picture, 1000 * (1 + CONTRAST * texture)))
    assert with_object[120, 150] == pytest.approx(without[120, 150], rel=0.1)


@pytest.mark.parametrize("level", [2.5, 9.0])
def test_the_bound_is_that_of_its_closed_form(texture, da_mobile, level):
    """Expectation: the bound of a known patch of this texture, from the covariance's inverse in closed form."""
    index = [sensors.channels(da_mobile.sensor).index(name) for name in window_bound.PLANES]
    variance = noise_variance(da_mobile, MEAN_E, 0.02)[index]
    power = cramer_rao.natural_power(criteria.SHAPE, spacing_px=2.0, contrast=CONTRAST * MEAN_E[index[0]])
    area = cramer_rao.window_area_px(31) / (criteria.SHAPE[0] * criteria.SHAPE[1] * 2.0**2)
    patch = criteria.TexturePatch(power, variance, MEAN_E[index] / MEAN_E[index[0]], area)
    step_px = geometry.level_blur_px(da_mobile)[1]
    planes = cramer_rao.camera_transfers(da_mobile, level * step_px, "D65", criteria.SHAPE, spacing_px=2.0)
    expected = np.sqrt(criteria.blur_variance(*(part[:, index] for part in planes), patch, "spectrum")[0][0]) / step_px
    assert bound(texture, level) == pytest.approx(expected, rel=CONTRAST_MISFIT)


def test_what_makes_a_window_tell_less(texture):
    """Expectation: less light, less infrared and less contrast do; a mosaic with twice the green pixels tells more."""
    best = bound(texture, 5)
    assert bound(texture, 5, mean_e=MEAN_E / 10) > 1.5 * best
    assert bound(texture, 5, mean_e=MEAN_E * (1, 1, 1, 0.1)) > 1.5 * best
    assert bound(texture, 5, contrast=CONTRAST / 3) > 1.5 * best
    assert bound(texture, 5, camera="da-4x4") < best


def test_strength_and_brightness_are_those_of_each_window(texture):
    """Set-up: twice the contrast on the right, or half the light. Expectation: the bound of a capture of these."""
    right = np.arange(SIZE[1]) >= SIZE[1] // 2
    where = np.zeros(SIZE, bool)
    where[48:-48, 180:-30] = where[48:-48, 30:-180] = True
    mixed = window_bound.level_bounds(shot(texture * np.where(right, 2, 1), 5), where)
    whole = {factor: window_bound.level_bounds(shot(factor * texture, 5), where) for factor in (1, 2)}
    side = np.broadcast_to(right, SIZE)[where]
    for part, factor in ((side, 2), (~side, 1)):
        assert np.median(mixed[part] / whole[factor][part]) == pytest.approx(1, abs=0.03)


def test_the_interpolation_meets_its_nodes():
    random = np.random.default_rng(1)
    table = np.exp(random.normal(size=(len(window_bound.STRENGTHS), len(window_bound.BLUR_PX))))
    for row, column in ((0, 0), (3, 4), (len(table) - 1, table.shape[1] - 1)):
        place = window_bound.STRENGTHS[[row]], window_bound.BLUR_PX[[column]]
        assert window_bound._interpolated(table, *place) == pytest.approx(table[row, column])


def test_no_pixels_have_no_bound(texture):
    assert window_bound.level_bounds(shot(texture, 5), np.zeros(SIZE, bool)).size == 0
