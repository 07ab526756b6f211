"""The depth map of an entrant on a sample.

Tested in tests/validation/test_dataset_scores.py.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path

import numpy as np

import dasim
import recon
from dasim.base.errors import InputError
from dasim.camera.specification import Camera
from dasim.files.banks import load_bank
from dasim.typing import FloatArray
from dasim.values import Capture, PsfBank, Truth
from recon import levels
from validation.dataset_scores.entrants import Constant, Entrant, MapFolder
from validation.dataset_scores.figures import best_constant
from validation.methods import estimated, reconstructed
from validation.scores.depth import check_size
from validation.scores.depth_files import read_depth
from validation.scores.margin import central


def depth_map(one: Entrant, capture: Capture, truth: Truth, sample: str, bank: Path | None) -> FloatArray:
    """The depth map of an entrant in metres, as large as the truth, [h, w]; NaN without an estimate.

    Of a bundled method it is the one that ``dasim recon`` writes, of a user's function its own estimate.
    """
    if isinstance(one, Constant):
        return best_constant(truth, capture.camera.lens.focus_distance_m)
    if isinstance(one, MapFolder):
        file = one.file(sample)
        if file is None:
            raise InputError(f"{one.folder}: lacks {sample}.npy")
        return _of_size(read_depth(file, one.metres_per_unit), capture, truth, str(file))
    kernels = _bank(bank, capture.camera.model_dump_json(), capture.provenance.get("diffraction", "wave"))
    if not one.source:
        return central(reconstructed(capture, kernels, one).depth_m.astype(np.float64), truth.depth_m.shape)
    estimate = estimated(capture, kernels, one)
    found = estimate.depth_m
    if found is None:
        assert estimate.level is not None  # one of both is there
        behind = None if kernels.behind is None else kernels.behind.depth_m
        known = np.isfinite(estimate.level)
        depth_m = levels.depth_of(np.where(known, estimate.level, 0), kernels.depth_m, behind)
        found = np.where(known, depth_m, np.nan)
    return central(np.asarray(found, np.float64), truth.depth_m.shape)


@lru_cache(maxsize=4)
def _bank(file: Path | None, camera: str, diffraction: str) -> PsfBank:
    """The bank of a file, or calibrated for a camera, given as JSON; the last ones are kept."""
    if file is not None:
        return load_bank(file)
    described = Camera.model_validate(json.loads(camera))
    return recon.calibrate(dasim.calibration_captures(described, diffraction=diffraction))


def _of_size(depth_m: FloatArray, capture: Capture, truth: Truth, where: str) -> FloatArray:
    """A map of the capture's size or of the truth's, which may lack a margin; raises InputError for any other."""
    if depth_m.shape == capture.raw_dn.shape:
        return central(depth_m, truth.depth_m.shape)
    check_size(depth_m, truth, where)
    return depth_m
