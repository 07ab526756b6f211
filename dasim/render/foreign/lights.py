"""Spectra up to 830 nm in place of the RGB lights of a Mitsuba scene, on the nodes of Mitsuba's parser.

Tested in tests/dasim/render/foreign/test_lights.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.base.errors import InputError
from dasim.render.foreign.colours import read_picture, replace
from dasim.render.foreign.notes import Notes, check_values, note_range
from dasim.render.plugin import spectrum_dict
from dasim.render.surrounding import Layer, surrounding_dict
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.spectra import illuminants, observer
from dasim.spectra.grid import LUMINANCE, WAVELENGTH_NM, integrate
from dasim.typing import FloatArray

NO_INFRARED = ("sunsky", "sun", "sky", "timed_sunsky")  # Mitsuba's tables end at 720 nm


def replace_light_colours(nodes: Any, scene: MitsubaScene, to_camera: FloatArray, notes: Notes) -> None:
    """Replace the spectrum of every RGB light by the scene's illuminant, at the same luminance.

    Intensities of point and spot lights are converted from the scene's units of length to metres. ``nodes`` are edited
    in place; ``to_camera`` [4, 4] is the transform from the scene's axes and units to camera axes and metres.
    """
    import mitsuba as mi

    for index, node in enumerate(nodes):
        if node.type != mi.ObjectType.Emitter:
            continue
        plugin = node.props.plugin_name()
        if plugin in NO_INFRARED:
            raise InputError(
                f"{scene.file}: emitter '{plugin}' has no light beyond 720 nm in Mitsuba, so that the near-infrared "
                "would be black; use an envmap or a constant emitter instead"
            )
        # The irradiance of a point light goes with 1 / distance^2, so that its intensity scales with the unit squared.
        factor = (scene.unit_cm * 1e-2) ** 2 if plugin in ("point", "spot") else 1.0
        if plugin == "envmap":
            replace(nodes, index, mi.load_dict(_environment(node.props, scene, to_camera, notes)))
            continue
        for key in ("radiance", "intensity", "irradiance"):
            if key in node.props:
                _light(nodes, node.props, key, factor, scene, notes)


def one_unit(name: str) -> FloatArray:
    """Spectrum of an illuminant with the luminance of a spectrum that is 1 everywhere, on ``WAVELENGTH_NM``."""
    power = illuminants.illuminant(name)
    efficiency = observer.luminous_efficiency()
    return power * integrate(efficiency) / integrate(power * efficiency)


def _light(nodes: Any, props: Any, key: str, factor: float, scene: MitsubaScene, notes: Notes) -> None:
    """Replace the spectrum ``key`` of an emitter: RGB by the illuminant, the scene's own spectra times ``factor``."""
    import mitsuba as mi

    kinds = mi.Properties.Type
    kind, value = props.type(key), props[key]
    if kind == kinds.ResolvedReference:
        inner = nodes[value.index()].props
        if inner.plugin_name() == "bitmap":
            image = read_picture(inner, scene.file)
            notes.add("pictures on lights: replaced by their mean luminance")
            _set_illuminant(props, key, float(image.mean(axis=(0, 1)) @ LUMINANCE) * factor, scene, notes)
        elif "color" in inner and inner.type("color") == kinds.Color:
            _set_illuminant(props, key, float(np.dot(list(inner["color"]), LUMINANCE)) * factor, scene, notes)
        elif factor != 1:
            props[key] = _spectrum_times(inner, factor)
    elif kind == kinds.Color:
        _set_illuminant(props, key, float(np.dot(list(value), LUMINANCE)) * factor, scene, notes)
    elif kind == kinds.Spectrum:
        check_values(value.values, f"{props.plugin_name()}.{key}", scene)
        note_range(value, f"{props.plugin_name()}.{key}", notes)
        if value.is_uniform():
            props[key] = mi.load_dict({"type": "uniform", "value": float(value.values[0]) * factor})
        elif factor != 1:
            table = {"wavelengths": value.wavelengths, "values": [v * factor for v in value.values]}
            text = {name: ", ".join(f"{v:.9g}" for v in row) for name, row in table.items()}
            props[key] = mi.load_dict({"type": "irregular", **text})
    elif kind == kinds.Float:
        check_values([value], f"{props.plugin_name()}.{key}", scene)
        props[key] = mi.load_dict({"type": "uniform", "value": float(value) * factor})


def _spectrum_times(inner: Any, factor: float) -> Any:
    """The scene's own nested spectrum (a blackbody, a table) times a factor, sampled on ``WAVELENGTH_NM``."""
    import drjit as dr
    import mitsuba as mi

    spectrum = mi.load_dict({"type": inner.plugin_name(), **{key: inner[key] for key in inner.keys()}})
    values = []
    for wavelength_nm in WAVELENGTH_NM:
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wavelengths = mi.Spectrum(float(wavelength_nm))
        values.append(float(np.ravel(spectrum.eval(si))[0]))
    return mi.load_dict(spectrum_dict(factor * np.array(values)))


def _set_illuminant(props: Any, key: str, luminance: float, scene: MitsubaScene, notes: Notes) -> None:
    """Set the spectrum ``key`` of a light to the scene's illuminant at a luminance, in the scene's units."""
    import mitsuba as mi

    check_values([luminance], f"{props.plugin_name()}.{key}", scene)
    props[key] = mi.load_dict(spectrum_dict(luminance * one_unit(scene.illuminant)))
    notes.add(f"RGB lights: the spectrum of {scene.illuminant} at the same luminance, without their tint")


def _environment(props: Any, scene: MitsubaScene, to_camera: FloatArray, notes: Notes) -> dict[str, Any]:
    """Mitsuba's description of an environment map that has the illuminant's spectrum in place of its colours."""
    luminance = np.asarray(read_picture(props, scene.file) @ np.array(LUMINANCE), np.float64)
    luminance *= float(props["scale"]) if "scale" in props else 1.0
    check_values([luminance.min(), luminance.max(), luminance.sum()], f"picture {props['filename']} of a light", scene)
    own = np.array(props["to_world"].matrix) if "to_world" in props else np.eye(4)
    turn = np.eye(4)
    turn[:3, :3] = _rotation(to_camera) @ _rotation(own)
    notes.add(f"environment map: the spectrum of {scene.illuminant} at the same luminance, without its colours")
    layer = Layer(luminance, one_unit(scene.illuminant), turn @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    return surrounding_dict((layer,))


def _rotation(matrix: FloatArray) -> FloatArray:
    """Rotation [3, 3] of a similarity transform [4, 4]."""
    return matrix[:3, :3] / np.cbrt(abs(np.linalg.det(matrix[:3, :3])))
