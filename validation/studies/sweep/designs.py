"""The camera, scene and settings of a point of a sweep.

Tested in tests/validation/studies/sweep/test_run.py.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import dasim
import recon
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry
from dasim.camera.dotted_keys import with_values
from dasim.camera.specification import Camera, Levels
from dasim.scene import targets
from dasim.scene.mitsuba_scene import MitsubaScene
from recon.settings import Settings
from validation.methods import NamedMethod, parsed
from validation.studies.sweep.specification import StudySpec, Value


def camera_of(spec: StudySpec, point: dict[str, Value]) -> Camera:
    """The camera of a point, with its whole frame; raises InputError if its parameters make no valid camera.

    All designs derived from one camera have the blur levels of that camera. The default levels would be further apart
    for a larger hole, and this alone would worsen its reconstruction.
    """
    name = str(point.get("camera", spec.camera))
    beside = spec.folder / name
    camera = dasim.load_camera(beside if beside.is_file() else name)
    if camera.levels is None:
        blurs = geometry.level_blur_px(camera)
        camera = camera.model_copy(update={"levels": Levels(count=len(blurs), max_blur_px=float(blurs[-1]))})
    if "mosaic" in point:
        camera = with_mosaic(camera, str(point["mosaic"]))
    changes = {key.removeprefix("camera."): value for key, value in point.items() if key.startswith("camera.")}
    if "disc_edge_nm" in point:  # the coating has one edge: light beyond it passes through the hole alone
        wide, hole = camera.stops[0].name, camera.stops[-1].name
        changes |= {f"stops.{wide}.passes_nm.0.1": point["disc_edge_nm"]}
        changes |= {f"stops.{hole}.passes_nm.0.0": point["disc_edge_nm"]}
    return with_values(camera, changes)


def with_mosaic(camera: Camera, text: str) -> Camera:
    """The camera with another mosaic, given as rows of R, G, B and I (infrared) separated by /, such as GR/BI."""
    rows = text.split("/")
    if set(text) != set("RGBI/") or len({len(row) for row in rows}) != 1:
        raise InputError(
            f"mosaic '{text}': give two or more rows of equal length, separated by /, of the letters R, G, B and I "
            "(infrared), each of which must occur, such as GR/BI"
        )
    block = [["IR" if letter == "I" else letter for letter in row] for row in rows]
    sensor = camera.sensor.model_dump() | {"mosaic": block}
    return camera.model_copy(update={"sensor": parse(type(camera.sensor), sensor, f"mosaic '{text}'")})


@functools.lru_cache(maxsize=32)
def _cached_scene(name: str, modified_ns: int) -> dasim.Scene | MitsubaScene:
    """A scene, read once for all points that show it, and again if its file's modification time differs."""
    return dasim.load_scene(name)


def scene_of(spec: StudySpec, point: dict[str, Value]) -> dasim.Scene:
    """The scene of a point, with the lights of its file.

    A board at the point's distance is scaled to have the same picture in pixels, apart from blur, in every design.
    Natural textures have similar statistics at all scales; without scaling, lenses with other fields of view would see
    smoother or coarser textures.
    """
    name = str(point.get("scene", spec.scene))
    beside = spec.folder / name
    file = beside if beside.is_file() else Path(name)
    scene = _cached_scene(str(file), file.stat().st_mtime_ns if file.is_file() else 0)
    if isinstance(scene, MitsubaScene):
        raise InputError(
            f"scene '{name}': a study changes the lights, which is impossible for a Mitsuba file; use TOML"
        )
    if "distance_cm" not in point:
        return scene
    cameras = camera_of(spec, point), dasim.load_camera(targets.DEFAULT_CAMERA)
    angles = [camera.sensor.pixel_pitch_um / camera.lens.focal_length_mm for camera in cameras]
    return targets.at_distance(scene, float(point["distance_cm"]), angles[0] / angles[1])


def settings_of(spec: StudySpec, point: dict[str, Value]) -> Settings:
    """The settings of a point's reconstruction: those of its preset, with the point's changes."""
    method = method_of(spec, point)
    preset = recon.DEFAULT if method.source else recon.PRESETS[method.name]
    changes = {
        key.removeprefix("recon."): value
        for key, value in point.items()
        if key.startswith("recon.") and key != "recon.preset"
    }
    return parse(Settings, preset.model_dump() | changes, "recon") if changes else preset


def method_of(spec: StudySpec, point: dict[str, Value]) -> NamedMethod:
    """The depth method of a point: a preset's name, or a user's function, whose file may lie beside the study's."""
    method = parsed(str(point.get("recon.preset", spec.preset)))
    file, _, name = method.source.rpartition(":")
    beside = spec.folder / file
    return replace(method, source=f"{beside}:{name}") if file.endswith(".py") and beside.is_file() else method


def own_methods(spec: StudySpec) -> list[NamedMethod]:
    """A user's depth methods that a study measures."""
    presets = spec.parameters.get("recon.preset", (spec.preset,))
    every = (method_of(spec, {"recon.preset": preset}) for preset in presets)
    return [method for method in every if method.source]


def with_methods(spec: StudySpec, methods: Sequence[str]) -> StudySpec:
    """The study with further depth methods at each of its points, beside the presets that it has."""
    if not methods:
        return spec
    default = (spec.design.get("recon.preset", spec.preset),)
    grids = [grid | {"recon.preset": (*grid.get("recon.preset", default), *methods)} for grid in spec.grids]
    return spec.model_copy(update={"grids": tuple(grids)})
