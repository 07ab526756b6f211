"""A Mitsuba XML scene in camera axes and metres, with our camera in place of its sensor.

Mitsuba's own parser reads the file, and the parsed nodes are edited before the scene is instantiated. Parameters,
includes, ``<path>`` elements and relative file names therefore have the same meaning as in Mitsuba.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dasim.base.errors import InputError
from dasim.render.foreign import reading
from dasim.render.foreign.colours import replace_surface_colours
from dasim.render.foreign.lights import replace_light_colours
from dasim.render.foreign.notes import Notes
from dasim.render.mesh_parameters import corners
from dasim.render.plugin import transform
from dasim.scene.clearance import LARGEST_M, SMALLEST_M
from dasim.scene.meshes import distance_from_origin
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.typing import FloatArray

MOST_COPIES = 5000  # most shapes of all instances: each is copied
_CLASSES = {"rectangle": "sheet", "disk": "sheet", "cube": "box", "sphere": "sphere", "cylinder": "cylinder"}
RIGID = 1e-3  # largest cosine between two axes of a sensor


class World(NamedTuple):
    """Mitsuba's scene, with notes on what was changed and the names of its objects and materials."""

    scene: Any
    notes: list[str]
    objects: list[str]  # names; entry 0 is number 1 of ``object_id``
    materials: list[str]  # names of BSDFs in the order of their first use
    material_number: np.ndarray  # by ``object_id``, from 1; 0 for no object
    classes: list[str]  # of the objects, in their order


def load(scene: MitsubaScene, fov_deg: float) -> World:
    """Mitsuba's scene of an XML file, in camera axes and metres and with spectral surfaces and lights.

    Args:
        scene: the file, its parameters, the unit of length, the illuminant and the near-infrared rule.
        fov_deg: horizontal field of view of our camera, for the notes.

    Raises InputError where Mitsuba cannot load the file, or it has no sensor, shapes or lights.
    """
    with reading.search_folders(scene.file):
        return _load(scene, fov_deg)


def _load(scene: MitsubaScene, fov_deg: float) -> World:
    """``load`` within :func:`reading.search_folders`."""
    notes = Notes()
    config, state = reading.parse(scene)
    nodes = state.nodes
    nodes[0].props["embree_use_robust_intersections"] = True  # keeps rays from slipping between triangles
    to_camera = _drop_sensor(nodes, scene, fov_deg, notes)
    _drop_media(nodes, notes)
    objects = _place_shapes(nodes, to_camera, scene)
    materials, numbers = _materials(nodes, [members for _, members in objects])
    _place_lights(nodes, to_camera, notes)
    replace_light_colours(nodes, scene, to_camera, notes)
    replace_surface_colours(nodes, scene, notes)
    for place, (_, members) in enumerate(objects):
        for member in members:
            nodes[member].props.set_id(f"object_{place:04d}")
    world = reading.instance(config, state, scene)
    if not world.emitters():
        raise InputError(f"{scene.file}: has no lights that are supported; the picture would be black")
    classes = [_CLASSES.get(nodes[members[0]].props.plugin_name(), "solid") for _, members in objects]
    return World(world, notes.lines(), [name for name, _ in objects], materials, numbers, classes)


def _children(nodes: Any) -> dict[str, int]:
    """Indices of the scene's child nodes, by key."""
    return _references(nodes[0].props)


def _references(props: Any) -> dict[str, int]:
    """Indices of the nodes that a node refers to, by key."""
    import mitsuba as mi

    kind = mi.Properties.Type.ResolvedReference
    return {key: props[key].index() for key in list(props.keys()) if props.type(key) == kind}


# --- the sensor ----------------------------------------------------------------------------------


def _drop_sensor(nodes: Any, scene: MitsubaScene, fov_deg: float, notes: Notes) -> FloatArray:
    """Remove sensors and integrators from the scene.

    Returns the transform [4, 4] from the scene's axes and units to the axes of its first sensor and metres.
    """
    import mitsuba as mi

    root, sensors = nodes[0].props, []
    for key, index in _children(nodes).items():
        if nodes[index].type == mi.ObjectType.Sensor:
            sensors.append(nodes[index].props)
        if nodes[index].type in (mi.ObjectType.Sensor, mi.ObjectType.Integrator):
            del root[key]
    if not sensors:
        raise InputError(f"{scene.file}: has no sensor, whose to_world gives the camera's pose")
    if len(sensors) > 1:
        notes.add(f"{len(sensors)} sensors: the first one's pose is used")
    props = sensors[0]
    pose = np.array(props["to_world"].matrix, dtype=np.float64) if "to_world" in props else np.eye(4)
    axes = pose[:3, :3] / np.maximum(np.linalg.norm(pose[:3, :3], axis=0), 1e-30)
    if not np.allclose(axes.T @ axes, np.eye(3), atol=RIGID) or np.linalg.det(axes) < 0:
        raise InputError(f"{scene.file}: the sensor's to_world is sheared or mirrored, which no camera can be")
    original = f" of {props['fov']:g} degrees" if "fov" in props else ""
    notes.add(
        f"sensor '{props.plugin_name()}'{original}, film, sampler and integrator: replaced; ours sees "
        f"{fov_deg:.1f} degrees across"
    )
    # Mitsuba's camera looks along z with x left and y up; ours has x right and y down.
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag([-1.0, -1.0, 1.0]) @ axes.T
    matrix[:3, 3] = -matrix[:3, :3] @ pose[:3, 3]
    metre = scene.unit_cm * 1e-2
    return np.diag([metre, metre, metre, 1.0]) @ matrix


# --- shapes and media ----------------------------------------------------------------------------


def _drop_media(nodes: Any, notes: Notes) -> None:
    """Remove all references to media and volumes."""
    import mitsuba as mi

    kinds = (mi.ObjectType.Medium, mi.ObjectType.Volume)
    for node in nodes:
        if node.type in kinds:
            continue
        for key, index in _references(node.props).items():
            if nodes[index].type in kinds:
                del node.props[key]
                notes.add("participating media: not supported, removed")


def _place_shapes(nodes: Any, to_camera: FloatArray, scene: MitsubaScene) -> list[tuple[str, list[int]]]:
    """Transform the shapes to camera axes, and replace instances by copies of the shapes of their group.

    Copies are needed because Mitsuba does not number the shapes of an instance. Returns the name and the indices of the
    nodes of each object, in the order of the file.
    """
    import mitsuba as mi

    # Appending a copy moves all nodes in memory: no reference to a node may be used after it.
    objects: list[tuple[str, list[int]]] = []
    copies: list[int] = []
    for key, index in _children(nodes).items():
        if nodes[index].type != mi.ObjectType.Shape:
            continue
        plugin = nodes[index].props.plugin_name()
        name = nodes[index].props.id() or f"{plugin}-{len(objects) + 1}"
        if plugin in ("shapegroup", "instance"):
            del nodes[0].props[key]
        if plugin == "shapegroup":
            continue
        if not np.isfinite(_to_world(nodes[index].props)).all():
            raise InputError(f"{scene.file}: object '{name}': its to_world has values that are not finite")
        if plugin != "instance":
            _move(nodes[index].props, to_camera)
            objects.append((name, [index]))
            continue
        own = to_camera @ _to_world(nodes[index].props)
        members = []
        for part in _group_members(nodes, index, f"{scene.file}: instance '{name}'"):
            if len(copies) == MOST_COPIES:
                raise InputError(f"{scene.file}: has instances of more than {MOST_COPIES} shapes in total; use fewer")
            members.append(_append_copy(nodes, part, own))
            copies.append(members[-1])
            nodes[0].props[f"copy_{len(copies)}"] = mi.Properties.ResolvedReference(members[-1])
        objects.append((name, members))
    if not objects:
        raise InputError(f"{scene.file}: has no shapes")
    return objects


def _group_members(nodes: Any, instance: int, where: str) -> list[int]:
    """Indices of the shapes of an instance's group."""
    import mitsuba as mi

    groups = [i for i in _references(nodes[instance].props).values() if nodes[i].props.plugin_name() == "shapegroup"]
    if not groups:
        raise InputError(f"{where}: refers to no shapegroup")
    return [i for i in _references(nodes[groups[0]].props).values() if nodes[i].type == mi.ObjectType.Shape]


def _append_copy(nodes: Any, index: int, matrix: FloatArray) -> int:
    """Append a copy of a shape, transformed by ``matrix``, to the nodes; returns its index."""
    import mitsuba as mi

    copy = mi.parser.SceneNode()
    copy.type = nodes[index].type
    copy.props = mi.Properties(nodes[index].props)
    copy.file_index, copy.offset = nodes[index].file_index, nodes[index].offset
    _move(copy.props, matrix)
    nodes.append(copy)
    return len(nodes) - 1


def _to_world(props: Any) -> FloatArray:
    return np.array(props["to_world"].matrix, dtype=np.float64) if "to_world" in props else np.eye(4)


def _move(props: Any, matrix: FloatArray) -> None:
    props["to_world"] = transform(matrix @ _to_world(props))


def _place_lights(nodes: Any, to_camera: FloatArray, notes: Notes) -> None:
    """Transform the lights that are not shapes to camera axes, and remove projectors."""
    import mitsuba as mi

    turn = to_camera[:3, :3] / np.cbrt(np.linalg.det(to_camera[:3, :3]))
    root = nodes[0].props
    for key, index in _children(nodes).items():
        if nodes[index].type != mi.ObjectType.Emitter:
            continue
        props = nodes[index].props
        plugin = props.plugin_name()
        if plugin == "projector":
            del root[key]
            notes.add("emitter 'projector': not supported, removed")
        elif "position" in props:
            place = to_camera @ [*np.ravel(props["position"]), 1.0]
            props["position"] = [float(value) for value in place[:3]]
        elif "direction" in props:
            props["direction"] = [float(value) for value in turn @ np.ravel(props["direction"])]
        elif plugin in ("point", "spot", "directional"):
            own = _to_world(props)
            pose = np.eye(4)
            pose[:3, :3] = turn @ own[:3, :3]
            pose[:3, 3] = (to_camera @ own)[:3, 3]
            props["to_world"] = transform(pose)


def _materials(nodes: Any, objects: list[list[int]]) -> tuple[list[str], np.ndarray]:
    """Names of BSDFs in the order of their first use, and the number of each object's BSDF, from 1.

    An object of several shapes (an instance) has the BSDF of its first shape.
    """
    import mitsuba as mi

    names: dict[int, str] = {}
    numbers = [0]
    for members in objects:
        references = _references(nodes[members[0]].props).values()
        bsdf = next((i for i in references if nodes[i].type == mi.ObjectType.BSDF), -1)
        if bsdf not in names:
            plugin = nodes[bsdf].props.plugin_name() if bsdf >= 0 else "diffuse"
            own = nodes[bsdf].props.id() if bsdf >= 0 else "default"
            names[bsdf] = own or f"{plugin}-{len(names) + 1}"
        numbers.append(list(names).index(bsdf) + 1)
    return list(names.values()), np.array(numbers, np.uint32)


def check_clear(world: World, scene: MitsubaScene, pupil_radius_m: float) -> None:
    """InputError where a mesh reaches into the lens, or a shape to infinity; a note where a size suggests a mistake of
    units.

    ``pupil_radius_m`` is the radius of the lens at the origin.
    """
    for shape in world.scene.shapes():
        box = shape.bbox()
        low, high = np.ravel(box.min), np.ravel(box.max)
        is_empty, is_object = bool((low > high).any()), shape.id().startswith("object_")
        if is_object and not is_empty and not np.isfinite([low, high]).all():
            name = world.objects[int(shape.id().removeprefix("object_"))]
            raise InputError(f"{scene.file}: object '{name}' reaches to infinity; give a finite place and size")
        size_m = 0.0 if is_empty else float((high - low).max())
        if is_object and not SMALLEST_M <= size_m <= LARGEST_M:
            name = world.objects[int(shape.id().removeprefix("object_"))]
            world.notes.append(f"object '{name}' is {size_m:.3g} m large; wrong unit? unit_cm is {scene.unit_cm:g}")
        if not shape.is_mesh() or (low > pupil_radius_m).any() or (high < -pupil_radius_m).any():
            continue
        if distance_from_origin(corners(shape)) <= pupil_radius_m:
            name = world.objects[int(shape.id().removeprefix("object_"))]
            raise InputError(
                f"{scene.file}: object '{name}' reaches into the lens, {2e3 * pupil_radius_m:.2g} mm wide; "
                f"wrong unit? unit_cm is {scene.unit_cm:g}"
            )
