"""PSF banks from simulated calibration pictures, kept in the user's cache folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import dasim.camera.noise
import dasim.camera.pointspread
import dasim.camera.specification
import dasim.camera.stops
import dasim.camera.thin_lens
import dasim.simulation.calibration
import dasim.spectra.grid
import recon.calibration.pictures
import recon.calibration.psf_bank
import recon.calibration.round_kernel
import recon.calibration.unaligned
from dasim.base.cache import cache_dir
from dasim.camera.specification import Camera
from dasim.files.banks import BANK_SCHEMA, load_bank, save_bank
from dasim.typing import Progress
from dasim.values import PsfBank

# The code that decides what a bank holds: a change there makes a new bank.
_DECIDING = (
    dasim.camera.stops,
    dasim.simulation.calibration,
    dasim.camera.specification,
    dasim.camera.thin_lens,
    dasim.camera.pointspread,
    dasim.camera.noise,
    dasim.spectra.grid,
    recon.calibration.pictures,
    recon.calibration.psf_bank,
    recon.calibration.round_kernel,
    recon.calibration.unaligned,
)
_LIBRARIES = ("numpy", "scipy", "colour-science")


def simulated_bank(
    camera: Camera,
    *,
    lights: Sequence[str] = dasim.simulation.calibration.CALIBRATION_LIGHTS,
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
        except dasim.camera.specification.InputError:
            path.unlink(missing_ok=True)  # damaged: make it anew
    bank = measured_bank(camera, lights=lights, diffraction=diffraction, progress=progress)
    save_bank(path, bank)
    return bank


def measured_bank(
    camera: Camera, *, lights: Sequence[str], diffraction: str, progress: Progress = lambda stage, share: None
) -> PsfBank:
    """The same without the cache."""
    pictures = dasim.simulation.calibration.calibration_captures(camera, lights, diffraction=diffraction)
    positions = len(camera.sensor.mosaic) * len(camera.sensor.mosaic[0])
    count = len(lights) * len(dasim.camera.geometry.level_blur_px(camera)) * positions

    def counted():  # type: ignore[no-untyped-def]
        for index, picture in enumerate(pictures):
            progress("photographing a point source", index / count)
            yield picture

    bank = recon.calibration.psf_bank.calibrate(counted(), camera, diffraction=diffraction)
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
