"""The lights of a scene as data: lengths in scene coordinates, centimetres; levels in lux.

Directions in the sky are elevations above the horizon (up is -y) and azimuths from straight ahead (+z) towards the
right (+x), in degrees: 0 is behind what the camera looks at, 90 to its right, 180 behind the camera.

Tested in tests/dasim/render/test_lights.py.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from dasim.base.toml import Specification
from dasim.spectra import daylight, illuminants
from dasim.typing import FloatArray

Vector = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0)]
Lux = Annotated[float, Field(ge=1e-6, le=1e7)]  # from less than starlight to many suns
Share = Annotated[float, Field(ge=0, le=1)]
Azimuth = Annotated[float, Field(ge=-360, le=360, description="from straight ahead towards the right")]

SUN_DIAMETER_DEG = 0.53


class Dome(Specification):
    """Even light from everywhere; ``lux`` is what an unshadowed surface receives."""

    kind: Literal["dome"]
    illuminant: str
    lux: Lux


class _Near(Specification):
    """A light at a place; ``lux`` is what a surface at its target, facing it, receives."""

    illuminant: str
    lux: Lux
    position_cm: Vector
    target_cm: Vector

    @model_validator(mode="after")
    def _not_at_target(self) -> _Near:
        if np.allclose(self.position_cm, self.target_cm):
            raise ValueError("position_cm and target_cm must differ")
        return self


class Lamp(_Near):
    """A round, flat lamp that faces its target."""

    kind: Literal["lamp"]
    radius_cm: Positive


class Panel(_Near):
    """A flat rectangle that faces its target, ``size_cm`` wide (level) and high."""

    kind: Literal["panel"]
    size_cm: tuple[Positive, Positive]


class Bulb(_Near):
    """A glowing sphere; light goes everywhere, ``target_cm`` is where it gives ``lux``."""

    kind: Literal["bulb"]
    radius_cm: Positive

    @model_validator(mode="after")
    def _target_outside(self) -> Bulb:
        distance = float(np.linalg.norm(np.subtract(self.position_cm, self.target_cm)))
        if distance <= self.radius_cm:
            raise ValueError(
                f"target_cm lies inside the bulb ({distance:g} cm from its centre, radius_cm is {self.radius_cm:g})"
            )
        return self


class Sun(Specification):
    """A disc of 0.53 degrees, far away; ``lux`` is what a surface facing it receives."""

    kind: Literal["sun"]
    illuminant: str
    lux: Lux
    elevation_deg: float = Field(gt=0, le=90)
    azimuth_deg: Azimuth = 0.0


class Sky(Specification):
    """The upper half of a dome; ``lux`` is what level ground receives. Without a sun, it is outdoor shade.

    ``overcast`` is three times as bright above as at the horizon, ``clear`` is brightest around the sun, which
    stands at ``sun_elevation_deg`` and ``sun_azimuth_deg`` and is not part of it. Below the horizon it is black, or a
    grey ground of ``ground_reflectance`` far below that the sky lights.
    """

    kind: Literal["sky"]
    illuminant: str
    lux: Lux
    distribution: Literal["uniform", "overcast", "clear"] = "uniform"
    sun_elevation_deg: float = Field(default=45.0, gt=0, le=90)
    sun_azimuth_deg: Azimuth = 0.0
    ground_reflectance: Share = 0.0


class Daylight(Specification):
    """Sun and clear sky in their physical ratio for the sun's elevation; ``lux`` is what level ground receives.

    Both light the ground below the horizon, which is black unless it has a ``ground_reflectance``.
    """

    kind: Literal["daylight"]
    lux: Lux
    elevation_deg: int = Field(ge=5, le=90, description="of the sun, whole degrees")
    azimuth_deg: Azimuth = 0.0
    ground_reflectance: Share = 0.0

    @property
    def illuminant(self) -> str:
        """Name of the illuminant of sun and sky together."""
        return f"daylight-{self.elevation_deg}deg"


class Ground(Specification):
    """The lower half of a dome, a part of outdoor lights; ``lux`` is what a level surface facing down receives."""

    kind: Literal["ground"]
    illuminant: str
    lux: float


class Environment(Specification):
    """A panorama (equirectangular, twice as wide as high) of what surrounds the scene, as a light.

    Its colours say nothing of the near-infrared, so they are not used: its luminance modulates the illuminant's
    spectrum. ``lux`` is what a level surface that faces straight up receives. The image's middle lies straight ahead
    (+z) and its right half to the right; ``rotation_deg`` turns its middle towards the right.
    """

    kind: Literal["environment"]
    illuminant: str
    lux: Lux
    image: str = Field(description="a file beside the scene: EXR or HDR (linear), or PNG or JPEG (sRGB)")
    rotation_deg: Azimuth = 0.0


Light = Annotated[Dome | Lamp | Panel | Bulb | Sun | Sky | Daylight | Environment, Field(discriminator="kind")]
Near = Lamp | Panel | Bulb
Surrounding = Dome | Sky | Ground | Environment  # light from all around, of one spectrum
Part = Near | Sun | Surrounding


def direction(elevation_deg: float, azimuth_deg: float) -> FloatArray:
    """Unit vector in scene coordinates towards a place in the sky, [3]."""
    elevation, azimuth = np.radians((elevation_deg, azimuth_deg))
    level = np.cos(elevation)
    return np.array([level * np.sin(azimuth), -np.sin(elevation), level * np.cos(azimuth)])


def parts(light: Light) -> tuple[Part, ...]:
    """What a light is made of: daylight is a sun, a clear sky and the ground that they light."""
    if not isinstance(light, (Sky, Daylight)):
        return (light,)
    ground: tuple[Part, ...] = ()
    if light.ground_reflectance > 0:
        # Even ground of radiance rho E / pi fills the lower half: what faces down receives rho E.
        lux = light.lux * light.ground_reflectance
        ground = (Ground(kind="ground", illuminant=light.illuminant, lux=lux),)
    if isinstance(light, Sky):
        return (light, *ground)
    sun, sky = daylight.sun_and_sky(light.elevation_deg)
    height = float(np.sin(np.radians(light.elevation_deg)))
    facing, level = illuminants.lux(sun), illuminants.lux(sky)
    scale = light.lux / (facing * height + level)
    degrees = light.elevation_deg
    # Not checked again: what is left of little light may be less than the least that a user may ask for.
    disc = Sun.model_construct(
        kind="sun",
        illuminant=f"sun-{degrees}deg",
        lux=facing * scale,
        elevation_deg=float(degrees),
        azimuth_deg=light.azimuth_deg,
    )
    clear = Sky.model_construct(
        kind="sky",
        illuminant=f"sky-{degrees}deg",
        lux=level * scale,
        distribution="clear",
        sun_elevation_deg=float(degrees),
        sun_azimuth_deg=light.azimuth_deg,
    )
    return (disc, clear, *ground)


def radiance_per_lux(light: Near) -> float:
    """Radiance of a lamp's surface over the irradiance that it gives at its target, facing it, 1/sr.

    On its axis a disc gives E = pi L r^2 / (r^2 + d^2), a sphere pi L (r / d)^2, and a rectangle four times what
    each of its quarters does (configuration factor of a rectangle over its corner, Howell's catalogue, B-3).
    """
    distance = float(np.linalg.norm(np.subtract(light.target_cm, light.position_cm)))
    if isinstance(light, Lamp):
        seen = light.radius_cm**2 / (light.radius_cm**2 + distance**2)
    elif isinstance(light, Bulb):
        seen = (light.radius_cm / distance) ** 2
    else:
        x, y = (side / 2 / distance for side in light.size_cm)
        far_x, far_y = np.hypot(1.0, x), np.hypot(1.0, y)
        seen = 2 / np.pi * (x / far_x * np.arctan(y / far_x) + y / far_y * np.arctan(x / far_y))
    return float(1 / (np.pi * seen))
