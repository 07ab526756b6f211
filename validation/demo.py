"""The whole chain on a bundled scene: render, calibrate, reconstruct, score, report."""

from __future__ import annotations

import json
import math
import operator
import resource
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2

import dasim
import recon
from dasim.files import new_folder, software_versions
from recon.output import save_reconstruction
from validation import metrics, report
from validation.banks import simulated_bank

DEMO_SCENE, DEMO_CAMERA, DEMO_SIZE_PX = "desk", "da-mobile", (768, 576)
RESULTS_SCHEMA = 1

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Claim:
    """A figure with its limit: one entry of ``results.json``."""

    id: str
    value: float
    limit: str | None
    unit: str
    passed: bool | None  # None where there is no limit: reported, not passed
    source: str


# Limits that a first version of the chain has to meet on the demo's scene.
LIMITS = {
    "level-raw-median": ("<=", 2.0),
    "level-raw-ratio": ("<=", 0.5),
    "psnr-gain-blurred": (">", 0.0),
    "pixels-textured": (">=", 0.25),  # an estimator that answers hardly anywhere does not pass
}


_COMPARE = {"<=": operator.le, ">": operator.gt, ">=": operator.ge}


def claims(figures: list[metrics.Figure]) -> list[Claim]:
    """Figures as claims, those with a limit first."""
    entries = []
    for figure in figures:
        relation, bound = LIMITS.get(figure.id, ("", None))
        passed = None if bound is None else _COMPARE[relation](figure.value, bound)
        limit = None if bound is None else f"{relation} {bound:g}"
        entries.append(Claim(f"demo.{figure.id}", figure.value, limit, figure.unit, passed, figure.meaning))
    return sorted(entries, key=lambda claim: claim.limit is None)


def run_demo(
    out: Path,
    *,
    variant: str | None = None,
    spp: int | None = None,
    size_px: tuple[int, int] = DEMO_SIZE_PX,
    progress: Progress = lambda stage, share: None,
) -> list[Claim]:
    """Run the chain; ``out`` gets ``capture``, ``recon``, ``report.html``, ``results.json`` and ``overview.jpg``."""
    with new_folder(out, "demo") as folder:
        start = time.perf_counter()
        timings: dict[str, float] = {}

        def lap(name: str) -> None:
            timings[name] = time.perf_counter() - start - sum(timings.values())

        scene = dasim.load_scene(DEMO_SCENE)
        camera = dasim.focused(dasim.cropped(dasim.load_camera(DEMO_CAMERA), *size_px), scene)
        options: dict[str, Any] = {} if spp is None else {"spp": spp}
        shot = dasim.simulate(scene, camera, seed=0, variant=variant, progress=progress, **options)
        dasim.save_capture(folder / "capture", shot.capture, shot.truth)
        lap("render")
        bank = simulated_bank(camera, diffraction=shot.capture.provenance["diffraction"], progress=progress)
        lap("calibrate")
        result = recon.reconstruct(shot.capture, bank, progress=lambda s, x: progress("reconstructing", x))
        save_reconstruction(folder / "recon", result)
        lap("reconstruct")
        entries = claims(metrics.score(result, shot.truth))
        lap("score")
        progress("writing the report", 0.0)
        (folder / "report.html").write_text(report.demo_page(shot, result, entries, timings), encoding="utf-8")
        cv2.imwrite(str(folder / "overview.jpg"), report.overview(shot, result), [cv2.IMWRITE_JPEG_QUALITY, 88])
        lap("report")
        write_results(folder / "results.json", entries, timings)
        progress("writing the report", 1.0)
    return entries


def _peak_memory_mb() -> float:
    """Largest resident set of this process so far."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3  # bytes there, kilobytes elsewhere


def plain_value(value: Any) -> Any:
    """The value for JSON, which has no NaN and no infinity: those become null."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_results(path: Path, entries: list[Claim], timings_s: dict[str, float]) -> None:
    """Write ``results.json``; NaN and infinity become null."""
    plain = [{k: plain_value(v) for k, v in asdict(entry).items()} for entry in entries]
    content = {
        "schema": RESULTS_SCHEMA,
        "claims": plain,
        "timings_s": {name: round(seconds, 2) for name, seconds in timings_s.items()},
        "peak_memory_mb": round(_peak_memory_mb()),
        "software": software_versions(),
    }
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
