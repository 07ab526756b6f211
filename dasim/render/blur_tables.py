"""Tables of blur as textures, and how numbers find their place in them.

Tested in tests/dasim/render/test_radial_blur.py.
"""

from __future__ import annotations

from typing import Any

from dasim.render.plugin import tensor

FLOOR = 1e-12  # of a density per square pixel that others are divided by


def texture(values: Any) -> Any:
    """A texture of one to three dimensions, linear between its nodes."""
    import mitsuba as mi

    kinds = {1: mi.Texture1f, 2: mi.Texture2f, 3: mi.Texture3f}
    return kinds[values.ndim](tensor(values[..., None]))


def texel(value: Any, step: float, nodes: Any) -> Any:
    """Texture coordinate of ``value`` on nodes 0, step, ...; the first node lies at half a texel."""
    return (value / step + 0.5) / nodes
