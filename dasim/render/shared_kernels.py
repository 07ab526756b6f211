"""Kernels that all scenes share, in the JIT variants.

A kernel compiled by Dr.Jit contains the code of every plugin that is alive in the process, in the order of the plugins'
numbers, with identical code only once, and the length of the plugins' data tables, which is the highest number. Scenes
therefore share a kernel only if they have the same kinds of plugins and the same highest numbers. For this reason, one
plugin of every kind used by random scenes is kept alive with a low number, in scenes that are never rendered, and
another one with a high number. What a scene adds between them is only data.

These plugins cost about half a processor second of tracing per picture, and the first kernels on a machine take three
times as long to compile. This pays off in a process that renders many scenes, such as those of a dataset: it holds the
plugins from its third scene on. Pictures are bit-identical with and without them.

Tested in tests/dasim/render/test_shared_kernels.py.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from dasim.materials.photographs import photograph_surface
from dasim.materials.surfaces import Coated, Diffuse, Glass, Metal, Mixture, Surface
from dasim.render.emitters import area_light, dark_emitter
from dasim.render.mesh_parameters import mesh
from dasim.render.plugin import spectrum_dict
from dasim.render.reflection import bsdf_dict, surface_bsdf
from dasim.render.surrounding import Layer, surrounding_dict
from dasim.scene.meshes import Part
from dasim.scene.panorama import SKY_ROWS
from dasim.spectra.grid import WAVELENGTH_NM
from dasim.typing import FloatArray

SHAPES, SURFACES, EMITTERS = 512, 512, 64  # highest numbers: enough for 200 objects in each of two scenes
FEW_SCENES = 2  # in a process, which compile kernels of their own
_EVEN = np.ones(len(WAVELENGTH_NM))
_names: set[str] = set()  # of the scenes of this process


def hold_for_many(name: str) -> None:
    """Count the scene ``name`` as one of this process; from the third on, :func:`hold`."""
    _names.add(name)
    if len(_names) > FEW_SCENES:
        hold()


@cache
def hold() -> tuple[Any, ...]:
    """Keep plugins of every kind that random scenes use, and plugins of the highest numbers, alive in this process."""
    import mitsuba as mi

    things = _objects() | _lamps(), _sky()
    scenes = [mi.load_dict({"type": "scene"} | each, optimize=False) for each in things]
    below = _below(SURFACES, mi.BSDFPtr, lambda: mi.load_dict({"type": "null"}))
    surface = mi.load_dict(bsdf_dict(Diffuse(_EVEN / 2)))
    below += _below(EMITTERS, mi.EmitterPtr, lambda: mi.load_dict({"type": "area"}))
    emitter = mi.load_dict(dark_emitter())
    props = mi.Properties()
    props["bsdf"] = surface
    below += _below(SHAPES, mi.ShapePtr, lambda: mi.Mesh("", 3, 1, props=props))
    shape = mi.Mesh("", 3, 1, props=props)
    del below
    return (*scenes, surface, emitter, shape)


def _below(number: int, pointer: Any, make: Callable[[], Any]) -> list[Any]:
    """Instances of a plugin that occupy the free numbers below ``number``."""
    import drjit as dr
    import mitsuba as mi

    first = make()
    lowest = np.array(dr.reinterpret_array(mi.UInt32, pointer(first))).item()
    return [first, *(make() for _ in range(lowest + 1, number))]


def _objects() -> dict[str, Any]:
    """A shape of every kind, and a surface of every kind on one of them."""
    corner = np.eye(3)
    faces = np.array([[0, 1, 2]], np.uint32)
    uses = [
        Part(corner, faces, uv, normals)
        for uv in (None, np.eye(3)[:, :2])
        for normals in (None, np.tile([0.0, 0.0, 1.0], (3, 1)))
    ]
    bsdfs = [surface_bsdf(surface, flip=False) for surface in _surfaces()]
    meshes: dict[str, Any] = {f"mesh_{n}": mesh(part, np.eye(4), bsdfs[0], f"mesh_{n}") for n, part in enumerate(uses)}
    plain = {kind: {"type": kind, "bsdf": bsdfs[0]} for kind in ("rectangle", "disk", "sphere", "cylinder")}
    return meshes | plain | {f"surface_{n}": {"type": "rectangle", "bsdf": bsdf} for n, bsdf in enumerate(bsdfs)}


def _surfaces() -> list[Surface]:
    plain = Diffuse(_EVEN / 2)
    weight = np.full((2, 2), 0.5, np.float32)
    blend = Mixture(weight, plain, plain)
    photograph = photograph_surface(np.full((2, 2, 3), 0.5, np.float32), "print")
    assert isinstance(photograph, Mixture)
    matt: list[Diffuse | Mixture] = [plain, blend, photograph]
    return [*matt, *(Coated(base) for base in matt), Metal("Al"), Glass()]


def _lamps() -> dict[str, Any]:
    lamps = {f"lamp_{kind}": area_light(kind, np.eye(4), _EVEN) for kind in ("rectangle", "disk", "sphere")}
    return lamps | {"dark": dark_emitter(), "dome": {"type": "constant", "radiance": spectrum_dict(_EVEN)}}


def _sky() -> dict[str, Any]:
    panorama: FloatArray = np.ones((SKY_ROWS, 2 * SKY_ROWS))
    return {"sky": surrounding_dict((Layer(panorama, _EVEN, np.eye(4)),) * 2)}


class Kernel(NamedTuple):
    """A kernel that was launched."""

    name: str  # hash of its code
    is_new: bool  # compiled for this launch, found neither in memory nor on disk
    compilation_s: float  # elapsed time
    has_plugins: bool  # whether it has code of shapes, surfaces or lights


@contextlib.contextmanager
def recorded() -> Iterator[list[Kernel]]:
    """Context manager that yields a list; at the end of the block, it holds the kernels launched in the block."""
    import drjit as dr

    result: list[Kernel] = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        yield result
        for entry in dr.kernel_history():
            if "hash" in entry:
                is_new = not (entry["cache_hit"] or entry["cache_disk"])
                seconds = entry["backend_time"] / 1e3 if is_new else 0.0
                result.append(Kernel(entry["hash"], is_new, seconds, "Call: " in entry["ir"].getvalue()))
