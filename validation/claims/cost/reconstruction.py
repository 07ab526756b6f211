"""Claim on the speed of the reconstruction."""

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
from dasim.values import PsfBank
from recon import fourier
from validation.gates.claim import Evidence
from validation.scores.figures import Figure

BANDS = 8
FIRST_LEVEL, LEVEL_STEP = 2, 3
WHITE_E = 3000.0
GAMMA = 2.2
EXPOSURE_S = 0.02

_TIMED = """
import json, resource, sys, time
from pathlib import Path
import numpy as np
from scipy import fft
import dasim, recon
folder = Path(sys.argv[1])
camera, bank = dasim.load_camera("da-mobile"), recon.load_bank(folder / "bank.npz")
recon.reconstruct(recon.load_raw(folder / "small.npy", camera), bank)  # loads the compiled functions
shot = recon.load_raw(folder / "frame.npy", camera)
begin = time.perf_counter()
result = recon.reconstruct(shot, bank)
total = time.perf_counter() - begin
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
frame = shot.raw_dn.astype(np.float32)
times = []
for _ in range(5):
    begin = time.perf_counter()
    fft.rfft2(frame)
    times.append(time.perf_counter() - begin)
print(json.dumps({"s": total, "memory_gb": peak / 1e9, "fft_s": sorted(times)[2], "stages": result.timings_s,
                  "known": float(np.isfinite(result.level_raw).mean())}))
"""


def recon_speed(progress: ShareDone) -> Evidence:
    """A capture of 3 Mpx is reconstructed in seconds.

    Rationale: captures of real cameras have millions of pixels, and parameters are tuned by repeated runs.

    Set-up: a capture of 2048 x 1536 pixels of da-mobile with sensor noise shows a photograph in eight vertical bands,
    each blurred with the bank's kernels of another level from 2 to 23, so that every stage has work in the whole frame.
    The whole pipeline runs with the default preset in a separate process, without reading or writing files; the PSF
    bank is loaded and compiled functions are cached beforehand.

    Expectation: times are those of this computer with its present load, so run this claim alone. The total is also
    reported in units of one real two-dimensional Fourier transform of the frame in the same process.

    Limit: 20 s and 4 GB on two cores.

    Source: the project's own limits.
    """
    camera = dasim.load_camera("da-mobile")
    bank = recon.calibrate(dasim.calibration_captures(camera))
    with tempfile.TemporaryDirectory() as folder:
        frame = banded_capture(camera, bank)
        np.save(Path(folder) / "frame.npy", frame)
        np.save(Path(folder) / "small.npy", frame[:128, :128])
        save_bank(Path(folder) / "bank.npz", bank)
        progress(0.2)
        process = subprocess.run([sys.executable, "-c", _TIMED, folder], capture_output=True, text=True)
    if process.returncode != 0:
        message = (process.stderr.strip().splitlines() or ["the process was killed"])[-1]
        raise RuntimeError(f"the reconstruction failed: {message}")
    timing: dict[str, Any] = json.loads(process.stdout.splitlines()[-1])
    progress(1.0)
    in_transforms = f"time of the whole pipeline over that of one rfft2 of the frame ({timing['fft_s']:.3f} s)"
    figures = [
        Figure("seconds", timing["s"], "s", "time of the whole pipeline, 2048 x 1536 px"),
        Figure("memory", timing["memory_gb"], "GB", "largest memory of the process"),
        Figure("transforms", timing["s"] / timing["fft_s"], "1", in_transforms),
        Figure("known", timing["known"], "1", "share of the pixels with a raw level"),
    ]
    stages = timing["stages"].items()
    figures += [Figure(f"stage.{name}", seconds, "s", f"time of the stage {name}") for name, seconds in stages]
    rows = [[name, f"{seconds:.2f}", f"{seconds / timing['fft_s']:.0f}"] for name, seconds in stages]
    caption = f"Time of each stage on {os.cpu_count()} cores"
    return Evidence(figures, tables=[(caption, ["stage", "seconds", "in transforms (rfft2)"], rows)])


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
