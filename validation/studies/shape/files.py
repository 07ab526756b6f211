"""The result folder of a shape study: table, figures, report, and each mask for cameras, plotters and people."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import asdict
from pathlib import Path

from dasim.camera.specification import Camera
from dasim.files.folders import new_folder, software_versions
from validation.studies.shape import drawings, report
from validation.studies.shape.designs import Design
from validation.studies.shape.infrared_stop import infrared_stop
from validation.studies.shape.study import Row, Study


def write_study(study: Study, out: Path) -> None:
    """Write table.csv, results.json, report.html, and masks/ with a PNG, an SVG and a TOML of each design."""
    with new_folder(out, "study") as folder:
        (folder / "masks").mkdir()
        for design in study.designs:
            stem = folder / "masks" / slug(design.name)
            drawings.save_png(stem.with_suffix(".png"), design.amplitude)
            stem.with_suffix(".svg").write_text(drawings.svg(study.plan.camera, design.amplitude, design.name))
            stem.with_suffix(".toml").write_text(_stop_toml(study.plan.camera, design))
        with (folder / "table.csv").open("w", newline="") as file:
            table = csv.DictWriter(file, list(Row.__annotations__))
            table.writeheader()
            table.writerows(asdict(row) for row in study.rows)
        (folder / "results.json").write_text(json.dumps(_results(study), indent=1) + "\n")
        (folder / "report.html").write_text(report.page(study, slug))


def _results(study: Study) -> dict[str, object]:
    """All figures, by the names that the designs have as files."""
    return {
        "schema": 1,
        "software": software_versions(),
        "study": "shape",
        "designs": {slug(row.name): asdict(row) for row in study.rows},
        "patches": {slug(name): {"error": error, "bound": bound} for name, (error, bound) in study.estimates.items()},
        "pipeline": {slug(name): asdict(scores) for name, scores in study.scores.items()},
        "limits": {slug(name): asdict(one) for name, one in study.limits.items()},
    }


def slug(name: str) -> str:
    """A design's name as the stem of its files: lower-case letters and digits, joined by hyphens."""
    return re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")


def _stop_toml(camera: Camera, design: Design) -> str:
    """The stop as a table for a camera file, with the mask's picture beside it."""
    stop = infrared_stop(camera)
    bands = ", ".join(f"[{low:g}, {high:g}]" for low, high in stop.passes_nm)
    return (
        f"# {design.name}: replaces stop '{stop.name}' of camera '{camera.name}'\n"
        f'[[stops]]\nname = "{stop.name}"\nshape = "mask"\nfile = "{slug(design.name)}.png"\n'
        f"passes_nm = [{bands}]\nedge_width_nm = {stop.edge_width_nm:g}\n"
    )
