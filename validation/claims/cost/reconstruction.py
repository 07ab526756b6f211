"""Claims on time and memory of the reconstruction."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.noise import expose
from dasim.camera.specification import Camera
from dasim.files.banks import save_bank
from dasim.spectra.grid import CHANNELS
from dasim.typing import ShareDone
from dasim.values import Capture, PsfBank
from recon import fourier
from recon.settings import DEFAULT_PRESET
from validation.gates.claim import Evidence
from validation.scores.figures import Figure

BANDS = 8
FIRST_LEVEL, LEVEL_STEP = 2, 3
WHITE_E = 3000.0
GAMMA = 2.2
EXPOSURE_S = 0.02

_TIMED = """
import json, sys, time
from pathlib import Path
import numpy as np
from scipy import fft
import dasim, recon
from dasim.base.memory import peak_bytes
folder, preset = Path(sys.argv[1]), recon.PRESETS[sys.argv[2]]
camera, bank = dasim.load_camera("da-mobile"), recon.load_bank(folder / "bank.npz")
recon.reconstruct(recon.load_raw(folder / "small.npy", camera), bank, preset)  # loads the compiled functions
shot = recon.load_raw(folder / "frame.npy", camera)
begin = time.perf_counter()
result = recon.reconstruct(shot, bank, preset)
total = time.perf_counter() - begin
peak = peak_bytes()
frame = shot.raw_dn.astype(np.float32)
times = []
for _ in range(5):
    begin = time.perf_counter()
    fft.rfft2(frame)
    times.append(time.perf_counter() - begin)
print(json.dumps({"s": total, "memory_gb": peak / 1e9, "fft_s": sorted(times)[2], "stages": result.timings_s,
                  "known": float(np.isfinite(result.level_raw).mean())}))
"""
REPEATS = {"12Mpx": 2, "50Mpx": 4}  # of the capture of 3 Mpx, along each side
SEAM_PART = np.s_[400:1104, 600:1560]  # of that capture: its bands end elsewhere than tiles
SEAM_TILE_PX = 256
SEAM_PERCENTILE = 99.9
LEAST_SEAM = 0.5  # of 255, that rounding to 8 bits may show


def recon_speed(progress: ShareDone) -> Evidence:
    """A capture of 3 Mpx is reconstructed in seconds.

    Rationale: captures of real cameras have millions of pixels, and parameters are tuned by repeated runs.

    Set-up: a capture of 2048 x 1536 pixels of da-mobile with sensor noise shows a photograph in eight vertical bands,
    each blurred with the bank's kernels of another level from 2 to 23, so that every stage has work in the whole frame.
    The whole pipeline runs with the default preset in a separate process, without reading or writing files; the PSF
    bank is loaded and compiled functions are cached beforehand. Then it runs with the preset fast.

    Expectation: times are those of this computer with its present load, so run this claim alone. The total is also
    reported in units of one real two-dimensional Fourier transform of the frame in the same process.

    Limit: 20 s and 4 GB on two cores; 8 s with the preset fast.

    Source: the project's own limits.
    """
    camera = dasim.load_camera("da-mobile")
    bank = recon.calibrate(dasim.calibration_captures(camera))
    frame = banded_capture(camera, bank)
    progress(0.2)
    timing = _timed(frame, bank)
    progress(0.8)
    fast = _timed(frame, bank, "fast")
    progress(1.0)
    in_transforms = f"time of the whole pipeline over that of one rfft2 of the frame ({timing['fft_s']:.3f} s)"
    figures = [
        Figure("seconds", timing["s"], "s", "time of the whole pipeline, 2048 x 1536 px"),
        Figure("memory", timing["memory_gb"], "GB", "largest memory of the process"),
        Figure("transforms", timing["s"] / timing["fft_s"], "1", in_transforms),
        Figure("known", timing["known"], "1", "share of the pixels with a raw level"),
        Figure("fast.seconds", fast["s"], "s", "time of the whole pipeline with the preset fast, 2048 x 1536 px"),
    ]
    stages = timing["stages"].items()
    figures += [Figure(f"stage.{name}", seconds, "s", f"time of the stage {name}") for name, seconds in stages]
    rows = [[name, f"{seconds:.2f}", f"{seconds / timing['fft_s']:.0f}"] for name, seconds in stages]
    caption = f"Time of each stage on {os.cpu_count()} cores"
    return Evidence(figures, tables=[(caption, ["stage", "seconds", "in transforms (rfft2)"], rows)])


def recon_large(progress: ShareDone) -> Evidence:
    """Captures of 12 and 50 Mpx are reconstructed on a small computer in limited time and memory, without seams.

    Rationale: phone sensors have 50 Mpx and more; memory must not grow in proportion to the number of pixels.

    Set-up: the capture of the claim recon-speed, repeated 2 x 2 and 4 x 4 times, with the default preset. A part of it,
    960 x 704 pixels, is reconstructed in tiles of 256 pixels in every stage and again in one tile.

    Expectation: stages whose memory grows with pixels times levels work in tiles; only the results and a few pictures
    are held for the whole frame. Tiles leave no seams if the result equals that of a single tile. Times depend on this
    computer and its current load, so run this claim alone.

    Limit: 12 Mpx in four times the time of 3 Mpx, 50 Mpx in 8 GB; with and without tiles, all levels equal within 0.1
    level and all pixels of the all-in-focus picture within 0.5 of 255. The 99.9th percentile of the differences is
    reported, too.

    Source: the project's own limits.
    """
    camera = dasim.load_camera("da-mobile")
    bank = recon.calibrate(dasim.calibration_captures(camera))
    frame = banded_capture(camera, bank)
    figures = []
    for done, (size, repeats) in enumerate(REPEATS.items()):
        progress(0.1 + 0.3 * done)
        timing = _timed(np.tile(frame, (repeats, repeats)), bank)
        pixels = f"{repeats * frame.shape[1]} x {repeats * frame.shape[0]} px"
        figures += [
            Figure(f"{size}.seconds", timing["s"], "s", f"time of the whole pipeline, {pixels}"),
            Figure(f"{size}.memory", timing["memory_gb"], "GB", f"largest memory of the process, {pixels}"),
        ]
    progress(0.7)
    figures += seams(_capture(frame[SEAM_PART], camera), bank, SEAM_TILE_PX)
    progress(1.0)
    return Evidence(figures)


def seams(capture: Capture, bank: PsfBank, tile_px: int) -> list[Figure]:
    """Differences that tiles of ``tile_px`` make in the reconstruction of a capture."""
    whole_px = max(capture.raw_dn.shape)
    tiled, whole = (recon.reconstruct(capture, bank, tile_px=size) for size in (tile_px, whole_px))
    level = np.abs(tiled.level - whole.level)
    picture = 255 * np.abs(tiled.sharp_rgb - whole.sharp_rgb).max(axis=-1)
    name = f"with tiles of {tile_px} px and without"
    return [
        Figure("seam.level", float(level.max()), "levels", f"largest difference of levels {name}"),
        Figure("seam.level.percentile", _most(level), "levels", f"percentile {SEAM_PERCENTILE} of these differences"),
        Figure("seam.picture", float(picture.max()), "DN", f"largest difference of the 8-bit picture in focus {name}"),
        Figure("seam.picture.percentile", _most(picture), "DN", f"percentile {SEAM_PERCENTILE} of these differences"),
        Figure("seam.picture.share", float((picture > LEAST_SEAM).mean()), "1", "share of the pixels above 0.5 of 255"),
    ]


def _most(difference: NDArray) -> float:
    return float(np.percentile(difference, SEAM_PERCENTILE))


def _capture(raw_dn: NDArray[np.uint16], camera: Camera) -> Capture:
    """A raw frame [h, w] as a capture of a camera of its size."""
    height, width = raw_dn.shape
    sensor = camera.sensor.model_copy(update={"width_px": width, "height_px": height})
    return Capture(np.ascontiguousarray(raw_dn), camera.model_copy(update={"sensor": sensor}), EXPOSURE_S, 1.0, 0)


def _timed(frame: NDArray[np.uint16], bank: PsfBank, preset: str = DEFAULT_PRESET) -> dict[str, Any]:
    """Time, memory and more of the reconstruction of a raw frame [h, w] of da-mobile in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        np.save(Path(folder) / "frame.npy", frame)
        np.save(Path(folder) / "small.npy", frame[:128, :128])
        save_bank(Path(folder) / "bank.npz", bank)
        process = subprocess.run([sys.executable, "-c", _TIMED, folder, preset], capture_output=True, text=True)
        if process.returncode != 0:
            message = (process.stderr.strip().splitlines() or ["the process was killed"])[-1]
            raise RuntimeError(f"the reconstruction failed: {message}")
        timing: dict[str, Any] = json.loads(process.stdout.splitlines()[-1])
    return timing


def banded_capture(camera: Camera, bank: PsfBank) -> NDArray[np.uint16]:
    """A raw frame [h, w] in digital numbers: a photograph in vertical bands of different blur, bank's first light."""
    import skimage.data

    height, width = camera.sensor.height_px, camera.sensor.width_px
    photo = skimage.data.astronaut().astype(np.float32) / 255
    sides = [(0, max(n - size, 0)) for n, size in zip((height, width), photo.shape, strict=False)]
    colours = np.pad(photo, (*sides, (0, 0)), "symmetric")[:height, :width] ** GAMMA
    infrared = 0.12 + 0.55 * colours[..., 0] + 0.2 * colours[..., 1]
    scene = np.dstack([colours, infrared]) * (WHITE_E * bank.signature[0])
    mean_e = np.zeros((height, width))
    edges = np.linspace(0, width // 2, BANDS + 1).astype(int) * 2
    reach = bank.kernel.shape[-1]
    for band, (left, right) in enumerate(itertools.pairwise(edges)):
        start, stop = max(left - reach, 0), min(right + reach, width)
        shape = fourier.fast_shape((height, stop - start), reach)
        for (y, x), name in np.ndenumerate(np.array(camera.sensor.mosaic)):
            index = CHANNELS.index(name)
            part = fourier.pad_blended(scene[:, start:stop, index].astype(np.float32), shape)
            kernel = bank.kernel[0, FIRST_LEVEL + LEVEL_STEP * band, index]
            blurred = fourier.inverse(fourier.forward(part) * fourier.transfer(kernel, shape), shape)
            mean_e[y::2, left + x : right : 2] = blurred[y:height:2, left - start + x : right - start : 2]
    collected_e = electronic_crosstalk(np.maximum(mean_e, 0), camera)
    raw, _ = expose(collected_e, camera.sensor, EXPOSURE_S, seed=0)
    return raw
