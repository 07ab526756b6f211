"""Surrounding light of any spectrum as one Mitsuba emitter.

Mitsuba's ``envmap`` derives its spectrum from RGB values and D65, and a scene may contain only one environment. This
emitter uses ``envmap`` for interpolation between pixels and for sampling directions in proportion to luminance, and
multiplies its value by the ratio of the illuminant's spectrum to that of D65. The result is exact on the wavelength
grid; between grid points, at steep lines, it is off by up to 1 %, which is 2e-5 of the total. The emitter works in
every variant. The scalar variants call Python for every ray that meets it, and are slow there.

Tested in tests/dasim/render/test_lights.py.
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from dasim.render.plugin import spectrum_dict, transform
from dasim.spectra.grid import WAVELENGTH_NM, integrate
from dasim.typing import FloatArray

FAR_M = 1e6  # distance of the environment, beyond everything else including the sun

_numbers = itertools.count()
# Layers by number, until their plugin reads them: a plugin's properties cannot hold Python objects.
_layers: dict[int, tuple[Layer, ...]] = {}


class Layer(NamedTuple):
    """A panorama of one spectrum: ``panorama`` times ``power`` is the radiance in W m^-2 sr^-1 nm^-1."""

    panorama: FloatArray  # [h, w], equirectangular
    power: FloatArray  # [wavelength]
    to_world: FloatArray  # [4, 4], from the panorama's axes (x right, y down, z ahead) to the world's


def surrounding_dict(layers: tuple[Layer, ...], **others: Any) -> dict[str, Any]:
    """Mitsuba's description of an emitter that is the sum of panoramas; ``others`` are further properties."""
    _register()
    number = next(_numbers)
    _layers[number] = layers
    return {"type": "dasim_surrounding", "number": number, **others}


def _envmap(panorama: FloatArray, to_world: FloatArray) -> Any:
    """Mitsuba's ``envmap`` of a panorama [h, w], with the spectrum of D65 everywhere."""
    import mitsuba as mi

    # The centre of an envmap is +z and its top is +y: half a turn about z gives our axes. Its first and last rows are
    # the poles, whereas ours are half a pixel away from them. Rows interpolated at the borders of the pixels, between
    # the rows at their centres, give the same bilinear function.
    axes = to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])
    rows = np.repeat(panorama, 2, axis=0)
    rows = np.concatenate([rows[:1], (rows[1:] + rows[:-1]) / 2, rows[-1:]])
    rows[1::2] = panorama
    bitmap = mi.Bitmap(np.ascontiguousarray(rows[..., None], dtype=np.float32))
    emitter = mi.load_dict({"type": "envmap", "bitmap": bitmap, "to_world": transform(axes)})
    parameters = mi.traverse(emitter)
    data = np.array(parameters["data"])
    data[..., :3] = 0.0  # coefficients of the RGB-to-spectrum sigmoid: it is 0.5 everywhere; the scale doubles it
    parameters["data"] = mi.TensorXf(data)
    parameters.update()
    return emitter


@cache
def _d65() -> FloatArray:
    """Spectrum of Mitsuba's ``envmap`` of value 1, [wavelength]: D65 in Mitsuba's normalisation."""
    import drjit as dr
    import mitsuba as mi

    emitter = _envmap(np.ones((2, 4)), np.eye(4))
    scalar = mi.variant().startswith("scalar")
    values = []
    for wavelengths_nm in WAVELENGTH_NM if scalar else [WAVELENGTH_NM]:
        si = dr.zeros(mi.SurfaceInteraction3f, np.size(wavelengths_nm))
        si.wi, si.wavelengths = mi.Vector3f(0, 0, 1), mi.Spectrum(mi.Float(wavelengths_nm))
        values.append(np.array(emitter.eval(si)[0]))
    return np.ravel(values)


def _guide(layers: tuple[Layer, ...]) -> Any:
    """The ``envmap`` whose directions are sampled: the sum of all layers, each times the integral of its power."""
    import cv2

    height = max(len(layer.panorama) for layer in layers)
    total = np.zeros((height, 2 * height))
    for layer in layers:
        total += integrate(layer.power) * cv2.resize(layer.panorama, (2 * height, height))
    return _envmap(total, layers[0].to_world)


@cache
def _register() -> None:
    import drjit as dr
    import mitsuba as mi

    class Surrounding(mi.Emitter):
        """The sum of panoramas, each with its own spectrum."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            layers = _layers.pop(props["number"])  # Mitsuba reads each description once
            self.maps = [_envmap(layer.panorama, layer.to_world) for layer in layers]
            self.factors = [mi.load_dict(spectrum_dict(layer.power / _d65())) for layer in layers]
            self.guide = self.maps[0] if len(layers) == 1 else _guide(layers)
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
            if not mi.variant().startswith("scalar"):
                self.number = dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(self))
                dr.make_opaque(self.number)

        def eval(self, si: Any, active: Any = True) -> Any:
            return sum(self.layer_radiances(si, active), mi.Spectrum(0.0))

        def layer_radiances(self, si: Any, active: Any = True) -> list[Any]:
            """Radiance of each layer in the direction -wi."""
            return [m.eval(si, active) * f.eval(si, active) for m, f in zip(self.maps, self.factors, strict=True)]

        def layer_spectra(self, si: Any) -> list[Any]:
            """Spectrum of each layer, for a panorama that is 1 everywhere."""
            even = _envmap(np.ones((2, 4)), np.eye(4))
            return [even.eval(si) * factor.eval(si) for factor in self.factors]

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            ds, _ = self.guide.sample_direction(it, sample, active)
            if not mi.variant().startswith("scalar"):
                ds.emitter = dr.reinterpret_array(mi.EmitterPtr, self.number)
            ds.dist = FAR_M
            ds.p = it.p + ds.d * FAR_M
            return ds, self.eval_direction(it, ds, active) * dr.select(ds.pdf > 0, dr.rcp(ds.pdf), 0.0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return self.guide.pdf_direction(it, ds, active)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.wi, si.wavelengths = -ds.d, it.wavelengths
            return self.eval(si, active)

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f()  # empty: the emitter has no place in the scene

        def traverse(self, callback: Any) -> None:
            pass

        def to_string(self) -> str:
            return "Surrounding[]"

    mi.register_emitter("dasim_surrounding", lambda props: Surrounding(props))
