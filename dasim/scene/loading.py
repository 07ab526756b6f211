"""Bundled scenes and TOML files of scenes.

Tested in tests/dasim/scene/test_specification.py.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from dasim.base.toml import bundled_or_file, parse_toml
from dasim.scene.checks import check
from dasim.scene.specification import Scene

_HERE = Path(__file__).parents[1]
SCENE_DIR = _HERE / "scenes" if (_HERE / "scenes").is_dir() else _HERE.parent / "scenes"


def scene_names() -> list[str]:
    """Sorted names of the bundled scenes; each is accepted wherever a scene is."""
    return sorted(path.stem for path in SCENE_DIR.glob("*.toml"))


def scene_descriptions() -> dict[str, str]:
    """Description of each bundled scene by name, read from its file without building the scene."""
    files = {name: SCENE_DIR / f"{name}.toml" for name in scene_names()}
    return {name: str(tomllib.loads(file.read_text(encoding="utf-8"))["description"]) for name, file in files.items()}


def load_scene(name_or_path: str | Path) -> Scene:
    """Load a bundled scene or a TOML file; InputError lists all problems of the scene."""
    path = bundled_or_file(name_or_path, SCENE_DIR, "scene")
    scene = parse_toml(Scene, path).model_copy(update={"folder": path.parent.resolve()})
    check(scene, str(path))
    return scene
