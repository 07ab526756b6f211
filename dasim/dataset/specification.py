"""Specification of a dataset: distributions of scenes, cameras, light, focus and exposure; splits and format."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from dasim.base.errors import InputError
from dasim.base.loading import load_function
from dasim.base.suggestions import did_you_mean
from dasim.base.toml import Specification, parse, parse_toml
from dasim.camera import specification as cameras
from dasim.camera.noise import LONGEST_EXPOSURE_S, NoiseModel, expose
from dasim.camera.specification import Camera
from dasim.files.truth import TRUTH_PARTS
from dasim.random_scenes import specification
from dasim.random_scenes.specification import RandomScenes
from dasim.scene.mitsuba_scene import MitsubaChoices, is_mitsuba
from dasim.scene.specification import scene_names
from dasim.simulation.adaptive_sampling import NOISE_AT, NOISE_SHARE
from dasim.simulation.checks import PERCENTILE
from dasim.spectra import illuminants

MOST_SAMPLES = 10_000_000
MOST_FRAMES = 1000  # of a sample
BRACKET = (1e-6, 1e6)  # of factors on an exposure time
Scalar = bool | int | float | str


class Draw(Specification):
    """Distribution of a number or text over the samples: uniform, log-uniform, a choice of equal probabilities, or each
    of some values in turn over the captures of a scene.

    Several ``each`` of a specification make a grid: those of the camera vary fastest, in their order, then light, focus
    and exposure.
    """

    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    choice: tuple[Scalar, ...] | None = Field(default=None, min_length=1)
    each: tuple[Scalar, ...] | None = Field(default=None, min_length=1, description="in turn, by capture of a scene")

    @model_validator(mode="after")
    def _one(self) -> Draw:
        names = [name for name in ("uniform", "log_uniform", "choice", "each") if getattr(self, name) is not None]
        if len(names) != 1:
            raise ValueError(
                "give one of uniform = [low, high], log_uniform = [low, high], choice = [...], each = [...]"
            )
        for low, high in (ends for ends in (self.uniform, self.log_uniform) if ends is not None):
            if low > high:
                raise ValueError(f"{names[0]} is [{low:g}, {high:g}]: the smaller number comes first")
        if self.log_uniform is not None and self.log_uniform[0] <= 0:
            raise ValueError(f"log_uniform is {list(self.log_uniform)}: both ends must be above 0")
        return self

    def draw(self, random: np.random.Generator, turn: int) -> Scalar:
        """A random value of the distribution; of ``each`` the value of a turn, counted from 0."""
        if self.each is not None:
            return self.each[turn % len(self.each)]
        if self.choice is not None:
            return self.choice[int(random.integers(len(self.choice)))]
        if self.uniform is not None:
            return float(random.uniform(*self.uniform))
        assert self.log_uniform is not None
        return float(np.exp(random.uniform(*np.log(self.log_uniform))))

    def extremes(self) -> tuple[Scalar, ...]:
        """Both ends of a range or all values of a choice: if they are allowed, every value is."""
        return self.choice or self.each or self.uniform or self.log_uniform or ()


def _constant(value: Any) -> Any:
    """A plain value as the choice of this value."""
    return {"choice": [value]} if isinstance(value, (bool, int, float, str)) else value


Drawn = Annotated[Draw, BeforeValidator(_constant)]


SET_ELSEWHERE = {
    "lens.focus_distance_m": "[focus] distance_m",
    "sensor.width_px": "size_px",
    "sensor.height_px": "size_px",
}


class CameraChoice(Specification):
    """A camera with the distributions of its varying parameters.

    Keys of ``vary`` are those of the camera's file, joined by dots; an entry of a list is given by its index or name.
    """

    name: str
    weight: float = Field(default=1.0, gt=0)
    vary: dict[str, Drawn] = Field(default_factory=dict)

    @field_validator("vary")
    @classmethod
    def _own(cls, vary: dict[str, Draw]) -> dict[str, Draw]:
        for key in vary:
            if key in SET_ELSEWHERE:
                raise ValueError(f"'{key}' is set by {SET_ELSEWHERE[key]}, not here")
        return vary


class SceneChoice(Specification):
    """Source of the scenes."""

    family: Literal["random", "bundled", "files", "meshes"] = "random"
    names: tuple[str, ...] = Field(default=(), description="bundled: names of scenes, used in turn; all by default")
    files: tuple[str, ...] = Field(default=(), description="files: TOML or Mitsuba XML files, used in turn")
    mitsuba: MitsubaChoices = Field(
        default=MitsubaChoices(),
        description="files: choices for Mitsuba XML files",
    )
    folder: str | None = Field(default=None, description="meshes: folder of OBJ, PLY, GLB, STL and OFF files")
    random: RandomScenes = RandomScenes()
    captures_per_scene: int = Field(default=1, ge=1, le=1000, description="random, meshes: captures per scene")

    @model_validator(mode="after")
    def _fitting(self) -> SceneChoice:
        for field, family in (("names", "bundled"), ("files", "files"), ("folder", "meshes")):
            if getattr(self, field) and self.family != family:
                raise ValueError(f"{field} is for family = '{family}', not for '{self.family}'")
        if self.mitsuba != MitsubaChoices() and not any(map(is_mitsuba, self.files)):
            raise ValueError("mitsuba is for Mitsuba XML files; files lists none")
        if self.family == "files" and not self.files:
            raise ValueError("files is missing: a list of TOML or Mitsuba XML files is needed")
        if self.family == "meshes" and not self.folder:
            raise ValueError("folder is missing: a folder of OBJ, PLY, GLB, STL or OFF files is needed")
        for listed in (self.names, self.files):
            for name in listed:
                if listed.count(name) > 1:
                    raise ValueError(f"'{name}' is twice in the list")
        for name in self.names:
            if name not in scene_names():
                listed_names = ", ".join(scene_names())
                hint = did_you_mean(name, scene_names())
                raise ValueError(f"names: scene '{name}' is unknown; allowed are {listed_names}{hint}")
        return self


class LightChoice(Specification):
    """Distributions of the scenes' lights; by default the lights are those of the scene."""

    illuminant: Drawn | None = Field(default=None, description="illuminant of all lights of the scene")
    scale: Drawn | None = Field(default=None, description="factor on the illuminance of all lights")


class FocusChoice(Specification):
    """Distribution of the focus distance; by default the one that the scene proposes."""

    distance_m: Drawn | None = None


class ExposureChoice(Specification):
    """Distributions of the exposure; by default it is automatic, and random scenes have their own."""

    time_s: Drawn | None = None
    gain: Drawn | None = None
    auto_level: Drawn | None = None


class FrameChoice(Specification):
    """Frames of each sample: several exposures of one rendering, with independent noise."""

    bracket: tuple[float, ...] = Field(
        default=(1.0,), min_length=1, description="factors on the exposure time; the first is that of raw.png"
    )
    burst: int = Field(default=1, ge=1, description="frames at each of these times")

    @model_validator(mode="after")
    def _whole(self) -> FrameChoice:
        for factor in self.bracket:
            if not BRACKET[0] <= factor <= BRACKET[1]:
                raise ValueError(f"bracket: {factor:g} is no factor from {BRACKET[0]:g} to {BRACKET[1]:g}")
        if self.count > MOST_FRAMES:
            raise ValueError(f"bracket and burst: {self.count} frames per sample; {MOST_FRAMES} are allowed")
        return self

    @property
    def count(self) -> int:
        """Frames of a sample."""
        return len(self.bracket) * self.burst


class TruthChoice(Specification):
    """Parts and format of the stored ground truth."""

    keep: tuple[str, ...] = Field(default=tuple(TRUTH_PARTS), min_length=1)
    half: bool = Field(default=False, description="16-bit floats, except for depth and labels")
    margin_px: int = Field(default=0, ge=0, le=4096, description="pixels left out along every edge of the frame")
    independent_mean: bool = Field(
        default=False, description="mean_e of its own samples: its rendering noise is independent of that of raw.png"
    )

    @field_validator("keep")
    @classmethod
    def _known(cls, keep: tuple[str, ...]) -> tuple[str, ...]:
        for name in keep:
            if name not in TRUTH_PARTS:
                hint = did_you_mean(name, TRUTH_PARTS)
                raise ValueError(f"'{name}' is unknown; allowed are {', '.join(TRUTH_PARTS)}{hint}")
        return tuple(part for part in TRUTH_PARTS if part in keep)


class DatasetSpec(Specification):
    """Specification of a dataset, which ``dasim dataset make`` reads from TOML."""

    name: str = Field(min_length=1, max_length=100)
    version: str = "1.0"
    licence: str = "not stated"
    description: str = ""
    samples: int = Field(ge=1, le=MOST_SAMPLES)
    seed: int = Field(default=0, ge=0, lt=2**63)
    size_px: tuple[int, int] = Field(default=(512, 384), description="width and height, a central crop of the sensor")
    format: Literal["folders", "webdataset"] = "webdataset"
    raw_scale: Literal["dn", "full"] = Field(
        default="dn",
        description="numbers in raw.png: those of the converter, or times 2^(16 - bits), so that they fill 16 bits; "
        "raw_scale in meta.json states the factor",
    )
    samples_per_shard: int = Field(default=100, ge=1, le=100_000)
    spp: int | Literal["auto"] = Field(default="auto", description="samples per pixel and stop")
    noise_share: float = Field(
        default=NOISE_SHARE,
        ge=0.01,
        le=10,
        description="target of spp = 'auto': rendering noise over sensor noise",
    )
    noise_at: float = Field(
        default=NOISE_AT,
        ge=PERCENTILE[0],
        le=PERCENTILE[1],
        description="percentile of the pixels at which noise_share is meant, 50 the median",
    )
    diffraction: Literal["wave", "airy", "off"] | None = None
    noise: str | None = Field(
        default=None, description="your own noise model: package.module:function or file.py:function, beside this file"
    )
    sensor_per_sample: bool = Field(
        default=False, description="a sensor of its own for each sample; by default one per camera, see sensor_seed"
    )
    scenes: SceneChoice = SceneChoice()
    cameras: tuple[CameraChoice, ...] = Field(default=(CameraChoice(name="da-mobile"),), min_length=1)
    light: LightChoice = LightChoice()
    focus: FocusChoice = FocusChoice()
    exposure: ExposureChoice = ExposureChoice()
    frames: FrameChoice = FrameChoice()
    truth: TruthChoice = TruthChoice()
    splits: dict[str, float] = Field(default={"train": 1.0}, min_length=1)
    folder: Path = Field(default=Path("."), exclude=True)

    @model_validator(mode="after")
    def _whole(self) -> DatasetSpec:
        for name, share in self.splits.items():
            if not name.isidentifier():
                raise ValueError(f"splits: '{name}' is not a name of letters, digits and underscores")
            if share <= 0:
                raise ValueError(f"splits.{name} is {share:g}: shares must be above 0")
        if abs(sum(self.splits.values()) - 1) > 1e-6:
            raise ValueError(f"splits sum to {sum(self.splits.values()):g}, not to 1")
        if isinstance(self.spp, int) and not 1 <= self.spp <= 65_536:
            raise ValueError(f"spp is {self.spp}: 1 to 65536 or 'auto' is allowed")
        if 2 * self.truth.margin_px >= min(self.size_px):
            raise ValueError(f"truth.margin_px is {self.truth.margin_px}: nothing of {self.size_px} is left")
        return self


def load_spec(path: Path) -> DatasetSpec:
    """Read and check a specification from a TOML file; all problems in one InputError."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; a dataset is specified by a TOML file (see docs/guides/datasets.md)")
    spec = parse_toml(DatasetSpec, path).model_copy(update={"folder": path.parent.resolve()})
    check(spec, str(path))
    return spec


def noise_model(spec: DatasetSpec) -> NoiseModel:
    """The noise model of the samples; InputError where the user's own cannot be loaded."""
    if spec.noise is None:
        return expose
    source, colon, name = spec.noise.rpartition(":")
    return load_function(f"{spec.folder / source if source.endswith('.py') else source}{colon}{name}", "noise model")


def check(spec: DatasetSpec, where: str) -> None:
    """InputError with all problems: files that are missing, names that are unknown, values out of range.

    ``where`` is the name of the specification, which begins the message.
    """
    problems = []
    for number, choice in enumerate(spec.cameras):
        problems += [f"cameras.{number}: {problem}" for problem in _camera_problems(spec, choice)]
    for key, distribution, allowed in (
        ("focus.distance_m", spec.focus.distance_m, (1e-3, 1e4)),
        ("exposure.time_s", spec.exposure.time_s, (1e-9, LONGEST_EXPOSURE_S)),
        ("exposure.gain", spec.exposure.gain, (1 / 16, 1024)),
        ("exposure.auto_level", spec.exposure.auto_level, (1e-6, 1)),
        ("light.scale", spec.light.scale, (1e-9, 1e9)),
    ):
        for value in distribution.extremes() if distribution else ():
            if isinstance(value, (str, bool)) or not allowed[0] <= value <= allowed[1]:
                problems.append(f"{key} is {value!r}; a number from {allowed[0]:g} to {allowed[1]:g} is allowed")
    for value in spec.light.illuminant.extremes() if spec.light.illuminant else ():
        try:
            illuminants.illuminant(str(value))
        except InputError as error:
            problems.append(f"light.illuminant: {error}")
    problems += _scene_problems(spec) + _each_problems(spec)
    try:
        noise_model(spec)
    except InputError as error:
        problems.append(f"noise: {error}")
    if problems:
        raise InputError(f"{where}: " + "; ".join(problems))


def _camera_problems(spec: DatasetSpec, choice: CameraChoice) -> list[str]:
    try:
        camera = cameras.cropped(named_camera(spec, choice), *spec.size_px)
    except InputError as error:
        return [str(error)]
    problems = []
    for key, distribution in choice.vary.items():
        problems += _use_problems(distribution, lambda value, key=key: with_values(camera, {key: value}))  # type: ignore[misc]
    if spec.focus.distance_m is not None:
        problems += _use_problems(spec.focus.distance_m, lambda value: cameras.refocused(camera, float(value)))
    return problems


def _use_problems(draw: Draw, use: Callable[[Scalar], Any]) -> list[str]:
    """Message of the first extreme value for which ``use`` raises an error; empty where there is none."""
    for value in draw.extremes():
        try:
            use(value)
        except (InputError, ValueError) as error:
            return [str(error)]
    return []


def _scene_problems(spec: DatasetSpec) -> list[str]:
    problems = []
    scenes = spec.scenes
    try:
        if scenes.family in ("random", "meshes"):
            specification.check(random_spec(spec))
    except InputError as error:
        problems.append(f"scenes: {error}")
    try:
        illuminants.illuminant(scenes.mitsuba.illuminant)
    except InputError as error:
        problems.append(f"scenes.mitsuba.illuminant: {error}")
    for name in scenes.files:
        if not (spec.folder / name).is_file():
            problems.append(f"scenes.files: {spec.folder / name}: no such file")
        elif is_mitsuba(name) and (spec.light.illuminant or spec.light.scale):
            problems.append(
                f"scenes.files: {name} is a Mitsuba scene, whose lights cannot be changed; leave out [light]"
            )
    count = scene_count(spec)
    if count < len(spec.splits):
        problems.append(f"splits: {len(spec.splits)} splits need {len(spec.splits)} scenes at least, there are {count}")
    return problems


def each_counts(spec: DatasetSpec, choice: CameraChoice) -> tuple[int, ...]:
    """Number of values of every ``each`` of a camera and of light, focus and exposure, in the order of the grid."""
    parts = (spec.light, spec.focus, spec.exposure)
    draws = (*choice.vary.values(), *(getattr(part, key) for part in parts for key in type(part).model_fields))
    return tuple(len(draw.each) for draw in draws if draw is not None and draw.each is not None)


def _each_problems(spec: DatasetSpec) -> list[str]:
    """Problems of grids of ``each``: every scene must have whole grids of captures."""
    scenes = len(scene_keys(spec))
    captures = spec.samples / scenes if scenes else spec.scenes.captures_per_scene
    problems = []
    for number, choice in enumerate(spec.cameras):
        size = math.prod(each_counts(spec, choice))
        if size > 1 and len(spec.cameras) > 1:
            problems.append("each: makes a grid of captures by one camera; give one camera, or choice instead of each")
        elif size > 1 and (captures % size or spec.samples % size):
            problems.append(
                f"each: the values of camera {number} make a grid of {size} captures, but a scene has {captures:g} of "
                f"{spec.samples} samples; choose " + ("samples" if scenes else "scenes.captures_per_scene and samples")
                + f" so that every scene has a multiple of {size}"
            )  # fmt: skip
    return problems


def random_spec(spec: DatasetSpec) -> RandomScenes:
    """Specification of the random scenes, with folders relative to that of the dataset's specification."""
    changes: dict[str, Any] = {"folder": spec.folder}
    if spec.scenes.family == "meshes":
        changes |= {"meshes": (spec.scenes.folder,), "mesh_share": 1.0}
    return spec.scenes.random.model_copy(update=changes)


def scene_keys(spec: DatasetSpec) -> tuple[str, ...]:
    """Names of the scenes of a family of fixed scenes; empty for random scenes and meshes."""
    if spec.scenes.family == "bundled":
        return spec.scenes.names or tuple(scene_names())
    return spec.scenes.files


def scene_count(spec: DatasetSpec) -> int:
    """Number of scenes that the samples show."""
    keys = scene_keys(spec)
    return min(len(keys), spec.samples) if keys else -(-spec.samples // spec.scenes.captures_per_scene)


def named_camera(spec: DatasetSpec, choice: CameraChoice) -> Camera:
    """Camera of a choice, from a file beside the specification or by its bundled name."""
    beside = spec.folder / choice.name
    return cameras.load_camera(beside if beside.is_file() else choice.name)


def with_values(camera: Camera, changes: dict[str, Scalar]) -> Camera:
    """Camera with values changed at dotted keys; raises InputError if a key does not exist or a value
    is not allowed.
    """
    if not changes:
        return camera
    data = camera.model_dump(mode="json")
    for key, value in changes.items():
        place, parts = data, key.split(".")
        for depth, part in enumerate(parts):
            entry = _entry(place, part)
            if entry is None:
                names = _names(place)
                raise InputError(
                    f"vary: '{key}' does not exist in camera '{camera.name}'; {'.'.join(parts[:depth]) or 'it'} has "
                    f"{', '.join(names)}{did_you_mean(part, names)}"
                )
            if depth == len(parts) - 1:
                place[entry] = value
            else:
                place = place[entry]
    return parse(Camera, data, "vary: " + ", ".join(f"{key} = {value!r}" for key, value in changes.items()))


def _entry(place: Any, part: str) -> Any:
    """Key or index of an entry of a table or list by its key, index or name; None where there is none."""
    if isinstance(place, dict):
        return part if part in place else None
    if isinstance(place, list):
        if part.isdigit() and int(part) < len(place):
            return int(part)
        matches = [index for index, item in enumerate(place) if isinstance(item, dict) and item.get("name") == part]
        return matches[0] if matches else None
    return None


def _names(place: Any) -> list[str]:
    """Keys of a table, or names (or else indices) of the entries of a list, for a message."""
    if isinstance(place, dict):
        return list(place)
    if isinstance(place, list):
        return [
            str(item.get("name", index)) if isinstance(item, dict) else str(index) for index, item in enumerate(place)
        ]
    return ["no parts"]
