"""Claim of the reconstruction's speed."""

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
recon.reconstruct(recon.load_raw(folder / "small.npy", camera), bank)  # loads what was compiled
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

    Rationale: captures of real cameras have millions of pixels, and parameters are found by trying.

    Set-up: 2048 x 1536 pixels of da-mobile with sensor noise: a photograph in eight bands, each blurred with the
    bank's kernels of its own level, 2 to 23, so that every stage has work everywhere. The bank is ready, what is
    compiled is in the cache. A process of its own, the whole pipeline with the default preset, without files.

    Expectation: reported in seconds of this computer, which is what was free of it: run alone. Beside it the total
    in units of one real two-dimensional Fourier transform of the frame on one core in the same process.

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
        done = subprocess.run([sys.executable, "-c", _TIMED, folder], capture_output=True, text=True)
    if done.returncode != 0:
        raise RuntimeError(f"reconstruction: {(done.stderr.strip().splitlines() or ['was killed'])[-1]}")
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    progress(1.0)
    figures = [
        Figure("seconds", found["s"], "s", "whole pipeline, 2048 x 1536"),
        Figure("memory", found["memory_gb"], "GB", "largest memory"),
        Figure("transforms", found["s"] / found["fft_s"], "1", f"the same over one rfft2 ({found['fft_s']:.3f} s)"),
        Figure("known", found["known"], "1", "share of the pixels with a raw level"),
    ]
    stages = found["stages"].items()
    figures += [Figure(f"stage.{name}", seconds, "s", f"seconds of the stage {name}") for name, seconds in stages]
    rows = [[name, f"{seconds:.2f}", f"{seconds / found['fft_s']:.0f}"] for name, seconds in stages]
    return Evidence(figures, tables=[(f"{os.cpu_count()} cores", ["stage", "seconds", "transforms"], rows)])


def banded_capture(camera: Camera, bank: PsfBank) -> NDArray[np.uint16]:
    """Raw numbers [h, w] of a photograph in vertical bands of different blur, under the bank's first light."""
    import skimage.data

    height, width = camera.sensor.height_px, camera.sensor.width_px
    photo = skimage.data.astronaut().astype(np.float32) / 255
    sides = [(0, max(n - own, 0)) for n, own in zip((height, width), photo.shape, strict=False)]
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
    raw, _ = expose(np.maximum(mean_e, 0), camera.sensor, EXPOSURE_S, seed=0)
    return raw
