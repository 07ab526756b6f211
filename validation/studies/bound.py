"""The study ``dasim study bound``: the least error of depth from one patch, by distance."""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from dasim.base.errors import InputError
from dasim.bounds import cramer_rao
from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.files.folders import software_versions
from dasim.typing import FloatArray
from validation.studies import criteria
from validation.studies.criteria import Texture

RANGE_M = (0.05, 0.24)  # distances of the table by default, where the focus leaves room for them


class Row(NamedTuple):
    """The bound at one distance: least standard deviations in levels, in dioptres and of the distance."""

    depth_m: float
    blur_px: float  # visible
    levels: float
    dioptres: float
    depth_sd_m: float


class Patch(NamedTuple):
    """What the bound is for: light, illuminance in lux, what is known of the texture, and the channels compared."""

    light: str
    lux: float
    texture: Texture
    channels: tuple[str, ...]  # the one with the sharp texture first


def range_m(camera: Camera, near_m: float | None, far_m: float | None) -> tuple[float, float]:
    """Nearest and farthest distance of the table, by default ``RANGE_M`` up to the last distance that has a bound.

    Raises InputError where the default range lies beyond it.
    """
    near = RANGE_M[0] if near_m is None else near_m
    last = criteria.farthest_m(camera)
    far = min(RANGE_M[1], last) if far_m is None else far_m
    if far_m is None and near >= far:
        raise InputError(
            f"--near-cm: the bound of camera '{camera.name}', focused at {camera.lens.focus_distance_m:g} m, ends at "
            f"{100 * last:.3g} cm, which is nearer than {100 * near:g} cm; give another --near-cm or --focus"
        )
    return near, far


def rows(camera: Camera, blur_px: FloatArray, patch: Patch) -> list[Row]:
    """The bound at each visible blur."""
    deviation = criteria.camera_bound(
        camera, blur_px, light=patch.light, level_lux=patch.lux, texture=patch.texture, planes=patch.channels
    )
    depth_m = geometry.depth_of_blur_m(camera, blur_px)
    error_m = cramer_rao.depth_deviation_m(camera, depth_m, deviation)
    levels = cramer_rao.level_deviation(camera, deviation)
    columns = (depth_m, blur_px, levels, error_m / depth_m**2, error_m)
    return [Row(*map(float, values)) for values in zip(*columns, strict=True)]


def lines(camera: Camera, patch: Patch, table: Sequence[Row]) -> Iterator[str]:
    """The bound as a table of text."""
    yield (
        f"{camera.name}, focus {camera.lens.focus_distance_m:g} m, {patch.light}, {patch.lux:g} lux, channels "
        f"{', '.join(patch.channels)}, texture {patch.texture}: least standard deviation in a patch of 31 px"
    )
    yield f"{'distance':>9}  {'blur':>8}  {'sd level':>8}  {'sd 1/m':>9}  {'sd depth':>10}"
    for row in table:
        yield (
            f"{100 * row.depth_m:6.2f} cm  {row.blur_px:5.1f} px  {row.levels:8.3f}  {row.dioptres:9.4f}  "
            f"{1000 * row.depth_sd_m:7.3f} mm"
        )


def as_json(camera: Camera, patch: Patch, table: Sequence[Row]) -> str:
    """The bound and what it is for as JSON."""
    content = {
        "schema": 1,
        "study": "bound",
        "software": software_versions(),
        "camera": camera.model_dump(mode="json", exclude_defaults=True),
        **patch._asdict(),
        "rows": [row._asdict() for row in table],
    }
    return json.dumps(content, indent=1) + "\n"


def as_csv(table: Sequence[Row]) -> str:
    """The table as CSV, with the units in the names of its columns."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(Row._fields)
    writer.writerows(table)
    return text.getvalue()


def seconds_per_design(camera: Camera, blur_px: FloatArray, patch: Patch) -> float:
    """Time of one evaluation of :func:`rows`, s; call it after another one, which reads the spectral tables."""
    begin = time.perf_counter()
    rows(camera, blur_px, patch)
    return time.perf_counter() - begin
