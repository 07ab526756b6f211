"""The page of a camera and its files: drawing of the apertures, kernels, transfer, responses, light, levels.

Tested in tests/validation/reports/camera/test_page.py.
"""

from __future__ import annotations

import base64
import csv
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from dasim.camera import describe, geometry, noise
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.files.folders import new_folder, software_versions
from dasim.spectra.illuminants import ENERGY_SAVING
from dasim.typing import Progress
from validation.reports.camera import figures, optics
from validation.reports.page import TEMPLATE_DIR, png_address
from validation.reports.plots import printed
from validation.subjects.texture import white_electrons

LIGHT = "D65"  # of kernels and transfer
LIGHTS = ("D65", "A", ENERGY_SAVING)  # of the table of light
LUX = 500.0  # of the exposure that the table of light shows
SHOWN = (0.0, 0.11, 0.25, 0.5, 1.0)  # levels whose kernels and transfer are drawn, of the last one


@dataclass(frozen=True)
class Drawn:
    """What a page shows: figures by file name, as data URLs, and tables as plain data."""

    camera: Camera
    pictures: dict[str, str]
    levels: list[optics.Level]
    light: list[dict[str, Any]]
    field: list[optics.FieldPoint]
    ideal_loss: float


def drawn(camera: Camera, progress: Progress = lambda stage, share: None) -> Drawn:
    """Compute the figures and tables of a camera; nothing is rendered."""
    levels = optics.levels(camera)
    index = np.unique(np.rint((len(levels) - 1) * np.array(SHOWN)).astype(int))
    shown = [levels[number] for number in index]
    blur_px = np.array([level.visible_blur_px for level in shown])
    progress("kernels", 0.0)
    kernels = optics.psfs(camera, blur_px, LIGHT)
    progress("kernels", 0.2)
    mtf = optics.modulation_transfer(camera, blur_px, LIGHT, figures.CYCLES_PX)
    progress("kernels", 1.0)
    progress("figures", 0.0)
    pictures = {
        "apertures.svg": figures.apertures(camera),
        "psf.svg": figures.kernels(camera, shown, kernels),
        "psf.png": png_address(figures.montage(kernels)),
        "mtf.svg": figures.transfer(camera, shown, mtf),
        "responses.svg": figures.responses(camera),
        "field.svg": figures.field(camera),
    }
    progress("figures", 1.0)
    light = [_light(camera, name) for name in LIGHTS]
    return Drawn(camera, pictures, levels, light, optics.field_points(camera), optics.ideal_light_loss(camera))


def _light(camera: Camera, light: str) -> dict[str, Any]:
    """The share of each channel's light that the stops leave, and the electrons of white at ``LUX``."""
    names = sensors.channels(camera.sensor)
    electrons, time_s = white_electrons(camera, light, LUX)
    kept = optics.light_kept(camera, light)
    pixels = [names.index(name) for row in camera.sensor.mosaic for name in row]
    return {
        "light": light,
        "kept": dict(zip(names, kept.tolist(), strict=True)),
        "mosaic_loss": float(1 - kept[pixels].mean()),
        "time_ms": 1e3 * time_s,
        "white_e": dict(zip(names, electrons.tolist(), strict=True)),
    }


def facts(camera: Camera) -> list[tuple[str, str]]:
    """Names and values of the camera's basic figures, for a table."""
    lens, sensor = camera.lens, camera.sensor
    pitch_um, distance_m = sensor.pixel_pitch_um, geometry.image_distance_m(camera)
    across, down, diagonal = optics.field_of_view_deg(camera)
    width_mm, height_mm = sensor.width_px * pitch_um / 1e3, sensor.height_px * pitch_um / 1e3
    aperture_mm = 1e3 * geometry.aperture_m(camera)
    dark_e = math.sqrt(noise.temporal_variance(sensor, 0.0).constant)
    full_e = noise.saturation_e(sensor)
    infinity_px = abs(float(geometry.blur_px(camera, np.inf)))
    per_dioptre_px = aperture_mm * distance_m / pitch_um * 1e3
    return [
        ("lens", f"{lens.focal_length_mm:g} mm f/{lens.f_number:g}, aperture {aperture_mm:.3f} mm"),
        ("focus", f"{100 * lens.focus_distance_m:g} cm, image distance {1e3 * distance_m:.4f} mm"),
        ("field of view", f"{across:.1f} x {down:.1f} degrees, diagonal {diagonal:.1f}"),
        (
            "sensor",
            f"{sensor.width_px} x {sensor.height_px} pixels of {pitch_um:g} um, {width_mm:.2f} x {height_mm:.2f} mm",
        ),
        ("mosaic", " / ".join(" ".join(row) for row in sensor.mosaic)),
        (
            "pixel",
            f"saturates at {full_e:g} e-, {sensor.adc_bits} bits, {noise.electrons_per_dn(sensor):.3g} e- per DN",
        ),
        (
            "noise in the dark",
            f"{dark_e:.2f} e- with rounding, {20 * math.log10(full_e / dark_e):.0f} dB below saturation",
        ),
        ("visible blur", f"{per_dioptre_px:.2f} px per dioptre from the focus, {infinity_px:.1f} px at infinity"),
    ]


def page(report: Drawn) -> str:
    """The HTML page; one file that loads nothing else."""
    environment = jinja2.Environment(loader=jinja2.FileSystemLoader(TEMPLATE_DIR), autoescape=True)
    camera = report.camera
    return environment.get_template("camera.html").render(
        camera=camera,
        facts=facts(camera),
        text=describe.describe(camera),
        pictures=report.pictures,
        levels=report.levels,
        light=report.light,
        field=report.field,
        channels=sensors.channels(camera.sensor),
        loss=report.ideal_loss,
        lux=LUX,
        shown_light=LIGHT,
    )


def write(out: Path, report: Drawn) -> None:
    """Write report.html, results.json, levels.csv and the pictures to a folder."""
    with new_folder(out, "camera page") as folder:
        (folder / "report.html").write_text(page(report), encoding="utf-8")
        for name, address in report.pictures.items():
            content = base64.b64decode(address.partition(",")[2])
            if name.endswith(".svg"):
                content = printed(content.decode()).encode()
            (folder / name).write_bytes(content)
        with (folder / "levels.csv").open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(optics.Level._fields)
            table.writerows(_filled(level) for level in report.levels)
        (folder / "results.json").write_text(json.dumps(_results(report), indent=1) + "\n", encoding="utf-8")


def _filled(level: optics.Level) -> Sequence[float | str]:
    """A level's values, an empty text for NaN."""
    return ["" if math.isnan(value) else value for value in level]


def _results(report: Drawn) -> dict[str, Any]:
    return {
        "schema": 1,
        "software": software_versions(),
        "camera": report.camera.model_dump(mode="json", exclude_defaults=True),
        "light_loss_eq_1": report.ideal_loss,
        "light": report.light,
        "field": [point._asdict() for point in report.field],
    }
