"""The gates of the claim exposure fail for rates that are not found again, clipped light, and a slow exposure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dasim.simulation import exposure as exposing
from validation.claims.cost import exposure
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates


def failed(figures) -> set[str]:
    """Ids of the figures that violate their limits, without the costs of a small frame."""
    entries = judged_all("exposure", figures, load_gates(GATES, CLAIMS))
    verdicts = {entry.id.removeprefix("exposure."): entry.passed for entry in entries}
    return {name for name, passed in verdicts.items() if passed is False and not name.startswith("cost")}


@pytest.fixture
def measured(jit, monkeypatch):
    """Function that measures the claim at a size that a test affords.

    With eight samples per pixel: with two, the control variate leaves some pixels so close to zero that the rounding of
    single precision is a large part of them.
    """
    monkeypatch.setattr(exposure, "SIZE_PX", (64, 48))
    monkeypatch.setattr(exposure, "SPP", 8)
    return lambda: failed(exposure.exposure(lambda share: None).figures)


@pytest.mark.slow
def test_the_claim_holds(measured):
    assert measured() == set()


@pytest.mark.slow
def test_rates_of_full_precision_are_not_found_again(measured, monkeypatch):
    monkeypatch.setattr("dasim.simulation.simulate.to_precision", np.float32)
    monkeypatch.setattr("dasim.simulation.exposure.to_precision", np.float32)
    assert "time.truth" in measured()


@pytest.mark.slow
def test_light_that_the_full_well_clips_fails(measured, monkeypatch):
    def clipped(shot, where):
        light = whole(shot, where)
        most = light.camera.sensor.full_well_e / shot.capture.exposure_s
        return replace(light, rate=np.minimum(light.rate, np.float32(most)))

    whole = exposing.sensor_light_of
    monkeypatch.setattr("dasim.simulation.exposure.sensor_light_of", clipped)
    assert "time.raw" in measured()


def test_an_exposure_that_renders_again_is_too_dear():
    entries = judged_all("exposure", exposure.cost_figures(10.0, 9.0, 9.0), load_gates(GATES, CLAIMS))
    verdict = {entry.id.removeprefix("exposure."): entry.passed for entry in entries}
    assert verdict["cost.frame"] is False and verdict["cost.folder"] is False and verdict["seconds.render"] is None
