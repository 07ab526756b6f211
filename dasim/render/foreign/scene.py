"""A Mitsuba XML scene in camera axes and metres, with its sensor replaced by the camera at the same pose.

Mitsuba's own parser reads the file, and its result is edited before the scene is instantiated, so that parameters,
includes and relative file names have the meaning that they have in Mitsuba.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from dasim.base.errors import InputError
from dasim.render.foreign.colours import Notes, replace_light_colours, replace_surface_colours
from dasim.render.mesh_parameters import corners
from dasim.render.plugin import transform
from dasim.scene.clearance import LARGEST_M, SMALLEST_M
from dasim.scene.meshes import distance_from_origin
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.typing import FloatArray

MOST_COPIES = 5000  # of an instance's shapes: each is a shape of its own here
RIGID = 1e-3  # how far a sensor's axes may be from a right angle


class World(NamedTuple):
    """A scene in Mitsuba, with its notes and the names of its objects and materials."""

    scene: Any
    notes: list[str]
    objects: list[str]  # names, from number 1 of ``object_id``
    materials: list[str]  # names of scattering functions in order of first use
    material_number: np.ndarray  # by ``object_id``; 0 is nothing


def load(scene: MitsubaScene, fov_deg: float) -> World:
    """Read, edit and make the scene; ``fov_deg`` is our horizontal field of view. InputError where it is broken."""
    import mitsuba as mi

    config = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False  # merged shapes would lose their names
    notes = Notes()
    before, resolver = mi.file_resolver(), mi.FileResolver(mi.file_resolver())
    resolver.prepend(str(scene.file.parent))
    mi.set_file_resolver(resolver)  # files of spectra are read while parsing
    try:
        state = mi.parser.parse_file(config, str(scene.file))
        mi.parser.transform_all(config, state)
    except Exception as error:
        raise _broken(scene, error) from None
    finally:
        mi.set_file_resolver(before)
    nodes = state.nodes
    nodes[0].props["embree_use_robust_intersections"] = True  # no rays between the triangles of a mesh
    to_camera = _drop_sensor(nodes, scene, fov_deg, notes)
    _drop_media(nodes, notes)
    _find_files(nodes, scene)
    objects = _place_shapes(nodes, to_camera, scene)
    materials, numbers = _materials(nodes, [members for _, members in objects])
    _place_lights(nodes, to_camera, notes)
    replace_light_colours(nodes, scene, to_camera, notes)
    replace_surface_colours(nodes, scene, notes)
    for place, (_, members) in enumerate(objects):
        for member in members:
            nodes[member].props.set_id(f"object_{place:04d}")
    world = _made(config, state, scene)
    if not world.emitters():
        raise InputError(f"{scene.file}: has no lights that can be honoured; nothing would be seen")
    return World(world, notes.lines(), [name for name, _ in objects], materials, numbers)


def _made(config: Any, state: Any, scene: MitsubaScene) -> Any:
    """Mitsuba's scene of a parser's nodes."""
    import mitsuba as mi

    try:
        made = mi.parser.instantiate(config, state)
    except Exception as error:
        broken = _broken(scene, error)
        # What was made so far must go: a light that outlives its shape is called by the next scene's kernels, and
        # a traceback that is kept would keep it.
        state.nodes.clear()
        error.__traceback__ = None
        raise broken from None
    return made[0] if isinstance(made, list) else made


def _broken(scene: MitsubaScene, error: Exception) -> InputError:
    """Mitsuba's complaint in one line, without the place in its own source."""
    text = " ".join(str(error).split())
    return InputError(f"{scene.file}: does not load in Mitsuba ({text.partition('] ')[2] or text})")


def _children(nodes: Any) -> dict[str, int]:
    """Nodes right below the scene, by the scene's key."""
    return _references(nodes[0].props)


def _references(props: Any) -> dict[str, int]:
    """Places of the nodes that a node refers to, by key."""
    import mitsuba as mi

    kind = mi.Properties.Type.ResolvedReference
    return {key: props[key].index() for key in list(props.keys()) if props.type(key) == kind}


# --- the sensor ----------------------------------------------------------------------------------


def _drop_sensor(nodes: Any, scene: MitsubaScene, fov_deg: float, notes: Notes) -> FloatArray:
    """Take sensors and integrators out; the transform of the scene's units into camera axes and metres, [4, 4]."""
    import mitsuba as mi

    root, found = nodes[0].props, []
    for key, index in _children(nodes).items():
        if nodes[index].type == mi.ObjectType.Sensor:
            found.append(nodes[index].props)
        if nodes[index].type in (mi.ObjectType.Sensor, mi.ObjectType.Integrator):
            del root[key]
    if not found:
        raise InputError(f"{scene.file}: has no sensor, so that nothing says where to photograph from")
    if len(found) > 1:
        notes.add(f"{len(found)} sensors: the first one's pose is used")
    props = found[0]
    pose = np.array(props["to_world"].matrix, dtype=np.float64) if "to_world" in props else np.eye(4)
    axes = pose[:3, :3] / np.maximum(np.linalg.norm(pose[:3, :3], axis=0), 1e-30)
    if not np.allclose(axes.T @ axes, np.eye(3), atol=RIGID) or np.linalg.det(axes) < 0:
        raise InputError(f"{scene.file}: the sensor's to_world is sheared or mirrored, which no camera can be")
    theirs = f" of {props['fov']:g} degrees" if "fov" in props else ""
    notes.add(
        f"sensor '{props.plugin_name()}'{theirs}, film, sampler and integrator: replaced; ours sees "
        f"{fov_deg:.1f} degrees across"
    )
    # Mitsuba's camera looks along z with x left and y up; ours has x right and y down.
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag([-1.0, -1.0, 1.0]) @ axes.T
    matrix[:3, 3] = -matrix[:3, :3] @ pose[:3, 3]
    metre = scene.unit_cm * 1e-2
    return np.diag([metre, metre, metre, 1.0]) @ matrix


# --- what is in the scene ------------------------------------------------------------------------


def _drop_media(nodes: Any, notes: Notes) -> None:
    """Take media and volumes out, wherever they are."""
    import mitsuba as mi

    gone = (mi.ObjectType.Medium, mi.ObjectType.Volume)
    for node in nodes:
        if node.type in gone:
            continue
        for key, index in _references(node.props).items():
            if nodes[index].type in gone:
                del node.props[key]
                notes.add("participating media: not honoured, light passes through empty space")


def _find_files(nodes: Any, scene: MitsubaScene) -> None:
    """Make relative file names absolute: the file resolver of Mitsuba looks where the program was started."""
    import mitsuba as mi

    for node in nodes:
        for key in ("filename", "file"):
            if key in node.props and node.props.type(key) == mi.Properties.Type.String:
                path = scene.file.parent / node.props[key]
                if path.is_file():
                    node.props[key] = str(path)


def _place_shapes(nodes: Any, to_camera: FloatArray, scene: MitsubaScene) -> list[tuple[str, list[int]]]:
    """Move the shapes into camera axes; their names, and the nodes of each, in the file's order.

    Instances become copies of their group's shapes: Mitsuba gives no number to what an instance shows.
    """
    import mitsuba as mi

    # Copies move the nodes in memory: none is held beyond the next copy.
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
        if plugin != "instance":
            _move(nodes[index].props, to_camera)
            objects.append((name, [index]))
            continue
        own = to_camera @ _to_world(nodes[index].props)
        members = []
        for part in _group_members(nodes, index, f"{scene.file}: instance '{name}'"):
            if len(copies) == MOST_COPIES:
                raise InputError(f"{scene.file}: instances of more than {MOST_COPIES} shapes; reduce them")
            members.append(_copied(nodes, part, own))
            copies.append(members[-1])
            nodes[0].props[f"copy_{len(copies)}"] = mi.Properties.ResolvedReference(members[-1])
        objects.append((name, members))
    if not objects:
        raise InputError(f"{scene.file}: has no shapes")
    return objects


def _group_members(nodes: Any, instance: int, where: str) -> list[int]:
    """Places of the shapes of an instance's group."""
    import mitsuba as mi

    groups = [i for i in _references(nodes[instance].props).values() if nodes[i].props.plugin_name() == "shapegroup"]
    if not groups:
        raise InputError(f"{where}: refers to no shapegroup")
    return [i for i in _references(nodes[groups[0]].props).values() if nodes[i].type == mi.ObjectType.Shape]


def _copied(nodes: Any, index: int, matrix: FloatArray) -> int:
    """A copy of a shape, moved by ``matrix``; its place among the nodes."""
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
    """Move the lights that are no shapes into camera axes."""
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
            notes.add("emitter 'projector': not honoured")
        elif "position" in props:
            place = to_camera @ [*np.ravel(props["position"]), 1.0]
            props["position"] = [float(value) for value in place[:3]]
        elif "direction" in props:
            props["direction"] = [float(value) for value in turn @ np.ravel(props["direction"])]
        elif plugin in ("point", "spot", "directional"):
            own = _to_world(props)
            moved = np.eye(4)
            moved[:3, :3] = turn @ own[:3, :3]
            moved[:3, 3] = (to_camera @ own)[:3, 3]
            props["to_world"] = transform(moved)


def _materials(nodes: Any, objects: list[list[int]]) -> tuple[list[str], np.ndarray]:
    """Names of scattering functions in order of first use, and each object's number among them, from 1.

    An object of several shapes, an instance, has that of its first.
    """
    import mitsuba as mi

    names: dict[int, str] = {}
    numbers = [0]
    for members in objects:
        references = _references(nodes[members[0]].props).values()
        found = next((i for i in references if nodes[i].type == mi.ObjectType.BSDF), -1)
        if found not in names:
            plugin = nodes[found].props.plugin_name() if found >= 0 else "diffuse"
            own = nodes[found].props.id() if found >= 0 else "default"
            names[found] = own or f"{plugin}-{len(names) + 1}"
        numbers.append(list(names).index(found) + 1)
    return list(names.values()), np.array(numbers, np.uint32)


def check_clear(world: World, scene: MitsubaScene, pupil_radius_m: float) -> None:
    """InputError where a mesh of the scene reaches into the lens; a note where a size suggests a mistake of units."""
    for shape in world.scene.shapes():
        box = shape.bbox()
        low, high = np.ravel(box.min), np.ravel(box.max)
        size_m = float((high - low).max())
        if not SMALLEST_M <= size_m <= LARGEST_M and shape.id().startswith("object_"):
            name = world.objects[int(shape.id().removeprefix("object_"))]
            world.notes.append(
                f"object '{name}' is {size_m:.3g} m large; a mistake of units? unit_cm is {scene.unit_cm:g}"
            )
        if not shape.is_mesh() or (low > pupil_radius_m).any() or (high < -pupil_radius_m).any():
            continue
        if distance_from_origin(corners(shape)) <= pupil_radius_m:
            name = world.objects[int(shape.id().removeprefix("object_"))]
            raise InputError(
                f"{scene.file}: object '{name}' reaches into the lens, {2e3 * pupil_radius_m:.2g} mm wide; "
                f"a mistake of units? unit_cm is {scene.unit_cm:g}"
            )
