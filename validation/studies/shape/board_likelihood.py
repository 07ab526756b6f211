"""Why a bound of a patch is not what a pipeline gets: patches without their surroundings, and boards step by step.

The bound takes a patch for periodic: what a wide kernel brings in from outside looks like the patch itself. Cut out of
a larger picture it tells less, since the surroundings are unknown; :func:`cut_deviation` is its bound, from the
covariances between all of its pixels. A picture does show the surroundings, up to its border and as long as depth stays
the same; :func:`board_deviations` is what maximum likelihood makes of rendered boards that fill the frame, with the
camera's own kernels and the texture's own power. It stands for what is left when bank, levels, presets and their
thresholds are taken away, and is no lower limit: it trusts that the surroundings go on, and at a frame's border, where
deblurring two windows carries what is missing far inwards, a preset that fits gain and scale in each patch can do
better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from dasim.bounds import cramer_rao, pupils
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.simulation.simulate import Shot
from dasim.typing import FloatArray
from dasim.values import Capture
from recon import fourier
from recon.depth import scores as depth
from recon.picture import mosaic
from validation.gates import stored
from validation.scores import texture
from validation.studies import criteria
from validation.studies.shape import pipeline
from validation.subjects import rendering
from validation.subjects.shots import photographed

SPACING_PX = criteria.SPACING_PX
SIDE = 16  # samples 2 px apart: a patch of 31 px
FIELD = 128  # samples a side of the field that patches are cut from
STEP_PX, AROUND_PX = 0.5, 8.0  # candidates of the visible blur about the true one
CELLS = 64  # of transforms across the lens
MARGIN = 40  # samples, in which opposite borders are blended
LOWEST = 1 / 64  # cycles/px, the lowest of the bound's grid


@dataclass(frozen=True)
class Reach:
    """What estimators can reach on the boards' blurs, dioptres; all but the first two on rendered boards."""

    periodic: tuple[float, ...]  # [level], bound of a periodic patch of 31 px
    cut: tuple[float, ...]  # [level], bound of a patch of 31 px cut out of its surroundings
    board: tuple[tuple[float, ...], ...]  # [exposure, level], likelihood with a window of 31 px
    wide: tuple[tuple[float, ...], ...]  # [exposure, level], with one of 63 px

    def steps(self) -> dict[str, tuple[float, ...]]:
        """Root mean square over the levels of each step, [exposure] or one."""
        return {
            "bound, periodic patch": (pipeline.rms(self.periodic),),
            "bound, patch without surroundings": (pipeline.rms(self.cut),),
            "likelihood on rendered boards": tuple(pipeline.rms(one) for one in self.board),
            "likelihood, window of 63 px": tuple(pipeline.rms(one) for one in self.wide),
        }


def reach(camera: Camera, folder: Path, light: str, level_lux: float, seed: int = 0) -> Reach:
    """Bounds and likelihoods at the boards' blurs; or what an earlier run has left in ``folder``."""
    variant = rendering.activate()
    what = [camera.model_dump_json(), light, f"{level_lux}", stored.key(reach, variant, seed)]

    def make() -> dict[str, Any]:
        blurs = geometry.level_blur_px(camera)[list(pipeline.LEVELS)]
        transfer, slope = pupils.camera_transfers(camera, blurs, light, criteria.SHAPE, spacing_px=SPACING_PX)
        index = [cameras.channels(camera.sensor).index(name) for name in criteria.PLANES]
        seen = criteria.sight(camera, light, level_lux)
        variance, _ = criteria.blur_variance(transfer[:, index], slope[:, index], seen, "spectrum")
        cut = cut_deviation(camera, blurs, SIDE, light=light, level_lux=level_lux)
        boards = board_deviations(camera, seed=seed).tolist()
        px = criteria.dioptre_px(camera)
        return asdict(Reach((np.sqrt(variance) / px).tolist(), (cut / px).tolist(), boards[0], boards[1]))

    return Reach(**pipeline.kept(folder, what, make))


def cut_deviation(
    camera: Camera,
    blur_px: FloatArray,
    side: int,
    *,
    light: str = "D65",
    level_lux: float = 5000.0,
    planes: tuple[str, ...] = criteria.PLANES,
) -> FloatArray:
    """Least standard deviation of the visible blur from ``side`` x ``side`` samples of each plane alone, px, [blur].

    Slepian and Bangs with the covariances between all samples; the texture's strength and the gain are unknown, its
    spectrum is known. ``side`` is at most half of ``FIELD``.
    """
    if 2 * side > FIELD:
        raise ValueError("the field must be twice the patch at least")
    seen = criteria.sight(camera, light, level_lux, planes)
    index = [cameras.channels(camera.sensor).index(name) for name in planes]
    shape = (FIELD, FIELD)
    radius = np.hypot(*cramer_rao.frequencies(shape, SPACING_PX))
    contrast = seen.power[0, 4] / cramer_rao.natural_power(criteria.SHAPE, spacing_px=SPACING_PX)[0, 4]
    power = contrast * cramer_rao.natural_power(shape, spacing_px=SPACING_PX) * (radius >= LOWEST)
    y, x = (part.ravel() for part in np.indices((side, side)))
    rows, columns = (part[:, None] - part[None, :] for part in (y, x))
    found = []
    for blur in blur_px:
        both = blur + np.array([-1, 1]) * cramer_rao.SLOPE_STEP_PX
        transfer, _ = pupils.stop_transfers(camera, both, light, shape, spacing_px=SPACING_PX, fine_cells=CELLS)
        s = seen.gain[:, None, None] * transfer[:, index]
        middle, slope = s.mean(axis=0), (s[1] - s[0]) / (2 * cramer_rao.SLOPE_STEP_PX)

        def covariance(one: NDArray, other: NDArray) -> FloatArray:
            spectra = power * one[:, None] * np.conj(other[None])
            return np.block([[np.fft.irfft2(part, shape)[rows, columns] for part in line] for line in spectra])

        signal = covariance(middle, middle)
        half = covariance(slope, middle)
        second = np.where(np.arange(len(planes))[:, None, None] == 1, middle, 0)
        gained = covariance(second, middle)
        factor = linalg.cho_factor(signal + np.diag(np.repeat(seen.noise, side * side)))
        parts = [linalg.cho_solve(factor, part) for part in (half + half.T, signal, gained + gained.T)]
        told = np.array([[0.5 * np.sum(a * b.T) for b in parts] for a in parts])
        found.append(np.sqrt(linalg.inv(told)[0, 0]))
    return np.array(found)


def board_deviations(camera: Camera, window_px: Sequence[float] = (31.0, 63.0), seed: int = 0) -> FloatArray:
    """Deviation of the most likely blur on the boards of :mod:`validation.studies.shape.pipeline`, dioptres.

    [window, exposure, level]; without each board's own bias, as the pipeline's are scored.
    """
    found = np.empty((len(window_px), pipeline.EXPOSURES, len(pipeline.LEVELS)))
    for level, (scene, own) in enumerate(pipeline.lit_boards(camera)):
        shot = photographed(scene, own, seed, spp=pipeline.SPP)
        where = pipeline.inner(texture.textured(shot.capture))[::2, ::2]
        blur = float(geometry.blur_px(camera, float(np.nanmedian(shot.truth.depth_m))))
        candidates = np.arange(max(blur - AROUND_PX, STEP_PX), blur + AROUND_PX + STEP_PX / 2, STEP_PX)
        for exposure, capture in enumerate(pipeline.exposures(shot)):
            for row, scores in enumerate(_scores(capture, shot, candidates, window_px)):
                error = _refined(scores, candidates)[where] - blur
                found[row, exposure, level] = np.sqrt(np.mean((error - np.median(error)) ** 2))
    return found / criteria.dioptre_px(camera)


def _scores(capture: Capture, shot: Shot, candidates: FloatArray, window_px: Sequence[float]) -> list[FloatArray]:
    """Log likelihood of each candidate at each sample, [candidate, h, w], for each window.

    Of both planes together: infrared, and green less what infrared tells of it, each in units of its own power.
    """
    camera = capture.camera
    electrons, _ = mosaic.linearise(capture)
    planes, places = mosaic.planes(electrons, camera), mosaic.phases(camera)
    height, width = planes["G"].shape
    side = fourier.fast_shape((max(height, width),) * 2, MARGIN)[0]
    spectra = [depth.transform(np.ascontiguousarray(planes[n]), places[n], (side, side)) for n in criteria.PLANES]
    noise = [float(mosaic.noise_variance(capture).at(planes[name]).mean()) for name in criteria.PLANES]
    gain = float(planes["IR"].mean() / planes["G"].mean())  # the board's white and black are so in both
    power = _power(shot, side)
    transfer, _ = pupils.stop_transfers(
        camera, candidates, pipeline.LIGHT, (side, side), spacing_px=SPACING_PX, fine_cells=CELLS
    )
    names = cameras.channels(camera.sensor)
    band = power > 0
    times = np.broadcast_to(cramer_rao.multiplicity(side), power.shape) / side**2
    scores: list[list[FloatArray]] = [[] for _ in window_px]
    for full in transfer:
        green, infrared = full[names.index("G")], gain * full[names.index("IR")]
        own = power * np.abs(infrared) ** 2 + noise[1]
        across = power * green * np.conj(infrared)
        left = power * np.abs(green) ** 2 + noise[0] - np.abs(across) ** 2 / own
        parts = (spectra[1] / np.sqrt(own), (spectra[0] - across / own * spectra[1]) / np.sqrt(left))
        images = [fourier.inverse((part * band).astype(np.complex64), (side, side))[:height, :width] for part in parts]
        energy = np.sum([image * image for image in images], axis=0)
        constant = float(((np.log(own) + np.log(left)) * times * band).sum())
        for row, window in enumerate(window_px):
            sigma = window / SPACING_PX / np.sqrt(12)
            mean = cv2.GaussianBlur(energy, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
            scores[row].append(-(mean + constant) / 2)
    return [np.stack(one) for one in scores]


def _power(shot: Shot, side: int) -> FloatArray:
    """Power of green's texture on the grid, [side, side/2 + 1], from the truth's sharp picture; 0 below ``LOWEST``."""
    names = cameras.channels(shot.capture.camera.sensor)
    sharp = shot.truth.sharp_e[..., names.index("G")].astype(np.float64)
    small = (64, 64)
    known = cramer_rao.picture_power(np.nan_to_num(sharp, nan=float(np.nanmean(sharp))), small)
    rings = np.rint(np.hypot(*cramer_rao.frequencies(small, 1.0)) * small[0]).astype(int)
    mean = np.bincount(rings.ravel(), known.ravel()) / np.bincount(rings.ravel())
    frequency = np.arange(2, len(mean)) / small[0]  # the window smears what is left of the mean to the first
    radius = np.hypot(*cramer_rao.frequencies((side, side), SPACING_PX))
    slope, level = np.polyfit(np.log(frequency[:16]), np.log(mean[2:18]), 1)  # to 0.25 cycles/px, the planes' own
    density = np.exp(level) * np.maximum(radius, LOWEST) ** slope / SPACING_PX**2
    return np.asarray(np.where(radius >= LOWEST, density, 0.0))


def _refined(scores: FloatArray, candidates: FloatArray) -> FloatArray:
    """The candidate of the largest score at each sample, between candidates by a parabola, [h, w]."""
    peak = scores.argmax(axis=0)
    middle = np.clip(peak, 1, len(candidates) - 2)
    before, at, after = (np.take_along_axis(scores, (middle + d)[None], 0)[0] for d in (-1, 0, 1))
    bend = 2 * at - before - after
    move = np.where((peak == middle) & (bend > 0), (after - before) / (2 * np.where(bend > 0, bend, 1)), 0)
    return np.interp(np.where(peak == middle, middle + move, peak), np.arange(len(candidates)), candidates)
