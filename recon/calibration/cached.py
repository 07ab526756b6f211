"""Calibration with a cache: banks from simulated pictures are stored in the user's cache folder."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from dasim.base import cache as results
from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.base.fingerprint import fingerprint
from dasim.camera.specification import Camera
from dasim.files.banks import load_bank, save_bank
from dasim.typing import Progress
from dasim.values import PointPicture, PointPictures, PsfBank
from recon.calibration import psf_bank

STAGE = "photographing a point source"


def calibrate(
    pictures: PointPictures | Iterable[PointPicture],
    camera: Camera | None = None,
    *,
    diffraction: str = "measured",
    field_px: tuple[float, float] = (0.0, 0.0),
    cache: bool = True,
    progress: Progress = lambda stage, share: None,
) -> PsfBank:
    """Measure the PSF bank of a camera from pictures of a point source, or load it from the cache.

    >>> bank = recon.calibrate(dasim.calibration_captures(camera))

    A bank from simulated pictures is stored in the cache folder. Its key covers everything that determines the pictures
    and the calibration: camera, lights, code, data and libraries.

    Args:
        pictures: those of ``dasim.calibration_captures``, or your own; for the required lights, levels and shifts see
            :func:`recon.calibration.psf_bank.calibrate`.
        camera: the camera of your own pictures; simulated pictures include theirs.
        diffraction: a remark on your own pictures, stored with the bank; simulated pictures include theirs.
        field_px: (x, y) of the source in your own pictures from the optical axis, stored with the bank; simulated
            pictures include theirs.
        cache: whether to use the cache.
        progress: called with the name of the stage and the share of it that is done, 0..1.
    """
    if not isinstance(pictures, PointPictures):
        if camera is None:
            raise InputError("calibrate: your own pictures do not include their camera; give camera=...")
        return psf_bank.calibrate(pictures, camera, diffraction=diffraction, field_px=field_px, progress=progress)
    if camera is not None and camera != pictures.camera:
        raise InputError("calibrate: camera differs from that of the simulated pictures; leave it out")
    cache = cache and pictures.fingerprint is not None
    path = bank_file(pictures)
    if cache and path.is_file():
        results.used(path)
        try:
            return replace(load_bank(path), camera=pictures.camera)
        except InputError:
            path.unlink(missing_ok=True)  # damaged
    shown = _with_progress(pictures, progress)
    bank = psf_bank.calibrate(shown, pictures.camera, diffraction=pictures.diffraction, field_px=pictures.field_px)
    progress(STAGE, 1.0)
    if cache:
        try:
            save_bank(path, bank)
            results.bound(path.parent)
        except OSError as error:
            warnings.warn(f"the PSF bank cannot be stored in the cache: {error}", stacklevel=2)
    return bank


def bank_file(pictures: PointPictures) -> Path:
    """Path of the bank of simulated pictures in the cache folder, whether or not it exists."""
    values = [str(pictures.fingerprint)]
    name = fingerprint(psf_bank.calibrate, save_bank, values=values, excluding=("cameras", "scenes"))
    return cache_dir() / "banks" / f"{name}.npz"


def _with_progress(pictures: PointPictures, progress: Progress) -> Iterator[PointPicture]:
    """The pictures, with a progress report before each."""
    for index, picture in enumerate(pictures):
        progress(STAGE, index / len(pictures))
        yield picture
