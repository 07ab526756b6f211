"""A Mitsuba 3 scene file as data: its path, and the choices that its XML and RGB colours leave open."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from dasim.base.toml import Specification


class MitsubaScene(Specification):
    """A Mitsuba XML file, viewed from the position of its sensor.

    The rule ``near_infrared`` extends RGB surface colours beyond the visible. RGB lights get the spectrum of
    ``illuminant`` at the same luminance. Levels are relative, as in Mitsuba: RGB light of luminance 1 is as bright as a
    spectrum that is 1 W m^-2 sr^-1 nm^-1 at all wavelengths (73,000 cd/m^2); automatic exposure adapts to any level.
    """

    name: str
    file: Path
    unit_cm: float = Field(default=100.0, gt=0, description="length of the scene's unit, centimetres")
    near_infrared: Literal["print", "dyed", "achromatic"] = "achromatic"
    illuminant: str = "D65"
    focus_cm: None = None  # the focus of the file's own sensor does not apply to another lens
