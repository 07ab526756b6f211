"""The example of a learned ring begins with the hole of the camera, and moves. Skipped without the extra ``learn``."""

from __future__ import annotations

from pathlib import Path

import pytest

import dasim
from dasim.base.loading import load_function

torch = pytest.importorskip("torch", reason="PyTorch is not installed; it comes with the extra 'learn'")
from dasim.differentiable import stop  # noqa: E402 - needs PyTorch

EXAMPLE = Path(__file__).parents[2] / "examples" / "learned_ring.py"


@pytest.fixture(scope="module")
def example():
    return load_function(f"{EXAMPLE}:main", "example").__globals__


def test_the_ring_begins_as_the_hole_of_the_camera(example):
    """Expectation: the infrared electrons of the exact disc, within 6 % for the soft edge of three hundredths."""
    lens = example["Lens"]()
    amplitude = lens.amplitude(torch.tensor([-0.1, 0.46]))
    camera = dasim.load_camera("da-mobile")
    _, expected = stop.fixed_stops(camera.model_copy(update={"stops": camera.stops[1:]}), "D65", [1.0], example["SIDE"])
    assert float(stop.electrons(lens.free, amplitude)[3]) == pytest.approx(float(expected[3]), rel=0.06)


def test_stop_and_network_learn_together(example, monkeypatch):
    """Expectation: a step moves both radii by Adam's first step, the rate; none does where the stop is not to learn."""
    monkeypatch.setitem(example, "BATCH", 2)
    monkeypatch.setitem(example, "ALONE", 0.0)
    lens = example["Lens"]()
    radii, net = example["train"](lens, 1, True)
    moved = [abs(float(now) - before) for now, before in zip(radii, (-0.1, 0.46), strict=True)]
    assert moved == pytest.approx([example["RADIUS_RATE"]] * 2, rel=0.01)
    assert example["mean_error"](lens, radii, net, pictures=1) > 0
    still, _ = example["train"](lens, 1, False)
    assert still.tolist() == pytest.approx([-0.1, 0.46])
