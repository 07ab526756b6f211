"""Loading of scenes by name: bundled scenes, members of a family, random scenes, TOML files and Mitsuba XML files.

Tested in tests/dasim/random_scenes/test_specification.py and tests/dasim/dataset/test_specification.py.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dasim.base.errors import InputError, kind_of
from dasim.base.toml import parse
from dasim.camera.specification import Camera, as_camera
from dasim.random_scenes.scene import by_name, is_random
from dasim.scene import loading, mitsuba_xml, specification, targets
from dasim.scene.mitsuba_scene import MitsubaScene, is_mitsuba
from dasim.scene.specification import Scene
from dasim.spectra import illuminants


def load_scene(
    name_or_path: str | Path, *, camera: Camera | str | Path | None = None, **choices: Any
) -> Scene | MitsubaScene:
    """Load a scene by its name or path; InputError lists all problems of the scene.

    Args:
        name_or_path: a bundled name (``dasim.scene_names()``), a member of a family (``staircase:14``, see
            :mod:`dasim.scene.targets`), a random scene (``random:SEED:INDEX`` or ``random:FILE.toml:SEED:INDEX``), a
            TOML file, or a Mitsuba XML file
        camera: the camera that will photograph the scene, with its final crop; it defines the blur levels of a family
            and the field of view of a random scene. Default: da-mobile
        choices: fields of :class:`~dasim.scene.mitsuba_scene.MitsubaChoices`, for Mitsuba XML files only: ``unit_cm``,
            ``near_infrared``, ``illuminant``, and ``define``, the values of the file's ``$parameters`` by name
    """
    if not isinstance(name_or_path, (str, Path)):
        raise InputError(f"scene: must be the name of a scene or a path, not {kind_of(name_or_path)}")
    loaded = None if camera is None else as_camera(camera)
    path = Path(name_or_path)
    if not is_mitsuba(path):
        if choices:
            raise InputError(f"scene '{name_or_path}': {', '.join(choices)} is for Mitsuba scenes (.xml) only")
        if targets.is_target(name_or_path):
            return targets.target(name_or_path, loaded)
        if is_random(name_or_path):
            return by_name(str(name_or_path), loaded)[0]
        return loading.load_scene(name_or_path)
    if not path.is_file():
        raise InputError(f"scene '{name_or_path}': no such file")
    data = {"name": path.stem, "file": path.resolve(), **choices}
    scene = parse(MitsubaScene, data, str(name_or_path))
    mitsuba_xml.check(scene.file, str(name_or_path), scene.define)
    illuminants.illuminant(scene.illuminant)
    return scene


def as_scene(
    scene: Scene | MitsubaScene | str | Path, camera: Camera | str | Path | None = None
) -> Scene | MitsubaScene:
    """Return a scene unchanged, or load it by its name or path (see :func:`load_scene`); raises InputError for other
    types.
    """
    if isinstance(scene, (Scene, MitsubaScene)):
        return scene
    if isinstance(scene, (str, Path)):
        return load_scene(scene, camera=camera)
    raise InputError(f"scene: must be a Scene, the name of a scene or a path, not {kind_of(scene)}")


def focused(camera: Camera | str | Path, scene: Scene | MitsubaScene | str | Path) -> Camera:
    """The camera focused at the distance that the scene proposes (``focus_cm``), or unchanged where it proposes none.

    Both arguments may be names or paths. A Mitsuba scene proposes no focus.
    """
    camera = as_camera(camera)
    scene = as_scene(scene, camera)
    return camera if isinstance(scene, MitsubaScene) else specification.focused(camera, scene)
