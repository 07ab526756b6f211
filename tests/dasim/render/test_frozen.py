"""Frozen functions: one batch of a pass is traced in Python, and pictures are the same as of plain functions."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.render import backend, frozen, irradiance_tracing, pinhole, ray_batches, ray_loop

LANES = 1 << 13  # of a batch: passes have many, the last of them smaller
MOST_TRACED = 5  # batches of a capture: through the lens, a pinhole (two kinds of passes), and of another size


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


@pytest.mark.slow
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


@pytest.mark.parametrize("is_shared", [False, True])
def test_one_batch_of_a_pass_is_traced(captured, monkeypatch, is_shared):
    """Expectation: of many batches per pass one is traced, and one more where the last is a single chunk of rays; of
    all passes of a capture, one per kind.
    """
    if not is_shared:
        monkeypatch.setattr(frozen, "sharing", contextlib.nullcontext)
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
    assert traced <= MOST_TRACED if is_shared else passes <= traced <= 2 * passes


@dataclasses.dataclass(frozen=True)
class _Table:
    values: Any
    name: str = dataclasses.field(metadata=frozen.HOST_ONLY)


def test_what_the_host_alone_reads_is_left_out(jit):
    """Expectation: another name is no reason to trace again, another number is; both give the right values."""
    import mitsuba as mi

    if jit.startswith("cuda"):
        pytest.skip("frozen functions are for processors")
    names: list[list[str]] = []
    note = names.append  # Dr.Jit looks into lists

    def scaled(tables, factor):
        note([table.name for table in tables])
        return [table.values * factor for table in tables]

    def values(name, factor):
        tables = [_Table(mi.Float([1.0, 2.0, 3.0]), name), _Table(mi.Float([4.0, 5.0]), name)]
        return [value.numpy().tolist() for value in frozen.frozen(scaled)(tables, factor)]

    with frozen.sharing():
        assert values("a", 2) == values("b", 2) == [[2.0, 4.0, 6.0], [8.0, 10.0]]
        assert names == [[None, None]]
        assert values("a", 3)[1] == [12.0, 15.0]
        assert len(names) == 2
    values("a", 2)
    assert len(names) == 3


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("no light")])
def test_errors_of_a_function_are_those_that_the_caller_gets(jit, error):
    """Rationale: a command that is stopped while a function is traced ends like any other."""
    import drjit as dr
    import mitsuba as mi

    if jit.startswith("cuda"):
        pytest.skip("frozen functions are for processors")

    def fails(values):
        def body(values):
            raise error

        return dr.while_loop((values,), lambda values: values < 3, body)

    with pytest.raises(type(error)) as raised:
        frozen.frozen(fails)(mi.Float([1.0, 2.0, 3.0]))
    assert raised.value is error
