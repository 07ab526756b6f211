"""The camera, scene and settings of a point of a sweep.

Tested in tests/validation/studies/test_sweep.py.
"""

from __future__ import annotations

import functools
from pathlib import Path

import dasim
import recon
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import geometry
from dasim.camera.specification import Camera, Levels
from dasim.dataset.specification import varied
from dasim.scene import targets
from dasim.scene.mitsuba_scene import MitsubaScene
from recon.settings import Settings
from validation.studies.sweep.specification import StudySpec, Value


def camera_of(spec: StudySpec, point: dict[str, Value]) -> Camera:
    """The camera of a point, whole frame; InputError where it cannot be made.

    Every design is calibrated at the blurs of the camera that it is made of: by default a wider hole would have wider
    steps between its levels, and the pipeline would be worse for that alone.
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
    if "disc_edge_nm" in point:  # one coating: what it stops passes the hole alone
        wide, hole = camera.stops[0].name, camera.stops[-1].name
        changes |= {f"stops.{wide}.passes_nm.0.1": point["disc_edge_nm"]}
        changes |= {f"stops.{hole}.passes_nm.0.0": point["disc_edge_nm"]}
    return varied(camera, changes)


def with_mosaic(camera: Camera, text: str) -> Camera:
    """The camera with another mosaic: rows of R, G, B and I (infrared) with / between them, such as GR/BI."""
    rows = text.split("/")
    if set(text) != set("RGBI/") or len({len(row) for row in rows}) != 1:
        raise InputError(
            f"mosaic '{text}': needs two rows or more of equal length with / between them, of R, G, B and I "
            "(infrared), all of which occur, such as GR/BI"
        )
    block = [["IR" if letter == "I" else letter for letter in row] for row in rows]
    changed = camera.sensor.model_dump() | {"mosaic": block}
    return camera.model_copy(update={"sensor": parse(type(camera.sensor), changed, f"mosaic '{text}'")})


@functools.lru_cache(maxsize=32)
def _loaded(name: str, changed_ns: int) -> dasim.Scene | MitsubaScene:
    """A scene, read once for all points that show it, and again when its file has changed."""
    return dasim.load_scene(name)


def scene_of(spec: StudySpec, point: dict[str, Value]) -> dasim.Scene:
    """The scene of a point, as it is lit in its file.

    A board at the point's distance has the same picture in every design, in pixels, but for its blur: textures of
    nature are alike at all scales, and no lens shall look at a smoother one than another.
    """
    name = str(point.get("scene", spec.scene))
    beside = spec.folder / name
    file = beside if beside.is_file() else Path(name)
    found = _loaded(str(file), file.stat().st_mtime_ns if file.is_file() else 0)
    if isinstance(found, MitsubaScene):
        raise InputError(f"scene '{name}': a study lights its scenes anew, which Mitsuba's files do not allow")
    if "distance_cm" not in point:
        return found
    ours, drawn_for = camera_of(spec, point), dasim.load_camera(targets.DEFAULT_CAMERA)
    angles = [one.sensor.pixel_pitch_um / one.lens.focal_length_mm for one in (ours, drawn_for)]
    return targets.at_distance(found, float(point["distance_cm"]), angles[0] / angles[1])


def settings_of(spec: StudySpec, point: dict[str, Value]) -> Settings:
    """The settings of the reconstruction of a point."""
    preset = str(point.get("recon.preset", spec.preset))
    if preset not in recon.PRESETS:
        raise InputError(f"preset '{preset}' is unknown; allowed are {', '.join(recon.PRESETS)}")
    changes = {
        key.removeprefix("recon."): value
        for key, value in point.items()
        if key.startswith("recon.") and key != "recon.preset"
    }
    return parse(Settings, recon.PRESETS[preset].model_dump() | changes, "recon") if changes else recon.PRESETS[preset]
