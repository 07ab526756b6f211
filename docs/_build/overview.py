"""The labelled picture of README.md and the first pages, from the output of ``dasim demo``.

    python docs/_build/overview.py out/demo docs/images/desk.jpg
"""

from __future__ import annotations

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import dasim
import recon

WIDTH_IN, DOTS_PER_IN = 12.0, 130
MAP, TICKS = "viridis", 6


def overview(demo: Path, out: Path) -> None:
    """Write capture, all-in-focus picture, true and estimated depth, two by two, with labels and a colour bar."""
    _, truth = dasim.load_capture(demo / "capture"), dasim.load_truth(demo / "capture")
    result = recon.load_reconstruction(demo / "recon")
    height, width = truth.depth_m.shape
    figure = Figure(figsize=(WIDTH_IN, WIDTH_IN * height / width + 0.9), dpi=DOTS_PER_IN, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    low, high = 1 / np.nanmax(truth.depth_m), 1 / np.nanmin(truth.depth_m)
    pictures = (("Captured: near things are blurred", result.rgb), ("All in focus, from the same exposure", result.sharp_rgb))
    for place, (label, picture) in zip(axes[0], pictures, strict=True):
        place.imshow(np.clip(picture, 0, 1), interpolation="antialiased")
        place.set_title(label, fontsize=15)
    maps = (("True depth", truth.depth_m), ("Estimated depth, from the same exposure", result.depth_m))
    for place, (label, depth_m) in zip(axes[1], maps, strict=True):
        shown = place.imshow(1 / depth_m, cmap=matplotlib.colormaps[MAP], vmin=low, vmax=high)
        place.set_title(label, fontsize=15)
    for place in axes.ravel():
        place.set_axis_off()
    bar = figure.colorbar(shown, ax=axes, orientation="horizontal", shrink=0.5, aspect=45, pad=0.01)
    places = np.linspace(low, high, TICKS)
    bar.set_ticks(list(places), labels=[f"{1e2 / place:.0f}" for place in places])
    bar.set_label("distance from the lens, cm (linear in 1/distance)", fontsize=13)
    figure.savefig(out, pil_kwargs={"quality": 84, "optimize": True}, facecolor="white")


if __name__ == "__main__":
    overview(Path(sys.argv[1]), Path(sys.argv[2]))
