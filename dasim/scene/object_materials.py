"""Materials of a scene's objects: their names, surfaces and classes, and the colours of meshes without one.

Tested in tests/dasim/scene/test_shapes.py and tests/dasim/scene/test_classes.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dasim.materials.library import Surface, surface
from dasim.materials.photographs import photograph_surface
from dasim.materials.surfaces import Diffuse, Finished, Mixture
from dasim.scene import mesh_merging, meshes
from dasim.scene.classes import class_of
from dasim.scene.shapes import Mesh, Object, mesh_parts, mesh_place
from dasim.scene.specification import Scene


def material_of(item: Object) -> str:
    """Name of an object's material; a mesh with its file's colours counts as a material ``colours of NAME``."""
    return item.material or f"colours of {item.name}"


def surface_of(item: Object, scene: Scene) -> Surface:
    """Surface of an object: that of its material, or its mesh's own colours extended by its near-infrared rule."""
    if item.material is not None:
        return surface(scene.materials.get(item.material, item.material), scene.folder)
    assert isinstance(item, Mesh) and item.near_infrared is not None  # checked when the scene is loaded
    part = triangles(item, scene.folder)
    assert part.paint is not None
    base = photograph_surface(part.paint, item.near_infrared)
    if part.finish is None:
        return base
    assert isinstance(base, Diffuse | Mixture)  # as the rules give it
    metallic, roughness = (np.ascontiguousarray(part.finish[..., channel]) for channel in (0, 1))
    normal = np.ascontiguousarray(part.finish[..., 2:])
    return Finished(base, metallic, roughness, normal if np.any(normal != (0.5, 0.5, 1.0)) else None)


def triangles(item: Mesh, folder: Path) -> meshes.Part:
    """Triangles of a mesh object; without a material they carry a picture of its colours and the matching ``uv``."""
    parts = mesh_parts(item, folder)
    if item.material is not None:
        return mesh_merging.merge(parts)
    return mesh_merging.merge_with_colours(parts, mesh_place(item, folder))


def material_names_of(scene: Scene) -> list[str]:
    """Names of the materials of a scene's objects in order of first use; material number 1 is the first."""
    return list(dict.fromkeys(material_of(item) for item in scene.objects))


def material_number_of_object(scene: Scene) -> NDArray[np.uint32]:
    """Material number by ``object_id``, [1 + objects]: from 1 in the order of ``material_names_of``; 0 is no object."""
    names = material_names_of(scene)
    return np.array([0, *(names.index(material_of(item)) + 1 for item in scene.objects)], np.uint32)


def class_names_of(scene: Scene) -> list[str]:
    """Class of each of a scene's objects, in their order."""
    return [class_of(item, scene.materials) for item in scene.objects]


def colour_notes(scene: Scene) -> list[str]:
    """One line per mesh with RGB colours of its own: the kinds of colours, the finish and the near-infrared rule."""
    return [_colour_note(item, scene) for item in scene.objects if isinstance(item, Mesh) and item.material is None]


def _colour_note(item: Mesh, scene: Scene) -> str:
    parts = mesh_parts(item, scene.folder)
    metallic = [float(part.finish[..., 0].mean()) for part in parts if part.finish is not None]
    finish = f"a finish of the file (metallic {np.mean(metallic):.2g})" if metallic else "a matt material"
    return (
        f"object '{item.name}': RGB of {item.file} ({', '.join(mesh_merging.colour_kinds(parts))}) rendered as "
        f"{finish} by the near-infrared rule '{item.near_infrared}'"
    )
