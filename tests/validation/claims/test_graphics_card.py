"""The gates of the claim graphics-card fail for other pictures; without a card it is not run."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.render import backend
from validation.claims.cost import graphics_card
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates
from validation.subjects.rendering import NotRun


@pytest.fixture(scope="module")
def pictures(renderer):
    """Pictures of ``desk`` with 16 seeds for each variant."""
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), 32, 24), dasim.load_scene("desk"))
    found = [dasim.simulate("desk", camera, seed, spp=8).truth.mean_e for seed in range(32)]
    return {graphics_card.CARD: np.array(found[:16]), graphics_card.PROCESSOR: np.array(found[16:])}


@pytest.mark.slow
@pytest.mark.parametrize("change", ["none", "brighter", "edge"])
def test_a_card_whose_pictures_are_others_fails(pictures, monkeypatch, change):
    """Set-up: those of the card 2 % brighter, or 10 % darker in a corner."""
    there = np.ones((24, 32, 1))
    there[:8, :8] = 0.9 if change == "edge" else 1.0
    factor = {graphics_card.CARD: 1.02 if change == "brighter" else there, graphics_card.PROCESSOR: 1.0}

    def run(variant, file):
        np.savez(file, **{str(scene): pictures[variant] * factor[variant] for scene in graphics_card.COMPARED})
        return {"seconds": {"512x384": 2.0, "3Mpx": 20.0}, "random_s": 3.0}

    monkeypatch.setattr(graphics_card, "_run", run)
    monkeypatch.setattr(backend, "choose", lambda name: None)
    evidence = graphics_card.graphics_card(lambda share: None)
    entries = judged_all("graphics-card", evidence.figures, load_gates(GATES, CLAIMS))
    assert {entry.value for entry in entries if entry.id.endswith("rate")} == {1200.0}
    failed = {entry.id.split(".")[2] for entry in entries if entry.passed is False}
    assert failed - {"mean"} == (set() if change == "none" else {"p"})


def test_without_a_card_it_is_not_run(monkeypatch):
    def choose(variant):
        raise InputError("it needs a card")

    monkeypatch.setattr(backend, "choose", choose)
    with pytest.raises(NotRun, match="cuda_ad_spectral does not work here: it needs a card"):
        graphics_card.graphics_card(lambda share: None)
