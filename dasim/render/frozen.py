"""Functions that are traced once and launched again with other arrays, in the JIT variants.

At every call, Dr.Jit runs a function in Python to find the kernel that an earlier call compiled. This takes 20 to 40 ms
for a batch of rays, whose kernel takes 0.2 s on one thread. The batches of a pass differ only in their arrays, so the
first batch is traced, and its kernels are launched again for the others (``drjit.freeze``).

All data that a frozen function reads must be passed as arguments, in arrays, plugins, tuples, lists and dataclasses
(Dr.Jit cannot look into named tuples). Values that are not arrays are read once and must be the same in all calls;
numbers that change are passed as arrays of one entry. Reading arrays from the host inside the function ends the
process.

Tested in tests/dasim/render/test_frozen.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

F = TypeVar("F", bound=Callable[..., object])
MOST_KINDS = 100  # kinds of arguments; a pass has a few, more would be a defect, and Dr.Jit warns


def frozen(function: F) -> F:
    """``function``, traced at its first call, and again where the kinds of its arguments are others.

    On graphics cards, where batches are 16 times as large, it is traced at every call.
    """
    import drjit as dr
    import mitsuba as mi

    return dr.freeze(function, warn_after=MOST_KINDS, enabled=not mi.variant().startswith("cuda"))
