"""A Mitsuba 3 scene file as data: the file, and the choices that RGB and XML leave open."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from dasim.base.toml import Specification


class MitsubaScene(Specification):
    """A Mitsuba XML file, seen from where its sensor stands.

    ``unit_cm`` is the length of the scene's unit. Its RGB surface colours become materials by the rule
    ``near_infrared``, its RGB lights get the spectrum of ``illuminant`` at the same luminance. Levels are relative,
    as in Mitsuba: RGB light of luminance 1 is as bright as a spectrum that is 1 W m^-2 sr^-1 nm^-1 everywhere
    (73,000 cd/m^2); automatic exposure takes care of the rest.
    """

    name: str
    file: Path
    unit_cm: float = Field(default=100.0, gt=0, description="length of the scene's unit")
    near_infrared: Literal["print", "dyed", "achromatic"] = "achromatic"
    illuminant: str = "D65"
    focus_cm: None = None  # what the file's own sensor is focused on means nothing to another lens
