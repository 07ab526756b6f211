"""Claims of depth: the staircase of Fig. 10, without a mosaic and through the whole camera, against prior work."""

from __future__ import annotations

import cv2
import numpy as np
import skimage.data
from numpy.typing import NDArray
from scipy import signal

import dasim
import recon
from dasim import sensor
from dasim.camera import BLUR_LEVELS, Camera
from dasim.spectra import CHANNELS
from dasim.values import Capture
from recon import depth, mosaic
from recon.settings import Settings
from validation import rendering
from validation.banks import simulated_bank
from validation.claim import Evidence, Progress
from validation.figures import Figure

FloatArray = NDArray[np.float64]

LIGHT = "D65"
TEXTURES = ("gravel", "brick")
NOISE_SHARES = (0.005, 0.01, 0.02)  # of full scale, standard deviation on both channels
STRIP_PX = (128, 224)  # of each level: the window and twice its reach stay clear of the borders
BORDER_PX = 45  # three sigma of the patch and half the largest kernel
WHITE_E = (5000.0, 2500.0, 1250.0)  # green electrons of white paper
CAMERA_PX = (160, 160)
EXPOSURE_S = 0.05  # for the dark signal; the light is set by WHITE_E
CAMERA_TEXTURE = "gravel"
WHITE_PERCENTILE = 99.9  # of the sharp picture: its white paper
SMALL_BLUR = 4  # levels below this: where the paper says its advantage is largest
OURS = ("paper", "likelihood")
SCORES = {
    "paper": recon.PRESETS["paper"],
    "likelihood": recon.PRESETS["likelihood"],
    "chakrabarti-zickler": recon.PRESETS["chakrabarti-zickler"],
    "published-diagonals": recon.PRESETS["chakrabarti-zickler"].model_copy(update={"diagonals": "published"}),
}


def staircase(progress: Progress) -> Evidence:
    """Levels are estimated without bias, and with little noise, on a texture blurred with the camera's kernels.

    Rationale: the paper's Fig. 10, the measure of its depth estimation.

    Set-up: photographs of scikit-image, gravel and brick, 1 at their full scale; green and infrared blurred with the
    kernels of each of the 29 levels of the bank of da-mobile under D65 by scipy's convolution, no mosaic,
    Gaussian noise of 0.5, 1 and 2 % of full scale on both. The depth code of the pipeline with samples one pixel apart;
    the estimate of every pixel that shows an edge, 45 px from a strip's borders. Presets paper, likelihood (levels
    scored by likelihood, not NCC) and chakrabarti-zickler, the last also with the diagonals of its published code.

    Expectation: mean over the levels of the estimate's absolute bias, and of its standard deviation.

    Limit: 0.05 / 0.1, 0.1 / 0.3 and 0.2 / 0.6 levels, of the presets paper and likelihood on
    gravel; brick has less contrast, at 2 % noise not at every level an edge (NaN), and is reported.

    Source: Fig. 10.
    """
    bank = simulated_bank(dasim.load_camera("da-mobile"))
    kernels = bank.kernel[bank.lights.index(LIGHT)]
    figures, tables = [], []
    runs = [(t, n, s) for t in TEXTURES for n in NOISE_SHARES for s in SCORES]
    for done, (texture, noise, name) in enumerate(runs):
        if texture == TEXTURES[1] and name not in OURS:
            continue
        bias, deviation, error, rows = _no_mosaic(texture, noise, kernels, SCORES[name])
        label = f"{name}.{texture}.{100 * noise:g}"
        said = f"{texture}, noise of {100 * noise:g} % of full scale, {name}: mean over 29 levels of the"
        figures.append(Figure(f"{label}.bias", bias, "levels", f"{said} absolute bias"))
        figures.append(Figure(f"{label}.deviation", deviation, "levels", f"{said} standard deviation"))
        figures.append(Figure(f"{label}.error", error, "levels", f"{said} absolute error"))
        tables.append((f"{said[:-26]}", ["level", "mean", "standard deviation"], rows))
        progress((done + 1) / len(runs))
    return Evidence(figures, tables=tables)


def staircase_camera(progress: Progress) -> Evidence:
    """Through the whole camera, levels are estimated better than by the closest prior work.

    Rationale: the second half of Fig. 10: a comparison with Chakrabarti and Zickler on equal terms.

    Set-up: the scene staircase:LEVEL (gravel) at each of the 29 levels, central 160 x 160 px of da-mobile focused at
    2 m, rendered; exposed so that the texture's white paper gives 5,000, 2,500 and 1,250 green electrons; sensor model
    with mosaic and noise. Raw levels of the colour planes' blocks, 45 px from the border, that show an edge, the same
    for all; the same bank, patches and band of edges for all. Presets paper and likelihood, and chakrabarti-zickler
    with the right and with the published diagonals.

    Expectation: mean absolute error over the levels, and over those below 4, relative to chakrabarti-zickler's.

    Limit: below 1 at every noise level; at small blur below 0.9 for the preset paper, below 0.7 for likelihood.

    Source: sec. 6.1: more accurate, particularly when the blur is small, and more robust to noise.
    """
    rendering.needs_wave()
    camera = dasim.cropped(dasim.focused(dasim.load_camera("da-mobile"), dasim.load_scene("staircase")), *CAMERA_PX)
    rates = []
    for level in range(BLUR_LEVELS):
        scene = dasim.load_scene(f"staircase:{level}:{CAMERA_TEXTURE}", camera=camera)
        shot = dasim.simulate(scene, camera, seed=level)
        rates.append((shot.truth.mean_e / shot.capture.exposure_s, shot.truth.sharp_e / shot.capture.exposure_s))
        progress(0.7 * (level + 1) / BLUR_LEVELS)
    green = CHANNELS.index("G")
    white = float(np.percentile([sharp[..., green] for _, sharp in rates], WHITE_PERCENTILE))
    bank = simulated_bank(camera)
    kernels = bank.kernel[bank.lights.index(LIGHT)]
    figures, tables = [], []
    for number, white_e in enumerate(WHITE_E):
        means = {}
        for name, settings in SCORES.items():
            errors = [
                _camera_levels(mean * white_e / white, camera, level, kernels, settings) - level
                for level, (mean, _) in enumerate(rates)
            ]
            bias, deviation, absolute, rows = _summary(errors)
            small = float(np.mean([np.abs(e).mean() for e in errors[:SMALL_BLUR]])) if rows else float("nan")
            means[name] = absolute, small
            label, said = f"{name}.white-{white_e:g}", f"white at {white_e:g} electrons, {name}:"
            for key, value, what in (
                ("bias", bias, "mean absolute bias"),
                ("deviation", deviation, "mean standard deviation"),
                ("error", absolute, "mean absolute error"),
                ("error-small", small, f"mean absolute error of levels below {SMALL_BLUR}"),
            ):
                figures.append(Figure(f"{label}.{key}", value, "levels", f"{said} {what}"))
            tables.append((said, ["level", "mean", "standard deviation"], rows))
        prior = means["chakrabarti-zickler"]
        for name in OURS:
            for key, index in (("ratio", 0), ("ratio-small", 1)):
                text = f"{name}: mean absolute error over that of chakrabarti-zickler, white at {white_e:g} electrons"
                figures.append(Figure(f"{name}.white-{white_e:g}.{key}", means[name][index] / prior[index], "1", text))
        progress(0.7 + 0.3 * (number + 1) / len(WHITE_E))
    return Evidence(figures, tables=tables)


def _camera_levels(mean_e: NDArray, camera: Camera, seed: int, kernels: NDArray, settings: Settings) -> FloatArray:
    """Raw levels of a noisy capture of mean electrons [h, w, channel]."""
    raw, _ = sensor.expose(sensor.mosaic(mean_e.astype(np.float64), camera), camera.sensor, EXPOSURE_S, seed)
    capture = Capture(raw, camera, EXPOSURE_S, 1.0, seed)
    electrons, _ = mosaic.linearise(capture)
    places, planes = mosaic.phases(camera), mosaic.planes(electrons, camera)
    channels = []
    for name in ("IR", "G"):
        plane = np.ascontiguousarray(planes[name])
        smooth = cv2.GaussianBlur(plane, (0, 0), 1.5)
        variance = mosaic.noise_variance(smooth, capture).astype(np.float32)
        channels.append((plane, places[name], variance, kernels[:, CHANNELS.index(name)]))
    return _levels(channels[0], channels[1], settings, depth.PLANE_SPACING_PX)


def _no_mosaic(
    texture: str, noise: float, kernels: NDArray, settings: Settings
) -> tuple[float, float, float, list[list[str]]]:
    """Mean absolute bias, mean deviation and mean absolute error over the levels; a row for each level."""
    green, infrared = (kernels[:, CHANNELS.index(name)] for name in ("G", "IR"))
    sharp = _photograph(texture, tuple(n + kernels.shape[-1] - 1 for n in STRIP_PX))
    errors = []
    for level in range(len(kernels)):
        random = np.random.default_rng((level, round(1e4 * noise)))
        planes = []
        for kernel in (infrared[level], green[level]):
            blurred = signal.fftconvolve(sharp, kernel.astype(float), mode="valid")
            noisy = blurred + noise * random.standard_normal(blurred.shape)
            planes.append(noisy.astype(np.float32))
        variance = np.full(planes[0].shape, noise**2, np.float32)
        pair = [(plane, (0, 0), variance, k) for plane, k in zip(planes, (infrared, green), strict=True)]
        errors.append(_levels(pair[0], pair[1], settings, 1.0) - level)
    return _summary(errors)


def _levels(sharper: depth.Channel, green: depth.Channel, settings: Settings, spacing_px: float) -> FloatArray:
    """Estimates of the samples away from the frame's border that show an edge in both channels, [n]."""
    found = depth.match(sharper, green, settings, spacing_px)
    level, _ = depth.best_level(found.score, found.plain, found.offset, settings)
    border = round(BORDER_PX / spacing_px)
    inner = slice(border, -border)
    edge = (found.snr > settings.edge_snr) & (found.green_snr > settings.edge_snr)
    return level[inner, inner][edge[inner, inner]].astype(np.float64)


def _summary(errors: list[FloatArray]) -> tuple[float, float, float, list[list[str]]]:
    """Means over the levels; NaN where a level has no estimate at all."""
    if not all(e.size for e in errors):
        return float("nan"), float("nan"), float("nan"), []
    bias, deviation = [float(e.mean()) for e in errors], [float(e.std()) for e in errors]
    rows = [[str(k), f"{k + b:.3f}", f"{s:.3f}"] for k, (b, s) in enumerate(zip(bias, deviation, strict=True))]
    absolute = float(np.mean([np.abs(e).mean() for e in errors]))
    return float(np.mean(np.abs(bias))), float(np.mean(deviation)), absolute, rows


def _photograph(name: str, shape: tuple[int, ...]) -> FloatArray:
    """A grey photograph of scikit-image, 0..1, its upper left part."""
    return np.asarray(getattr(skimage.data, name)(), np.float64)[: shape[0], : shape[1]] / 255
