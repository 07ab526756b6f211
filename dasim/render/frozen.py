"""Functions that are traced once and launched again for other arrays, in the JIT variants.

Dr.Jit runs a function in Python at every call, to find the kernel that the last call compiled: 20 to 40 ms for a batch
of rays, whose kernel takes 0.2 s on one thread. The batches of a pass differ in nothing but their arrays, so that the
first is traced and its kernels are launched for the others (``drjit.freeze``).

What a frozen function reads must be among its arguments, in arrays, plugins, tuples, lists and dataclasses (tuples with
names are opaque to Dr.Jit), and what is no array is the same in all calls: it is read once. Numbers that differ are
arrays of one entry. Arrays that a function reads from the host stop the process.

Tested in tests/dasim/render/test_frozen.py.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

F = TypeVar("F", bound=Callable[..., object])
MOST_KINDS = 100  # of arguments, of which a pass has a few; more would be a defect, of which Dr.Jit tells


def frozen(function: F) -> F:
    """``function``, traced at its first call, and again where the kinds of its arguments are others.

    On graphics cards, where batches are 16 times as large, it is traced at every call.
    """
    import drjit as dr
    import mitsuba as mi

    return dr.freeze(function, warn_after=MOST_KINDS, enabled=not mi.variant().startswith("cuda"))
