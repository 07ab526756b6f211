"""The gates of the claim fewer-rays fail without a control variate, and with one whose mean is not what it says."""

from __future__ import annotations

from dataclasses import replace

import pytest

import dasim
from dasim.simulation import exact
from validation.claims.cost import fewer_rays
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates


@pytest.fixture
def failed(jit, monkeypatch):
    """Function that gives the ids of the figures of a small picture that violate their limits."""
    monkeypatch.setattr(fewer_rays, "SIZE_PX", (32, 24))
    monkeypatch.setattr(fewer_rays, "BIAS_SIZE_PX", (32, 24))
    monkeypatch.setattr(fewer_rays, "BIAS_SEEDS", 8)
    monkeypatch.setattr(fewer_rays, "BIAS_SPP", 64)
    monkeypatch.setattr(fewer_rays, "PLAIN_SPP", (16, 64))
    monkeypatch.setattr(fewer_rays, "TARGETS", {"default": (0.4, 50.0)})
    scene = dasim.load_scene("desk")

    def run() -> set[str]:
        figures = fewer_rays.bias_figures(scene) + fewer_rays.ray_figures("desk", scene)
        entries = judged_all("fewer-rays", figures, load_gates(GATES, CLAIMS))
        return {entry.id.removeprefix("fewer-rays.") for entry in entries if entry.passed is False}

    return run


@pytest.mark.slow
def test_the_means_are_the_same(failed):
    assert not [name for name in failed() if name.startswith("bias")]


@pytest.mark.slow
def test_an_expectation_that_is_off_fails(failed, monkeypatch):
    true = exact.sharp_pictures

    def off(*arguments):
        sharp = true(*arguments)
        controls = [control and replace(control, expected=0.9 * control.expected) for control in sharp.controls]
        return replace(sharp, controls=controls)

    monkeypatch.setattr(exact, "sharp_pictures", off)
    assert "bias.p.G" in failed()


@pytest.mark.slow
def test_rays_without_a_control_variate_are_not_fewer(failed, monkeypatch):
    true = exact.sharp_pictures
    monkeypatch.setattr(exact, "sharp_pictures", lambda *arguments: fewer_rays._without(true(*arguments)))
    assert "ratio.default.desk" in failed()
