"""The whole chain on a bundled scene: render, calibrate, reconstruct, score, report.

Tested in tests/validation/scores/test_score.py.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import cv2

import dasim
import recon
from dasim.base import atomic
from dasim.files.folders import new_folder
from dasim.typing import Progress
from recon.files.reconstruction import save_reconstruction
from validation.gates.claim import Claim, write_results
from validation.gates.limits import judged
from validation.reports.demo import demo_page, overview
from validation.reports.view.page import reconstruction_page
from validation.scores.figures import Figure
from validation.scores.score import score

DEMO_SCENE, DEMO_CAMERA, DEMO_SIZE_PX = "desk", "da-mobile", (768, 576)


# Limits of a working chain on the demo's scene, well apart from what it measures.
LIMITS = {
    "raw.all.coverage": ">= 0.25",  # an estimator that answers hardly anywhere does not pass
    "raw.all.level-median": "<= 2",
    "raw.all.level-ratio": "<= 0.5",
    "regularised.all.abs-rel": "<= 0.25",
    "regularised.error-surer-half": "<= 1",
    "all-in-focus.blurred.psnr-gain": "> 0",
    "all-in-focus.blurred.ssim": ">= 0.75",  # the captured picture: 0.72
    "all-in-focus.blurred.ciede2000": "<= 4",
}


def claims(figures: list[Figure]) -> list[Claim]:
    """Figures as claims, those with a limit first."""
    entries = [judged(figure, LIMITS.get(figure.id), claim="demo") for figure in figures]
    return sorted(entries, key=lambda claim: claim.limit is None)


def run_demo(
    out: Path,
    *,
    variant: str | None = None,
    spp: int | None = None,
    size_px: tuple[int, int] = DEMO_SIZE_PX,
    progress: Progress = lambda stage, share: None,
) -> list[Claim]:
    """Run the chain; ``out`` gets ``capture``, ``recon``, ``report.html``, ``view.html``, ``results.json`` and more."""
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
        pictures = dasim.calibration_captures(camera, diffraction=shot.capture.provenance["diffraction"])
        bank = recon.calibrate(pictures, progress=progress)
        lap("calibrate")
        result = recon.reconstruct(shot.capture, bank, progress=lambda s, x: progress("reconstructing", x))
        save_reconstruction(folder / "recon", result, raw_dn=shot.capture.raw_dn)
        lap("reconstruct")
        entries = claims(score(result, shot.capture, shot.truth))
        lap("score")
        view = reconstruction_page(result, bank, shot.capture, shot.truth, progress=progress)
        (folder / "view.html").write_text(view, encoding="utf-8")
        lap("view")
        progress("writing the report", 0.0)
        (folder / "report.html").write_text(demo_page(shot, result, entries, timings), encoding="utf-8")
        _, picture = cv2.imencode(".jpg", overview(shot, result), [cv2.IMWRITE_JPEG_QUALITY, 88])
        atomic.write(folder / "overview.jpg", picture.tobytes())
        lap("report")
        write_results(folder / "results.json", entries, timings)
        progress("writing the report", 1.0)
    return entries
