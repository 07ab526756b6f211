"""Families of test targets: one scene per blur level, or per depth and step.

A bundled TOML file is the template of a family. Its target is moved along the optical axis and scaled in proportion to
its distance from the lens, so that every point keeps its position in the picture and only the blur changes. A name such
as ``staircase:14`` denotes a member of a family wherever the name of a scene is accepted.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from dasim.base.errors import InputError
from dasim.camera.geometry import depth_of_blur_m, level_blur_px
from dasim.camera.specification import Camera, as_camera, load_camera
from dasim.materials import photographs
from dasim.scene import loading, specification
from dasim.scene.lights import Dome, Lamp, Light
from dasim.scene.shapes import Object, Plane
from dasim.scene.specification import Scene

DEFAULT_CAMERA = "da-mobile"
DEPTH_RANGE_CM = (1.0, 10_000.0)  # allowed depths of depth-steps and at_distance


def staircase(camera: Camera | str | Path, level: int, texture: str | None = None) -> Scene:
    """The board of ``scenes/staircase.toml`` at a blur level of a camera (Fig. 10 of the paper).

    Args:
        camera: a Camera, a bundled name or a path. Its own focus applies; ``dasim.focused(camera, "staircase")`` sets
            the focus that the scene proposes
        level: blur level, from 0 (in focus) to 28, or to the last of the camera's own levels
        texture: another image: ``pattern:NAME``, or the name of a photograph of scikit-image such as ``brick``
    """
    template = loading.load_scene("staircase")
    return _with_texture(_at_level(template, as_camera(camera), level), texture)


def point_source(camera: Camera | str | Path, level: int) -> Scene:
    """The backlit hole in black cloth of ``scenes/point.toml`` at a blur level of a camera (sec. 5.1 of the paper).

    ``camera`` and ``level`` are those of :func:`staircase`.
    """
    return _at_level(loading.load_scene("point"), as_camera(camera), level)


def depth_steps(depth_cm: float, step_cm: float, texture: str | None = None) -> Scene:
    """The two halves of ``scenes/depth-steps.toml``: the left one at ``depth_cm``, the right one ``step_cm`` farther.

    Both depths must lie between 1 and 10,000 cm; ``texture`` is that of :func:`staircase`.
    """
    low, high = DEPTH_RANGE_CM
    if not (low <= depth_cm and step_cm > 0 and depth_cm + step_cm <= high):  # written so that NaN is refused
        raise InputError(
            f"scene 'depth-steps': depth {depth_cm:g} cm and step {step_cm:g} cm; a depth from {low:g} cm and a step "
            f"above 0 are allowed, their sum up to {high:g} cm"
        )
    template = loading.load_scene("depth-steps")
    depths = {"near": depth_cm, "far": depth_cm + step_cm}
    halves = tuple(_scale_plane(item, depths[item.name] / item.position_cm[2]) for item in template.objects)
    name = f"depth-steps:{depth_cm:g}:{step_cm:g}"
    return _with_texture(template.model_copy(update={"name": name, "objects": halves}), texture)


def at_distance(template: Scene, depth_cm: float, scale: float = 1.0) -> Scene:
    """Move a scene of planes so that its nearest plane is at ``depth_cm``, scaled in proportion: only blur changes.

    Args:
        template: a scene of planes, domes and lamps
        depth_cm: distance of the nearest plane, 1 to 10,000 cm
        scale: additional factor on widths, heights and offsets, for a camera with another field of view
    """
    low, high = DEPTH_RANGE_CM
    if not low <= depth_cm <= high:  # written so that NaN is refused
        raise InputError(f"distance {depth_cm:g} cm: must be between {low:g} and {high:g} cm")
    lights = all(isinstance(light, Dome | Lamp) for light in template.lights)
    if not (lights and all(isinstance(item, Plane) for item in template.objects)):
        raise InputError(f"scene '{template.name}': only scenes of planes, such as staircase, can be set at a distance")
    factor = depth_cm / min(item.position_cm[2] for item in template.objects)
    changes: dict[str, Any] = {
        "name": f"{template.name} at {depth_cm:g} cm",
        "objects": tuple(_scale_plane(item, factor, scale) for item in template.objects),
        "lights": tuple(_scale_light(light, factor) for light in template.lights),
    }
    return template.model_copy(update=changes)


# --- by name -------------------------------------------------------------------------------------


def is_target(name: str | Path) -> bool:
    """Whether a name denotes a member of a family, such as ``staircase:14``."""
    family, colon, _ = str(name).partition(":")
    return bool(colon) and family in _FAMILIES


def target(name: str | Path, camera: Camera | None = None) -> Scene:
    """The scene ``staircase:LEVEL[:IMAGE]``, ``point:LEVEL`` or ``depth-steps:DEPTH:STEP[:IMAGE]``, depths in cm.

    Levels are those of ``camera`` (default: da-mobile) at the focus that the family proposes.
    """
    family, _, rest = str(name).partition(":")
    form, make = _FAMILIES[family]
    try:
        return make(camera or load_camera(DEFAULT_CAMERA), rest)
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"scene '{name}': has the form {form}; words in capitals stand for numbers") from None


def _parse_staircase(camera: Camera, text: str) -> Scene:
    level, _, texture = text.partition(":")
    return staircase(specification.focused(camera, loading.load_scene("staircase")), int(level), texture or None)


def _parse_point(camera: Camera, text: str) -> Scene:
    return point_source(specification.focused(camera, loading.load_scene("point")), int(text))


def _parse_depth_steps(camera: Camera, text: str) -> Scene:
    depth, step, *texture = text.split(":", 2)
    return depth_steps(float(depth), float(step), texture[0] if texture else None)


_FAMILIES: dict[str, tuple[str, Callable[[Camera, str], Scene]]] = {
    "staircase": ("staircase:LEVEL or staircase:LEVEL:image", _parse_staircase),
    "point": ("point:LEVEL", _parse_point),
    "depth-steps": ("depth-steps:DEPTH:STEP or depth-steps:DEPTH:STEP:image, in cm", _parse_depth_steps),
}


# --- templates -----------------------------------------------------------------------------------


def _at_level(template: Scene, camera: Camera, level: int) -> Scene:
    """Move and scale a template so that its nearest object or lamp has the depth of a blur level."""
    blurs = level_blur_px(camera)
    if not 0 <= level < len(blurs):
        raise InputError(f"scene '{template.name}': level {level} is not one of 0 to {len(blurs) - 1}")
    depth_cm = float(depth_of_blur_m(camera, blurs[level])) * 1e2
    depths_cm = [item.position_cm[2] for item in template.objects]
    depths_cm += [light.position_cm[2] for light in template.lights if isinstance(light, Lamp)]
    factor = depth_cm / min(depths_cm)
    changes: dict[str, Any] = {
        "name": f"{template.name}:{level}",
        "objects": tuple(_scale_plane(item, factor) for item in template.objects),
        "lights": tuple(_scale_light(light, factor) for light in template.lights),
    }
    return template.model_copy(update=changes)


def _scale_plane(item: Object, factor: float, scale: float = 1.0) -> Object:
    """Multiply all lengths of a plane by ``factor``, which leaves its projection through the lens centre unchanged.

    Its width, height and offset from the axis are also multiplied by ``scale``.
    """
    assert isinstance(item, Plane), "the templates are flat"
    x, y, z = item.position_cm
    width, height = item.size_cm
    across = factor * scale
    changes = {"position_cm": (x * across, y * across, z * factor), "size_cm": (width * across, height * across)}
    return item.model_copy(update=changes)


def _scale_light(light: Light, factor: float) -> Light:
    """Multiply all lengths of a light by ``factor``; the illuminance at its target is unchanged."""
    if isinstance(light, Dome):
        return light
    assert isinstance(light, Lamp), "the templates have domes and lamps"
    places = {
        "position_cm": tuple(value * factor for value in light.position_cm),
        "target_cm": tuple(value * factor for value in light.target_cm),
        "radius_cm": light.radius_cm * factor,
    }
    return light.model_copy(update=places)


def _with_texture(template: Scene, texture: str | None) -> Scene:
    """The scene with another image on all materials that it defines."""
    if texture is None:
        return template
    image = texture if ":" in texture else f"skimage:{texture}"
    try:
        photographs.linear_rgb(image, template.folder)
    except InputError as error:
        raise InputError(f"scene '{template.name}': {error}") from None
    materials = {name: item.model_copy(update={"image": image}) for name, item in template.materials.items()}
    return template.model_copy(update={"name": f"{template.name}:{texture}", "materials": materials})
