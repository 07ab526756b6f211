"""Distributions of random rooms and table tops, and the user's meshes and pictures for them.

Every scene is valid by construction. ``RandomScenes`` documents the distributions; ``scene`` draws from them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from dasim.base.errors import InputError
from dasim.base.toml import Specification, parse_toml
from dasim.camera.noise import Exposure
from dasim.random_scenes import own_files
from dasim.random_scenes.own_files import OwnMeshes
from dasim.scene.lights import Lux
from dasim.spectra import illuminants

Share = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(gt=0, le=1e6)]
Depth = Annotated[float, Field(ge=3, le=4000, description="centimetres; nearer, the floor would touch the lens")]
Size = Annotated[float, Field(gt=0, le=0.6)]
Count = Annotated[int, Field(ge=3, le=200)]
Lamps = Annotated[int, Field(ge=1, le=8)]
Kelvin = Annotated[int, Field(ge=illuminants.BLACKBODY_K[0], le=illuminants.BLACKBODY_K[1])]

LEAST_RATIO = 1.5  # least ratio of the far to the near end of the depth range

# Default weights. Daylight and incandescent light are rich in near-infrared; LEDs and fluorescent lamps emit little.
ILLUMINANTS = {
    **{"D50": 1.0, "D55": 1.0, "D65": 1.5, "D75": 0.5},
    **{"A": 1.0, "incandescent-2800K": 1.0, "blackbody": 1.5},
    **{"F2": 0.4, "F7": 0.3, "F11": 0.4, "energy-saving-3500K": 0.7},
    **{"LED-B1": 0.3, "LED-B3": 0.3, "LED-B5": 0.3, "LED-V1": 0.3},
}


class RandomScenes(Specification):
    """Distributions of random scenes. Ranges are uniform unless stated otherwise; lengths are in centimetres."""

    room_share: Share = Field(
        default=0.5,
        description="share of rooms (a corner or one wall, objects on boxes, posters); the rest are table tops",
    )
    depth_cm: tuple[Depth, Depth] = Field(default=(20.0, 80.0), description="range of the depths of all visible points")
    objects: tuple[Count, Count] = Field(default=(5, 40), description="number of objects, without floor and walls")
    size: tuple[Size, Size] = Field(
        default=(0.07, 0.32), description="size of an object over the width of the picture, log-uniform; less in crowds"
    )
    surfaces: int = Field(
        default=10,
        ge=1,
        le=100,
        description="number of different surfaces, without pictures; the first is plain, shares are of the others",
    )
    textured_share: Share = 0.65
    background_textured_share: Share = 0.95
    glossy_share: Share = 0.10
    metal_share: Share = 0.03
    glass_share: Share = 0.02
    floating: bool = Field(
        default=False, description="whether some objects of rooms float in the air; by default they stand on boxes"
    )
    meshes: tuple[str, ...] = Field(
        default=(), description="your own OBJ, PLY, GLB, STL and OFF files, scaled to size: files, folders or patterns"
    )
    mesh_share: Share = Field(default=0.4, description="share of objects from meshes, if given")
    mesh_up: Literal["y", "z"] = Field(default="y", description="axis of the mesh files that points up")
    mesh_near_infrared: Literal["print", "dyed", "achromatic", "drawn"] = Field(
        default="drawn", description="rule for meshes with RGB colours of their own; 'drawn' chooses at random"
    )
    textures: tuple[str, ...] = Field(
        default=(), description="PNG and JPEG files instead of the bundled photographs: files, folders or patterns"
    )
    lamps: tuple[Lamps, Lamps] = Field(default=(1, 3), description="number of lamps, in scenes lit by lamps")
    window_share: Share = Field(
        default=0.2,
        description="share of scenes lit by a large panel on one side, like a window, of any of the illuminants",
    )
    outdoor_share: Share = Field(default=0.1, description="share of scenes lit by sun and sky, or an overcast sky")
    lux: tuple[Lux, Lux] = Field(
        default=(100.0, 2000.0), description="sum of all lamps, log-uniform; outdoors ten times as much"
    )
    fill_share: tuple[Share, Share] = Field(default=(0.1, 0.3), description="level of the dome relative to the lamps")
    illuminants: dict[str, Weight] = Field(default=ILLUMINANTS, description="weights; blackbodies are uniform in mired")
    blackbody_k: tuple[Kelvin, Kelvin] = (2300, 6500)
    mixed_light_share: Share = Field(default=0.25, description="share of scenes whose lamps have different illuminants")
    focus: Literal["far", "near", "within"] = Field(
        default="far", description="at one end of the depth range, or (within) uniform in dioptres between them"
    )
    auto_level: tuple[Share, Share] = Field(
        default=(0.6, 0.9), description="share of full scale that the exposure aims at"
    )
    gains: dict[float, Weight] = Field(default={1.0: 3.0, 2.0: 1.0, 4.0: 1.0}, description="weights")
    folder: Path = Path(".")

    @model_validator(mode="after")
    def _ranges(self) -> RandomScenes:
        for name in ("depth_cm", "objects", "size", "lamps", "lux", "fill_share", "blackbody_k", "auto_level"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name} is [{low}, {high}]: the smaller number comes first")
        if self.depth_cm[1] < LEAST_RATIO * self.depth_cm[0]:
            raise ValueError(f"depth_cm must reach at least {LEAST_RATIO} times its nearer end")
        if self.auto_level[0] <= 0 or not self.gains or not self.illuminants:
            raise ValueError("auto_level must be above 0; gains and illuminants need at least one entry")
        if self.metal_share + self.glass_share + self.glossy_share > 1 or self.window_share + self.outdoor_share > 1:
            raise ValueError(
                "metal_share + glass_share + glossy_share and window_share + outdoor_share must not exceed 1"
            )
        low_k, high_k = self.blackbody_k
        for name in self.illuminants:
            for variant in (f"blackbody-{low_k}K", f"blackbody-{high_k}K") if name == "blackbody" else (name,):
                try:
                    illuminants.illuminant(variant)
                except InputError as error:
                    raise ValueError(f"illuminants: {error}") from None
        for gain in self.gains:
            Exposure(gain=gain)
        return self


def load_random_scenes(path: str | Path) -> RandomScenes:
    """Load a specification from a TOML file; InputError lists all problems of the file and of those that it names."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"random scenes '{path}': no such file")
    spec = parse_toml(RandomScenes, path).model_copy(update={"folder": path.parent.resolve()})
    check(spec)
    return spec


def check(spec: RandomScenes) -> None:
    """Raise InputError with all broken meshes and pictures of the user; files read once are cached."""
    problems: list[str] = []
    for read in (own_meshes, own_pictures):
        try:
            read(spec)
        except InputError as error:
            problems.append(str(error))
    if problems:
        raise InputError("; ".join(problems))


def own_meshes(spec: RandomScenes) -> OwnMeshes | None:
    """The user's meshes, measured; None without any. Raises InputError if some are missing or broken."""
    if not spec.meshes:
        return None
    files = own_files.found(spec.folder, spec.meshes, own_files.MESH_SUFFIXES, "meshes")
    measured = own_files.measured_meshes(spec.folder, files)
    return OwnMeshes(measured, spec.mesh_share, spec.mesh_up, spec.mesh_near_infrared)


def own_pictures(spec: RandomScenes) -> tuple[str, ...]:
    """Names of the user's pictures; empty without any. Raises InputError if some are missing or broken."""
    if not spec.textures:
        return ()
    files = own_files.found(spec.folder, spec.textures, own_files.PICTURE_SUFFIXES, "textures")
    own_files.check_pictures(spec.folder, files)
    return tuple(name for name, _, _ in files)
