"""The gates of the claim side-of-focus fail for exchanged sides and for a side that is not said to be assumed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import dasim
import recon
from recon.depth import raw_levels
from validation.claims.depth import side_of_focus
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates
from validation.subjects import rendering


def failed(figures) -> set[str]:
    entries = judged_all("side-of-focus", figures, load_gates(GATES, CLAIMS))
    wrong = {entry.id.removeprefix("side-of-focus.") for entry in entries if entry.passed is False}
    return wrong & {figure.id for figure in figures}  # a gate without a figure fails as well


@pytest.mark.slow
@pytest.mark.parametrize("exchanged", [False, True])
def test_exchanged_sides_fail(renderer, monkeypatch, exchanged):
    """Set-up: two boards behind the focus in a small frame, few samples."""
    monkeypatch.setattr(side_of_focus, "SIZE_PX", (128, 96))
    camera = dasim.cropped(dasim.load_camera("da-mobile"), 128, 96)
    lens = {"focus_distance_m": side_of_focus.FOCUS_M, "focal_shift_um": side_of_focus.AXIAL_COLOUR_UM}
    camera = rendering.changed(camera, lens=lens)
    if exchanged:
        true = raw_levels.probability_behind
        monkeypatch.setattr(raw_levels, "probability_behind", lambda near, far, *rest: true(far, near, *rest))
    shot = dasim.simulate(side_of_focus.scene(camera, "behind"), camera, 1, spp=64)
    bank = recon.calibrate(dasim.calibration_captures(camera, ("D65",)))
    result = recon.reconstruct(shot.capture, bank)
    assert result.side == "estimated" and "estimated from axial colour" in result.notes[-1]
    figures = side_of_focus.side_figures("behind", result, shot)
    assert failed(figures) == ({"behind.textured"} if exchanged else set())
    if not exchanged:  # without axial colour in the bank everything is taken to be nearer, and that fails too
        blind = recon.reconstruct(shot.capture, dataclasses.replace(bank, behind=None))
        assert failed(side_of_focus.side_figures("behind", blind, shot)) == {"behind.textured"}


@pytest.mark.parametrize(
    ("level", "side", "wrong"),
    [(1.0, "assumed", set()), (-1.0, "assumed", {"assumed.behind"}), (1.0, "estimated", {"assumed.stated"})],
)
def test_what_is_assumed_must_be_said(level, side, wrong):
    note = f"the side of the focus is {side}: everything"
    result = type("Result", (), {"level": np.full((4, 4), level), "side": side, "notes": (note,)})
    assert failed(side_of_focus.assumed_figures("assumed", result)) == wrong
