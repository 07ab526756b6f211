"""The parts of a dataset's specification: distributions of values, scenes, cameras, light, focus, exposure and truth.

Tested in tests/dasim/dataset/test_specification.py and tests/dasim/dataset/test_draws.py.
"""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, field_validator, model_validator

from dasim.base.suggestions import did_you_mean
from dasim.base.toml import Specification
from dasim.camera.dotted_keys import Scalar
from dasim.files.truth import TRUTH_PARTS
from dasim.random_scenes.specification import RandomScenes
from dasim.scene.loading import scene_names
from dasim.scene.mitsuba_scene import MitsubaChoices, is_mitsuba
from dasim.scene.poses import Pose, between
from dasim.typing import FloatArray

MOST_FRAMES = 1000  # of a sample
MOST_VIEWS = 10_000  # of a capture
BRACKET = (1e-6, 1e6)  # of factors on an exposure time
KIND = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")


class Draw(Specification):
    """Distribution of a number or text over the samples: uniform, log-uniform, a choice with equal probabilities, or
    ``each``: the values in turn, one per capture of a scene.

    Several ``each`` in a specification form a grid: those of the camera vary fastest, in their order, then light, focus
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
        """Both ends of a range and a value between them, which is no whole number, or all values of a choice: if they
        are allowed, every value is.
        """
        ends = self.uniform or self.log_uniform
        if ends is not None:
            return (*ends, ends[0] + BETWEEN * (ends[1] - ends[0]))
        return self.choice or self.each or ()


def _constant(value: Any) -> Any:
    """A plain value as the choice of this value."""
    return {"choice": [value]} if isinstance(value, (bool, int, float, str)) else value


Drawn = Annotated[Draw, BeforeValidator(_constant)]


BETWEEN = 1 / np.pi  # place in a range of the value between its ends that is tried
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
    weight: float = Field(default=1.0, gt=0, le=1e6)
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
    kinds: dict[str, RandomScenes] = Field(
        default_factory=dict,
        description="random: several distributions by name instead of one; the scenes are of each in turn",
    )
    captures_per_scene: int = Field(default=1, ge=1, le=1000, description="random, meshes: captures per scene")

    @model_validator(mode="after")
    def _fitting(self) -> SceneChoice:
        for field, family in (("names", "bundled"), ("files", "files"), ("folder", "meshes")):
            if getattr(self, field) and self.family != family:
                raise ValueError(f"{field} is for family = '{family}', not for '{self.family}'")
        if self.captures_per_scene > 1 and self.family not in ("random", "meshes"):
            raise ValueError(
                f"captures_per_scene is for random scenes; those of family = '{self.family}' are used in turn, "
                "so that the number of samples decides"
            )
        if self.random != RandomScenes() and self.family not in ("random", "meshes"):
            raise ValueError(f"random is for family = 'random' or 'meshes', not for '{self.family}'")
        if self.family == "meshes" and self.random.meshes:
            raise ValueError("random.meshes: family = 'meshes' takes all of its folder; leave it out")
        if self.kinds and (self.family != "random" or self.random != RandomScenes()):
            raise ValueError("kinds is for family = 'random', and replaces the table random: leave that out")
        for name in self.kinds:
            if not KIND.fullmatch(name):
                raise ValueError(f"kinds: '{name}' is not a name of letters, digits, - and _, a letter first")
        if self.mitsuba != MitsubaChoices() and not any(map(is_mitsuba, self.files)):
            raise ValueError("mitsuba is for Mitsuba XML files; files lists none")
        if self.family == "files" and not self.files:
            raise ValueError("files is missing: give a list of TOML or Mitsuba XML files")
        if self.family == "meshes" and not self.folder:
            raise ValueError("folder is missing: give a folder of OBJ, PLY, GLB, STL or OFF files")
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

    illuminant: Drawn | None = Field(
        default=None,
        description="illuminant of all lights but daylight, whose spectrum follows from the sun's elevation",
    )
    scale: Drawn | None = Field(default=None, description="factor on the illuminance of all lights")


class FocusChoice(Specification):
    """Distribution of the focus distance; by default the one that the scene proposes."""

    distance_m: Drawn | None = None


class ExposureChoice(Specification):
    """Distributions of the exposure; by default it is automatic, and random scenes have their own."""

    time_s: Drawn | None = None
    gain: Drawn | None = None
    auto_level: Drawn | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> ExposureChoice:
        if self.time_s is not None and self.auto_level is not None:
            raise ValueError("time_s and auto_level: an exposure time leaves nothing to auto_level; leave one out")
        return self


class FrameChoice(Specification):
    """Frames of each sample: several exposures of one rendering, with independent noise."""

    bracket: tuple[Annotated[float, Field(ge=BRACKET[0], le=BRACKET[1])], ...] = Field(
        default=(1.0,), min_length=1, description="factors on the exposure time; the first is that of raw.png"
    )
    burst: int = Field(default=1, ge=1, le=MOST_FRAMES, description="frames at each of these times")

    @model_validator(mode="after")
    def _whole(self) -> FrameChoice:
        if self.count > MOST_FRAMES:
            raise ValueError(f"bracket and burst: {self.count} frames per sample; at most {MOST_FRAMES} are allowed")
        return self

    @property
    def count(self) -> int:
        """Frames of a sample."""
        return len(self.bracket) * self.burst


class RigCamera(Pose):
    """A camera of a rig, with its pose in the rig; each camera has its own sensor."""

    name: str = Field(min_length=1, description="its name in meta.json and in the index")
    camera: str | None = Field(default=None, description="bundled name or file; by default that of [[cameras]]")


class ViewChoice(Specification):
    """Views of every capture of a scene, each a sample: cameras of a rig, times poses of the rig.

    The views of a capture share scene, light, exposure and all drawn values; each has noise of its own.
    """

    rig: tuple[RigCamera, ...] = Field(
        default=(RigCamera(name="camera"),), min_length=1, max_length=MOST_VIEWS, description="cameras with known poses"
    )
    poses: tuple[Pose, ...] = Field(
        default=(Pose(),),
        min_length=1,
        max_length=MOST_VIEWS,
        description="poses of the rig, relative to the view of the scene",
    )
    steps: int | None = Field(
        default=None,
        ge=2,
        le=MOST_VIEWS,
        description="a trajectory: as many poses at equal steps on the path through poses",
    )

    @model_validator(mode="after")
    def _whole(self) -> ViewChoice:
        names = [camera.name for camera in self.rig]
        if len(set(names)) < len(names):
            raise ValueError(f"rig: names of cameras must be unique, not {', '.join(names)}")
        if self.steps is not None and len(self.poses) < 2:
            raise ValueError("steps is for a trajectory: poses must list two poses or more that it passes through")
        if self.count > MOST_VIEWS:
            raise ValueError(f"rig and poses: {self.count} views; at most {MOST_VIEWS} are allowed")
        return self

    @property
    def count(self) -> int:
        """Views of a capture."""
        return len(self.rig) * (self.steps or len(self.poses))

    @property
    def moves(self) -> bool:
        """Whether some view has another pose than that of the scene."""
        return any(not np.array_equal(pose.matrix(), np.eye(4)) for pose in (*self.poses, *self.rig))

    def camera_of(self, number: int) -> RigCamera:
        """Camera of the rig that takes view ``number``; the camera varies fastest, then the pose."""
        return self.rig[number % len(self.rig)]

    def pose(self, number: int) -> FloatArray:
        """Pose [4, 4] of view ``number`` relative to the view of the scene, metres."""
        rig = [pose.matrix() for pose in self.poses]
        rig = rig if self.steps is None else between(rig, self.steps)
        return np.asarray(rig[number // len(self.rig)] @ self.camera_of(number).matrix())


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
