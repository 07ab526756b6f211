"""A design in the whole pipeline: rendered with wave optics, calibrated, reconstructed and scored."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene
from dasim.typing import FloatArray
from dasim.values import PsfBank, Reconstruction, Truth
from recon.settings import Settings
from validation.gates import stored
from validation.scores import texture
from validation.scores.pictures import picture_scores
from validation.scores.score import depth_of_level
from validation.studies.shape import boards, cached
from validation.subjects import rendering
from validation.subjects.shots import photographed

DESK_PX = (256, 192)
# The preset bands compares means over rings of frequencies, which assumes round stops, and rejects uncertain levels;
# the paper's eq. (9) to (12) (preset paper) and the preset likelihood use the kernels as they are.
PRESETS = ("bands", "paper", "likelihood")
ALL = {"least_confidence": 0.0, "edge_snr": 0.0, "fallback": False}  # a level for every pixel, from infrared alone


@dataclass(frozen=True)
class PipelineScores:
    """Errors of one design with one preset; depth in dioptres, of raw levels at all textured pixels."""

    board_deviation: tuple[tuple[float, ...], ...]  # [exposure, level], root mean square about the median: no bias
    board_error: tuple[tuple[float, ...], ...]  # [exposure, level], root mean square
    board_coverage: tuple[float, ...]  # [level], share of the textured pixels to which the preset assigns a level
    board_sharp_db: tuple[float, ...]  # [level], PSNR of the preset's all-in-focus picture
    desk_error: tuple[float, ...]  # [exposure], median absolute
    desk_sharp_db: float

    @property
    def deviations(self) -> tuple[float, ...]:
        """Root mean square over the boards, each without its bias, [exposure]."""
        return tuple(boards.rms(one) for one in self.board_deviation)

    @property
    def errors(self) -> tuple[float, ...]:
        """Root mean square over the boards, [exposure]."""
        return tuple(boards.rms(one) for one in self.board_error)


def pipeline_scores(camera: Camera, preset: str) -> PipelineScores:
    """Render, calibrate, reconstruct and score a camera with a preset of ``recon``; cached.

    Depth is scored with the preset's confidence thresholds off, so that designs are compared at the same pixels.
    """
    rendering.needs_wave()
    variant = rendering.activate()
    key = [camera.model_dump_json(), preset, stored.key(pipeline_scores, variant, boards.SEED)]
    return PipelineScores(**cached.figures(key, lambda: asdict(_scored(camera, preset))))


def _scored(camera: Camera, preset: str) -> PipelineScores:
    bank = recon.calibrate(dasim.calibration_captures(camera, lights=(boards.LIGHT,)))
    settings = recon.PRESETS[preset]
    everywhere = settings.model_copy(update=ALL)
    depth, coverage, sharp = [], [], []
    for scene, cropped in boards.lit_boards(camera):
        shot = photographed(scene, cropped, boards.SEED, spp=boards.SPP)
        result = recon.reconstruct(shot.capture, bank, settings)
        where = boards.inner(texture.textured(shot.capture))
        coverage.append(float(np.isfinite(result.level_raw[where]).mean()))
        sharp.append(_sharp_db(result, shot.truth))
        captures = boards.exposures(shot)
        depth.append([board_scores(recon.reconstruct(one, bank, everywhere), shot.truth, where) for one in captures])
    scores = np.array(depth)  # [level, exposure, score]
    desk_error, desk_db = _desk_scores(camera, bank, settings, everywhere)
    return PipelineScores(
        cached.as_tuple(scores[..., 0].T.tolist()),
        cached.as_tuple(scores[..., 1].T.tolist()),
        tuple(coverage),
        tuple(sharp),
        desk_error,
        desk_db,
    )


def _desk_scores(
    camera: Camera, bank: PsfBank, settings: Settings, everywhere: Settings
) -> tuple[tuple[float, ...], float]:
    """Median absolute error of depth on the scene ``desk`` in dioptres, [exposure], and PSNR of its sharp picture."""
    desk = dasim.load_scene("desk")
    assert isinstance(desk, Scene)
    shot = photographed(desk, cameras.cropped(camera, *DESK_PX), boards.SEED, spp=boards.SPP)
    sharp_db = _sharp_db(recon.reconstruct(shot.capture, bank, settings), shot.truth)
    where = texture.textured(shot.capture) & ~shot.truth.boundary
    errors = []
    for one in boards.exposures(shot):
        error = _dioptre_errors(recon.reconstruct(one, bank, everywhere), shot.truth)[where]
        errors.append(float(np.nanmedian(np.abs(error))))
    return tuple(errors), sharp_db


def board_scores(result: Reconstruction, truth: Truth, where: NDArray[np.bool_]) -> tuple[float, float]:
    """Root mean square error of the raw levels in dioptres, about its median and about 0; NaN without any level.

    Of the pixels ``where``, [h, w], that have a level.
    """
    error = _dioptre_errors(result, truth)[where]
    error = error[np.isfinite(error)]  # a level is missing only where infrared has no energy above its noise
    if not error.size:
        return float("nan"), float("nan")
    return boards.rms(error - np.median(error)), boards.rms(error)


def _dioptre_errors(result: Reconstruction, truth: Truth) -> FloatArray:
    """Error of the raw levels in dioptres, [h, w]; NaN without a level and where the truth is not valid."""
    raw_m = np.where(np.isfinite(result.level_raw), depth_of_level(result.level_raw, result), np.nan)
    return np.asarray(np.where(truth.valid, 1 / raw_m - 1 / truth.depth_m, np.nan))


def _sharp_db(result: Reconstruction, truth: Truth) -> float:
    """PSNR of the all-in-focus picture within the frame's inner region."""
    inner = next(one for one in picture_scores(result, truth) if one.region == "inner")
    return float(inner.sharpened["psnr"])
