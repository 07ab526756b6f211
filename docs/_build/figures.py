"""The figures of "How it works", computed from the bundled camera when the site is built; nothing is rendered.

    python docs/_build/figures.py FOLDER

writes them as PNG files. As a hook of MkDocs, ``on_files`` adds them to the site.
"""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import dasim
from dasim.bounds import cramer_rao
from dasim.camera import geometry, noise, response_curves
from dasim.spectra import grid
from validation.studies import criteria

CAMERA = "da-mobile"
FOCUS_M = 0.4
COLOURS = {"R": "tab:red", "G": "tab:green", "B": "tab:blue", "IR": "tab:purple"}


def camera() -> dasim.Camera:
    """The bundled camera focused at 40 cm."""
    return dasim.refocused(dasim.load_camera(CAMERA), FOCUS_M)


def kernels() -> Figure:
    """Point-spread functions of green and near-infrared at four distances, on a square-root scale."""
    lens, size = camera(), 41
    figure = Figure(figsize=(9, 4.9), layout="constrained")
    axes = figure.subplots(2, 4)
    for column, depth_cm in enumerate((40, 30, 20, 14)):
        for row, channel in enumerate(("G", "IR")):
            kernel = dasim.psf(lens, depth_cm / 100, channel, "D65", size=size)
            place = axes[row, column]
            place.imshow(np.sqrt(np.maximum(kernel, 0)), cmap="magma", interpolation="nearest")
            place.set_xticks([])
            place.set_yticks([])
            if row == 0:
                place.set_title(f"{depth_cm} cm" + (" (focus)" if depth_cm == 100 * FOCUS_M else ""))
            if column == 0:
                place.set_ylabel({"G": "green", "IR": "near-infrared"}[channel], fontsize=12)
    figure.suptitle(f"A white point as {CAMERA} sees it, {size} x {size} pixels")
    return figure


def responses() -> Figure:
    """Response curves of the sensor, and the pass band of the disc around the hole."""
    lens = camera()
    curves = response_curves.rgb_ir_quantum_efficiency()
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    for name, curve in zip(grid.CHANNELS, np.asarray(curves), strict=True):
        axes.plot(grid.WAVELENGTH_NM, curve, color=COLOURS[name], label=name)
    axes.axvspan(650, lens.sensor.cutoff_nm, color="0.88", label="blocked outside the hole")
    axes.axvline(lens.sensor.cutoff_nm, color="0.3", linestyle="--", label="cut-off of the sensor")
    axes.set(xlabel="wavelength, nm", ylabel="electrons per photon", xlim=(400, 830), ylim=(0, None))
    axes.legend(ncols=2)
    return figure


def blur() -> Figure:
    """Diameter of the geometric blur through the lens and through the hole, against distance."""
    lens = camera()
    alpha = next(stop.radius_ratio for stop in lens.stops if stop.name == "hole")
    blur_px = np.linspace(0, 52, 200)
    depth_cm = 100 * geometry.depth_of_blur_m(lens, blur_px)
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    axes.plot(depth_cm, blur_px, color=COLOURS["G"], label="visible: the whole lens")
    axes.plot(depth_cm, alpha * blur_px, color=COLOURS["IR"], label=f"near-infrared: the hole of {alpha:g}")
    axes.plot(depth_cm, (1 - alpha) * blur_px, color="0.4", linestyle="--", label="difference: the blur level")
    axes.set(xlabel="distance, cm", ylabel="diameter of the blur, pixels", xlim=(4, 42), ylim=(0, None))
    axes.legend()
    return figure


def noise_parts() -> Figure:
    """Standard deviation of a pixel against its signal, by cause."""
    sensor = camera().sensor
    signal = np.geomspace(1, sensor.full_well_e, 200)
    temporal = noise.temporal_variance(sensor, 0.02)
    fixed = noise.fixed_variance(sensor, 0.02)
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    axes.loglog(signal, np.sqrt(temporal.at(signal) + fixed.at(signal)), color="k", label="all together")
    axes.loglog(signal, np.sqrt(signal), label="photon noise")
    axes.loglog(signal, np.full_like(signal, np.sqrt(temporal.constant)), label="dark: read noise, dark current, rounding")
    axes.loglog(signal, np.sqrt(fixed.at(signal)), label="fixed pattern: offsets and gains of the pixels")
    axes.set(xlabel="mean signal, electrons", ylabel="standard deviation, electrons")
    axes.legend()
    return figure


def bounds() -> Figure:
    """The Cramer-Rao bound of depth from one patch against distance, at three levels of light."""
    lens = camera()
    blurs = criteria.blurs_between(lens, 0.05, 0.27, 12)
    depth_m = geometry.depth_of_blur_m(lens, blurs)
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    for lux in (30, 300, 3000):
        deviation = criteria.camera_bound(lens, blurs, light="D65", level_lux=lux, texture="free", planes=criteria.PLANES)
        axes.semilogy(100 * depth_m, 1e3 * cramer_rao.depth_deviation_m(lens, depth_m, deviation), label=f"{lux:,} lux")
    axes.set(xlabel="distance, cm", ylabel="least standard deviation of depth, mm")
    axes.legend()
    return figure


FIGURES: dict[str, Callable[[], Figure]] = {
    "kernels": kernels,
    "responses": responses,
    "blur": blur,
    "noise": noise_parts,
    "bounds": bounds,
}


def png(figure: Figure) -> bytes:
    """A figure as the bytes of a PNG file."""
    FigureCanvasAgg(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, facecolor="white")
    return buffer.getvalue()


def on_files(files: Any, config: Any) -> Any:
    """Add the figures to the site."""
    from mkdocs.structure.files import File

    for name, make in FIGURES.items():
        files.append(File.generated(config, f"how/{name}.png", content=png(make())))
    return files


if __name__ == "__main__":
    Path(sys.argv[1]).mkdir(parents=True, exist_ok=True)
    for stem, made in FIGURES.items():
        Path(sys.argv[1], f"{stem}.png").write_bytes(png(made()))
