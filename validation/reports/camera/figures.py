"""Drawings and plots of a camera: apertures with dimensions, kernels, modulation transfer, responses, light.

Tested in tests/validation/reports/camera/test_page.py.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dasim.camera import geometry, pointspread, radiometry, stops
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.coatings import edge_factor
from dasim.camera.specification import Camera
from dasim.spectra import grid
from dasim.typing import FloatArray
from validation.reports.camera import optics
from validation.reports.plots import CHANNEL_COLOURS, plot

OTHERS = ("#cc79a7", "#e69f00", "#56b4e9", "#000000")  # of channels that are neither R, G, B nor IR
DEPTH_COLOURS, COLOUR_RANGE = "plasma", (0.1, 0.8)  # which contrast with a light and with a dark page
COATING, LINE = "#bbbbbb", "#000000"  # neutral, so that they follow the theme of the page
CYCLES_PX = np.linspace(0.0, 0.5, 101)
MOST_COLUMNS = 3


def channel_colours(camera: Camera) -> dict[str, str]:
    """A colour for each channel of the camera."""
    others = iter(OTHERS * len(sensors.channels(camera.sensor)))
    return {name: CHANNEL_COLOURS.get(name) or next(others) for name in sensors.channels(camera.sensor)}


def apertures(camera: Camera) -> str:
    """The stops as the light sees them, to scale in mm, with their diameters; a data URL of an SVG picture."""
    columns = min(len(camera.stops), MOST_COLUMNS)
    rows = -(-len(camera.stops) // columns)

    def draw(axes: Any) -> None:
        places = np.ravel(axes)
        for place in places[len(camera.stops) :]:
            place.set_axis_off()
        for place, stop in zip(places, camera.stops, strict=False):
            _draw_stop(place, camera, stop)

    return plot(draw, columns=columns, rows=rows, size=(3.6, 4.1))


def _draw_stop(axes: Any, camera: Camera, stop: stops.Stop) -> None:
    """One stop: the lens's rim, the coating grey, the opening, and dimensions below it."""
    from matplotlib.patches import Circle
    from matplotlib.patches import Polygon as Corners

    radius = geometry.aperture_m(camera) * 5e2  # of the lens, mm
    axes.add_patch(Circle((0, 0), radius, facecolor=COATING, edgecolor=LINE, linewidth=1.2))
    ring = stops.ring(stop)
    dimensions = [(-radius, radius, f"lens {2 * radius:.3f} mm")]
    if ring is not None:
        x, y = (radius * place for place in ring.centre)
        axes.add_patch(Circle((x, y), radius * ring.outer, facecolor="#ffffff", edgecolor=LINE, linewidth=1.2))
        if ring.outer < 1:
            outer = radius * ring.outer
            dimensions.insert(0, (x - outer, x + outer, f"{2 * outer:.3f} mm ({ring.outer:g} of the lens)"))
        if ring.inner > 0:
            inner = radius * ring.inner
            axes.add_patch(Circle((x, y), inner, facecolor=COATING, edgecolor=LINE, linewidth=1.2))
            dimensions.insert(0, (x - inner, x + inner, f"inside {2 * inner:.3f} mm"))
        if (x, y) != (0.0, 0.0):
            axes.plot([0, x], [0, y], color=LINE, linewidth=0.7, linestyle=":")
            axes.plot([x], [y], marker="+", color=LINE)
            text = f"centre at x {x:.3f}, y {y:.3f} mm"
            axes.text(0, radius * (1.15 + 0.26 * len(dimensions)), text, ha="center", va="top", fontsize=8)
    elif isinstance(stop, stops.Polygon):
        corners = radius * np.array(stop.corners_ratio)
        axes.add_patch(Corners(corners, closed=True, facecolor="#ffffff", edgecolor=LINE, linewidth=1.2))
        low, high = corners[:, 0].min(), corners[:, 0].max()
        dimensions.insert(0, (low, high, f"{high - low:.3f} mm across"))
    else:
        transmitted, _ = stops.pupil(stop)
        shown = np.ma.masked_equal(transmitted, 0.0)
        axes.imshow(shown, extent=(-radius, radius, radius, -radius), cmap="viridis", vmin=0, vmax=1, zorder=2)
    for number, (low, high, text) in enumerate(dimensions):
        y = radius * (1.15 + 0.26 * number)
        for x in (low, high):
            axes.plot([x, x], [0, y], color=LINE, linewidth=0.5, linestyle=":")
        axes.annotate("", (low, y), (high, y), arrowprops={"arrowstyle": "<->", "color": LINE, "linewidth": 0.8})
        axes.text(0, y + 0.04 * radius, text, ha="center", va="top", fontsize=8)
    axes.axhline(0, color=LINE, linewidth=0.4, linestyle="-.")
    axes.axvline(0, ymin=0.35, color=LINE, linewidth=0.4, linestyle="-.")
    axes.set(xlim=(-1.2 * radius, 1.2 * radius), ylim=(1.95 * radius, -1.15 * radius), aspect="equal")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_frame_on(False)
    f_number = pointspread.working_f_number(camera, float(np.sqrt(stops.open_area(stop))))
    bands = " and ".join(f"{low:g}-{high:g}" for low, high in stop.passes_nm)
    axes.set_title(f"{stop.name}: {bands} nm\n{stops.open_area(stop):.1%} of the lens, f/{f_number:.2g}", fontsize=9)


def kernels(camera: Camera, shown: list[optics.Level], made: list[FloatArray]) -> str:
    """Point-spread functions, a row per channel and a column per level, on a square-root scale of their own."""
    names = sensors.channels(camera.sensor)

    def draw(axes: Any) -> None:
        for column, (level, kernel) in enumerate(zip(shown, _padded(made), strict=True)):
            for row, name in enumerate(names):
                place = axes[row, column]
                place.imshow(np.sqrt(np.maximum(kernel[row], 0.0)), cmap="magma", interpolation="nearest")
                place.set_xticks([])
                place.set_yticks([])
                if row == 0:
                    place.set_title(f"level {level.level}: {level.distance_cm:.1f} cm", fontsize=9)
                if column == 0:
                    place.set_ylabel(name, fontsize=11)

    return plot(draw, columns=len(shown), rows=len(names), size=(1.7, 1.75))


def montage(made: list[FloatArray], times: int = 4) -> FloatArray:
    """The same kernels as a picture of display values 0..1, [h, w], each pixel ``times`` wide, a row per channel."""
    columns = []
    for kernel in _padded(made):
        tops = np.maximum(kernel.max(axis=(1, 2), keepdims=True), np.finfo(float).tiny)
        columns.append(np.sqrt(np.maximum(kernel, 0.0) / tops).reshape(-1, kernel.shape[-1]))
    return np.kron(np.concatenate(columns, axis=1), np.ones((times, times)))


def _padded(made: list[FloatArray]) -> list[FloatArray]:
    """Kernels [channel, y, x] with zeros around them, all in the frame of the widest."""
    side = max(kernel.shape[-1] for kernel in made)
    margins = [(side - kernel.shape[-1]) // 2 for kernel in made]
    return [np.pad(kernel, ((0, 0), (one, one), (one, one))) for kernel, one in zip(made, margins, strict=True)]


def transfer(camera: Camera, shown: list[optics.Level], mtf: FloatArray) -> str:
    """Modulation transfer over spatial frequency, a panel per channel and a line per level."""
    import matplotlib

    names = sensors.channels(camera.sensor)
    colours = matplotlib.colormaps[DEPTH_COLOURS](np.linspace(*COLOUR_RANGE, len(shown)))

    def draw(axes: Any) -> None:
        for index, (place, name) in enumerate(zip(np.ravel(axes), names, strict=True)):
            for level, colour, curve in zip(shown, colours, mtf[:, index], strict=True):
                place.plot(CYCLES_PX, curve, color=colour, label=f"level {level.level}, {level.distance_cm:.1f} cm")
            place.axvline(0.25, color="#888888", linestyle=":", linewidth=0.8)
            place.set(title=name, xlabel="spatial frequency along rows, cycles/px", xlim=(0, 0.5), ylim=(0, 1.02))
        np.ravel(axes)[0].set_ylabel("modulation transfer")
        np.ravel(axes)[0].legend(fontsize=7)

    return plot(draw, columns=len(names), size=(3.3, 3.0))


def responses(camera: Camera) -> str:
    """Response curves of the sensor, and the signal through the stops, over wavelength."""
    names, colours = sensors.channels(camera.sensor), channel_colours(camera)
    nm = grid.WAVELENGTH_NM
    sensor = sensors.collected_efficiency(camera.sensor) * sensors.cutoff(camera.sensor)
    whole = radiometry.response(camera) / grid.photons_per_joule()
    shares = sensors.spectral_shares(camera.sensor)

    def draw(axes: Any) -> None:
        low, high = cameras.near_infrared_nm(camera)
        for index, name in enumerate(names):
            axes[0].plot(nm, sensor[index], color=colours[name], label=name)
            axes[1].plot(nm, whole[index] / whole.max(), color=colours[name], label=name)
        for place in axes[:2]:
            place.axvspan(low, high, color="#888888", alpha=0.18, linewidth=0)
            place.set(xlabel="wavelength, nm", xlim=(400, 830), ylim=(0, None))
        axes[0].set(title="sensor behind its filter", ylabel="collected electrons per photon")
        axes[1].set(title="through the stops, on the axis", ylabel="signal per photon, relative to the highest")
        axes[0].legend(fontsize=8)
        axes[2].plot(nm, 1e2 * shares.edge, color="#0072b2", label="each edge neighbour")
        axes[2].plot(nm, 1e2 * shares.corner, color="#d55e00", label="each corner neighbour")
        axes[2].set(title="crosstalk between pixels", xlabel="wavelength, nm", xlim=(400, 830), ylim=(0, None))
        axes[2].set_ylabel("share of a pixel's electrons, %")
        axes[2].legend(fontsize=8)

    return plot(draw, columns=3, size=(3.9, 3.2))


def field(camera: Camera) -> str:
    """Relative illumination and the near-infrared band from the middle of the frame to its corner."""
    sensor = camera.sensor
    corner = np.array([sensor.width_px, sensor.height_px]) / 2
    share = np.linspace(0, 1, 101)
    axis = np.array(geometry.frame_field_px(camera))
    angle = np.array([geometry.field_angle_deg(camera, tuple(axis + s * corner)) for s in share])
    x, y = np.minimum(((1 + share)[:, None] * corner), 2 * corner - 1).astype(int).T
    illumination = radiometry.relative_illumination(camera)[y, x]
    ends = {nm: stop.name for stop in camera.stops for band in stop.passes_nm for nm in band}
    edges = {f"{name}, {nm:g} nm": (camera.lens.coating_index, nm) for nm, name in ends.items() if _inside(nm)}
    edges[f"sensor, {sensor.cutoff_nm:g} nm"] = (sensor.coating_index, sensor.cutoff_nm)

    def draw(axes: Any) -> None:
        axes[0].plot(angle, illumination, color="#0072b2")
        axes[0].set(
            xlabel="angle of the chief ray, degrees", ylabel="illumination relative to the axis", ylim=(0, 1.02)
        )
        for name, (index, nm) in edges.items():
            axes[1].plot(angle, [nm * edge_factor(index, float(one)) for one in angle], label=name)
        axes[1].set(xlabel="angle of the chief ray, degrees", ylabel="wavelength of the edge, nm")
        axes[1].legend(fontsize=8)

    return plot(draw, columns=2, size=(4.6, 3.0))


def _inside(wavelength_nm: float) -> bool:
    """Whether a band that ends here ends within the grid of wavelengths."""
    low, high = grid.WHOLE_GRID_NM
    return low < wavelength_nm < high
