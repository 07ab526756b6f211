"""Depth maps of a dataset by :mod:`recon.depth.learned`: ``dasim learn predict``.

Tested in tests/validation/training/test_fit_depth.py.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import dasim
import recon
from dasim.base.errors import InputError
from dasim.dataset.reading import open_dataset
from dasim.dataset.sample import key
from dasim.files.captures import capture_of
from dasim.typing import Progress
from dasim.values import PsfBank
from recon import levels
from recon.depth import learned


def write(
    dataset: str,
    split: str,
    folder: Path,
    weights: Path | None = None,
    bank: PsfBank | None = None,
    progress: Progress = lambda stage, share: None,
) -> int:
    """Write depth in metres to ``depth/ID.npy`` and its standard deviation in levels to ``sd/ID.npy``, float32 [h, w];
    the number of samples.
    """
    samples = open_dataset(dataset, split)
    if not len(samples):
        raise InputError(f"{dataset}: split '{split}' has no samples")
    for name in ("depth", "sd"):
        (folder / name).mkdir(parents=True)
    for number, sample in enumerate(samples):
        name = key(sample.index)
        capture = capture_of(sample.meta, sample.raw_dn, f"sample {name}")
        diffraction = capture.provenance.get("diffraction", "wave")
        own = bank or recon.calibrate(dasim.calibration_captures(capture.camera, diffraction=diffraction))
        found = learned.estimated(capture, own, weights or learned.FILE)
        depth_m = levels.depth_of(np.asarray(found.level, np.float64), own.depth_m)
        for part, values in (("depth", depth_m), ("sd", found.sd)):
            np.save(folder / part / f"{name}.npy", np.asarray(values, np.float32))
        progress("depth", (number + 1) / len(samples))
    return len(samples)
