"""One point of a sweep: render, calibrate, reconstruct, and score in units that are comparable between designs.

Tested in tests/validation/studies/sweep/test_point.py.
"""

from __future__ import annotations

import json
import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

import dasim
import recon
from dasim.base.errors import InputError, describe_error
from dasim.base.executors import Outcome
from dasim.base.fingerprint import fingerprint, named_files, text_hash
from dasim.camera import geometry, noise, radiometry
from dasim.camera.specification import Camera
from dasim.dataset import sample, storage
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot
from dasim.simulation.relight import LONGEST_S, MOST_GAIN, exposed, lit_by
from dasim.typing import FloatArray
from dasim.values import Capture, Reconstruction, Truth
from validation.methods import function, reconstructed
from validation.scores import pictures as picture_scores
from validation.scores.depth import near_side
from validation.studies import criteria
from validation.studies.sweep import second_camera
from validation.studies.sweep.designs import camera_of, method_of, own_methods, scene_of, settings_of
from validation.studies.sweep.specification import StudySpec, Unit, Value, units

BOUND_BLURS = 10  # number of blurs at which the bound is computed; its logarithm is interpolated between them
FLAT = 1e-3  # largest relative range of blur over a board that counts as one distance
FOCUS_BLUR_PX = 0.5  # least visible blur for the bound: nearer to focus, blur carries no depth and the bound diverges
MOST_BEYOND = 0.5  # largest share of pixels outside the bank's depth range for which a median error is reported
BASELINE = "stereo.baseline_mm"
QUANTILES = 200  # number of quantiles that represent the deviations of all pixels
OTHER_SEED = 1_000_000  # added to the seed for the second camera, which has independent noise; also its sensor's
FIGURES = {
    "light-loss": ("1", "share of the light lost to the stops, eq. (1) for the camera's mosaic"),
    "infrared-snr": ("1", "median signal-to-noise ratio of the infrared pixels"),
    "in-range": ("1", "share of the pixels between the focal plane and the nearest depth of the PSF bank"),
    "depth-median": (
        "1/m",
        "median absolute error of 1/z over all pixels in front of the focal plane; empty if most are out of range",
    ),
    "depth-rmse": ("1/m", "root mean square error of 1/z over the same pixels"),
    "depth-constant": ("1/m", "median absolute error of 1/z of the best constant depth map"),
    "depth-seen": ("1/m", "median absolute error of 1/z where the visible blur is at least 3 px"),
    "depth-bound": ("1/m", "Cramer-Rao bound of depth-seen, for a patch of natural texture"),
    "depth-median-m": ("m", "median absolute error of z"),
    "depth-rmse-m": ("m", "root mean square error of z"),
    "depth-bound-m": ("m", "Cramer-Rao bound of the median error of z, at the median depth"),
    "half-pixel-m": ("m", "depth error of half a pixel of blur, d^2 N p / (2 f^2) as in Fig. 13, at the median depth"),
    "coverage": ("1", "share of the pixels in front of the focal plane with a raw estimate"),
    "psnr": ("dB", "PSNR of the all-in-focus picture against the sharp truth, linear light"),
    "psnr-gain": ("dB", "PSNR of the all-in-focus picture less that of the captured picture"),
    "ciede2000": ("1", "mean colour difference between the all-in-focus picture and the sharp truth"),
    "matched-defocus": ("1/m", "median absolute error of 1/z by defocus, where both cameras see and match the point"),
    "stereo-median": ("1/m", "median absolute error of 1/z by stereo, where both cameras see and match the point"),
    "matched-combined": (
        "1/m",
        "median absolute error of 1/z by stereo and defocus, where both cameras see and match the point",
    ),
    "stereo-coverage": ("1", "share of the pixels in front of the focal plane with a stereo match"),
    "combined-median": (
        "1/m",
        "median absolute error of 1/z by stereo and defocus, all pixels in front of the focal plane",
    ),
    "combined-rmse": (
        "1/m",
        "root mean square error of 1/z by stereo and defocus, all pixels in front of the focal plane",
    ),
    "occluded-share": ("1", "share of the pixels that the second camera does not see"),
    "occluded-median": (
        "1/m",
        "median absolute error of 1/z by stereo and defocus, where the second camera does not see the point",
    ),
    "occluded-matched": ("1", "share of the pixels unseen by the second camera that have a (false) stereo match"),
    "seconds": ("s", "time to measure the point, including its share of the rendering"),
}


@dataclass(frozen=True)
class Sweep:
    """What a worker needs to measure a unit: the study, the output folder and the software environment.

    ``code`` is the fingerprint of the code that measures; by default it is computed.
    """

    spec: StudySpec
    out: str
    environment: dict[str, Any]
    code: str = ""

    def __post_init__(self) -> None:
        if not self.code:
            object.__setattr__(self, "code", code(self.spec, self.environment["variant"]))


def code(spec: StudySpec, variant: str) -> str:
    """Fingerprint of the code that measures a unit, a user's depth methods among it, its data and libraries."""
    methods = (function(method) for method in own_methods(spec))
    return fingerprint(measure, *methods, variant=variant, excluding=("cameras", "scenes"))


def file_of(job: Sweep, unit: Unit) -> str:
    """The file of a unit's rows in the output folder.

    Its name is a hash of everything that determines the rows, and does not depend on where dasim is installed.
    """
    spec = job.spec
    described = scene_of(spec, unit.render)
    scene = described.model_dump(mode="json", exclude={"folder"})
    design = [camera_of(spec, unit.render).model_dump(mode="json"), scene, named_files(scene, described.folder)]
    fixed = [spec.preset, spec.size_px, spec.spp, unit, job.environment]
    return f"points/{text_hash([json.dumps([design, fixed], sort_keys=True, default=str), job.code])}.json"


def work(job: Sweep, index: int) -> Outcome:
    """Measure a unit in this process and write its rows; errors are reported in the outcome, not raised."""
    begin = time.perf_counter()
    unit = units(job.spec)[index]
    try:
        if code(job.spec, job.environment["variant"]) != job.code:
            return Outcome(index, "this worker has other code than the study: figures would not compare", fatal=True)
        sample.activate(job.environment["variant"])
        rows = measure(job.spec, unit)
    except Exception as error:
        return Outcome(index, describe_error(error))
    try:
        storage.write(job.out, file_of(job, unit), sample.json_bytes(rows))
    except Exception as error:  # each store raises its own
        return Outcome(index, f"cannot be written: {describe_error(error)}", fatal=True)
    return Outcome(index, seconds=time.perf_counter() - begin)


def measure(spec: StudySpec, unit: Unit) -> list[dict[str, Any]]:
    """The rows of a unit's points, with their parameters, seed and figures.

    The picture is rendered and the camera calibrated once; each point exposes, reconstructs and scores it.
    """
    begin = time.perf_counter()
    scene = scene_of(spec, unit.render)
    if "light.illuminant" in unit.render:
        scene = lit_by(scene, str(unit.render["light.illuminant"]))
    camera = dasim.focused(dasim.cropped(camera_of(spec, unit.render), *spec.size_px), scene)
    if "focus_m" in unit.render:
        camera = dasim.refocused(camera, float(unit.render["focus_m"]))
    shot = dasim.simulate(scene, camera, unit.seed, spp=spec.spp)
    bank = recon.calibrate(dasim.calibration_captures(camera, diffraction=shot.capture.provenance["diffraction"]))
    other = None
    if BASELINE in unit.render:
        moved = second_camera.other_view(scene, 1e-3 * float(unit.render[BASELINE]))
        sensor = camera.sensor.model_copy(update={"sensor_seed": OTHER_SEED})
        second_body = camera.model_copy(update={"sensor": sensor})
        other = dasim.simulate(moved, second_body, unit.seed + OTHER_SEED, spp=spec.spp)
    shared = (time.perf_counter() - begin) / len(unit.points)
    rows = []
    for number, point in enumerate(unit.points):
        begin = time.perf_counter()
        capture = capture_of(shot, scene, point, unit.seed * len(unit.points) + number)
        exact = truth_of(shot, capture, scene, point)
        method, settings = method_of(spec, point), settings_of(spec, point)
        result = reconstructed(capture, bank, method, settings)
        values = figures(result, capture, exact)
        values |= limits(capture, exact, shot.capture.illuminant, lux(scene, point))
        if other is not None:
            second = capture_of(other, scene, point, unit.seed * len(unit.points) + number + OTHER_SEED)
            right = reconstructed(second, bank, method, settings)
            baseline_m = 1e-3 * float(unit.render[BASELINE])
            values |= second_camera.errors(result, right, exact, other.truth, baseline_m, bank.depth_m)
        values["seconds"] = shared + time.perf_counter() - begin
        rows.append({"point": point, "seed": unit.seed, "light_chosen": result.light, "figures": values})
    return rows


def capture_of(shot: Shot, scene: Scene, point: dict[str, Value], seed: int) -> Capture:
    """A capture of the shot at the point's light level, with the point's limits of exposure time and gain."""
    longest_s = float(point.get("exposure.longest_s", LONGEST_S))
    most_gain = float(point.get("exposure.most_gain", MOST_GAIN))
    return exposed(shot, light_ratio(scene, point), seed, longest_s=longest_s, most_gain=most_gain)


def lux(scene: Scene, point: dict[str, Value]) -> float:
    """Illuminance in lux of a point, by default that of all lights of the scene together."""
    return float(point.get("light.lux", sum(getattr(light, "lux", 0.0) for light in scene.lights)))


def light_ratio(scene: Scene, point: dict[str, Value]) -> float:
    """Ratio of the point's illuminance to that of the scene's file."""
    return lux(scene, point) / lux(scene, {})


def limits(capture: Capture, truth: Truth, light: str | None, level_lux: float) -> dict[str, float]:
    """Theoretical limits of depth: the Cramer-Rao bound in dioptres and metres, and half a pixel of blur (Fig. 13).

    ``light`` is the illuminant, ``level_lux`` its illuminance; metres refer to the median depth.
    """
    camera = capture.camera
    depth = truth.depth_m[near_side(truth)]
    if not depth.size:
        return dict.fromkeys(("depth-bound", "depth-bound-m", "half-pixel-m"), math.nan)
    least, square = bound(camera, depth, light, level_lux), float(np.median(depth)) ** 2
    focal_m = camera.lens.focal_length_mm * 1e-3
    half = square * camera.lens.f_number * camera.sensor.pixel_pitch_um * 1e-6 / (2 * focal_m**2)
    return {"depth-bound": least, "depth-bound-m": least * square, "half-pixel-m": half}


def bound(camera: Camera, depth_m: NDArray, light: str | None, level_lux: float) -> float:
    """Cramer-Rao bound of the median absolute error of 1/z over the pixels of ``depth-seen``; NaN without pixels.

    It is the median of normal errors that have the bound's standard deviation at each pixel's blur, for a patch of
    unknown natural texture; the texture of the scene has no influence. If no pixel has the blur of ``depth-seen``,
    all pixels with at least half a pixel of blur count.
    """
    blur = np.asarray(geometry.blur_px(camera, depth_m.astype(np.float64)))
    for least in (criteria.NEAREST_BLUR_PX, FOCUS_BLUR_PX):
        if (part := blur[blur >= least]).size:
            break
    else:
        return math.nan
    grid = np.linspace(part.min(), part.max(), BOUND_BLURS if np.ptp(part) > FLAT * part.max() else 1)
    try:
        deviation = criteria.camera_bound(camera, grid, light=str(light), level_lux=level_lux)
    except InputError:  # the camera lacks a green or an infrared plane
        return math.nan
    if not np.isfinite(deviation).all():  # all stops have the same blur
        return math.nan
    return median_error(np.exp(np.interp(part, grid, np.log(deviation / criteria.dioptre_px(camera)))))


def median_error(deviation: FloatArray) -> float:
    """Median absolute value of a mixture of normal errors with the given standard deviations, all finite."""
    of_all = np.quantile(deviation, (np.arange(QUANTILES) + 0.5) / QUANTILES)

    def beyond_half(size: float) -> float:
        return float(np.mean(2 * stats.norm.cdf(size / of_all) - 1)) - 0.5

    return float(optimize.brentq(beyond_half, 0.0, float(of_all[-1])))  # at least 68 % of errors are below the largest


def truth_of(shot: Shot, capture: Capture, scene: Scene, point: dict[str, Value]) -> Truth:
    """The truth, with its electrons scaled to the light level and exposure time of a capture."""
    factor = light_ratio(scene, point) * capture.exposure_s / shot.capture.exposure_s
    return shot.truth.scaled(factor)


def figures(result: Reconstruction, capture: Capture, truth: Truth) -> dict[str, float]:
    """Figures of a reconstruction in units that are comparable between designs (see ``FIGURES``)."""
    pictures = {score.region: score for score in picture_scores.picture_scores(result, truth)}
    sharp, captured = pictures["inner"].sharpened, pictures["inner"].captured
    return {
        "light-loss": radiometry.light_loss(capture.camera),
        "infrared-snr": infrared_snr(capture, truth),
        **depth_figures(result, truth),
        "psnr": sharp["psnr"],
        "psnr-gain": sharp["psnr"] - captured["psnr"],
        "ciede2000": sharp["ciede2000"],
    }


def depth_figures(result: Reconstruction, truth: Truth) -> dict[str, float]:
    """Depth errors over all pixels in front of the focal plane; without errors if most are out of the bank's range."""
    near = near_side(truth)
    share = float((near & (truth.level <= len(geometry.level_blur_px(result.camera)) - 0.5))[truth.valid].mean())
    result_figures = {
        "in-range": share,
        "coverage": float(np.isfinite(result.level_raw[near]).mean()) if near.any() else 0.0,
    }
    if share < 1 - MOST_BEYOND:
        return result_figures
    exact, estimate = (1 / np.maximum(a[near].astype(np.float64), 1e-3) for a in (truth.depth_m, result.depth_m))
    error, metres = estimate - exact, 1 / estimate - 1 / exact
    out_of_focus = truth.blur_px[near] >= criteria.NEAREST_BLUR_PX
    return result_figures | {
        "depth-median": float(np.median(np.abs(error))),
        "depth-seen": float(np.median(np.abs(error[out_of_focus]))) if out_of_focus.any() else math.nan,
        "depth-rmse": float(np.sqrt(np.mean(error**2))),
        "depth-constant": float(np.median(np.abs(exact - np.median(exact)))),
        "depth-median-m": float(np.median(np.abs(metres))),
        "depth-rmse-m": float(np.sqrt(np.mean(metres**2))),
    }


def infrared_snr(capture: Capture, truth: Truth) -> float:
    """Median ratio of signal to temporal noise of the infrared pixels."""
    electrons = truth.mean_e[..., truth.channels.index("IR")][truth.valid].astype(np.float64)
    variance = noise.temporal_variance(capture.camera.sensor, capture.exposure_s, capture.gain).at(electrons)
    return float(np.median(electrons / np.sqrt(variance)))
