"""PSF banks from simulated calibration pictures, kept in the user's cache folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

import dasim.aperture
import dasim.calibration
import dasim.camera
import dasim.optics
import dasim.pointspread
import dasim.sensor
import dasim.spectra
import recon.point_pictures
import recon.psf_bank
import recon.round_kernel
import recon.scattered
from dasim.cache import cache_dir
from dasim.camera import Camera
from dasim.files import BANK_SCHEMA, load_bank, save_bank
from dasim.values import PsfBank

Progress = Callable[[str, float], None]

# The code that decides what a bank holds: a change there makes a new bank.
_DECIDING = (
    dasim.aperture,
    dasim.calibration,
    dasim.camera,
    dasim.optics,
    dasim.pointspread,
    dasim.sensor,
    dasim.spectra,
    recon.point_pictures,
    recon.psf_bank,
    recon.round_kernel,
    recon.scattered,
)
_LIBRARIES = ("numpy", "scipy", "colour-science")


def simulated_bank(
    camera: Camera,
    *,
    lights: Sequence[str] = dasim.calibration.CALIBRATION_LIGHTS,
    diffraction: str = "wave",
    progress: Progress = lambda stage, share: None,
) -> PsfBank:
    """Photograph a point source and measure the camera's kernels, or find them in the cache.

    The bank does not depend on the frame's size. The cache is keyed by the content of everything that
    decides the bank: the camera, the lights, the diffraction model and the code.
    """
    path = cache_dir() / "banks" / f"{_key(camera, lights, diffraction)}.npz"
    if path.is_file():
        try:
            return load_bank(path)
        except dasim.camera.InputError:
            path.unlink(missing_ok=True)  # damaged: make it anew
    bank = measured_bank(camera, lights=lights, diffraction=diffraction, progress=progress)
    save_bank(path, bank)
    return bank


def measured_bank(
    camera: Camera, *, lights: Sequence[str], diffraction: str, progress: Progress = lambda stage, share: None
) -> PsfBank:
    """The same without the cache."""
    pictures = dasim.calibration.calibration_captures(camera, lights, diffraction=diffraction)
    positions = len(camera.sensor.mosaic) * len(camera.sensor.mosaic[0])
    count = len(lights) * len(dasim.camera.level_blur_px(camera)) * positions

    def counted():  # type: ignore[no-untyped-def]
        for index, picture in enumerate(pictures):
            progress("photographing a point source", index / count)
            yield picture

    bank = recon.psf_bank.calibrate(counted(), camera, diffraction=diffraction)
    progress("photographing a point source", 1.0)
    return bank


def _key(camera: Camera, lights: Sequence[str], diffraction: str) -> str:
    description = camera.model_dump(mode="json")
    for size in ("width_px", "height_px"):
        del description["sensor"][size]
    for module in _DECIDING:
        description[module.__name__] = hashlib.sha256(Path(str(module.__file__)).read_bytes()).hexdigest()
    description["libraries"] = {name: version(name) for name in _LIBRARIES}
    text = json.dumps([BANK_SCHEMA, description, list(lights), diffraction], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:24]
