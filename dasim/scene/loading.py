"""A Mitsuba 3 scene that someone else made, as data: the file and the choices that RGB and XML leave open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera.specification import Camera
from dasim.scene import specification, targets
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.spectra import illuminants
from dasim.typing import FloatArray

SUFFIX = ".xml"


def load_scene(name_or_path: str | Path, *, camera: Camera | None = None, **choices: Any) -> Scene | MitsubaScene:
    """A bundled scene, a TOML file, or a Mitsuba XML file with its ``choices`` (see ``MitsubaScene``).

    Of a family of scenes (``targets``), ``camera`` says whose blur levels count; da-mobile's by default. InputError
    names everything that is wrong.
    """
    path = Path(name_or_path)
    if path.suffix.lower() != SUFFIX:
        if choices:
            raise InputError(f"scene '{name_or_path}': {', '.join(choices)} is for Mitsuba scenes (.xml) only")
        if targets.is_target(name_or_path):
            return targets.target(name_or_path, camera)
        return specification.load_scene(name_or_path)
    if not path.is_file():
        raise InputError(f"scene '{name_or_path}': no such file")
    data = {"name": path.stem, "file": path.resolve(), **choices}
    found = parse(MitsubaScene, data, str(name_or_path))
    illuminants.illuminant(found.illuminant)
    return found


def focused(camera: Camera, described: Scene | MitsubaScene) -> Camera:
    """The camera focused where the scene proposes; a Mitsuba scene proposes nothing."""
    return camera if isinstance(described, MitsubaScene) else specification.focused(camera, described)


def main_illuminant(described: Scene | MitsubaScene) -> str:
    """Name of the illuminant that gives the most light, or that RGB lights were given."""
    return described.illuminant if isinstance(described, MitsubaScene) else specification.main_illuminant(described)


def light_spectrum(described: Scene | MitsubaScene) -> FloatArray:
    """Spectral power of all lights together, relative, on the wavelength grid."""
    if isinstance(described, MitsubaScene):
        return illuminants.illuminant(described.illuminant)
    return specification.light_spectrum(described)
