"""A description of a camera for people, with its coefficients of eq. (8).

Tested in tests/dasim/camera/test_cameras.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dasim.camera import rings, stops, wavefront
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.spectra import grid
from dasim.spectra.grid import CHANNELS


def describe(camera: Camera | str | Path) -> str:
    """Lines of text on the lens, each stop, the sensor and, if it has R, G, B and IR, the coefficients of eq. (8).

    ``camera`` may be a bundled name or a path.
    """
    camera = cameras.as_camera(camera)
    lens, sensor = camera.lens, camera.sensor
    extras = [f"transmittance {lens.transmittance:g}"] if lens.transmittance != 1 else []
    extras += ["radial shading"] if lens.shading_per_mm else []
    extras += ["distortion"] if lens.distortion_per_mm else []
    extras += ["axial colour"] if lens.focal_shift_um else []
    extras += [] if wavefront.is_perfect(camera) else ["wavefront errors"]
    lines = [
        f"lens     {lens.focal_length_mm:g} mm f/{lens.f_number:g}, focused at {lens.focus_distance_m * 100:g} cm"
        + "".join(f", {extra}" for extra in extras)
    ]
    for stop in camera.stops:
        share = f"{stops.open_area(stop):.1%} of the lens's area"
        lines.append(f"stop     {stop.name}: {_shape(stop)}, {share}, passes {_bands(stop)}")
    rows = " / ".join(" ".join(row) for row in sensor.mosaic)
    curves = "synthetic curves" if sensor.quantum_efficiency is None else "its own curves"
    curves += f" in {sensor.silicon_um:g} um of silicon" if sensor.silicon_um is not None else ""
    lines += [
        f"sensor   {sensor.width_px} x {sensor.height_px} pixels of {sensor.pixel_pitch_um:g} um, mosaic {rows}",
        f"         {curves}, cut at {sensor.cutoff_nm:g} nm; full well {sensor.full_well_e:g} e-, "
        f"read noise {sensor.read_noise_e:g} e-, {sensor.adc_bits} bits",
    ]
    if set(CHANNELS) <= set(sensors.channels(sensor)) and np.isfinite(cameras.crosstalk(camera)).all():
        lines.append(f"eq. (8)  near-infrared in {_crosstalk(camera, 0.0)}, equal photons")
        if np.isfinite(rings.spacing_of(camera)):
            corner_deg = float(np.degrees(np.arcsin(np.sqrt(rings.square_of_sine(camera).max()))))
            lines.append(f"         in the corner, at {corner_deg:.1f} degrees: {_crosstalk(camera, corner_deg)}")
    return "\n".join(lines)


def _crosstalk(camera: Camera, angle_deg: float) -> str:
    """Coefficients of eq. (8) and their band at an angle of the field."""
    alpha = zip("RGB", cameras.crosstalk(camera, angle_deg), strict=True)
    low_nm, high_nm = cameras.near_infrared_nm(camera, angle_deg)
    listed = ", ".join(f"{name} {value:.3f}" for name, value in alpha)
    return f"{listed} of that in IR ({low_nm:.0f}-{high_nm:.0f} nm)"


def _shape(stop: stops.Stop) -> str:
    if isinstance(stop, stops.Polygon):
        return f"polygon of {len(stop.corners_ratio)} corners"
    ring = stops.ring(stop)
    if ring is None:
        return "mask"
    size = f"disc of {ring.outer:g}" if ring.inner == 0 else f"annulus from {ring.inner:g} to {ring.outer:g}"
    x, y = ring.centre
    return size if (x, y) == (0, 0) else f"{size} centred at ({x:.3g}, {y:.3g})"


def _bands(stop: stops.Stop) -> str:
    if stop.passes_nm == (grid.WHOLE_GRID_NM,):
        return "all light"
    bands = " and ".join(f"{low:g}-{high:g}" for low, high in stop.passes_nm)
    return f"{bands} nm (edges {stop.edge_width_nm:g} nm wide)"
