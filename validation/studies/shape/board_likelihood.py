"""From the bound to the pipeline: bounds of a patch, and maximum likelihood on rendered boards.

The periodic bound overstates the information in an isolated patch. The bound of
:mod:`validation.studies.shape.finite_patch` understates the information in a picture, which also shows the surroundings
of a patch, up to its border and as long as depth stays the same. :func:`board_deviations` is the error of maximum
likelihood on rendered boards that fill the frame, with the camera's own kernels and the texture's own power: the
pipeline without its bank, levels, presets and thresholds. It is not a lower bound. It assumes that the surroundings
continue beyond the frame. Near the border, deblurring with the two-window stop spreads the error from the missing part
far inwards, and a preset that fits gain and scale in each patch can be better.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.bounds import cramer_rao, pupils
from dasim.camera import geometry
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera
from dasim.simulation.exposure import Shot
from dasim.typing import FloatArray
from dasim.values import Capture
from recon import fourier
from recon.depth.grid import transform
from recon.picture import mosaic
from validation.gates import stored
from validation.scores import texture
from validation.studies import criteria
from validation.studies.criteria import PLANES, SPACING_PX
from validation.studies.shape import boards, cached
from validation.studies.shape.finite_patch import LOWEST, SIDE, cut_deviation
from validation.subjects import rendering
from validation.subjects.shots import photographed

WINDOWS_PX = (31.0, 63.0)
STEP_PX, AROUND_PX = 0.5, 8.0  # candidates of the visible blur around the true one
CELLS = 64  # of transforms across the lens
MARGIN = 40  # samples, over which opposite borders are blended
WELCH_SHAPE = (64, 64)  # of the patches from which the texture's power is estimated


@dataclass(frozen=True)
class Limits:
    """Limits of estimators at the boards' blurs, in dioptres: two bounds, and likelihood on rendered boards."""

    periodic: tuple[float, ...]  # [level], bound of a periodic patch of 31 px
    cut: tuple[float, ...]  # [level], bound of a patch of 31 px without its surroundings
    board: tuple[tuple[float, ...], ...]  # [exposure, level], likelihood with a window of 31 px
    wide: tuple[tuple[float, ...], ...]  # [exposure, level], likelihood with a window of 63 px

    def steps(self) -> dict[str, tuple[float, ...]]:
        """Root mean square over the levels at each step, [exposure], or one value for a bound."""
        return {
            "bound, periodic patch": (boards.rms(self.periodic),),
            "bound, patch without surroundings": (boards.rms(self.cut),),
            "likelihood on rendered boards": tuple(boards.rms(one) for one in self.board),
            "likelihood, window of 63 px": tuple(boards.rms(one) for one in self.wide),
        }


def limits(camera: Camera, light: str, level_lux: float) -> Limits:
    """Bounds under ``light`` at ``level_lux``, and likelihoods, at the boards' blurs; cached."""
    variant = rendering.activate()
    key = [camera.model_dump_json(), light, f"{level_lux}", stored.key(limits, variant, boards.SEED)]

    def compute() -> dict[str, Any]:
        blurs = geometry.level_blur_px(camera)[list(boards.LEVELS)]
        periodic = criteria.camera_bound(camera, blurs, light=light, level_lux=level_lux, texture="spectrum")
        cut = cut_deviation(camera, blurs, SIDE, light=light, level_lux=level_lux)
        board, wide = board_deviations(camera).tolist()
        px = criteria.dioptre_px(camera)
        return asdict(Limits((periodic / px).tolist(), (cut / px).tolist(), board, wide))

    return Limits(**cached.figures(key, compute))


def board_deviations(camera: Camera) -> FloatArray:
    """Deviation of the most likely blur on rendered boards in dioptres, [window, exposure, level].

    Root mean square over the textured pixels about the median of each board, as in the scores of the pipeline.
    """
    deviations = np.empty((len(WINDOWS_PX), boards.EXPOSURES, len(boards.LEVELS)))
    for level, (scene, cropped) in enumerate(boards.lit_boards(camera)):
        shot = photographed(scene, cropped, boards.SEED, spp=boards.SPP)
        where = boards.inner(texture.textured(shot.capture))[::2, ::2]
        blur = float(geometry.blur_px(camera, float(np.nanmedian(shot.truth.depth_m))))
        candidates = np.arange(max(blur - AROUND_PX, STEP_PX), blur + AROUND_PX + STEP_PX / 2, STEP_PX)
        for exposure, capture in enumerate(boards.exposures(shot)):
            for row, likelihood in enumerate(_log_likelihoods(capture, shot, candidates)):
                error = _most_likely(likelihood, candidates)[where] - blur
                deviations[row, exposure, level] = np.sqrt(np.mean((error - np.median(error)) ** 2))
    return deviations / criteria.dioptre_px(camera)


def _log_likelihoods(capture: Capture, shot: Shot, candidates: FloatArray) -> list[FloatArray]:
    """Log likelihood of each candidate blur at each sample, [candidate, h, w], for each of ``WINDOWS_PX``.

    The joint likelihood of both planes: of infrared, and of green minus its prediction from infrared, each whitened.
    """
    camera = capture.camera
    electrons, _ = mosaic.linearise(capture)
    planes, places = mosaic.planes(electrons, camera), mosaic.phases(camera)
    height, width = planes["G"].shape
    side = fourier.fast_shape((max(height, width),) * 2, MARGIN)[0]
    spectra = [transform(np.ascontiguousarray(planes[n]), places[n], (side, side)) for n in PLANES]
    collected = mosaic.planes(mosaic.collected(electrons, camera), camera)
    noise = [float(mosaic.noise_variance(capture, name).at(collected[name]).mean()) for name in PLANES]
    gain = float(planes["IR"].mean() / planes["G"].mean())  # the board's white and black are the same in both
    power = _power(shot, side)
    transfer, _ = pupils.stop_transfers(
        camera, candidates, boards.LIGHT, (side, side), spacing_px=SPACING_PX, fine_cells=CELLS
    )
    green_index, infrared_index = (sensors.channels(camera.sensor).index(name) for name in PLANES)
    band = power > 0
    multiplicity = np.broadcast_to(cramer_rao.multiplicity(side), power.shape) / side**2
    likelihoods: list[list[FloatArray]] = [[] for _ in WINDOWS_PX]
    for one in transfer:
        parts, log_determinant = _whitened(spectra, (one[green_index], gain * one[infrared_index]), power, noise)
        images = [fourier.inverse((part * band).astype(np.complex64), (side, side))[:height, :width] for part in parts]
        energy = np.sum([image * image for image in images], axis=0)
        constant = float((log_determinant * multiplicity * band).sum())
        for row, window in enumerate(WINDOWS_PX):
            sigma = window / SPACING_PX / np.sqrt(12)
            mean = cv2.GaussianBlur(energy, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
            likelihoods[row].append(-(mean + constant) / 2)
    return [np.stack(one) for one in likelihoods]


def _whitened(
    spectra: Sequence[NDArray], transfer: Sequence[NDArray], power: FloatArray, noise: Sequence[float]
) -> tuple[tuple[NDArray, NDArray], FloatArray]:
    """Two independent spectra of unit power for those of (green, infrared), and ln det C at each frequency.

    C = power s s^H + diag(noise), s the two ``transfer`` functions. The first spectrum is infrared, the second green
    minus its prediction from infrared (Cholesky's factorisation of C).
    """
    green, infrared = transfer
    infrared_power = power * np.abs(infrared) ** 2 + noise[1]
    across = power * green * np.conj(infrared)
    residual_power = power * np.abs(green) ** 2 + noise[0] - np.abs(across) ** 2 / infrared_power
    residual = spectra[0] - across / infrared_power * spectra[1]
    whitened = (spectra[1] / np.sqrt(infrared_power), residual / np.sqrt(residual_power))
    return whitened, np.log(infrared_power) + np.log(residual_power)


def _power(shot: Shot, side: int) -> FloatArray:
    """Power of the texture in green, [side, side/2 + 1], from the truth's sharp picture; 0 below ``LOWEST``.

    A power law is fitted to Welch's estimate up to 0.25 cycles/px, the Nyquist frequency of the planes.
    """
    names = sensors.channels(shot.capture.camera.sensor)
    sharp = shot.truth.sharp_e[..., names.index("G")].astype(np.float64)
    known = cramer_rao.picture_power(np.nan_to_num(sharp, nan=float(np.nanmean(sharp))), WELCH_SHAPE)
    rings = np.rint(np.hypot(*cramer_rao.frequencies(WELCH_SHAPE, 1.0)) * WELCH_SHAPE[0]).astype(int)
    mean = np.bincount(rings.ravel(), known.ravel()) / np.bincount(rings.ravel())
    frequency = np.arange(2, len(mean)) / WELCH_SHAPE[0]  # the window leaks the rest of the mean into the first
    radius = np.hypot(*cramer_rao.frequencies((side, side), SPACING_PX))
    slope, level = np.polyfit(np.log(frequency[:16]), np.log(mean[2:18]), 1)
    density = np.exp(level) * np.maximum(radius, LOWEST) ** slope / SPACING_PX**2
    return np.asarray(np.where(radius >= LOWEST, density, 0.0))


def _most_likely(likelihood: FloatArray, candidates: FloatArray) -> FloatArray:
    """The candidate of the largest likelihood at each sample, [h, w], refined by a parabola through its neighbours."""
    peak = likelihood.argmax(axis=0)
    middle = np.clip(peak, 1, len(candidates) - 2)
    before, at, after = (np.take_along_axis(likelihood, (middle + d)[None], 0)[0] for d in (-1, 0, 1))
    bend = 2 * at - before - after
    move = np.where((peak == middle) & (bend > 0), (after - before) / (2 * np.where(bend > 0, bend, 1)), 0)
    return np.interp(np.where(peak == middle, middle + move, peak), np.arange(len(candidates)), candidates)
