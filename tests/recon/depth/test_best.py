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
    found = method(ramp.capture, recon_scenes.bank()).level
    default = METHODS["best"](ramp.capture, recon_scenes.bank()).level
    assert 0.005 < np.abs(found - default).mean() < 2
