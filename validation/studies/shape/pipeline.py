"""A mask in the whole pipeline: rendered wave-true, calibrated, reconstructed and scored, beside what was predicted."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.base import atomic
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.scene import targets
from dasim.scene.specification import Scene
from dasim.simulation.relight import exposed
from dasim.simulation.simulate import Shot
from dasim.typing import FloatArray, Progress
from dasim.values import Capture, Reconstruction, Truth
from validation.gates import stored
from validation.scores import texture
from validation.scores.pictures import picture_scores
from validation.scores.score import depth_of_level
from validation.subjects import rendering
from validation.subjects.shots import photographed

LIGHT = "D55"  # the desk's; one light, so that a mask's kernels are calibrated in a minute or two
LEVELS = (5, 11, 17, 23)  # of boards with one texture: visible blurs of 9 to 43 px with a hole of 0.46
BOARD_PX, DESK_PX = (384, 288), (256, 192)
SPP = 64
EXPOSURES = 3  # of each picture, with noise of their own
# The default compares means over rings of frequencies, for which round stops were assumed, and keeps what it is sure
# of; the paper's own, eq. (9) to (12), and its likelihood take kernels as they are.
PRESETS = ("bands", "paper", "likelihood")
ALL = {"least_confidence": 0.0, "edge_snr": 0.0, "fallback": False}  # a level for every pixel, from infrared alone
BORDER_PX = 64  # of a board's picture, that lacks half of its surroundings, and what deblurring carries inwards


@dataclass(frozen=True)
class Proof:
    """Errors of one design in the pipeline; depth in dioptres, of raw levels at all textured pixels."""

    board_deviation: tuple[tuple[float, ...], ...]  # [exposure, level], root mean square about the median: no bias
    board_error: tuple[tuple[float, ...], ...]  # [exposure, level], root mean square
    board_coverage: tuple[float, ...]  # [level], share of textured pixels that the preset itself gives a level
    board_sharp_db: tuple[float, ...]  # [level], PSNR of the preset's all-in-focus picture
    desk_error: tuple[float, ...]  # [exposure], median absolute
    desk_sharp_db: float

    @property
    def deviations(self) -> tuple[float, ...]:
        """Over the boards, root mean square without bias, [exposure]."""
        return tuple(rms(one) for one in self.board_deviation)

    @property
    def errors(self) -> tuple[float, ...]:
        """Over the boards, root mean square, [exposure]."""
        return tuple(rms(one) for one in self.board_error)


def rms(values: Sequence[float] | FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def ratio(one: Sequence[float], other: Sequence[float]) -> tuple[float, float]:
    """Mean of the ratios of two designs, exposure by exposure, and their standard deviation."""
    ratios = np.asarray(one) / np.asarray(other)
    return float(ratios.mean()), float(ratios.std(ddof=1)) if len(ratios) > 1 else float("nan")


def proof(
    camera: Camera,
    folder: Path,
    preset: str = PRESETS[0],
    seed: int = 0,
    progress: Progress = lambda stage, share: None,
) -> Proof:
    """Render, calibrate, reconstruct and score; or what an earlier run has left in ``folder`` for the same camera.

    Designs are compared where all have a level: depth is scored with the preset's thresholds of confidence off.
    """
    rendering.needs_wave()
    variant = rendering.activate()
    what = [camera.model_dump_json(), preset, stored.key(proof, variant, seed)]
    return Proof(**kept(folder, what, lambda: asdict(_proved(camera, preset, seed, progress))))


def kept(folder: Path, what: list[str], make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """What was made before of the same, from ``folder``; or made now and left there. Lists come as tuples."""
    path = folder / f"{stored.hashed(what)}.json"
    if not path.is_file():
        found = json.dumps(make(), indent=1)
        atomic.write(path, found + "\n")
    return {name: _frozen(value) for name, value in json.loads(path.read_text()).items()}


def _proved(camera: Camera, preset: str, seed: int, progress: Progress) -> Proof:
    bank = recon.calibrate(dasim.calibration_captures(camera, lights=(LIGHT,)), progress=progress)
    own = recon.PRESETS[preset]
    everywhere = own.model_copy(update=ALL)
    boards, coverage, sharp = [], [], []
    for number, (scene, cropped) in enumerate(lit_boards(camera)):
        progress("boards", number / len(LEVELS))
        shot = photographed(scene, cropped, seed, spp=SPP)
        found = recon.reconstruct(shot.capture, bank, own)
        where = inner(texture.textured(shot.capture))
        coverage.append(float(np.isfinite(found.level_raw[where]).mean()))
        sharp.append(_sharp_db(found, shot.truth))
        boards.append(
            [_board_scores(recon.reconstruct(one, bank, everywhere), shot.truth, where) for one in exposures(shot)]
        )
    desk = dasim.load_scene("desk")
    assert isinstance(desk, Scene)
    shot = photographed(desk, cameras.cropped(camera, *DESK_PX), seed, spp=SPP)
    sharp_db = _sharp_db(recon.reconstruct(shot.capture, bank, own), shot.truth)
    where = texture.textured(shot.capture) & ~shot.truth.boundary
    desks = []
    for one in exposures(shot):
        error = _dioptre_errors(recon.reconstruct(one, bank, everywhere), shot.truth)[where]
        desks.append(float(np.nanmedian(np.abs(error))))
    scores = np.array(boards)  # [level, exposure, score]
    return Proof(
        _frozen(scores[..., 0].T.tolist()), _frozen(scores[..., 1].T.tolist()), tuple(coverage), tuple(sharp),
        tuple(desks), sharp_db,
    )  # fmt: skip


def _frozen(value: Any) -> Any:
    return tuple(_frozen(one) for one in value) if isinstance(value, list) else value


def exposures(shot: Shot) -> Iterator[Capture]:
    """The picture itself and others of the same light with noise of their own: renders are the costly part."""
    yield shot.capture
    for seed in range(1, EXPOSURES):
        yield exposed(shot, 1.0, shot.capture.seed + 1000 * seed)


def lit_boards(camera: Camera) -> Iterator[tuple[Scene, Camera]]:
    """Boards of one texture at each of ``LEVELS``, and the camera that sees them."""
    own = cameras.cropped(camera, *BOARD_PX)
    for level in LEVELS:
        scene = targets.staircase(own, level)
        lights = tuple(light.model_copy(update={"illuminant": LIGHT}) for light in scene.lights)
        yield scene.model_copy(update={"lights": lights}), own


def inner(textured: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Textured pixels that are far from the border."""
    mask = np.zeros(textured.shape, bool)
    mask[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    return mask & textured


def _board_scores(found: Reconstruction, truth: Truth, where: NDArray[np.bool_]) -> tuple[float, float]:
    one = _dioptre_errors(found, truth)[where]
    one = one[np.isfinite(one)]  # without a level are those alone whose infrared has no energy above its noise
    if not one.size:
        return float("nan"), float("nan")
    return float(np.sqrt(np.mean((one - np.median(one)) ** 2))), rms(one)


def _dioptre_errors(found: Reconstruction, truth: Truth) -> FloatArray:
    """Error of the raw levels in dioptres, [h, w]; NaN without a level or where nothing is."""
    raw_m = np.where(np.isfinite(found.level_raw), depth_of_level(found.level_raw, found), np.nan)
    return np.asarray(np.where(truth.valid, 1 / raw_m - 1 / truth.depth_m, np.nan))


def _sharp_db(found: Reconstruction, truth: Truth) -> float:
    inner = next(one for one in picture_scores(found, truth) if one.region == "inner")
    return float(inner.sharpened["psnr"])
