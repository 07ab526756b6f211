"""The lights of a scene as data. Lengths are centimetres in scene coordinates, levels are illuminances in lux.

A direction in the sky is an elevation above the horizon (up is -y) and an azimuth from straight ahead (+z) towards the
right (+x), both in degrees. A light at azimuth 0 stands behind the subject, at 90 to its right, at 180 behind the
camera (for a camera that looks along z).

Tested in tests/dasim/render/test_lights.py and tests/dasim/scene/test_skies.py.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from dasim.base.toml import Specification
from dasim.scene.shapes import Length, Vector
from dasim.spectra import daylight, illuminants
from dasim.typing import FloatArray

LUX_RANGE = (1e-6, 1e7)  # from below starlight to about 100 times sunlight
Lux = Annotated[float, Field(ge=LUX_RANGE[0], le=LUX_RANGE[1])]
Share = Annotated[float, Field(ge=0, le=1)]
Azimuth = Annotated[float, Field(ge=-360, le=360, description="degrees from straight ahead towards the right")]

SUN_DIAMETER_DEG = 0.53  # angular diameter of the solar disc


class Dome(Specification):
    """Uniform light from all directions; ``lux`` is the illuminance on an unshadowed surface of any orientation."""

    kind: Literal["dome"]
    illuminant: str
    lux: Lux


class _Near(Specification):
    """A light at a finite distance; ``lux`` is the illuminance at ``target_cm`` on a surface that faces the light."""

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
    radius_cm: Length


class Panel(_Near):
    """A flat rectangle that faces its target; ``size_cm`` is its width, which is horizontal, and its height.

    In directions within 26 degrees of the vertical, as of a ceiling panel, its height is horizontal instead, along x
    for one that faces straight down.
    """

    kind: Literal["panel"]
    size_cm: tuple[Length, Length]


class Bulb(_Near):
    """A sphere that emits in all directions; ``target_cm`` is the point where it gives ``lux``."""

    kind: Literal["bulb"]
    radius_cm: Length

    @model_validator(mode="after")
    def _target_outside(self) -> Bulb:
        distance = float(np.linalg.norm(np.subtract(self.position_cm, self.target_cm)))
        if distance <= self.radius_cm:
            raise ValueError(
                f"target_cm lies inside the bulb ({distance:g} cm from its centre, radius_cm is {self.radius_cm:g})"
            )
        return self


class Sun(Specification):
    """A disc at infinity, 0.53 degrees wide; ``lux`` is the illuminance on a surface that faces it."""

    kind: Literal["sun"]
    illuminant: str
    lux: Lux
    elevation_deg: float = Field(gt=0, le=90)
    azimuth_deg: Azimuth = 0.0


class Sky(Specification):
    """Light from the upper hemisphere; ``lux`` is the illuminance on level ground. Without a sun it is outdoor shade.

    An ``overcast`` sky is three times as bright at the zenith as at the horizon. A ``clear`` sky is brightest around
    the sun at ``sun_elevation_deg`` and ``sun_azimuth_deg``; the solar disc itself is a light of its own. Below the
    horizon lies an infinitely distant grey ground of ``ground_reflectance`` that the sky illuminates (default: black).
    """

    kind: Literal["sky"]
    illuminant: str
    lux: Lux
    distribution: Literal["uniform", "overcast", "clear"] = "uniform"
    sun_elevation_deg: float = Field(default=45.0, gt=0, le=90)
    sun_azimuth_deg: Azimuth = 0.0
    ground_reflectance: Share = 0.0


class Daylight(Specification):
    """Sun and clear sky in their physical ratio for the sun's elevation; ``lux`` is their sum on level ground.

    Both illuminate the ground below the horizon, which has ``ground_reflectance`` (default: black).
    """

    kind: Literal["daylight"]
    lux: Lux
    elevation_deg: int = Field(ge=5, le=90, description="elevation of the sun, whole degrees")
    azimuth_deg: Azimuth = 0.0
    ground_reflectance: Share = 0.0

    @property
    def illuminant(self) -> str:
        """Name of the illuminant that is the sum of sun and sky."""
        return f"daylight-{self.elevation_deg}deg"


class Ground(Specification):
    """Uniform light from the lower hemisphere, part of outdoor lights; ``lux`` is that on a surface that faces down."""

    kind: Literal["ground"]
    illuminant: str
    lux: float = Field(ge=0, le=LUX_RANGE[1])


class Environment(Specification):
    """An equirectangular panorama (twice as wide as high) that surrounds the scene as a light.

    Its luminance modulates the spectrum of ``illuminant``; its colours are ignored, since RGB does not determine the
    near-infrared. ``lux`` is the illuminance on a level surface that faces straight up. The centre of the image lies
    straight ahead (+z) and its right half to the right; ``rotation_deg`` rotates the centre towards the right.
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
    """Unit vector in scene coordinates towards a direction of the sky, [3]."""
    elevation, azimuth = np.radians((elevation_deg, azimuth_deg))
    horizontal = np.cos(elevation)
    return np.array([horizontal * np.sin(azimuth), -np.sin(elevation), horizontal * np.cos(azimuth)])


def parts(light: Light) -> tuple[Part, ...]:
    """Elementary lights that a light consists of: daylight is a sun, a clear sky and the ground that both illuminate.

    All other lights are their own only part, apart from the ground below a sky.
    """
    if not isinstance(light, (Sky, Daylight)):
        return (light,)
    ground: tuple[Part, ...] = ()
    if light.ground_reflectance > 0:
        # Ground of uniform radiance rho E / pi fills the lower hemisphere: a surface that faces down receives rho E.
        lux = light.lux * light.ground_reflectance
        ground = (Ground(kind="ground", illuminant=light.illuminant, lux=lux),)
    if isinstance(light, Sky):
        return (light, *ground)
    sun, sky = daylight.sun_and_sky(light.elevation_deg)
    height = float(np.sin(np.radians(light.elevation_deg)))
    facing, level = illuminants.lux(sun), illuminants.lux(sky)
    scale = light.lux / (facing * height + level)
    degrees = light.elevation_deg
    # Built without validation: a part of a very weak light may lie below the smallest level that a user may set.
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
    """Radiance of a light's surface per irradiance at its target, on a surface that faces it, 1/sr.

    With radiance L, radius r and distance d, the irradiance is E = pi L r^2 / (r^2 + d^2) on the axis of a disc,
    pi L (r / d)^2 of a sphere, and for a rectangle four times that of one quarter (configuration factor of an element
    opposite the corner of a rectangle, Howell's catalogue, B-3).
    """
    distance = float(np.linalg.norm(np.subtract(light.target_cm, light.position_cm)))
    if isinstance(light, Lamp):
        factor = light.radius_cm**2 / (light.radius_cm**2 + distance**2)
    elif isinstance(light, Bulb):
        factor = (light.radius_cm / distance) ** 2
    else:
        x, y = (side / 2 / distance for side in light.size_cm)
        far_x, far_y = np.hypot(1.0, x), np.hypot(1.0, y)
        factor = 2 / np.pi * (x / far_x * np.arctan(y / far_x) + y / far_y * np.arctan(x / far_y))
    return float(1 / (np.pi * factor))
