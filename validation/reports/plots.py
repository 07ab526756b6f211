"""Plots of the reports: SVG pictures by matplotlib, which follow the reader's light or dark theme, in colours that
colour-blind readers can distinguish.

Tested in tests/validation/claims/test_pictures.py and tests/validation/reports/test_plots.py.
"""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Callable
from typing import Any

CHANNEL_COLOURS = {"R": "#d55e00", "G": "#009e73", "B": "#0072b2", "IR": "#444444"}  # Okabe and Ito, colour-blind-safe
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444")  # Okabe and Ito
INK, PAPER = (26, 232), (255, 22)  # grey levels of text and of the page, in the light theme and in the dark one
FEW_DECADES = 2.5  # a logarithmic axis up to this length has ticks at 1, 2 and 5 of every decade
PLAIN_DECADES = (-4, 5)  # powers of ten between which ticks are plain numbers

_VARIABLE, _STYLE = re.compile(r"var\(--g([0-9a-f]{2})\)"), re.compile(r"<style>:root.*?</style>", re.DOTALL)
_NEUTRAL = re.compile(r"#([0-9a-f]{2})\1\1\b")


def plot(
    draw: Callable[[Any], None], *, columns: int = 1, rows: int = 1, size: tuple[float, float] = (6.4, 3.6)
) -> str:
    """A plot as a data URL of an SVG picture.

    ``draw`` gets the matplotlib axes, as an array if there are several ``columns`` or ``rows``. ``size`` is the width
    and height of one panel in inches. Ticks of logarithmic axes are plain numbers.
    """
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with matplotlib.rc_context({"font.size": 9}):
        figure = Figure(figsize=(size[0] * columns, size[1] * rows), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure.subplots(rows, columns))
        for axes in figure.axes:
            _plain_ticks(axes.xaxis)
            _plain_ticks(axes.yaxis)
        return svg_address(figure)


def svg_address(figure: Any, dpi: float = 100) -> str:
    """A matplotlib figure as a data URL of an SVG picture that follows the reader's theme.

    The background is transparent. Greys run from the colour of the page's text to that of the page: black becomes
    light where the page is dark. ``dpi`` is the resolution of false-colour maps in the figure.
    """
    import matplotlib

    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "dasim"}):
        figure.savefig(buffer, format="svg", transparent=True, dpi=dpi, metadata={"Date": None})
    text = themed(buffer.getvalue().decode())
    return "data:image/svg+xml;base64," + base64.b64encode(text.encode()).decode()


def themed(svg: str) -> str:
    """An SVG file whose neutral colours depend on the theme: of the light theme, or of the dark one."""
    levels = sorted({"00", *_NEUTRAL.findall(svg)})
    light, dark = (
        "".join(f"--g{level}:{_grey(int(level, 16), INK[theme], PAPER[theme])};" for level in levels)
        for theme in range(2)
    )
    # Text without a colour is black by default.
    style = f"<style>:root{{{light}fill:var(--g00)}}@media(prefers-color-scheme:dark){{:root{{{dark}}}}}</style>"
    head, start, body = svg.partition("<defs>")
    return head + style + start + _NEUTRAL.sub(r"var(--g\1)", body) if start else svg


def printed(svg: str) -> str:
    """A :func:`themed` SVG file in the colours of the light theme alone, for programs that know no CSS variables."""
    plain = _VARIABLE.sub(lambda found: _grey(int(found.group(1), 16), INK[0], PAPER[0]), _STYLE.sub("", svg, count=1))
    return plain.replace("<svg ", f'<svg fill="{_grey(0, INK[0], PAPER[0])}" ', 1)


def _grey(level: int, ink: int, paper: int) -> str:
    """The grey as far from the ink to the paper as a level from 0 to 255."""
    value = round(ink + (paper - ink) * level / 255)
    return f"#{value:02x}{value:02x}{value:02x}"


def _plain_ticks(axis: Any) -> None:
    """Ticks of a logarithmic axis as plain numbers, at 1, 2 and 5 of every decade where these are few."""
    from matplotlib.ticker import FuncFormatter, LogFormatter, LogLocator, NullFormatter

    if axis.get_scale() != "log" or not isinstance(axis.get_major_formatter(), LogFormatter):
        return
    low, high = sorted(axis.get_view_interval())
    if not 10 ** PLAIN_DECADES[0] <= low < high <= 10 ** PLAIN_DECADES[1]:
        return
    few = high < low * 10**FEW_DECADES
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())
