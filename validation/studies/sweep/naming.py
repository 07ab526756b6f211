"""Parameters and figures of sweeps in the words of plots and tables, with their units.

Tested in tests/validation/studies/test_report.py.
"""

from __future__ import annotations

from typing import Any

from validation.studies.sweep.point import FIGURES

_PARAMETERS = {
    "camera.stops.hole.radius_ratio": "hole radius / lens radius",
    "camera.lens.focal_length_mm": "focal length (mm)",
    "camera.lens.f_number": "f-number",
    "camera.sensor.pixel_pitch_um": "pixel pitch (um)",
    "camera.sensor.cutoff_nm": "end of the sensor's filter (nm)",
    "disc_edge_nm": "edge of the disc (nm)",
    "distance_cm": "distance (cm)",
    "focus_m": "focus distance (m)",
    "light.illuminant": "light",
    "light.lux": "illuminance (lux)",
    "mosaic": "mosaic",
    "recon.preset": "reconstruction",
    "scene": "scene",
    "stereo.baseline_mm": "distance between the cameras (mm)",
}
_FIGURES = {
    "light-loss": "share of the light lost",
    "infrared-snr": "signal to noise, infrared pixels",
    "depth-median": "median error of depth",
    "depth-rmse": "RMS error of depth",
    "depth-constant": "error of the best constant depth",
    "depth-seen": "median error of depth, blur above 3 px",
    "depth-bound": "Cramer-Rao bound of depth",
    "depth-median-m": "median error of depth",
    "depth-rmse-m": "RMS error of depth",
    "depth-bound-m": "Cramer-Rao bound of depth",
    "coverage": "share of pixels with an estimate",
    "psnr": "PSNR, all in focus",
    "psnr-gain": "gain of PSNR, all in focus",
    "ciede2000": "colour difference CIEDE2000",
    "stereo-median": "median error by stereo",
    "combined-median": "median error by stereo and defocus",
    "stereo-coverage": "share of pixels with a stereo match",
    "occluded-share": "share unseen by the second camera",
    "occluded-median": "median error where unseen by the second",
}
_UNITS = ("nm", "um", "mm", "cm", "m", "s", "deg", "lux")
CONDITIONS = ("light.", "scene", "exposure.")  # beginnings of the parameters that are no part of a design


def parameter(key: str) -> str:
    """A parameter in words with its unit, such as ``focal length (mm)``."""
    if key in _PARAMETERS:
        return _PARAMETERS[key]
    name, _, unit = key.rpartition(".")[2].rpartition("_")
    return f"{name.replace('_', ' ')} ({unit})" if name and unit in _UNITS else key.rpartition(".")[2].replace("_", " ")


def figure(key: str) -> str:
    """A figure in a few words with its unit, for an axis, such as ``median error of depth (1/m)``."""
    unit = FIGURES[key][0]
    return _FIGURES.get(key, key.replace("-", " ")) + ("" if unit == "1" else f" ({unit})")


def value(entry: Any) -> str:
    """A parameter's value."""
    return f"{entry:g}" if isinstance(entry, float) else str(entry)


def valued(key: str, entry: Any) -> str:
    """A parameter's value with its name or its unit: ``650 nm``, ``1000 lux``, ``f-number 2.8``, ``D65``."""
    if isinstance(entry, str):
        return entry
    name, _, unit = parameter(key).partition(" (")
    return f"{value(entry)} {unit[:-1]}" if unit else f"{name} {value(entry)}"


def is_condition(key: str) -> bool:
    """Whether a parameter describes the light, the scene or the exposure, and not the design."""
    return key.startswith(CONDITIONS)
