"""Plots of the reports: SVG pictures by matplotlib, in colours that colour-blind readers can distinguish.

Tested in tests/validation/claims/test_pictures.py.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable
from typing import Any

CHANNEL_COLOURS = {"R": "#d55e00", "G": "#009e73", "B": "#0072b2", "IR": "#444444"}  # Okabe and Ito, colour-blind-safe


def plot(
    draw: Callable[[Any], None], *, columns: int = 1, rows: int = 1, size: tuple[float, float] = (6.4, 3.6)
) -> str:
    """A plot as a data URL of an SVG picture.

    ``draw`` gets the matplotlib axes, as an array if there are several ``columns`` or ``rows``. ``size`` is the width
    and height of one panel in inches.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"svg.hashsalt": "dasim", "font.size": 9}):
        figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure.subplots(rows, columns))
        buffer = io.BytesIO()
        figure.savefig(buffer, format="svg", facecolor="white", metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode()
