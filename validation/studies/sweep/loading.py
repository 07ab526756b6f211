"""Reading studies from files, and checking them completely before the first render.

Tested in tests/validation/studies/sweep/test_loading.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import dasim
from dasim.base.errors import InputError
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import parse_toml
from dasim.camera import radiometry
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.simulation.relight import lit_by
from recon.picture import mosaic
from validation.methods import function
from validation.studies.sweep.designs import camera_of, method_of, scene_of, settings_of, with_methods
from validation.studies.sweep.specification import StudySpec, Value, points

OTHERS = ("sweep", "bound", "shape")  # commands of ``dasim study`` beside the names of studies
BUNDLED = Path(__file__).parents[1] / "bundled"
LEAST_SHARE = 1e-3  # least share of a channel's light that passes a stop which counts as open
# Groups of parameters whose combinations have to be checked; every other parameter is checked alone.
OF_SCENE = ("distance_cm", "light.illuminant")  # that some scenes do not allow
TOGETHER = (("camera", "disc_edge_nm", "focus_m", "mosaic"), ("scene", *OF_SCENE))
PLAIN = {
    "scene": "a bundled scene or a file",
    "camera": "a bundled camera or a file",
    "mosaic": "rows of R, G, B and I (infrared), such as GR/BI",
    "distance_cm": "distance of the board of a flat scene, which keeps its size in the picture",
    "light.illuminant": "illuminant of all lights",
    "light.lux": "illuminance by all lights together",
    "disc_edge_nm": "wavelength beyond which the disc blocks light",
    "focus_m": "focus distance",
    "stereo.baseline_mm": "distance of a second camera to the right of the first",
    "exposure.longest_s": "longest exposure time",
    "exposure.most_gain": "highest analogue gain",
}


def names() -> list[str]:
    """Names of the bundled studies."""
    return sorted(path.stem for path in BUNDLED.glob("*.toml"))


def load_study(name_or_path: str, *, quick: bool = False, methods: Sequence[str] = ()) -> StudySpec:
    """A study from its bundled name or a TOML file, checked as a whole; InputError names all mistakes at once.

    ``quick`` replaces values by those of the study's ``[quick]`` table and uses at most two seeds.
    """
    bundled = BUNDLED / f"{name_or_path}.toml"
    path = bundled if bundled.is_file() else Path(name_or_path)
    if not path.is_file():
        hint = did_you_mean(name_or_path, (*names(), *OTHERS))
        raise InputError(f"study '{name_or_path}' is neither a bundled name ({', '.join(names())}) nor a file{hint}")
    spec = parse_toml(StudySpec, path).model_copy(update={"folder": path.parent.resolve()})
    if quick:
        unknown = [key for key in spec.quick if key not in spec.parameters]
        if unknown:
            raise InputError(
                f"{path}: quick.{unknown[0]} is not a parameter of the study; its parameters are "
                f"{', '.join(spec.parameters)}{did_you_mean(unknown[0], spec.parameters)}"
            )
        grids = tuple({key: spec.quick.get(key, values) for key, values in grid.items()} for grid in spec.grids)
        spec = spec.model_copy(update={"grids": grids, "seeds": min(spec.seeds, 2)})
    spec = with_methods(spec, methods)
    check(spec, str(path))
    return spec


def check(spec: StudySpec, where: str) -> None:
    """Raise one InputError with all mistakes of a study: unknown parameters, empty lists, impossible designs."""
    problems = _parameter_problems(spec)
    if problems:
        raise InputError(f"{where}: " + "; ".join(problems))
    problems = _design_problems(spec)
    for key, value in spec.reference.items():
        if value not in spec.parameters.get(key, ()):
            problems.append(f"reference: {key} = {value!r} is not among the values of a parameter of this study")
    problems += _picture_problems(spec)
    if problems:
        raise InputError(f"{where}: " + "; ".join(dict.fromkeys(problems)))


def _parameter_problems(spec: StudySpec) -> list[str]:
    """Mistakes in the names and lists of parameters, before any design is made."""
    problems = []
    if not spec.parameters:
        problems.append("parameters: is empty; give at least one parameter")
    for number, grid in enumerate(spec.grids, 1):
        problems += [
            f"parameters.{key}: is empty; give at least one value" for key, entries in grid.items() if not entries
        ]
        problems += [
            f"parameters, table {number}: has no '{key}', which other tables vary; give its value here or in [design]"
            for key in spec.parameters
            if key not in grid and key not in spec.design
        ]
    for key, values in spec.parameters.items():
        if len({isinstance(value, str) for value in values}) > 1:
            problems.append(f"parameters.{key}: has words and numbers, {', '.join(map(str, values))}; give one kind")
    for key in spec.parameters:
        if key not in PLAIN and not key.startswith(("camera.", "recon.")):
            known = [*PLAIN, "camera.<key of a camera file>", "recon.<setting>"]
            hint = did_you_mean(key, known)
            problems.append(f"parameters.{key}: does not exist; allowed are {', '.join(known)}{hint}")
    return problems


def _design_problems(spec: StudySpec) -> list[str]:
    """Mistakes in the designs: first those of single values, whose messages are shortest, then of combinations."""
    problems = _base_problems(spec)
    for key, values in spec.parameters.items() if not problems else ():
        scene = {"scene": spec.parameters["scene"][0]} if key in OF_SCENE and "scene" in spec.parameters else {}
        for value in values:
            problems += _point_problems(spec, {**scene, key: value})
    if not problems:
        parts = [
            {tuple((key, value) for key, value in point.items() if key.startswith(group)) for point in points(spec)}
            for group in TOGETHER
        ]
        for design in sorted((part for group in parts for part in group if len(part) > 1), key=str):
            problems += _point_problems(spec, dict(design))
    return problems


def _base_problems(spec: StudySpec) -> list[str]:
    """Mistakes in the study's own camera, scene and preset, unless a parameter replaces them."""
    checks: dict[str, Callable[[], object]] = {
        "camera": lambda: _check_sees(dasim.cropped(camera_of(spec, {}), *spec.size_px)),
        "scene": lambda: scene_of(spec, {}),
        "recon.preset": lambda: function(method_of(spec, {})),
    }
    problems = []
    for key, check_one in checks.items():
        if key not in spec.parameters:
            try:
                check_one()
            except InputError as error:
                problems.append(str(error))
    return problems


def _picture_problems(spec: StudySpec) -> list[str]:
    """Unknown parameters and figures in the study's curves and Pareto front."""
    from validation.studies.sweep.point import FIGURES

    problems = []
    for name in (*(curve.x for curve in spec.curves), *(curve.by for curve in spec.curves if curve.by)):
        if name not in spec.parameters:
            hint = did_you_mean(name, spec.parameters)
            problems.append(f"curves: '{name}' is not a parameter of this study ({', '.join(spec.parameters)}){hint}")
    for name in (*(name for curve in spec.curves for name in (curve.y, *curve.beside)), *(spec.pareto or ())):
        if name not in FIGURES:
            problems.append(f"'{name}' is not a figure; allowed are {', '.join(FIGURES)}{did_you_mean(name, FIGURES)}")
    return problems


def _point_problems(spec: StudySpec, point: dict[str, Value]) -> list[str]:
    """Mistakes in some parameters of a point, at most one message."""
    label = ", ".join(f"{key} = {value!r}" for key, value in point.items())
    try:
        camera = camera_of(spec, point)
        if "focus_m" in point:
            camera = dasim.refocused(camera, float(point["focus_m"]))
        if any(key.startswith(("camera", "disc", "mosaic")) for key in point):
            _check_sees(camera)
        dasim.cropped(camera, *spec.size_px)
        if "scene" in point or "distance_cm" in point:
            scene_of(spec, point)
        settings_of(spec, point)
        function(method_of(spec, point))
        if "light.illuminant" in point:
            lit_by(scene_of(spec, point), str(point["light.illuminant"]))
        for key, low, high in (
            ("stereo.baseline_mm", 0.1, 1000.0),
            ("light.lux", 1e-3, 1e6),
            ("exposure.longest_s", 1e-9, 3600.0),
            ("exposure.most_gain", 1.0, 1024.0),
        ):
            if key in point and not low <= float(point[key]) <= high:
                raise InputError(f"must be from {low:g} to {high:g}")
    except InputError as error:
        return [f"{label}: {error}"]
    except ValueError:
        return [f"{label}: is not a number"]
    return []


def _check_sees(camera: Camera) -> None:
    """Raise InputError if a channel receives no light, a stop passes none, or the mosaic cannot be reconstructed."""
    names, parts = sensors.channels(camera.sensor), [radiometry.stop_response(camera, stop) for stop in camera.stops]
    whole = np.sum(parts, axis=(0, -1))
    dark = [name for name, light in zip(names, whole, strict=True) if light <= 0]
    if dark:
        raise InputError(f"no light of any wavelength reaches {', '.join(dark)}")
    for stop, part in zip(camera.stops, parts, strict=True):
        if np.max(part.sum(axis=-1) / whole) < LEAST_SHARE:
            raise InputError(f"the sensor sees no light through stop '{stop.name}'")
    if "IR" not in mosaic.grids(camera):
        raise InputError(f"camera '{camera.name}' has no infrared pixels, so its captures contain no depth information")
