"""Classes of objects, which mean the same in every scene and every sample.

Tested in tests/dasim/scene/test_classes.py.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dasim.materials.library import Coating, Print, Texture
from dasim.scene.procedural import mannequin, plants
from dasim.scene.procedural.library import PREFIX

if TYPE_CHECKING:
    from dasim.scene.shapes import Object

ClassName = Literal[
    "wall",
    "floor",
    "print",
    "chart",
    "sheet",
    "box",
    "sphere",
    "cylinder",
    "relief",
    "solid",
    "vessel",
    "plant",
    "figure",
    "fence",
    "furniture",
]
# Number 1 is the first; 0 is no object. New classes are added at the end: numbers in files keep their meaning.
CLASSES: tuple[ClassName, ...] = get_args(ClassName)

_OF_SHAPE: dict[str, ClassName] = {
    "plane": "sheet",
    "disc": "sheet",
    "box": "box",
    "sphere": "sphere",
    "cylinder": "cylinder",
    "heightfield": "relief",
    "mesh": "solid",
}
_OF_PROCEDURAL: dict[str, ClassName] = {
    "vase": "vessel",
    "chain-link": "fence",
    **dict.fromkeys(plants.MESHES, "plant"),
    **dict.fromkeys(mannequin.MESHES, "figure"),
}


def class_of(item: Object, materials: Mapping[str, Texture]) -> ClassName:
    """Class of an object: its key ``class``, or else the one that its shape implies.

    A plane or disc is a ``print`` if its material is a printed photograph, coated or not, else a ``sheet``. Procedural
    meshes have the class of what they show; other meshes are a ``solid``.

    Args:
        item: the object
        materials: the materials of its scene by name
    """
    if item.class_name is not None:
        return item.class_name
    texture = materials.get(item.material or "")
    if item.shape in ("plane", "disc") and isinstance(texture.base if isinstance(texture, Coating) else texture, Print):
        return "print"
    if item.shape == "mesh" and item.file.startswith(PREFIX):
        return _OF_PROCEDURAL.get(item.file.removeprefix(PREFIX).partition(":")[0], "solid")
    return _OF_SHAPE[item.shape]


def class_numbers(names: Iterable[str]) -> NDArray[np.uint32]:
    """Class number by ``object_id``, [1 + objects], from the class of each object in order; 0 is no object."""
    return np.array([0, *(CLASSES.index(name) + 1 for name in names)], np.uint32)
