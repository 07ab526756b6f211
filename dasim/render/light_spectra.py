"""Distinct spectra ("lights") of a scene's emitters, and the share of each light in the light of an emitter (JIT
variants).

Light from surroundings and from other surfaces is a smooth function of wavelength times the spectrum of its source.
Where emitters have different spectra, each spectrum needs an irradiance field of its own: the sum of an F11 lamp and a
D65 dome, divided by any single spectrum, keeps the spectral lines of the lamp where the lamp does not shine.

Tested in tests/dasim/render/test_light_spectra.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dasim.render.plugin import aligned
from dasim.scene import specification as scenes
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.spectra import grid, illuminants
from dasim.typing import FloatArray

FEWEST_SLOTS = 4  # where a scene has several lights
NODES = 32  # wavelengths at which irradiance over a light's spectrum is stored, and interpolated between
# Spectra are sampled at these wavelengths, which include the nodes of tables with steps of 1 or 5 nm.
FINE_NM: FloatArray = np.arange(grid.WAVELENGTH_NM[0], grid.WAVELENGTH_NM[-1] + 0.25, 0.5)
ONE_SPECTRUM = 1e-4  # largest error of a spectrum interpolated as a multiple of another, relative to its mean
BETWEEN_GRID = 0.02  # largest error of a surrounding between points of the wavelength grid, over its spectrum's peak
_KEYS = ("radiance", "intensity", "irradiance")  # of a spectrum among the parameters of Mitsuba's emitters


@dataclass(frozen=True)
class Lights:
    """Distinct spectra of a scene's emitters, and which emitter has which."""

    spectra: FloatArray  # [light, FINE_NM]
    emitters: tuple[tuple[Any, tuple[int, ...]], ...]  # each emitter with the light of each of its layers

    @property
    def slots(self) -> int:
        """Number of lights for which kernels are compiled: one, or a power of two from ``FEWEST_SLOTS``."""
        count = len(self.spectra)
        return 1 if count == 1 else max(FEWEST_SLOTS, 1 << (count - 1).bit_length())

    def shares(self) -> Shares:
        """The share of each light in the light of an emitter, for use in kernels."""
        import drjit as dr
        import mitsuba as mi

        numbers = {_number(emitter): emitter_lights for emitter, emitter_lights in self.emitters}
        table = np.full(max(numbers, default=0) + 1, self.slots, np.uint32)
        for number, emitter_lights in numbers.items():
            table[number] = emitter_lights[0]
        layered = next((entry for entry in self.emitters if len(set(entry[1])) > 1), None)
        place = dr.opaque(mi.UInt32, _number(layered[0])) if layered else None
        return Shares(self.slots, mi.UInt32(aligned(table)), layered, place)


@dataclass(frozen=True)
class Shares:
    """The share of each light in the light of each emitter."""

    count: int  # slots, of which the last may be empty
    table: Any  # the light of each emitter by Mitsuba's number; ``count`` for none
    layered: tuple[Any, tuple[int, ...]] | None  # the surrounding, where its layers have several spectra
    layered_number: Any  # Mitsuba's number of it

    def of(self, emitter: Any, direction: Any, wavelengths: Any, active: Any) -> list[Any]:
        """Share 0..1 of each light in the radiance of ``emitter`` that arrives from ``direction`` (towards it), at each
        wavelength.
        """
        import drjit as dr
        import mitsuba as mi

        if self.count == 1:
            return [1.0]
        number = dr.reinterpret_array(mi.UInt32, emitter)
        light = dr.gather(mi.UInt32, self.table, number, active)
        shares = [mi.Spectrum(dr.select(light == index, 1.0, 0.0)) for index in range(self.count)]
        if self.layered is None:
            return shares
        surrounding, layer_lights = self.layered
        here = active & (number == self.layered_number)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.wi, si.wavelengths = -direction, wavelengths
        parts = surrounding.layer_radiances(si, here)
        whole = sum(parts[1:], parts[0])
        for index in range(self.count):
            part = sum((p for p, k in zip(parts, layer_lights, strict=True) if k == index), mi.Spectrum(0.0))
            shares[index] = mi.Spectrum(dr.select(here, dr.select(whole > 0, part / whole, 0.0), shares[index]))
        return shares


def lights_of(mitsuba_scene: Any) -> Lights:
    """The distinct spectra of the emitters of a Mitsuba scene; emitters without light are left out.

    Two spectra count as one light if their ratio is constant, or changes so slowly with wavelength that the ``NODES``
    wavelengths of an irradiance field represent it to ``ONE_SPECTRUM``.
    """
    spectra: list[FloatArray] = []
    emitters = []
    for emitter in mitsuba_scene.emitters():
        curves = _spectra(emitter)
        if any(curve.any() for curve in curves):
            emitters.append((emitter, tuple(_light(spectra, curve) for curve in curves)))
    return Lights(np.array(spectra or [np.ones_like(FINE_NM)]), tuple(emitters))


def total(scene: Scene | MitsubaScene, mitsuba_scene: Any) -> FloatArray:
    """Relative spectral power of all lights together, [wavelength].

    Lights of a scene are weighted by their lux. The contribution of each light of a Mitsuba scene is not known
    beforehand, so that its spectra have equal weights. The result determines the wavelengths at which the picture is
    sampled.
    """
    import mitsuba as mi

    if isinstance(scene, Scene):
        return scenes.light_spectrum(scene)
    illuminant = illuminants.illuminant(scene.illuminant)
    if mi.variant().startswith("scalar"):  # does not draw wavelengths by the light's spectrum
        return illuminant
    spectra = lights_of(mitsuba_scene).spectra
    fine = np.interp(FINE_NM, grid.WAVELENGTH_NM, illuminant)
    if len(spectra) == 1 and _same(fine, spectra[0], BETWEEN_GRID * spectra[0].max()):
        return illuminant
    mean = np.mean([curve / curve.mean() for curve in spectra], axis=0)
    return np.interp(grid.WAVELENGTH_NM, FINE_NM, mean)


def above_zero(spectrum: FloatArray) -> FloatArray:
    """The spectrum raised to at least a thousandth of its mean, for use as a divisor."""
    return np.maximum(spectrum, 1e-3 * spectrum.mean())


def nodes_nm() -> FloatArray:
    """Wavelengths of an irradiance field."""
    return np.linspace(grid.WAVELENGTH_NM[0], grid.WAVELENGTH_NM[-1], NODES)


def on_grid(curve: FloatArray, spectrum: FloatArray) -> bool:
    """Whether ``spectrum``, given on the wavelength grid, represents ``curve`` including any narrow lines
    of its table.
    """
    return _same(np.interp(FINE_NM, grid.WAVELENGTH_NM, spectrum), curve, BETWEEN_GRID * curve.max())


def _number(emitter: Any) -> int:
    """Mitsuba's number of an emitter."""
    import drjit as dr
    import mitsuba as mi

    return int(np.ravel(np.array(dr.reinterpret_array(mi.UInt32, mi.EmitterPtr(emitter))))[0])


def _light(spectra: list[FloatArray], curve: FloatArray) -> int:
    """Index of ``curve`` among ``spectra``; a curve that is not yet represented is appended."""
    if not curve.any():
        return 0
    for index, known in enumerate(spectra):
        if _same(known, curve, ONE_SPECTRUM * curve.mean()):
            return index
    spectra.append(curve)
    return len(spectra) - 1


def _same(known: FloatArray, curve: FloatArray, limit: float) -> bool:
    """Whether one irradiance field can represent both spectra.

    It can if ``curve`` over ``known``, interpolated between the nodes of the field, reproduces ``curve`` up to
    ``limit``.
    """
    divisor = above_zero(known)
    ratio = np.interp(
        FINE_NM, nodes_nm(), np.interp(nodes_nm(), FINE_NM, curve) / np.interp(nodes_nm(), FINE_NM, divisor)
    )
    return bool(np.abs(ratio * divisor - curve).max() <= limit)


def _spectra(emitter: Any) -> list[FloatArray]:
    """Spectra of an emitter, one for each layer of a surrounding, [``FINE_NM``]."""
    import drjit as dr
    import mitsuba as mi

    si = dr.zeros(mi.SurfaceInteraction3f, len(FINE_NM))
    si.wi, si.wavelengths = mi.Vector3f(0.0, 0.0, 1.0), mi.Spectrum(mi.Float(aligned(FINE_NM)))
    if hasattr(emitter, "layer_spectra"):
        values = emitter.layer_spectra(si)
    else:
        parameters = _objects(emitter)
        textures = [parameters[key] for key in _KEYS if isinstance(parameters.get(key), mi.Texture)]
        values = [textures[0].eval(si)] if textures else [mi.Spectrum(1.0)]
    return [np.broadcast_to(np.array(value[0], dtype=float), FINE_NM.shape) for value in values]


def _objects(emitter: Any) -> dict[str, Any]:
    """Objects that an emitter holds, by name."""
    import mitsuba as mi

    class Collect(mi.TraversalCallback):
        def put_object(self, name: str, value: Any, *others: Any) -> None:
            objects[name] = value

        def put_value(self, *others: Any) -> None:
            pass

        def put(self, name: str, value: Any, *others: Any) -> None:
            objects[name] = value

    objects: dict[str, Any] = {}
    emitter.traverse(Collect())
    return objects
