"""The specification of a sweep: grids of parameters, their points, and the points that share a picture.

Tested in tests/validation/studies/sweep/test_loading.py.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from dasim.base.errors import InputError
from dasim.base.toml import Specification, parse
from dasim.camera.sensor import SMALLEST_FRAME_PX

Value = bool | int | float | str

# Keys of a point that need no new rendering: the light's level, the exposure and the reconstruction.
AFTERWARDS = ("light.lux", "exposure.", "recon.")

MOST_VALUES = 10_000  # largest number of values of a grid

MOST_POINTS = 100_000  # of a study, with all seeds
Pixels = Annotated[int, Field(ge=SMALLEST_FRAME_PX, le=20_000)]
Count = Annotated[int, Field(ge=1, le=MOST_VALUES)]


class Grid(Specification):
    """Evenly spaced values, or evenly spaced logarithms."""

    grid: tuple[float, float, Count] | None = None
    log_grid: tuple[float, float, Count] | None = None

    def values(self) -> tuple[float, ...]:
        """The values, including both ends, rounded to six significant digits."""
        if self.grid is not None:
            return tuple(float(f"{v:.6g}") for v in np.linspace(*self.grid))
        assert self.log_grid is not None
        return tuple(float(f"{v:.6g}") for v in np.geomspace(*self.log_grid))

    @model_validator(mode="after")
    def _one(self) -> Grid:
        if (self.grid is None) == (self.log_grid is None):
            raise ValueError("give either grid = [first, last, count] or log_grid = [first, last, count]")
        low, high, _ = self.grid or self.log_grid or (0, 0, 0)
        if self.log_grid is not None and not 0 < low <= high:
            raise ValueError(
                f"log_grid goes from {low:g} to {high:g}; both ends must be above 0, the smaller one first"
            )
        return self


def _values(value: Any) -> Any:
    """A list unchanged, a grid as its values, a single value as a list of one."""
    if isinstance(value, dict):
        return parse(Grid, value, "grid").values()
    return value if isinstance(value, list | tuple) else [value]


def _tables(value: Any) -> Any:
    """One table or several, as a list."""
    return [value] if isinstance(value, dict) else value


Table = dict[str, Annotated[tuple[Value, ...], BeforeValidator(_values)]]


class Curve(Specification):
    """A plot of the report: the figure ``y`` against the parameter ``x``, with a line for each value of ``by``."""

    x: str
    y: str
    beside: tuple[str, ...] = Field(
        default=(), max_length=2, description="further figures in the same plot, dashed and dotted"
    )
    by: str | None = None
    log_x: bool = False
    log_y: bool = False


class StudySpec(Specification):
    """A sweep, as ``dasim study sweep`` reads it from TOML.

    ``[parameters]`` is a grid of all combinations of its values. Several tables ``[[parameters]]`` are several grids
    around one base design: a parameter that a grid does not vary has its value from ``[design]``.
    """

    name: str = Field(min_length=1, max_length=100)
    question: str = ""
    camera: str = "da-mobile"
    scene: str = "desk"
    preset: str = "bands"
    size_px: tuple[Pixels, Pixels] = (256, 192)
    spp: int = Field(default=128, ge=1, le=65_536)
    seeds: int = Field(default=2, ge=1, le=1000)
    grids: Annotated[tuple[Table, ...], BeforeValidator(_tables)] = Field(alias="parameters", min_length=1)
    design: dict[str, Value] = Field(default_factory=dict, description="values of parameters that a grid does not vary")
    curves: tuple[Curve, ...] = ()
    pareto: tuple[str, str] | None = Field(default=None, description="two figures that are better if smaller")
    reference: dict[str, Value] = Field(
        default_factory=dict, max_length=1, description="a parameter's value that the report compares with all others"
    )
    quick: Table = Field(default_factory=dict, description="values of parameters for --quick")
    folder: Path = Field(default=Path("."), exclude=True)

    @property
    def parameters(self) -> dict[str, tuple[Value, ...]]:
        """All values of each parameter, from the base design and all grids; numbers from several grids are sorted."""
        tables: list[Table] = [{key: (value,) for key, value in self.design.items()}, *self.grids]
        parameters: dict[str, tuple[Value, ...]] = {}
        for key in dict.fromkeys(key for table in tables for key in table):
            lists = [table[key] for table in tables if key in table]
            values = list(dict.fromkeys(value for entries in lists for value in entries))
            if len(lists) > 1 and not any(isinstance(value, str) for value in values):
                values.sort(key=float)
            parameters[key] = tuple(values)
        return parameters


class Unit(NamedTuple):
    """A picture that is rendered once: the parameters that determine it, and the points that share it."""

    render: dict[str, Value]
    points: tuple[dict[str, Value], ...]
    seed: int


def points(spec: StudySpec) -> list[dict[str, Value]]:
    """All combinations of each grid's values, the last parameter fastest; a point of several grids occurs once."""
    count = sum(math.prod(len(values) for values in grid.values()) for grid in spec.grids)
    if count * spec.seeds > MOST_POINTS:
        raise InputError(
            f"grids: make {count * spec.seeds:.3g} points with all seeds, at most {MOST_POINTS} are allowed"
        )
    distinct: dict[tuple[Value, ...], dict[str, Value]] = {}
    for grid in spec.grids:
        for values in itertools.product(*grid.values()):
            point = spec.design | dict(zip(grid, values, strict=True))
            ordered = {key: point[key] for key in spec.parameters}
            distinct.setdefault(tuple(ordered.values()), ordered)
    return list(distinct.values())


def units(spec: StudySpec) -> list[Unit]:
    """Groups of points that share a picture, for each seed."""
    groups: dict[tuple[tuple[str, Value], ...], list[dict[str, Value]]] = {}
    for point in points(spec):
        render = tuple((key, value) for key, value in point.items() if not key.startswith(AFTERWARDS))
        groups.setdefault(render, []).append(point)
    return [
        Unit(dict(render), tuple(points_of_unit), seed)
        for seed in range(spec.seeds)
        for render, points_of_unit in groups.items()
    ]
