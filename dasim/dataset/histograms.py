"""Histograms of a dataset as a figure.

Tested in tests/dasim/cli/test_datasets.py.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from dasim.base import atomic
from dasim.dataset.sample import BLUR_EDGES_PX, DEPTH_EDGES_M


def plot(rows: list[dict[str, Any]], file: Path, title: str) -> None:
    """Write histograms of depth, visible blur, exposure and illuminants to a PNG or SVG file.

    ``rows`` are those of the index.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = Figure(figsize=(9, 6), layout="constrained", dpi=120)
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2).ravel()
    colour = "#0072b2"
    for place, what, edges, label in (
        (0, "depth", DEPTH_EDGES_M, "depth z in metres"),
        (1, "blur", BLUR_EDGES_PX, "visible blur in pixels (below 0: behind the focus)"),
    ):
        count = np.sum([row[f"{what}_histogram"] for row in rows], axis=0)
        axes[place].stairs(count / max(count.sum(), 1), edges, fill=True, color=colour)
        occupied = np.flatnonzero(count)
        axes[place].set(xlabel=label, ylabel="share of pixels")
        if occupied.size:
            axes[place].set_xlim(edges[occupied[0]], edges[occupied[-1] + 1])
    axes[0].set_xscale("log")
    exposure = np.array([row["exposure_s"] for row in rows]) * 1e3
    axes[2].hist(exposure, bins=np.geomspace(exposure.min() * 0.99, exposure.max() * 1.01, 25), color=colour)
    axes[2].set(xlabel="exposure in ms", ylabel="samples", xscale="log")
    for axis in (axes[0].xaxis, axes[2].xaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    lights = Counter(str(row["illuminant"]) for row in rows).most_common(15)[::-1]
    axes[3].barh([name for name, _ in lights], [count for _, count in lights], color=colour)
    axes[3].set(xlabel="samples by illuminant")
    axes[3].tick_params(axis="y", labelsize=7)
    figure.suptitle(f"{title}: {len(rows)} samples")
    with atomic.writing(file) as stream:
        figure.savefig(stream, format=file.suffix[1:].lower())
