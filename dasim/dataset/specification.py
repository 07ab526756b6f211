"""Specification of a dataset, and its checks; its parts are defined in :mod:`dasim.dataset.choices`."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from dasim.base.errors import InputError
from dasim.base.loading import load_function
from dasim.base.toml import Specification, bundled_or_file, parse_toml
from dasim.camera import specification as cameras
from dasim.camera.dotted_keys import with_values
from dasim.camera.noise import LONGEST_EXPOSURE_S, NoiseModel, expose
from dasim.camera.sensor import SMALLEST_FRAME_PX
from dasim.camera.specification import Camera
from dasim.dataset.choices import (
    CameraChoice,
    Draw,
    ExposureChoice,
    FocusChoice,
    FrameChoice,
    LightChoice,
    Scalar,
    SceneChoice,
    TruthChoice,
    ViewChoice,
)
from dasim.random_scenes import specification
from dasim.random_scenes.specification import RandomScenes
from dasim.scene.loading import scene_names
from dasim.scene.mitsuba_scene import is_mitsuba
from dasim.simulation.adaptive_sampling import NOISE_AT, NOISE_SHARE
from dasim.simulation.checks import MOST_SPP, PERCENTILE
from dasim.spectra import illuminants

BUNDLED = Path(__file__).with_name("bundled")
MOST_SAMPLES = 10_000_000
Pixels = Annotated[int, Field(ge=SMALLEST_FRAME_PX, le=20_000)]


class DatasetSpec(Specification):
    """Specification of a dataset, which ``dasim dataset make`` reads from TOML."""

    name: str = Field(min_length=1, max_length=100)
    version: str = "1.0"
    licence: str = "not stated"
    description: str = ""
    samples: int = Field(ge=1, le=MOST_SAMPLES)
    first: int | None = Field(
        default=None,
        ge=1,
        le=MOST_SAMPLES,
        description="make only the first samples; each is identical to that of the whole dataset, and in its split",
    )
    seed: int = Field(default=0, ge=0, lt=2**63)
    size_px: tuple[Pixels, Pixels] = Field(
        default=(512, 384), description="width and height, a central crop of the sensor"
    )
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
        description="percentile of the pixels to which noise_share applies; 50 is the median",
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
    views: ViewChoice = ViewChoice()
    light: LightChoice = LightChoice()
    focus: FocusChoice = FocusChoice()
    exposure: ExposureChoice = ExposureChoice()
    frames: FrameChoice = FrameChoice()
    truth: TruthChoice = TruthChoice()
    splits: dict[str, Annotated[float, Field(gt=0, le=1)]] = Field(default={"train": 1.0}, min_length=1)
    folder: Path = Field(default=Path("."), exclude=True)

    @property
    def made(self) -> int:
        """Number of samples that are made."""
        return self.samples if self.first is None else self.first

    @model_validator(mode="after")
    def _whole(self) -> DatasetSpec:
        for name in self.splits:
            if not name.isidentifier():
                raise ValueError(f"splits: '{name}' is not a name of letters, digits and underscores")
        if self.first is not None and self.first > self.samples:
            raise ValueError(f"first is {self.first}: the dataset has {self.samples} samples")
        if abs(sum(self.splits.values()) - 1) > 1e-6:
            raise ValueError(f"splits sum to {sum(self.splits.values()):g}, not to 1")
        if isinstance(self.spp, int) and not 1 <= self.spp <= MOST_SPP:
            raise ValueError(f"spp is {self.spp}: 1 to {MOST_SPP} or 'auto' is allowed")
        if self.spp != "auto" and (self.noise_share, self.noise_at) != (NOISE_SHARE, NOISE_AT):
            raise ValueError("noise_share and noise_at are for spp = 'auto'; leave them out")
        seeds = "sensor.sensor_seed"
        if self.sensor_per_sample and any(seeds in choice.vary for choice in self.cameras):
            raise ValueError(f"sensor_per_sample and {seeds} of a camera both choose the sensor; leave one out")
        if 2 * self.truth.margin_px >= min(self.size_px):
            raise ValueError(f"truth.margin_px is {self.truth.margin_px}: nothing of {self.size_px} is left")
        if self.samples % self.views.count:
            raise ValueError(
                f"samples is {self.samples}: every capture has {self.views.count} views, choose a multiple of them"
            )
        return self


def bundled_names() -> list[str]:
    """Names of the bundled specifications."""
    return sorted(path.stem for path in BUNDLED.glob("*.toml"))


def load_spec(path: str | Path) -> DatasetSpec:
    """Read and check a specification from a TOML file or by its bundled name; all problems in one InputError."""
    path = bundled_or_file(path, BUNDLED, "dataset specification")
    spec = parse_toml(DatasetSpec, path).model_copy(update={"folder": path.parent.resolve()})
    check(spec, str(path))
    return spec


def with_first(spec: DatasetSpec, first: int | None) -> DatasetSpec:
    """The specification with only its first samples; unchanged for None."""
    if first is None:
        return spec
    if not 1 <= first <= spec.samples:
        raise InputError(f"--first {first}: must be from 1 to {spec.samples}, the samples of '{spec.name}'")
    return spec.model_copy(update={"first": first})


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
    problems += _rig_problems(spec) + _scene_problems(spec) + _each_problems(spec)
    try:
        noise_model(spec)
    except InputError as error:
        problems.append(f"noise: {error}")
    if problems:
        raise InputError(f"{where}: " + "; ".join(problems))


def _camera_problems(spec: DatasetSpec, choice: CameraChoice) -> list[str]:
    try:
        camera = cameras.cropped(named_camera(spec, choice.name), *spec.size_px)
    except InputError as error:
        return [str(error)]
    problems = _focus_problems(spec, camera)
    for key, distribution in choice.vary.items():
        found = _use_problems(distribution, lambda value, key=key: with_values(camera, {key: value}))  # type: ignore[misc]
        problems += [f"vary: {problem}" for problem in found]
    return problems


def _rig_problems(spec: DatasetSpec) -> list[str]:
    """Problems of a rig's cameras of other names, and of views of scenes whose camera cannot be moved."""
    problems = []
    for number, member in enumerate(spec.views.rig):
        where = f"views.rig.{number}"
        try:
            if member.camera is not None:
                camera = cameras.cropped(named_camera(spec, member.camera), *spec.size_px)
                problems += [f"{where}: {problem}" for problem in _focus_problems(spec, camera)]
        except InputError as error:
            problems.append(f"{where}: {error}")
    if spec.views.moves:
        problems += [
            f"scenes.files: {name} is a Mitsuba scene, whose camera cannot be moved; leave out poses in [views]"
            for name in spec.scenes.files
            if is_mitsuba(name)
        ]
    return problems


def _focus_problems(spec: DatasetSpec, camera: Camera) -> list[str]:
    if spec.focus.distance_m is None:
        return []
    return _use_problems(spec.focus.distance_m, lambda value: cameras.refocused(camera, float(value)))


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
            for number in range(max(len(scenes.kinds), 1)):
                specification.check(random_spec(spec, number))
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
    total = capture_count(spec)
    captures = total / scenes if scenes else spec.scenes.captures_per_scene
    problems = []
    for number, choice in enumerate(spec.cameras):
        size = math.prod(each_counts(spec, choice))
        if size > 1 and len(spec.cameras) > 1:
            problems.append("each: makes a grid of captures by one camera; give one camera, or choice instead of each")
        elif size > 1 and (captures % size or total % size):
            problems.append(
                f"each: the values of camera {number} make a grid of {size} captures, but a scene has {captures:g} of "
                f"{total} captures; choose " + ("samples" if scenes else "scenes.captures_per_scene and samples")
                + f" so that every scene has a multiple of {size}"
            )  # fmt: skip
    return problems


def kind(spec: DatasetSpec, number: int) -> str | None:
    """Name of the distribution that scene ``number`` is drawn from; None where the dataset has one only."""
    return list(spec.scenes.kinds)[number % len(spec.scenes.kinds)] if spec.scenes.kinds else None


def random_spec(spec: DatasetSpec, number: int) -> RandomScenes:
    """Distribution of random scene ``number``, with folders relative to that of the dataset's specification."""
    name = kind(spec, number)
    source = spec.scenes.random if name is None else spec.scenes.kinds[name]
    changes: dict[str, Any] = {"folder": spec.folder}
    if spec.scenes.family == "meshes":
        changes |= {"meshes": (spec.scenes.folder,), "mesh_share": 1.0}
    return source.model_copy(update=changes)


def scene_keys(spec: DatasetSpec) -> tuple[str, ...]:
    """Names of the scenes of a family of fixed scenes; empty for random scenes and meshes."""
    if spec.scenes.family == "bundled":
        return spec.scenes.names or tuple(scene_names())
    return spec.scenes.files


def capture_count(spec: DatasetSpec) -> int:
    """Number of captures, each of which has all views."""
    return spec.samples // spec.views.count


def scene_count(spec: DatasetSpec) -> int:
    """Number of scenes that the samples show."""
    keys, captures = scene_keys(spec), capture_count(spec)
    return min(len(keys), captures) if keys else -(-captures // spec.scenes.captures_per_scene)


def named_camera(spec: DatasetSpec, name: str) -> Camera:
    """Camera from a file beside the specification or by its bundled name."""
    beside = spec.folder / name
    return cameras.load_camera(beside if beside.is_file() else name)
