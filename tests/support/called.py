"""A record of what loops of rays call of Mitsuba and Dr.Jit: plugins, classes of arrays, launches, and host reads."""

from __future__ import annotations

import contextlib
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import pytest

READS = ("__array__", "__dlpack__", "__bool__", "numpy", "to_numpy", "torch", "jax", "item", "memview")
ENTRIES = (
    "__getitem__",
    "__iter__",
)  # read by the host where an array holds a number per ray, and not if it is a vector
ROOM = "dasim/render/"


@dataclass
class Batch:
    """One call of a function that traces rays."""

    function: str
    reads: Counter[tuple[str, int]] = field(default_factory=Counter)  # by the function that reads, and numbers read
    launches: Counter[str] = field(default_factory=Counter)  # of compiled kernels, sums and others
    traced: list[tuple[int, int]] = field(default_factory=list)  # rays, and numbers kept per ray, of tracing launches


@dataclass
class Record:
    """What was called while rays were traced, and the plugins that were made."""

    plugins: set[str] = field(default_factory=set)
    classes: set[type] = field(default_factory=set)  # of arrays that functions of the renderer take and give
    textures: list[Any] = field(default_factory=list)
    batches: list[Batch] = field(default_factory=list)


@contextlib.contextmanager
def recorded(*functions: tuple[Any, str]) -> Iterator[Record]:
    """Fill the record that it gives while the block runs; each call of a function (module, name) is a batch."""
    import drjit as dr
    import mitsuba as mi

    record = Record()
    now: list[Batch] = []
    load_dict = mi.load_dict

    def load(description: Any, *others: Any, **named: Any) -> Any:
        record.plugins |= set(_types(description))
        return load_dict(description, *others, **named)

    def reading(original: Any, entries: bool) -> Callable[..., Any]:
        def read(array: Any, *others: Any, **named: Any) -> Any:
            if now and not (entries and dr.depth_v(array) > 1):
                now[-1].reads[_reader(), dr.width(array)] += 1
            return original(array, *others, **named)

        return read

    def note(values: Any) -> None:
        for value in _arrays(values):
            if isinstance(value, dr.ArrayBase):
                record.classes.add(type(value))
            else:
                record.textures.append(value)

    def returned(frame: Any, event: str, result: Any) -> None:
        if event == "return" and ROOM in frame.f_code.co_filename:
            note(result)

    def batch(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any) -> Any:
            dr.kernel_history_clear()
            now.append(Batch(function.__name__))
            note(arguments)
            sys.setprofile(returned)
            try:
                return function(*arguments)
            finally:
                sys.setprofile(None)
                record.batches.append(_launched(now.pop(), dr.kernel_history()))

        return call

    with pytest.MonkeyPatch.context() as patch, dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        patch.setattr(mi, "load_dict", load)
        for kind in (dr.ArrayBase, mi.Float, mi.UInt32, mi.Bool):
            for name in (*READS, *ENTRIES):
                if name in vars(kind):
                    patch.setattr(kind, name, reading(vars(kind)[name], name in ENTRIES))
        for module, name in functions:
            patch.setattr(module, name, batch(getattr(module, name)))
        yield record


def _launched(batch: Batch, kernels: list[dict[str, Any]]) -> Batch:
    """The batch with its launches; kernels that trace rays call plugins."""
    for kernel in kernels:
        batch.launches[kernel["type"].name] += 1
        if "ir" in kernel and "Call: " in kernel["ir"].getvalue():
            batch.traced.append((kernel["size"], kernel["output_count"]))
    return batch


def _reader() -> str:
    """Name of the function that reads an array."""
    frame = sys._getframe(2)
    inside = {"<listcomp>", "<genexpr>", "<dictcomp>", "read"}  # comprehensions, and calls of the original
    while frame.f_code.co_name in inside and frame.f_back is not None:
        frame = frame.f_back
    return frame.f_code.co_qualname


def _types(description: Any) -> Iterator[str]:
    """Types of the plugins of a description."""
    if isinstance(description, dict):
        yield from ([description["type"]] if "type" in description else [])
        for part in description.values():
            yield from _types(part)


def _arrays(values: Any) -> Iterator[Any]:
    """Arrays and textures in values, wherever they are nested."""
    import drjit as dr

    if isinstance(values, dr.ArrayBase) or hasattr(values, "use_accel"):
        yield values
    elif is_dataclass(values) and not isinstance(values, type):
        yield from _arrays([getattr(values, each.name) for each in fields(values)])
    elif isinstance(values, (list, tuple)):
        for value in values:
            yield from _arrays(value)
