"""Spectra up to 830 nm in place of the RGB colours of a Mitsuba scene's surfaces, on the nodes of Mitsuba's parser.

Tested in tests/dasim/render/foreign/test_surfaces.py.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.materials.photographs import photograph_surface
from dasim.materials.surfaces import Diffuse, Mixture, Surface
from dasim.render import reflection
from dasim.render.foreign import conductors
from dasim.render.foreign.notes import Notes, check_values, note_range
from dasim.render.mixture import mixture_dict
from dasim.render.plugin import spectrum_dict
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.typing import FloatArray

# Parameters whose texture is a colour. All others (roughness, weights, opacity, bumps) are data and stay unchanged.
COLOURS = (
    "reflectance",
    "diffuse_reflectance",
    "specular_reflectance",
    "specular_transmittance",
    "diffuse_transmittance",
    "transmittance",
    "base_color",
)
TOO_BRIGHT = "reflectances above 1: clipped to 1"


def replace_surface_colours(nodes: Any, scene: MitsubaScene, notes: Notes) -> None:
    """Replace every RGB colour of the BSDFs and textures by a spectrum, and clip reflectances to 1.

    Colours continue into the near-infrared by the scene's ``near_infrared`` rule. ``nodes`` are edited in place.
    """
    import mitsuba as mi

    kinds = mi.Properties.Type
    for index, node in enumerate(nodes):
        props = node.props
        if node.type not in (mi.ObjectType.BSDF, mi.ObjectType.Texture):
            continue
        if props.plugin_name() in conductors.PLUGINS:
            conductors.continue_material(props, notes)
        for key in list(props.keys()):
            kind = props.type(key)
            what = f"{props.plugin_name()}.{key}"
            if kind == kinds.Color and props.plugin_name() not in ("d65",):
                check_values(list(props[key]), what, scene)
                props[key] = _colour(key, list(props[key]), scene, notes)
            elif kind == kinds.Spectrum:
                check_values(props[key].values, what, scene)
                if key in COLOURS:
                    props[key] = _clip_to_one(props[key], notes)
                if key in conductors.INDICES:
                    conductors.continue_index(props, key, notes)
                if props.type(key) == kinds.Spectrum:
                    note_range(props[key], what, notes)
            elif kind == kinds.Float and key in COLOURS:
                check_values([props[key]], what, scene)
                if props[key] > 1:
                    notes.add(TOO_BRIGHT)
                    props[key] = 1.0
            elif kind == kinds.ResolvedReference and node.type == mi.ObjectType.BSDF and key in COLOURS:
                _texture(nodes, index, key, scene, notes)


def _clip_to_one(spectrum: Any, notes: Notes) -> Any:
    """The scene's own reflectance spectrum, clipped to 1."""
    import mitsuba as mi

    if max(spectrum.values) <= 1:
        return spectrum
    notes.add(TOO_BRIGHT)
    values = np.minimum(spectrum.values, 1.0)
    if spectrum.is_uniform():
        return mi.load_dict({"type": "uniform", "value": float(values[0])})
    return mi.load_dict(
        {
            "type": "irregular",
            "wavelengths": ", ".join(f"{value:.9g}" for value in spectrum.wavelengths),
            "values": ", ".join(f"{value:.9g}" for value in values),
        }
    )


def _colour(key: str, rgb: list[float], scene: MitsubaScene, notes: Notes) -> Any:
    """Mitsuba's spectrum of a linear RGB colour, [3]; uniform at its mean where it is not a reflectance."""
    import mitsuba as mi

    if key in COLOURS and max(rgb) > 1:
        notes.add(TOO_BRIGHT)
        rgb = [min(value, 1.0) for value in rgb]
    if max(rgb) > 1 or key in ("eta", "k"):
        notes.add(f"RGB values of '{key}' above 1, or not a reflectance: replaced by their mean at all wavelengths")
        return mi.load_dict({"type": "uniform", "value": float(np.mean(rgb))})
    notes.add(f"RGB surface colours: spectra by the near-infrared rule '{scene.near_infrared}'")
    return mi.load_dict(spectrum_dict(spectrum_of(np.array(rgb, np.float32), scene.near_infrared)))


def spectrum_of(linear_rgb: Any, rule: str) -> FloatArray:
    """Reflectance spectrum [wavelength] of a linear RGB colour, [3], by a near-infrared rule."""
    return _mean(photograph_surface(np.asarray(linear_rgb, np.float32).reshape(1, 1, 3), rule))


def _mean(surface: Surface) -> FloatArray:
    """Spectrum [wavelength] of a surface with images of one texel."""
    if isinstance(surface, Mixture):
        share = float(surface.weight.mean())
        return (1 - share) * _mean(surface.first) + share * _mean(surface.second)
    assert isinstance(surface, Diffuse)
    return surface.reflectance


def _texture(nodes: Any, index: int, key: str, scene: MitsubaScene, notes: Notes) -> None:
    """Replace the picture or mesh attribute that is the colour ``key`` of the BSDF ``nodes[index]``."""
    import mitsuba as mi

    parent = nodes[index].props
    texture = nodes[parent[key].index()].props
    plugin = texture.plugin_name()
    if plugin == "mesh_attribute":
        parent[key] = mi.load_dict({"type": "uniform", "value": 0.5})
        notes.add("colours of mesh attributes: not supported, replaced by grey 0.5")
    if plugin != "bitmap":
        return
    picture = read_picture(texture, scene.file)
    check_values([picture.min(), picture.max(), picture.mean()], f"picture {texture['filename']}", scene)
    if "filter_type" in texture and texture["filter_type"] != "bilinear":
        notes.add(f"pictures with the filter '{texture['filter_type']}': read bilinearly")
    if picture.max() > 1:
        notes.add(TOO_BRIGHT)
    jit = not str(mi.variant()).startswith("scalar")
    upright = np.clip(picture[::-1], 0.0, 1.0)  # v runs down Mitsuba's bitmaps, and up our images
    repeats = jit and _wrap_mode(texture) == "repeat"
    surface = photograph_surface(np.pad(upright, _RIM, mode="wrap") if repeats else upright, scene.near_infrared)
    notes.add(f"RGB pictures on surfaces: spectra by the near-infrared rule '{scene.near_infrared}'")
    assert isinstance(surface, Mixture)
    if jit:
        parent[key] = mi.load_dict(_layout_dict(texture, mixture_dict(surface), picture.shape))
    elif parent.plugin_name() == "diffuse" and "to_uv" not in texture:
        replace(nodes, index, mi.load_dict(reflection.bsdf_dict(surface)))
    else:
        mean = spectrum_of(np.clip(picture, 0, 1).mean(axis=(0, 1)), scene.near_infrared)
        parent[key] = mi.load_dict(spectrum_dict(mean))
        notes.add("pictures on glossy or scaled surfaces: replaced by their mean colour (JIT variants show them)")


def replace(nodes: Any, index: int, substitute: Any) -> None:
    """Replace every reference to the node ``index`` by an object."""
    import mitsuba as mi

    for node in nodes:
        for key in list(node.props.keys()):
            if node.props.type(key) == mi.Properties.Type.ResolvedReference and node.props[key].index() == index:
                node.props[key] = substitute


def read_picture(texture: Any, file: Path) -> Any:
    """Picture of a bitmap texture in linear RGB, [h, w, 3], as Mitsuba reads it."""
    import mitsuba as mi

    if "filename" not in texture:
        raise InputError(f"{file}: a bitmap names no file; give its filename")
    path = Path(texture["filename"])
    try:
        bitmap = mi.Bitmap(str(path))
        if texture.get("raw"):
            bitmap.set_srgb_gamma(False)  # its values are linear
        bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    except Exception as error:
        text = " ".join(str(error).split())
        raise InputError(f"{file}: picture {path} does not load ({text})") from None
    return np.array(bitmap)


_RIM = ((1, 1), (1, 1), (0, 0))  # padding of a periodic picture by its opposite edges, for interpolation


def _wrap_mode(texture: Any) -> str:
    return texture["wrap_mode"] if "wrap_mode" in texture else "repeat"


def _layout_dict(texture: Any, inner: dict[str, Any], size: tuple[int, ...]) -> dict[str, Any]:
    """Mitsuba's description of the texture ``inner`` with the uv transform and wrap mode of a bitmap texture.

    ``size`` is the size of the bitmap, [h, w, ...].
    """
    _register()
    layout: dict[str, Any] = {"type": "dasim_layout", "inner": inner, "wrap": _wrap_mode(texture)}
    layout |= {"height": size[0], "width": size[1]}
    if "to_uv" in texture:
        layout["to_uv"] = texture["to_uv"]
    return layout


@cache
def _register() -> None:
    import drjit as dr
    import mitsuba as mi

    class LayoutTexture(mi.Texture):
        """Another texture, evaluated at transformed texture coordinates."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.inner, self.wrap = props["inner"], props["wrap"]
            self.size = props["width"], props["height"]
            matrix = np.array(props["to_uv"].matrix) if "to_uv" in props else np.eye(4)
            self.rows = matrix[:2][:, [0, 1, -1]].tolist()

        def eval(self, si: Any, active: Any = True) -> Any:
            at_uv = mi.SurfaceInteraction3f(si)
            uv = [row[0] * si.uv.x + row[1] * si.uv.y + row[2] for row in self.rows]
            if self.wrap == "repeat":
                inside = [value - dr.floor(value) for value in uv]
                uv = [(value * size + 1) / (size + 2) for value, size in zip(inside, self.size, strict=True)]
            elif self.wrap == "clamp":
                uv = [dr.clip(value, 0.0, 1.0) for value in uv]
            at_uv.uv = mi.Point2f(*uv)
            return self.inner.eval(at_uv, active)

        def mean(self) -> Any:
            return self.inner.mean()

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "LayoutTexture[]"

    mi.register_texture("dasim_layout", lambda props: LayoutTexture(props))
