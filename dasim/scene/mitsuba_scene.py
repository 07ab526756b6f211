"""A Mitsuba 3 scene file as data: its path, its parameters, and the choices that its XML and RGB colours leave open.

Tested in tests/dasim/render/foreign/test_reading.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, field_validator

from dasim.base.errors import kind_of
from dasim.base.toml import Specification

SUFFIX = ".xml"
RESERVED = ("config", "filename")  # Mitsuba's parser has arguments of these names


class MitsubaChoices(Specification):
    """What a Mitsuba XML file leaves open.

    The rule ``near_infrared`` extends RGB surface colours beyond the visible. RGB lights get the spectrum of
    ``illuminant`` at the same luminance. ``define`` has the values of the file's ``$parameters``, by name; they take
    precedence over its ``<default>`` elements, as with Mitsuba's own option ``--define``.
    """

    unit_cm: float = Field(default=100.0, ge=1e-4, le=1e6, description="length of the scene's unit, centimetres")
    near_infrared: Literal["print", "dyed", "achromatic"] = "achromatic"
    illuminant: str = "D65"
    define: dict[str, str] = Field(default={}, description="values of the file's $parameters")

    @field_validator("define", mode="before")
    @classmethod
    def _as_text(cls, define: Any) -> Any:
        return {name: _text(name, value) for name, value in define.items()} if isinstance(define, dict) else define


class MitsubaScene(MitsubaChoices):
    """A Mitsuba XML file, viewed from the position of its sensor.

    Levels are relative, as in Mitsuba: RGB light of luminance 1 is as bright as a spectrum that is
    1 W m^-2 sr^-1 nm^-1 at all wavelengths (73,000 cd/m^2); automatic exposure adapts to any level.
    """

    name: str
    file: Path
    focus_cm: None = None  # the focus of the file's own sensor does not apply to another lens


def _text(name: Any, value: Any) -> str:
    """A parameter's value as it is written in XML; ValueError for names and values that no file can use."""
    if not isinstance(name, str) or not (name.isascii() and name.isidentifier()) or name in RESERVED:
        raise ValueError(
            f"'{name}' cannot be a parameter's name: letters, digits and underscores are allowed, except for "
            + " and ".join(RESERVED)
        )
    if not isinstance(value, (str, int, float)):
        raise ValueError(f"the value of '{name}' is {kind_of(value)}; text, a number, true or false is allowed")
    return str(value).lower() if isinstance(value, bool) else str(value)


def is_mitsuba(path: str | Path) -> bool:
    """Whether a path denotes a Mitsuba XML file, by its suffix."""
    return Path(path).suffix.lower() == SUFFIX
