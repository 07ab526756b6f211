"""Light from all around, of any spectrum, as one Mitsuba emitter.

Mitsuba's ``envmap`` colours its light through RGB and D65, and a scene may hold only one environment. So its map is
kept for what it does well, directions in proportion to luminance and values between pixels, and the spectrum is put
in its place: the illuminant's over that of D65, exact on the wavelength grid (between its points, where lines are
steep, off by up to 1 %; 2e-5 of the whole). It works in every variant; the scalar ones call Python for every ray
that meets it, and are slow there.

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

FAR_M = 1e6  # beyond everything, the sun included

_numbers = itertools.count()
_layers: dict[int, tuple[Layer, ...]] = {}  # what a plugin's properties cannot carry, until the plugin has read it


class Layer(NamedTuple):
    """A panorama [h, w] of one spectrum: their product is radiance in W m^-2 sr^-1 nm^-1."""

    panorama: FloatArray
    power: FloatArray
    to_world: FloatArray  # [4, 4] of its directions (x right, y down, z ahead)


def surrounding_dict(layers: tuple[Layer, ...], **others: Any) -> dict[str, Any]:
    """Mitsuba's description of the sum of some panoramas as an emitter."""
    _register()
    number = next(_numbers)
    _layers[number] = layers
    return {"type": "dasim_surrounding", "number": number, **others}


def _envmap(panorama: FloatArray, to_world: FloatArray) -> Any:
    """Mitsuba's map of a panorama, with a spectrum that is everywhere that of D65."""
    import mitsuba as mi

    # Its middle is +z and its top +y: half a turn about z gives our axes. Its first and last row are the poles, so
    # rows at the pixels' borders are put between those at their centres: the same bilinear function.
    axes = to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])
    rows = np.repeat(panorama, 2, axis=0)
    rows = np.concatenate([rows[:1], (rows[1:] + rows[:-1]) / 2, rows[-1:]])
    rows[1::2] = panorama
    bitmap = mi.Bitmap(np.ascontiguousarray(rows[..., None], dtype=np.float32))
    emitter = mi.load_dict({"type": "envmap", "bitmap": bitmap, "to_world": transform(axes)})
    parameters = mi.traverse(emitter)
    data = np.array(parameters["data"])
    data[..., :3] = 0.0  # of the sigmoid that would make a spectrum of RGB: a half, and the scale is twice the value
    parameters["data"] = mi.TensorXf(data)
    parameters.update()
    return emitter


@cache
def _d65() -> FloatArray:
    """Spectrum that Mitsuba gives an environment map of radiance 1 everywhere, [wavelength]."""
    import drjit as dr
    import mitsuba as mi

    emitter = _envmap(np.ones((2, 4)), np.eye(4))
    values = []
    for wavelength_nm in WAVELENGTH_NM:
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi, si.wavelengths = mi.Vector3f(0, 0, 1), mi.Spectrum(float(wavelength_nm))
        values.append(emitter.eval(si)[0])
    return np.array([np.array(value).item() for value in values])


def _guide(layers: tuple[Layer, ...]) -> Any:
    """The map that directions are drawn from: the sum of all layers, each with its whole power."""
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
        """Sum of panoramas, each with its spectrum."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            layers = _layers.pop(props["number"])  # each description is read once
            self.maps = [_envmap(layer.panorama, layer.to_world) for layer in layers]
            self.factors = [mi.load_dict(spectrum_dict(layer.power / _d65())) for layer in layers]
            self.guide = self.maps[0] if len(layers) == 1 else _guide(layers)
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying

        def eval(self, si: Any, active: Any = True) -> Any:
            parts = zip(self.maps, self.factors, strict=True)
            return sum((m.eval(si, active) * f.eval(si, active) for m, f in parts), mi.Spectrum(0.0))

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            ds, _ = self.guide.sample_direction(it, sample, active)
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
            return mi.ScalarBoundingBox3f()  # it is nowhere

        def traverse(self, callback: Any) -> None:
            pass

        def to_string(self) -> str:
            return "Surrounding[]"

    mi.register_emitter("dasim_surrounding", lambda props: Surrounding(props))
