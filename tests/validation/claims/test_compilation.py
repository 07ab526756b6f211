"""The gate of the claim compiled-kernels fails where a random scene compiles a kernel."""

from __future__ import annotations

import pytest

from validation.claims.cost import compilation
from validation.claims.cost.compilation import Cost
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, judged_all, load_gates

ALONE = "from dasim.render import shared_kernels\nshared_kernels.hold = lambda: ()\n"


def passes(costs: list[Cost]) -> bool:
    entries = judged_all("compiled-kernels", compilation.figures(costs), load_gates(GATES, CLAIMS))
    return all(entry.passed is not False for entry in entries)


@pytest.mark.parametrize("compiled", [0, 1])
def test_a_kernel_of_a_later_scene_fails(compiled):
    first = [Cost(number, 50, 50, 9.0, 20.0) for number in compilation.FIRST]
    assert passes([*first, Cost(16, 40, 0, 0.0, 3.0), Cost(17, 40, compiled, 2.0, 5.0)]) is not bool(compiled)


@pytest.mark.slow
def test_scenes_without_the_plugins_of_others_fail(jit_variant, monkeypatch):
    """Set-up: two scenes under a lamp in a process that holds no other scene's plugins."""
    monkeypatch.setattr(compilation, "FIRST", (5, 6, 2))
    monkeypatch.setattr(compilation, "_RUN", ALONE + compilation._RUN)
    assert not passes(compilation._costs([5, 6, 2, 12]))
