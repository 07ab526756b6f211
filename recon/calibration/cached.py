"""Calibration whose result is kept in the user's cache folder where the pictures say what decides them."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from dasim.base.cache import cache_dir
from dasim.base.errors import InputError
from dasim.base.fingerprint import fingerprint
from dasim.camera.specification import Camera
from dasim.files.banks import load_bank, save_bank
from dasim.typing import Progress
from dasim.values import PointPicture, PointPictures, PsfBank
from recon.calibration import psf_bank

TAKING = "photographing a point source"


def calibrate(
    pictures: PointPictures | Iterable[PointPicture],
    camera: Camera | None = None,
    *,
    diffraction: str = "measured",
    cache: bool = True,
    progress: Progress = lambda stage, share: None,
) -> PsfBank:
    """Measure the PSF bank of a camera from pictures of a point source, or find it in the cache.

    >>> bank = recon.calibrate(dasim.calibration_captures(camera))

    A bank from simulated pictures is kept in the cache folder. It is measured again when anything that decides the
    pictures or the calibration has changed: camera, lights, code, data, libraries.

    Args:
        pictures: what ``dasim.calibration_captures`` gives, or pictures of your own; see
            :func:`recon.calibration.psf_bank.calibrate` for what they have to cover.
        camera: the camera of pictures of your own; simulated pictures bring theirs.
        diffraction: a remark on pictures of your own; simulated pictures bring theirs.
        cache: whether to use the cache.
        progress: called with the stage and its share done.
    """
    if not isinstance(pictures, PointPictures):
        if camera is None:
            raise InputError("calibrate: pictures of your own do not say their camera; give camera=...")
        return psf_bank.calibrate(pictures, camera, diffraction=diffraction, progress=progress)
    if camera is not None and camera != pictures.camera:
        raise InputError("calibrate: camera is not the one of the simulated pictures; leave it out")
    path = bank_file(pictures)
    if cache and path.is_file():
        try:
            return replace(load_bank(path), camera=pictures.camera)
        except InputError:
            path.unlink(missing_ok=True)  # damaged
    bank = psf_bank.calibrate(_counted(pictures, progress), pictures.camera, diffraction=pictures.diffraction)
    progress(TAKING, 1.0)
    if cache:
        try:
            save_bank(path, bank)
        except OSError as error:
            warnings.warn(f"the PSF bank cannot be kept in the cache: {error}", stacklevel=2)
    return bank


def bank_file(pictures: PointPictures) -> Path:
    """The bank of some pictures in the cache folder, existing or not."""
    name = fingerprint(psf_bank.calibrate, save_bank, values=[pictures.fingerprint], excluding=("cameras", "scenes"))
    return cache_dir() / "banks" / f"{name}.npz"


def _counted(pictures: PointPictures, progress: Progress) -> Iterator[PointPicture]:
    for index, picture in enumerate(pictures):
        progress(TAKING, index / len(pictures))
        yield picture
