"""A mask in the whole pipeline: rendered wave-true, calibrated, reconstructed and scored, beside what was predicted."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim import camera as cameras
from dasim import targets
from dasim.camera import Camera
from dasim.scene import Scene
from dasim.values import Reconstruction, Truth
from validation import rendering, stored, texture
from validation.banks import simulated_bank
from validation.picture_scores import picture_scores
from validation.scores import depth_of_level
from validation.shots import photographed

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float], None]

LIGHT = "D55"  # the desk's; one light, so that a mask's kernels are calibrated in a minute or two
LEVELS = (5, 11, 17, 23)  # of boards with one texture: visible blurs of 9 to 43 px with a hole of 0.46
BOARD_PX, DESK_PX = (192, 144), (256, 192)
SPP = 64
FOUND = 0.5  # of a board's textured pixels have a level, or the board is not found
# The default compares means over rings of frequencies, for which round stops were assumed, and keeps what it is sure
# of; the paper's own, eq. (9) to (12), and its likelihood take kernels as they are.
PRESETS = ("bands", "paper", "likelihood")
BORDER_PX = 24  # of a board's picture, that lacks half of its surroundings


@dataclass(frozen=True)
class Proof:
    """Errors of one design in the pipeline; depth in dioptres, of raw levels at textured pixels."""

    board_deviation: tuple[float, ...]  # [level], root mean square about the median, so without bias
    board_error: tuple[float, ...]  # [level], root mean square
    board_coverage: tuple[float, ...]  # [level], share of textured pixels with a raw level
    board_sharp_db: tuple[float, ...]  # [level], PSNR of the all-in-focus picture
    desk_error: float  # median absolute
    desk_sharp_db: float

    @property
    def deviation(self) -> float:
        """Over the boards: root mean square without bias; NaN where one is not found."""
        return _rms(self.board_deviation, self.board_coverage)

    @property
    def error(self) -> float:
        """Over the boards: root mean square; NaN where one is not found."""
        return _rms(self.board_error, self.board_coverage)


def _rms(values: tuple[float, ...], coverage: tuple[float, ...]) -> float:
    """A mean over the boards that were found would reward a design for those that were not: there is none then."""
    return float(np.sqrt(np.mean(np.square(values)))) if min(coverage) >= FOUND else float("nan")


def proof(
    camera: Camera,
    folder: Path,
    preset: str = PRESETS[0],
    seed: int = 0,
    progress: Progress = lambda stage, share: None,
) -> Proof:
    """Render, calibrate, reconstruct and score; or what an earlier run has left in ``folder`` for the same camera."""
    rendering.needs_wave()
    variant = rendering.activate()
    path = folder / f"{stored.hashed([camera.model_dump_json(), preset, stored.key(proof, variant, seed)])}.json"
    if path.is_file():
        kept: Any = {k: tuple(v) if isinstance(v, list) else v for k, v in json.loads(path.read_text()).items()}
        return Proof(**kept)
    bank = simulated_bank(camera, lights=(LIGHT,), progress=progress)
    boards = []
    for number, (scene, own) in enumerate(_boards(camera)):
        progress("boards", number / len(LEVELS))
        shot = photographed(scene, own, seed, spp=SPP)
        found = recon.reconstruct(shot.capture, bank, recon.PRESETS[preset])
        boards.append(_board_scores(found, shot.truth, texture.textured(shot.capture)))
    desk = dasim.load_scene("desk")
    assert isinstance(desk, Scene)
    shot = photographed(desk, cameras.cropped(camera, *DESK_PX), seed, spp=SPP)
    found = recon.reconstruct(shot.capture, bank, recon.PRESETS[preset])
    error = _dioptre_errors(found, shot.truth)
    where = texture.textured(shot.capture) & ~shot.truth.boundary & np.isfinite(error)
    deviation, whole, coverage, sharp = zip(*boards, strict=True)
    median = float(np.median(np.abs(error[where]))) if where.any() else float("nan")
    result = Proof(deviation, whole, coverage, sharp, median, _sharp_db(found, shot.truth))
    folder.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(asdict(result), indent=1) + "\n")
    part.replace(path)
    return result


def _boards(camera: Camera) -> Iterator[tuple[Scene, Camera]]:
    own = cameras.cropped(camera, *BOARD_PX)
    for level in LEVELS:
        scene = targets.staircase(own, level)
        lights = tuple(light.model_copy(update={"illuminant": LIGHT}) for light in scene.lights)
        yield scene.model_copy(update={"lights": lights}), own


def _board_scores(found: Reconstruction, truth: Truth, textured: NDArray[np.bool_]) -> tuple[float, ...]:
    inner = np.zeros(textured.shape, bool)
    inner[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    error = _dioptre_errors(found, truth)
    where = inner & textured & np.isfinite(error)
    if not where.any():
        return float("nan"), float("nan"), 0.0, _sharp_db(found, truth)
    one = error[where]
    deviation, whole = np.sqrt(np.mean((one - np.median(one)) ** 2)), np.sqrt(np.mean(one**2))
    return float(deviation), float(whole), float(where.sum() / (inner & textured).sum()), _sharp_db(found, truth)


def _dioptre_errors(found: Reconstruction, truth: Truth) -> FloatArray:
    """Error of the raw levels in dioptres, [h, w]; NaN without a level or where nothing is."""
    raw_m = np.where(np.isfinite(found.level_raw), depth_of_level(found.level_raw, found), np.nan)
    return np.asarray(np.where(truth.valid, 1 / raw_m - 1 / truth.depth_m, np.nan))


def _sharp_db(found: Reconstruction, truth: Truth) -> float:
    inner = next(one for one in picture_scores(found, truth) if one.region == "inner")
    return float(inner.sharpened["psnr"])
