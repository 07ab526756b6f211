"""Translation of a scene into Mitsuba's dictionary, in camera axes: x right, y down, z forward, metres.

The lens is at the origin, and the camera's pose is applied to the objects, so that depth is z. Spectra are those of the
scene (radiance in W m^-2 sr^-1 nm^-1, reflectance 0..1); Mitsuba's upsampling of RGB values is never used.

Tested in tests/dasim/render/test_lights.py and tests/dasim/render/test_passes.py.
"""

from __future__ import annotations

from typing import Any

from dasim.camera import geometry
from dasim.camera.specification import Camera
from dasim.render import backend, shared_kernels, truth
from dasim.render.emitters import emitters
from dasim.render.foreign import scene as foreign
from dasim.render.foreign.scene import World
from dasim.render.geometry import shape
from dasim.render.reflection import surface_bsdf
from dasim.scene import checks, object_materials
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene

MAX_PATH_DEPTH = 6  # segments from lens to light: four bounces after the first surface


def load(scene: Scene) -> Any:
    """Mitsuba's scene in the active variant."""
    import mitsuba as mi

    if not mi.variant().startswith("scalar"):
        shared_kernels.hold_for_many(scene.name)
    return mi.load_dict(scene_dict(scene), optimize=False)  # merging shapes would lose their numbers


def world(scene: Scene | MitsubaScene, camera: Camera) -> World:
    """Mitsuba's scene of a dasim or Mitsuba XML scene, with its notes and names, for a camera at the origin.

    Raises InputError if an object reaches into the lens.
    """
    pupil_radius_m = geometry.aperture_m(camera) / 2
    if isinstance(scene, MitsubaScene):
        with backend.reading_threads():
            result = foreign.load(scene, truth.field_of_view_deg(camera))
        foreign.check_clear(result, scene, pupil_radius_m)
        return result
    checks.check_clear(scene, pupil_radius_m)
    return World(
        load(scene),
        object_materials.colour_notes(scene),
        [item.name for item in scene.objects],
        object_materials.material_names_of(scene),
        object_materials.material_number_of_object(scene),
        object_materials.class_names_of(scene),
    )


def scene_dict(scene: Scene) -> dict[str, Any]:
    """Mitsuba's description of a scene: its integrator, then its objects in their order, then its lights."""
    # Otherwise rays slip between the triangles of a mesh, and the truth has the depth behind it.
    result: dict[str, Any] = {"type": "scene", "embree_use_robust_intersections": True}
    result["integrator"] = {"type": "path", "max_depth": MAX_PATH_DEPTH}
    surfaces: dict[tuple[str, bool], Any] = {}
    for index, item in enumerate(scene.objects):
        # On Mitsuba's sphere v = 0 is the upper pole; on all other shapes it is the bottom.
        key = (object_materials.material_of(item), item.shape == "sphere")
        if key not in surfaces:
            surfaces[key] = surface_bsdf(object_materials.surface_of(item, scene), flip=key[1])
        result[object_key(index)] = shape(item, scene, surfaces[key], object_key(index))
    return result | emitters(scene)


def object_key(index: int) -> str:
    """Name of the scene's object ``index`` (from 0) in Mitsuba's scene."""
    return f"object_{index:04d}"
