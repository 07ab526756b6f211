"""Pareto fronts of a sweep, one for each light and scene, and small drawings of its designs.

Tested in tests/validation/studies/test_report.py.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb

from dasim.camera import geometry, stops
from dasim.camera.specification import Camera
from dasim.typing import FloatArray
from recon.views.maps import TINT
from validation.reports.page import png_address
from validation.reports.plots import COLOURS, plot
from validation.studies.sweep import naming
from validation.studies.sweep.designs import camera_of
from validation.studies.sweep.specification import StudySpec

Row = dict[str, Any]

MOST_COLUMNS = 3  # of panels
LOG_RATIO = 15.0  # largest ratio of a figure's values over all designs on a linear axis
DRAWING_PX = 96
VISIBLE_NM = 650.0  # where near-infrared begins
CLOSED, VISIBLE_ALONE, INFRARED_ALONE, BOTH = (to_rgb(c) for c in ("#222222", "#56b4e9", "#cc79a7", "#ffffff"))


def pareto(rows: list[Row], first: str, second: str) -> list[Row]:
    """The Pareto front of two figures that are better if smaller: rows that no other row beats in both, sorted."""
    good = [row for row in rows if math.isfinite(row[first]) and math.isfinite(row[second])]
    front: list[Row] = []
    for row in sorted(good, key=lambda r: (r[first], r[second])):
        if not front or row[second] < front[-1][second]:
            front.append(row)
    return front


def conditions(spec: StudySpec, rows: list[Row]) -> dict[str, list[Row]]:
    """The rows of each combination of light, scene and exposure, by its words; designs are compared within one."""
    keys = [key for key in spec.parameters if naming.is_condition(key) and len(spec.parameters[key]) > 1]
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(", ".join(naming.valued(key, row[key]) for key in keys), []).append(row)
    return groups


def design_keys(spec: StudySpec) -> list[str]:
    """The parameters of the design that the study varies."""
    return [key for key, values in spec.parameters.items() if not naming.is_condition(key) and len(values) > 1]


def label(spec: StudySpec, row: Row) -> str:
    """A design's values, for a label in a plot."""
    return ", ".join(naming.value(row[key]) for key in design_keys(spec))


def fronts(spec: StudySpec, rows: list[Row]) -> dict[str, list[Row]]:
    """The Pareto front in each light and scene."""
    assert spec.pareto is not None
    return {name: pareto(group, *spec.pareto) for name, group in conditions(spec, rows).items()}


def fronts_plot(spec: StudySpec, rows: list[Row]) -> str:
    """A panel per light and scene: all designs, their front, and a label at every point of the front."""
    assert spec.pareto is not None
    x, y = spec.pareto
    groups, best = conditions(spec, rows), fronts(spec, rows)
    columns = min(len(groups), MOST_COLUMNS)
    lines = -(-len(groups) // columns)

    def draw(axes: Any) -> None:
        panels = list(np.atleast_1d(axes).ravel())
        for panel, (name, group) in zip(panels, groups.items(), strict=False):
            _front_panel(panel, spec, group, best[name])
            panel.set_title(name, fontsize=9)
        for number, panel in enumerate(panels):
            panel.set_visible(number < len(groups))
            panel.set_xlabel(naming.figure(x))
            panel.set_ylabel(naming.figure(y) if number % columns == 0 else "")
        panels[0].legend(fontsize=7)

    return plot(draw, columns=columns, rows=lines, size=(6.4, 3.6) if columns == 1 else (3.6, 3.0))


def _front_panel(axes: Any, spec: StudySpec, rows: list[Row], front: list[Row]) -> None:
    assert spec.pareto is not None
    x, y = spec.pareto
    others = [row for row in rows if row not in front]
    axes.plot([r[x] for r in others], [r[y] for r in others], "o", color="0.6", markersize=4, label="another is better")
    axes.plot([r[x] for r in front], [r[y] for r in front], "s-", color=COLOURS[1], markersize=4, label="Pareto front")
    for key, value in spec.reference.items():
        same = [row for row in rows if row[key] == value]
        axes.plot([r[x] for r in same], [r[y] for r in same], "o", markersize=10, fillstyle="none", color=COLOURS[0],
                  label=f"{naming.parameter(key)} {naming.value(value)}")  # fmt: skip
    for row in front:
        axes.annotate(label(spec, row), (row[x], row[y]), xytext=(4, 4), textcoords="offset points", fontsize=7)
    for figure, set_scale in ((x, axes.set_xscale), (y, axes.set_yscale)):
        figures = np.array([row[figure] for row in rows], float)
        known = figures[np.isfinite(figures)]
        if known.size and known.min() > 0 and known.max() > LOG_RATIO * known.min():
            set_scale("log")
    axes.margins(0.12)


def drawings(spec: StudySpec, rows: list[Row]) -> tuple[str, list[tuple[str, str]]]:
    """What the drawings show, and one of each design with its values; none where a design has nothing to draw.

    Designs that differ in their stops or the size of the lens are drawn as apertures, those that differ in the mosaic
    as a block of it.
    """
    keys = design_keys(spec)
    designs = {label(spec, row): {key: row[key] for key in spec.parameters} for row in rows}
    if "mosaic" in keys:
        pictures = {name: _mosaic(camera_of(spec, point)) for name, point in designs.items()}
        text = "A block of the mosaic; infrared violet."
    elif any(key.startswith(("camera.stops.", "camera.lens.")) or key == "disc_edge_nm" for key in keys):
        cameras = {name: camera_of(spec, point) for name, point in designs.items()}
        widest_m = max(geometry.aperture_m(camera) for camera in cameras.values())
        pictures = {name: _aperture(camera, widest_m) for name, camera in cameras.items()}
        text = "Apertures to scale. White: all light passes; blue: visible light alone; pink: near-infrared alone."
    else:
        return "", []
    named = [(", ".join(naming.valued(key, designs[name][key]) for key in keys), png_address(picture))
             for name, picture in pictures.items()]  # fmt: skip
    return text, named


def _mosaic(camera: Camera) -> FloatArray:
    """A period of the mosaic, a square of pixels per filter."""
    block = np.array([[TINT[name] for name in row] for row in camera.sensor.mosaic])
    times = max(1, DRAWING_PX // max(block.shape[:2]))
    return block.repeat(times, axis=0).repeat(times, axis=1)


def _aperture(camera: Camera, widest_m: float) -> FloatArray:
    """The open parts of the lens in colours for what passes, on a square as wide as the widest lens."""
    from dasim.spectra.grid import WAVELENGTH_NM

    infrared = WAVELENGTH_NM >= VISIBLE_NM
    share = geometry.aperture_m(camera) / widest_m
    centres = (np.arange(DRAWING_PX) + 0.5) * 2 / DRAWING_PX - 1
    at = centres / share
    passes = np.zeros((2, DRAWING_PX, DRAWING_PX))
    for stop in camera.stops:
        values, cells = stops.pupil(stop)
        place = np.clip(np.searchsorted(cells, at), 0, len(cells) - 1)
        open_cells = values[np.ix_(place, place)] * (np.abs(at) <= 1)[:, None] * (np.abs(at) <= 1)
        through = stops.transmittance(stop)
        passes += np.array([through[~infrared].mean(), through[infrared].mean()])[:, None, None] * open_cells
    light, heat = np.clip(passes, 0, 1)[..., None]
    closed, visible_alone, infrared_alone, both = np.array([CLOSED, VISIBLE_ALONE, INFRARED_ALONE, BOTH])
    picture = (1 - light) * (1 - heat) * closed + light * (1 - heat) * visible_alone
    picture += (1 - light) * heat * infrared_alone + light * heat * both
    outside = np.hypot(*np.meshgrid(at, at)) > 1
    return np.where(outside[..., None], 0.5, picture)
