"""Colours and lights of a Mitsuba scene made physical to 830 nm, on the nodes that Mitsuba's parser found.

Tested in tests/dasim/render/foreign/test_scene.py.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.materials.photographs import photograph_surface
from dasim.materials.surfaces import Diffuse, Mixture, Surface
from dasim.render import reflection
from dasim.render.mixture import mixture_dict
from dasim.render.plugin import spectrum_dict
from dasim.render.surrounding import Layer, surrounding_dict
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.spectra import illuminants
from dasim.spectra.grid import LUMINANCE, WAVELENGTH_NM, integrate
from dasim.typing import FloatArray

# Where a texture is a colour. Elsewhere (roughness, weights, opacity, bumps) it is data, and stays.
COLOURS = (
    "reflectance",
    "diffuse_reflectance",
    "specular_reflectance",
    "specular_transmittance",
    "diffuse_transmittance",
    "transmittance",
    "base_color",
)
TOO_BRIGHT = "reflectances above 1: surfaces reflect at most everything"
NO_INFRARED = ("sunsky", "sun", "sky", "timed_sunsky")  # Mitsuba's tables end at 720 nm


class Notes:
    """What was done to a scene, counted, in the order of first use."""

    def __init__(self) -> None:
        self.counted: Counter[str] = Counter()

    def add(self, what: str) -> None:
        """Count one more of a kind."""
        self.counted[what] += 1

    def lines(self) -> list[str]:
        """One line per kind."""
        return [what if count == 1 else f"{what} ({count} times)" for what, count in self.counted.items()]


# --- surfaces ------------------------------------------------------------------------------------


def replace_surface_colours(nodes: Any, scene: MitsubaScene, notes: Notes) -> None:
    """Give every RGB colour of the scattering functions and their textures a spectrum by the scene's rule."""
    import mitsuba as mi

    kinds = mi.Properties.Type
    for index, node in enumerate(nodes):
        props = node.props
        if node.type not in (mi.ObjectType.BSDF, mi.ObjectType.Texture):
            continue
        for key in list(props.keys()):
            kind = props.type(key)
            what = f"{props.plugin_name()}.{key}"
            if kind == kinds.Color and props.plugin_name() not in ("d65",):
                _check_values(list(props[key]), what, scene)
                props[key] = _colour(key, list(props[key]), scene, notes)
            elif kind == kinds.Spectrum:
                _check_values(props[key].values, what, scene)
                if key in COLOURS:
                    props[key] = _at_most_all(props[key], notes)
                if props.type(key) == kinds.Spectrum:
                    _say_range(props[key], what, notes)
            elif kind == kinds.Float and key in COLOURS:
                _check_values([props[key]], what, scene)
                if props[key] > 1:
                    notes.add(TOO_BRIGHT)
                    props[key] = 1.0
            elif kind == kinds.ResolvedReference and node.type == mi.ObjectType.BSDF and key in COLOURS:
                _texture(nodes, index, key, scene, notes)


def _check_values(values: Any, what: str, scene: MitsubaScene) -> None:
    """InputError for what no surface and no light can have."""
    if not np.isfinite(values).all() or min(values) < 0:
        raise InputError(f"{scene.file}: {what} has values that are negative or no numbers; 0 or more is allowed")


def _at_most_all(spectrum: Any, notes: Notes) -> Any:
    """A reflectance spectrum of an author's, cut at 1."""
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
    import mitsuba as mi

    if key in COLOURS and max(rgb) > 1:
        notes.add(TOO_BRIGHT)
        rgb = [min(value, 1.0) for value in rgb]
    if max(rgb) > 1 or key in ("eta", "k"):
        notes.add(f"RGB values of '{key}' above 1, or no reflectance: taken as their mean at all wavelengths")
        return mi.load_dict({"type": "uniform", "value": float(np.mean(rgb))})
    notes.add(f"RGB surface colours: spectra by the near-infrared rule '{scene.near_infrared}'")
    return mi.load_dict(spectrum_dict(spectrum_of(np.array(rgb, np.float32), scene.near_infrared)))


def spectrum_of(linear_rgb: Any, rule: str) -> FloatArray:
    """Reflectance spectrum of one linear RGB colour by a near-infrared rule."""
    return _mean(photograph_surface(np.asarray(linear_rgb, np.float32).reshape(1, 1, 3), rule))


def _mean(surface: Surface) -> FloatArray:
    """Spectrum of a surface of one texel."""
    if isinstance(surface, Mixture):
        share = float(surface.weight.mean())
        return (1 - share) * _mean(surface.first) + share * _mean(surface.second)
    assert isinstance(surface, Diffuse)
    return surface.reflectance


def _texture(nodes: Any, index: int, key: str, scene: MitsubaScene, notes: Notes) -> None:
    """Replace a picture, or vertex colours, that a scattering function takes as its colour."""
    import mitsuba as mi

    parent = nodes[index].props
    texture = nodes[parent[key].index()].props
    plugin = texture.plugin_name()
    if plugin == "mesh_attribute":
        parent[key] = mi.load_dict({"type": "uniform", "value": 0.5})
        notes.add("colours of mesh attributes: not honoured, taken as grey 0.5")
    if plugin != "bitmap":
        return
    picture = _picture(texture, scene.file)
    _check_values([picture.min(), picture.max(), picture.mean()], f"picture {texture['filename']}", scene)
    if "filter_type" in texture and texture["filter_type"] != "bilinear":
        notes.add(f"pictures with the filter '{texture['filter_type']}': read bilinearly")
    if picture.max() > 1:
        notes.add(TOO_BRIGHT)
    jit = not str(mi.variant()).startswith("scalar")
    shown = np.clip(picture[::-1], 0.0, 1.0)  # Mitsuba's v runs down
    repeats = jit and _wrap(texture) == "repeat"
    surface = photograph_surface(np.pad(shown, _RIM, mode="wrap") if repeats else shown, scene.near_infrared)
    notes.add(f"RGB pictures on surfaces: spectra by the near-infrared rule '{scene.near_infrared}'")
    assert isinstance(surface, Mixture)
    if jit:
        parent[key] = mi.load_dict(_placed(texture, mixture_dict(surface), picture.shape))
    elif parent.plugin_name() == "diffuse" and "to_uv" not in texture:
        _refer(nodes, index, mi.load_dict(reflection._bsdf(surface)))
    else:
        mean = spectrum_of(np.clip(picture, 0, 1).mean(axis=(0, 1)), scene.near_infrared)
        parent[key] = mi.load_dict(spectrum_dict(mean))
        notes.add("pictures on glossy or scaled surfaces: their mean colour (a JIT variant shows them)")


def _refer(nodes: Any, index: int, found: Any) -> None:
    """Put an object in place of a node, wherever it is referred to."""
    import mitsuba as mi

    for node in nodes:
        for key in list(node.props.keys()):
            if node.props.type(key) == mi.Properties.Type.ResolvedReference and node.props[key].index() == index:
                node.props[key] = found


def _picture(texture: Any, file: Path) -> Any:
    """A bitmap texture's picture in linear RGB, [h, w, 3], as Mitsuba reads it."""
    import mitsuba as mi

    if "filename" not in texture:
        raise InputError(f"{file}: a picture in it names no file")
    path = file.parent / texture["filename"]
    try:
        bitmap = mi.Bitmap(str(path))
        if texture.get("raw"):
            bitmap.set_srgb_gamma(False)  # its values are linear
        bitmap = bitmap.convert(mi.Bitmap.PixelFormat.RGB, mi.Struct.Type.Float32, srgb_gamma=False)
    except Exception as error:
        text = " ".join(str(error).split())
        raise InputError(f"{file}: picture {path} does not load ({text})") from None
    return np.array(bitmap)


_RIM = ((1, 1), (1, 1), (0, 0))  # of a picture that repeats: its other side, for values between texels


def _wrap(texture: Any) -> str:
    return texture["wrap_mode"] if "wrap_mode" in texture else "repeat"


def _placed(texture: Any, inner: dict[str, Any], size: tuple[int, ...]) -> dict[str, Any]:
    """A texture laid out as a bitmap of Mitsuba's is: its own transform of uv, repeated, mirrored or clamped."""
    _register()
    placed: dict[str, Any] = {"type": "dasim_placed", "inner": inner, "wrap": _wrap(texture)}
    placed |= {"height": size[0], "width": size[1]}
    if "to_uv" in texture:
        placed["to_uv"] = texture["to_uv"]
    return placed


_registered: list[bool] = []


def _register() -> None:
    import drjit as dr
    import mitsuba as mi

    if _registered:
        return
    _registered.append(True)

    class PlacedTexture(mi.Texture):
        """Another texture, looked up elsewhere."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.inner, self.wrap = props["inner"], props["wrap"]
            self.size = props["width"], props["height"]
            matrix = np.array(props["to_uv"].matrix) if "to_uv" in props else np.eye(4)
            self.rows = matrix[:2][:, [0, 1, -1]].tolist()

        def eval(self, si: Any, active: Any = True) -> Any:
            moved = mi.SurfaceInteraction3f(si)
            uv = [row[0] * si.uv.x + row[1] * si.uv.y + row[2] for row in self.rows]
            if self.wrap == "repeat":
                inside = [value - dr.floor(value) for value in uv]
                uv = [(value * size + 1) / (size + 2) for value, size in zip(inside, self.size, strict=True)]
            elif self.wrap == "clamp":
                uv = [dr.clip(value, 0.0, 1.0) for value in uv]
            moved.uv = mi.Point2f(*uv)
            return self.inner.eval(moved, active)

        def mean(self) -> Any:
            return self.inner.mean()

        def is_spatially_varying(self) -> bool:
            return True

        def to_string(self) -> str:
            return "PlacedTexture[]"

    mi.register_texture("dasim_placed", lambda props: PlacedTexture(props))


def _say_range(spectrum: Any, what: str, notes: Notes) -> None:
    """Note where an author's spectrum ends before our band does."""
    if spectrum.is_uniform():
        return
    low, high = min(spectrum.wavelengths), max(spectrum.wavelengths)
    if high < WAVELENGTH_NM[-1]:
        notes.add(f"spectrum {what} ends at {high:g} nm: Mitsuba takes it as zero from there to 830 nm")
    if low > WAVELENGTH_NM[0]:
        notes.add(f"spectrum {what} begins at {low:g} nm: Mitsuba takes it as zero from 400 nm to there")


# --- lights --------------------------------------------------------------------------------------


def replace_light_colours(nodes: Any, scene: MitsubaScene, to_camera: FloatArray, notes: Notes) -> None:
    """Give every RGB light the scene's illuminant at the same luminance, and point lights the scene's unit."""
    import mitsuba as mi

    for index, node in enumerate(nodes):
        if node.type != mi.ObjectType.Emitter:
            continue
        plugin = node.props.plugin_name()
        if plugin in NO_INFRARED:
            raise InputError(
                f"{scene.file}: emitter '{plugin}' has no light beyond 720 nm in Mitsuba, so that the near-infrared "
                "would be black; put an envmap or a constant emitter in its place"
            )
        # A point's intensity is W/sr in the scene's units of length: what falls on a surface goes with 1/distance^2.
        factor = (scene.unit_cm * 1e-2) ** 2 if plugin in ("point", "spot") else 1.0
        if plugin == "envmap":
            _refer(nodes, index, mi.load_dict(_surrounding(node.props, scene, to_camera, notes)))
            continue
        for key in ("radiance", "intensity", "irradiance"):
            if key in node.props:
                _light(nodes, node.props, key, factor, scene, notes)


def one_unit(name: str) -> FloatArray:
    """An illuminant as bright as a spectrum that is 1 at all wavelengths, on ``WAVELENGTH_NM``."""
    power = illuminants.illuminant(name)
    efficiency = illuminants.luminous_efficiency()
    return power * integrate(efficiency) / integrate(power * efficiency)


def _light(nodes: Any, props: Any, key: str, factor: float, scene: MitsubaScene, notes: Notes) -> None:
    import mitsuba as mi

    kinds = mi.Properties.Type
    kind, value = props.type(key), props[key]
    if kind == kinds.ResolvedReference:
        inner = nodes[value.index()].props
        if inner.plugin_name() == "bitmap":
            picture = _picture(inner, scene.file)
            notes.add("pictures on lights: their mean luminance")
            _give(props, key, float(picture.mean(axis=(0, 1)) @ LUMINANCE) * factor, scene, notes)
        elif "color" in inner and inner.type("color") == kinds.Color:
            _give(props, key, float(np.dot(list(inner["color"]), LUMINANCE)) * factor, scene, notes)
        elif factor != 1:
            props[key] = _scaled(inner, factor)
    elif kind == kinds.Color:
        _give(props, key, float(np.dot(list(value), LUMINANCE)) * factor, scene, notes)
    elif kind == kinds.Spectrum:
        _check_values(value.values, f"{props.plugin_name()}.{key}", scene)
        _say_range(value, f"{props.plugin_name()}.{key}", notes)
        if value.is_uniform():
            props[key] = mi.load_dict({"type": "uniform", "value": float(value.values[0]) * factor})
        elif factor != 1:
            scaled = {"wavelengths": value.wavelengths, "values": [v * factor for v in value.values]}
            text = {name: ", ".join(f"{v:.9g}" for v in row) for name, row in scaled.items()}
            props[key] = mi.load_dict({"type": "irregular", **text})
    elif kind == kinds.Float:
        _check_values([value], f"{props.plugin_name()}.{key}", scene)
        props[key] = mi.load_dict({"type": "uniform", "value": float(value) * factor})


def _scaled(inner: Any, factor: float) -> Any:
    """A nested spectrum of an author's (a blackbody, a table), multiplied by a factor, on our wavelengths."""
    import drjit as dr
    import mitsuba as mi

    spectrum = mi.load_dict({"type": inner.plugin_name(), **{key: inner[key] for key in inner.keys()}})
    values = []
    for wavelength_nm in WAVELENGTH_NM:
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = mi.Spectrum(float(wavelength_nm))
        values.append(float(np.ravel(spectrum.eval(si))[0]))
    return mi.load_dict(spectrum_dict(factor * np.array(values)))


def _give(props: Any, key: str, luminance: float, scene: MitsubaScene, notes: Notes) -> None:
    import mitsuba as mi

    _check_values([luminance], f"{props.plugin_name()}.{key}", scene)
    props[key] = mi.load_dict(spectrum_dict(luminance * one_unit(scene.illuminant)))
    notes.add(f"RGB lights: the spectrum of {scene.illuminant} at the same luminance, without their tint")


def _surrounding(props: Any, scene: MitsubaScene, to_camera: FloatArray, notes: Notes) -> dict[str, Any]:
    """An environment map with the illuminant's spectrum; its colours are dropped."""
    luminance = np.asarray(_picture(props, scene.file) @ np.array(LUMINANCE), np.float64)
    luminance *= float(props["scale"]) if "scale" in props else 1.0
    own = np.array(props["to_world"].matrix) if "to_world" in props else np.eye(4)
    turn = np.eye(4)
    turn[:3, :3] = _turned(to_camera) @ _turned(own)
    notes.add(f"environment map: the spectrum of {scene.illuminant} at the same luminance, without its colours")
    layer = Layer(luminance, one_unit(scene.illuminant), turn @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    return surrounding_dict((layer,))


def _turned(matrix: FloatArray) -> FloatArray:
    return matrix[:3, :3] / np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
