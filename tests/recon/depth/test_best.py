"""The preset ``best`` on captures with known levels: a ramp, a capture without texture, clipped pixels."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import recon
from dasim.base.loading import load_function
from recon.depth.method import METHODS
from tests.support import recon_scenes

ABLATIONS = Path(__file__).parents[3] / "examples" / "ablations.py"
BEST, BANDS = recon.PRESETS["best"], recon.PRESETS["bands"]


@pytest.fixture(scope="module")
def ramp():
    return recon_scenes.make(recon_scenes.slanted(256, 320, 0.5, 9), white_e=3000)


@pytest.fixture(scope="module")
def result(ramp):
    return recon.reconstruct(ramp.capture, recon_scenes.bank(), BEST)


def test_a_slanted_surface_is_followed(ramp, result):
    """Expectation: a median error below 0.4 levels, a mean error below that of ``bands``, and no gap."""
    error = np.abs(result.level - ramp.level)
    other = np.abs(recon.reconstruct(ramp.capture, recon_scenes.bank(), BANDS).level - ramp.level)
    assert np.isfinite(result.level).all()
    assert np.median(error) < 0.4
    assert error.mean() < other.mean()


def test_the_standard_deviation_holds_most_errors(ramp, result):
    sd = np.sqrt(1 / result.confidence - 1)
    share = (np.abs(result.level - ramp.level) <= sd).mean()
    assert share > 0.6
    assert np.median(sd) < 1.5


def test_raw_levels_are_those_of_windows_that_know(result):
    known = np.isfinite(result.level_raw)
    assert 0.5 < known.mean() <= 1
    assert np.median(np.abs(result.level_raw - result.level)[known]) < 1


def test_clipped_pixels_take_the_level_of_their_neighbours(ramp):
    """Set-up: a square of 60 px is saturated. Expectation: no level there differs from the surface's by more than 3."""
    raw = ramp.capture.raw_dn.copy()
    box = (slice(100, 160), slice(120, 180))
    raw[box] = 2**ramp.capture.camera.sensor.adc_bits - 1
    capture = dataclasses.replace(ramp.capture, raw_dn=raw)
    found = recon.reconstruct(capture, recon_scenes.bank(), BEST)
    assert np.abs(found.level - ramp.level)[box].max() < 3


def test_large_windows_alone_follow_the_surface_too(ramp):
    """Expectation: of ``fast``, the error of ``best`` or little more, with other levels."""
    found = recon.reconstruct(ramp.capture, recon_scenes.bank(), recon.PRESETS["fast"])
    assert 0.05 < np.median(np.abs(found.level - ramp.level)) < 0.6


@pytest.mark.parametrize(
    "name",
    [
        *(
            "without_network",
            "network_alone",
            "one_network",
            "without_row",
            "without_weighted_median",
            "without_picture",
        ),
        *("without_small_windows", "without_bands"),
    ],
)
def test_the_estimate_without_an_ingredient_differs(ramp, name):
    """Expectation: of each example of an ablation, a map that is not the default's, and not far from it."""
    method = load_function(f"{ABLATIONS}:{name}", "method")
    found, default = (
        recon.reconstruct(ramp.capture, recon_scenes.bank(), method=of).level for of in (method, METHODS["best"])
    )
    assert 0.005 < np.abs(found - default).mean() < 2


def cut(last):
    """The bank without its levels beyond ``last``."""
    bank = recon_scenes.bank()
    short = {name: getattr(bank, name)[: last + 1] for name in ("depth_m", "blur_px")}
    return dataclasses.replace(bank, kernel=bank.kernel[:, : last + 1], **short)


@pytest.mark.parametrize("preset", ["best", "fast"])
@pytest.mark.parametrize(("last", "level"), [(2, 1), (3, 2), (12, 12)])
def test_short_banks_know_their_levels(preset, last, level):
    """Set-up: a textured plane; a bank that ends at its level or soon beyond.

    Expectation: known, and within a level: 12 is reached, which lay beyond the levels of the network before. Scores of
    few levels differ less than those of many.
    """
    capture = recon_scenes.make(np.full((96, 128), float(level)), photo="brick", white_e=3000).capture
    found = recon.reconstruct(capture, cut(last), recon.PRESETS[preset])
    assert abs(np.median(found.level) - level) < 0.95
    assert np.median(found.confidence) > 0.2
    assert np.isfinite(found.level_raw).mean() > 0.5


def test_a_short_bank_knows_nothing_of_noise():
    """Set-up: a plane without texture. Expectation: no confidence with three levels either."""
    plain = recon_scenes.make(np.zeros((96, 128)), photo="brick", white_e=3000)
    raw = plain.capture.raw_dn.copy()
    for y, x in np.ndindex(2, 2):
        own = raw[y::2, x::2]
        random = np.random.default_rng((y, x))
        own[:] = random.permutation(np.quantile(own, random.uniform(0.49, 0.51, own.size))).reshape(own.shape)
    found = recon.reconstruct(dataclasses.replace(plain.capture, raw_dn=raw), cut(2), BEST)
    assert found.confidence.max() == 0


@pytest.mark.parametrize("levels", [(1.0, 5.0), (2.0, 8.0)])
def test_steps_that_are_moved_count_as_doubt(levels):
    """Set-up: two boards side by side; the filter moves their step to an edge of the picture.

    Expectation: within 12 px of the step, at most a fifth of the errors is above three standard deviations.
    """
    width = 192
    level = np.where(np.arange(width) < width // 2, *levels) * np.ones((144, 1))
    found = recon.reconstruct(recon_scenes.make(level, photo="brick", white_e=3000).capture, recon_scenes.bank(), BEST)
    near = np.abs(np.arange(width) + 0.5 - width / 2) < 12
    sd = np.sqrt(1 / found.confidence - 1)
    assert (np.abs(found.level - level) > 3 * sd)[:, near].mean() < 0.2


@pytest.mark.parametrize("preset", ["likelihood", "bands", "chakrabarti-zickler"])
def test_standard_deviations_of_the_other_presets_are_those_of_their_errors(preset):
    """Set-up: planes of gravel. Expectation: errors of 0.3 to 6 standard deviations, root mean square; those of few
    levels' bias are among them.
    """
    share = []
    for level in (5.0, 10.0):
        scene = recon_scenes.make(np.full((128, 160), level), photo="gravel", white_e=2000)
        found = METHODS[preset](scene.capture, recon_scenes.bank())
        known = np.isfinite(found.level)
        share.append(((found.level[known] - level) / found.sd[known]) ** 2)
    assert 0.3 < np.sqrt(np.concatenate(share).mean()) < 6
