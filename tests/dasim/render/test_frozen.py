"""Frozen functions: one batch of a pass is traced in Python, and pictures are the same as of plain functions."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import pytest

import dasim
from dasim.render import backend, irradiance_tracing, pinhole, ray_batches, ray_loop

LANES = 1 << 13  # of a batch: passes have many, the last of them smaller


@pytest.fixture
def captured(jit, make_scene, da_mobile, lamp, monkeypatch):
    """A function that captures a card before a wall: pixels of one depth and of several, samples by their noise."""
    if jit.startswith("cuda"):
        pytest.skip("frozen functions are for processors")
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 40), "material": "sand"}
    card = {"name": "card", "shape": "plane", "size_cm": (6, 20), "position_cm": (-3, 0, 20), "material": "leaf-green"}
    scene, camera = make_scene(wall, card, lights=[lamp]), dasim.cropped(da_mobile, 32, 24)
    monkeypatch.setattr(backend, "LANES", LANES)
    return lambda: dasim.simulate(scene, camera, spp="auto")


def test_pictures_are_those_of_functions_that_are_not_frozen(captured, monkeypatch):
    """Rationale: what is no array is read at the first call alone: a size, a seed or a table of the first batch would
    be used for all.

    Expectation: the same bits.
    """
    _check_same(captured, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "diffraction"),
    [("coded-mobile", "wave"), ("bando", "wave"), ("chromatic-mobile", "wave"), ("da-mobile", "off")],
)
def test_pictures_through_stops_of_every_kind_are_the_same(jit, monkeypatch, name, diffraction):
    """Rationale: stops, axial colour and distortion bring tables of their own, which each batch must read.

    Set-up: a random scene through a mask, stops off the axis, a lens with axial colour, and one with distortion without
    wave optics.

    Expectation: the same bits.
    """
    if jit.startswith("cuda"):
        pytest.skip("frozen functions are for processors")
    camera = dasim.cropped(name, 20, 16)
    if diffraction == "off":
        camera = camera.model_copy(update={"lens": camera.lens.model_copy(update={"distortion_per_mm": (-0.002,)})})
    scene = dasim.random_scene(0, 4, dasim.RandomScenes(), camera)
    camera = dasim.focused(camera, scene)
    monkeypatch.setattr(backend, "LANES", LANES)
    _check_same(lambda: dasim.simulate(scene, camera, spp=16, diffraction=diffraction), monkeypatch)


def _check_same(capture, monkeypatch):
    """Assert that a function's captures have the same bits with frozen functions and without."""
    first = capture()
    for module in (ray_loop, pinhole, irradiance_tracing):
        monkeypatch.setattr(module, "frozen", lambda function: function)
    second = capture()
    for picture in ("mean_e", "focus_e", "sharp_e"):
        np.testing.assert_array_equal(getattr(first.truth, picture), getattr(second.truth, picture))


def test_one_batch_of_a_pass_is_traced(captured, monkeypatch):
    """Expectation: of many batches per pass one is traced, and one more where the last is a single chunk of rays."""
    called: dict[str, Iterator[int]] = {name: itertools.count() for name in ("frozen", "block_of", "aim")}

    def count(module, name):
        function, calls = getattr(module, name), called[name]

        def counted(*arguments):
            next(calls)
            return function(*arguments)

        monkeypatch.setattr(module, name, counted)

    of_modules = ((ray_loop, ("frozen", "aim")), (ray_batches, ("block_of",)), (pinhole, tuple(called)))
    for module, names in of_modules:
        for name in names:
            count(module, name)
    captured()
    passes, batches, traced = (next(calls) for calls in called.values())
    assert passes > 5
    assert batches > 5 * passes
    assert passes <= traced <= 2 * passes
