"""Functions that are traced once and launched again with other arrays, in the JIT variants.

At every call, Dr.Jit runs a function in Python to find the kernel that an earlier call compiled. This takes 20 to 150
ms for a batch of rays, whose kernel takes 0.2 s on one thread. The batches of a pass differ only in their arrays, and
so do most passes of a capture: a function is traced for the first of them, and its kernels are launched again for the
others (``drjit.freeze``).

All data that a frozen function reads must be passed as arguments, in arrays, plugins, tuples, lists and dataclasses
(Dr.Jit cannot look into named tuples). Values that are not arrays are part of the kind of the arguments, and so are
the sizes that arrays have in common and the alignment of their memory (:func:`dasim.render.plugin.aligned`); for
another kind, the function is traced again. Numbers that change are therefore passed as arrays of one entry, and fields
of dataclasses that only the host reads are marked as ``HOST_ONLY`` and left out. Reading arrays from the host inside
the function ends the process.

Tested in tests/dasim/render/test_frozen.py.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])
HOST_ONLY = {"host_only": True}  # metadata of a dataclass's field
MOST_KINDS = 100  # kinds of arguments; a capture has up to a dozen, more would be a defect, and Dr.Jit warns

_shared: list[dict[Any, Any]] = []  # frozen functions by function, for each open :func:`sharing`


@contextmanager
def sharing() -> Iterator[None]:
    """Passes within this context share what is traced: those of one scene."""
    _shared.append({})
    try:
        yield
    finally:
        _shared.pop()


def frozen(function: F) -> F:
    """``function``, traced at its first call, and again where the kinds of its arguments are others.

    Within :func:`sharing`, all results for one function share their traces. On graphics cards, where batches are 16
    times as large, it is traced at every call.
    """
    import mitsuba as mi

    if mi.variant().startswith("cuda"):
        return function
    kept = _shared[-1] if _shared else {}
    if function not in kept:
        kept[function] = _traced(function)
    traced = kept[function]

    def launched(*arguments: Any) -> Any:
        try:
            return traced(*(_for_rays(argument) for argument in arguments))
        except RuntimeError as error:
            raise _first_cause(error) from None  # Ctrl-C above all: Dr.Jit wraps what its functions raise

    return launched  # type: ignore[return-value]


def _traced(function: Callable[..., Any]) -> Any:
    import drjit as dr

    return dr.freeze(function, warn_after=MOST_KINDS)


def _first_cause(error: BaseException) -> BaseException:
    return error if error.__cause__ is None else _first_cause(error.__cause__)


def _for_rays(value: Any) -> Any:
    """``value``, with None in the fields of dataclasses that are marked as ``HOST_ONLY``."""
    if isinstance(value, tuple | list):
        return type(value)(_for_rays(part) for part in value)
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        return value
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(value):
        own = getattr(value, field.name)
        read = None if field.metadata.get("host_only") else _for_rays(own)
        if read is not own:
            changes[field.name] = read
    return dataclasses.replace(value, **changes) if changes else value
