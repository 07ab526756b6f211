"""What a sweep varies and how each point is measured."""

from __future__ import annotations

import difflib
import functools
import itertools
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

import dasim
import recon
from dasim import camera as cameras
from dasim import illuminants, targets
from dasim.camera import Camera, Levels
from dasim.dataset.specification import varied
from dasim.errors import InputError
from dasim.foreign import MitsubaScene
from dasim.specification import Specification, parse, parse_toml
from recon.settings import Settings

BUNDLED = Path(__file__).parent / "bundled"
Value = bool | int | float | str

# Keys of a point that need no new rendering: the light's level, the exposure and the reconstruction.
AFTERWARDS = ("light.lux", "exposure.", "recon.")
# What decides together whether a point can be made.
TOGETHER = (("camera", "disc_edge_nm", "focus_m", "mosaic"), ("scene", "distance_cm"))
PLAIN = {
    "scene": "a bundled scene or a file",
    "camera": "a bundled camera or a file",
    "mosaic": "rows of R, G, B and I, infrared, such as GR/BI",
    "distance_cm": "of the board of a flat scene, which keeps its size in the picture",
    "light.illuminant": "of all lights",
    "light.lux": "of all lights together",
    "disc_edge_nm": "where the disc begins to block",
    "focus_m": "focus distance",
    "stereo.baseline_mm": "of a second camera to the right",
    "exposure.longest_s": "longest exposure",
    "exposure.most_gain": "highest analogue gain",
}


class Grid(Specification):
    """Evenly spaced values, or evenly spaced logarithms."""

    grid: tuple[float, float, int] | None = None
    log_grid: tuple[float, float, int] | None = None

    def values(self) -> tuple[float, ...]:
        """The values, both ends among them."""
        if self.grid is not None:
            return tuple(float(f"{v:.6g}") for v in np.linspace(*self.grid))
        assert self.log_grid is not None
        return tuple(float(f"{v:.6g}") for v in np.geomspace(*self.log_grid))

    @model_validator(mode="after")
    def _one(self) -> Grid:
        if (self.grid is None) == (self.log_grid is None):
            raise ValueError("give grid = [first, last, count] or log_grid = [first, last, count]")
        low, high, count = self.grid or self.log_grid or (0, 0, 0)
        if count < 1:
            raise ValueError(f"has {count} values; 1 or more are needed")
        if self.log_grid is not None and not 0 < low <= high:
            raise ValueError(f"log_grid goes from {low:g} to {high:g}; both above 0, the smaller one first")
        return self


def _values(given: Any) -> Any:
    """A list as it is, a grid as its values, one value as a list of one."""
    if isinstance(given, dict):
        return parse(Grid, given, "grid").values()
    return given if isinstance(given, list | tuple) else [given]


def _tables(given: Any) -> Any:
    """One table or several, as a list."""
    return [given] if isinstance(given, dict) else given


Table = dict[str, Annotated[tuple[Value, ...], BeforeValidator(_values)]]


class Curve(Specification):
    """A picture of the report: a figure against a parameter, a line for each value of another."""

    x: str
    y: str
    beside: tuple[str, ...] = Field(default=(), max_length=2, description="figures drawn with it, dashed and dotted")
    by: str | None = None
    log_x: bool = False
    log_y: bool = False


class StudySpec(Specification):
    """A sweep, as ``dasim study sweep`` reads it from TOML.

    ``[parameters]`` is a grid: all combinations of its values. Several tables ``[[parameters]]`` are as many grids
    about one base design: what a grid does not vary has its value of ``[design]``.
    """

    name: str = Field(min_length=1, max_length=100)
    question: str = ""
    camera: str = "da-mobile"
    scene: str = "desk"
    preset: str = "bands"
    size_px: tuple[int, int] = (256, 192)
    spp: int = Field(default=128, ge=1, le=65_536)
    seeds: int = Field(default=2, ge=1, le=1000)
    grids: Annotated[tuple[Table, ...], BeforeValidator(_tables)] = Field(alias="parameters", min_length=1)
    design: dict[str, Value] = Field(default_factory=dict, description="values where a grid does not vary them")
    curves: tuple[Curve, ...] = ()
    pareto: tuple[str, str] | None = Field(default=None, description="two figures, both the better the smaller")
    reference: dict[str, Value] = Field(
        default_factory=dict, max_length=1, description="a parameter's value that the report holds against all others"
    )
    quick: Table = Field(default_factory=dict, description="values of parameters for --quick")
    folder: Path = Field(default=Path("."), exclude=True)

    @property
    def parameters(self) -> dict[str, tuple[Value, ...]]:
        """All values of each parameter, of the base design and of every grid; numbers of several grids in order."""
        tables: list[Table] = [{key: (value,) for key, value in self.design.items()}, *self.grids]
        found: dict[str, tuple[Value, ...]] = {}
        for key in dict.fromkeys(key for table in tables for key in table):
            lists = [table[key] for table in tables if key in table]
            values = list(dict.fromkeys(value for own in lists for value in own))
            if len(lists) > 1 and not any(isinstance(value, str) for value in values):
                values.sort(key=float)
            found[key] = tuple(values)
        return found


class Unit(NamedTuple):
    """What is rendered once: what decides the picture, and the points that are measured on it."""

    render: dict[str, Value]
    points: tuple[dict[str, Value], ...]
    seed: int


def names() -> list[str]:
    """Bundled studies."""
    return sorted(path.stem for path in BUNDLED.glob("*.toml"))


def load_study(name_or_path: str, *, quick: bool = False) -> StudySpec:
    """A bundled study or a TOML file, checked as a whole; InputError names everything that is wrong."""
    bundled = BUNDLED / f"{name_or_path}.toml"
    path = bundled if bundled.is_file() else Path(name_or_path)
    if not path.is_file():
        near = difflib.get_close_matches(name_or_path, names(), 3) or names()
        raise InputError(f"study '{name_or_path}' is neither bundled nor a file; did you mean {', '.join(near)}?")
    spec = parse_toml(StudySpec, path).model_copy(update={"folder": path.parent.resolve()})
    if quick:
        unknown = [key for key in spec.quick if key not in spec.parameters]
        if unknown:
            raise InputError(f"{path}: quick.{unknown[0]} is no parameter of the study")
        grids = tuple({key: spec.quick.get(key, values) for key, values in grid.items()} for grid in spec.grids)
        spec = spec.model_copy(update={"grids": grids, "seeds": min(spec.seeds, 2)})
    check(spec, str(path))
    return spec


def points(spec: StudySpec) -> list[dict[str, Value]]:
    """Every combination of each grid's values, the last parameter fastest; what several grids share once."""
    found: dict[tuple[Value, ...], dict[str, Value]] = {}
    for grid in spec.grids:
        for values in itertools.product(*grid.values()):
            point = spec.design | dict(zip(grid, values, strict=True))
            ordered = {key: point[key] for key in spec.parameters}
            found.setdefault(tuple(ordered.values()), ordered)
    return list(found.values())


def units(spec: StudySpec) -> list[Unit]:
    """Points that show the same picture, together, for each seed."""
    groups: dict[tuple[tuple[str, Value], ...], list[dict[str, Value]]] = {}
    for point in points(spec):
        render = tuple((key, value) for key, value in point.items() if not key.startswith(AFTERWARDS))
        groups.setdefault(render, []).append(point)
    return [Unit(dict(render), tuple(own), seed) for seed in range(spec.seeds) for render, own in groups.items()]


def camera_of(spec: StudySpec, point: dict[str, Value]) -> Camera:
    """The camera of a point, whole frame; InputError where it cannot be made.

    Every design is calibrated at the blurs of the camera that it is made of: by default a wider hole would have wider
    steps between its levels, and the pipeline would be worse for that alone.
    """
    name = str(point.get("camera", spec.camera))
    beside = spec.folder / name
    camera = dasim.load_camera(beside if beside.is_file() else name)
    if camera.levels is None:
        blurs = cameras.level_blur_px(camera)
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


def check(spec: StudySpec, where: str) -> None:
    """InputError with all that is wrong: unknown parameters, empty lists, designs that cannot be made."""
    problems = []
    for number, grid in enumerate(spec.grids, 1):
        problems += [f"parameters.{key}: is empty; give one value at least" for key, own in grid.items() if not own]
        problems += [
            f"parameters, table {number}: has no '{key}', which others vary; give its value here or in [design]"
            for key in spec.parameters
            if key not in grid and key not in spec.design
        ]
    for key in spec.parameters:
        if key not in PLAIN and not key.startswith(("camera.", "recon.")):
            known = [*PLAIN, "camera.<key of a camera file>", "recon.<setting>"]
            near = difflib.get_close_matches(key, known, 3) or known
            problems.append(f"parameters.{key}: does not exist; did you mean {', '.join(near)}?")
    if problems:
        raise InputError(f"{where}: " + "; ".join(problems))
    for key, values in spec.parameters.items():  # each parameter by itself first: the shortest message
        where_else = (
            {"scene": spec.parameters["scene"][0]} if key == "distance_cm" and "scene" in spec.parameters else {}
        )
        for value in values:
            problems += _point_problems(spec, {**where_else, key: value})
    if not problems:
        parts = [
            {tuple((key, value) for key, value in point.items() if key.startswith(group)) for point in points(spec)}
            for group in TOGETHER
        ]
        for design in sorted((part for group in parts for part in group if len(part) > 1), key=str):
            problems += _point_problems(spec, dict(design))
    for key, value in spec.reference.items():
        if value not in spec.parameters.get(key, ()):
            problems.append(f"reference: {key} = {value!r} is not among the values of a parameter of this study")
    problems += _picture_problems(spec)
    if problems:
        raise InputError(f"{where}: " + "; ".join(dict.fromkeys(problems)))


def _picture_problems(spec: StudySpec) -> list[str]:
    """What the curves and the front name that there is not."""
    from validation.studies.point import FIGURES

    problems = []
    for name in (*(curve.x for curve in spec.curves), *(curve.by for curve in spec.curves if curve.by)):
        if name not in spec.parameters:
            problems.append(f"curves: '{name}' is no parameter of this study ({', '.join(spec.parameters)})")
    for name in (*(name for curve in spec.curves for name in (curve.y, *curve.beside)), *(spec.pareto or ())):
        if name not in FIGURES:
            near = difflib.get_close_matches(name, FIGURES, 3) or list(FIGURES)
            problems.append(f"'{name}' is no figure; did you mean {', '.join(near)}?")
    return problems


def _point_problems(spec: StudySpec, point: dict[str, Value]) -> list[str]:
    said = ", ".join(f"{key} = {value!r}" for key, value in point.items())
    try:
        camera = camera_of(spec, point)
        if "focus_m" in point:
            camera = dasim.refocused(camera, float(point["focus_m"]))
        if any(key.startswith(("camera", "disc", "mosaic")) for key in point):
            _check_sees(camera)
        if "scene" in point or "distance_cm" in point:
            scene_of(spec, point)
        settings_of(spec, point)
        if "light.illuminant" in point:
            illuminants.illuminant(str(point["light.illuminant"]))
        for key, low, high in (
            ("stereo.baseline_mm", 0.1, 1000.0),
            ("light.lux", 1e-3, 1e6),
            ("exposure.longest_s", 1e-9, 3600.0),
            ("exposure.most_gain", 1.0, 1024.0),
        ):
            if key in point and not low <= float(point[key]) <= high:
                raise InputError(f"must be from {low:g} to {high:g}")
    except InputError as error:
        return [f"{said}: {error}"]
    except ValueError:
        return [f"{said}: is no number"]
    return []


def _check_sees(camera: Camera) -> None:
    """InputError where a channel gets no light, or where its mosaic is none that is reconstructed."""
    from dasim import camera as cameras
    from recon import mosaic

    rates = cameras.response(camera).max(axis=-1)
    dark = [name for name, rate in zip(cameras.channels(camera.sensor), rates, strict=True) if rate <= 0]
    if dark:
        raise InputError(f"no light of any wavelength reaches {', '.join(dark)}")
    mosaic.grids(camera)
