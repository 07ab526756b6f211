"""Claims on the staircase of Fig. 10: the depth code without a mosaic, and the complete camera, compared with prior
work.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.bounds import cramer_rao
from dasim.camera import noise as sensor
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.geometry import level_blur_px
from dasim.camera.specification import BLUR_LEVELS, Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from dasim.values import Capture, PsfBank
from recon.depth.channels import Channel
from recon.depth.grid import PLANE_SPACING_PX
from recon.depth.method import on_blocks
from recon.picture import mosaic
from recon.settings import Settings
from validation.gates.claim import Evidence
from validation.methods import NamedMethod, bundled, estimated
from validation.reports.plots import plot
from validation.scores.figures import Figure
from validation.subjects import rendering, strips
from validation.subjects.shots import photographed
from validation.subjects.strips import Estimates, Noise, Strips
from validation.subjects.texture import noise_variance

LIGHT = "D65"
TEXTURE = "gravel"  # at every level, and the one that has limits
TEXTURES = ("brick", "grass", "chelsea", "coins")  # at every fourth level
EVERY = 4
NOISES = (
    *(Noise(f"{100 * share:g}", share) for share in (0.005, 0.01, 0.02, 0.04)),
    Noise("photon", white_e=(750.0, 2500.0)),
)
PUBLISHED = ("0.5", "1", "2")  # noises at which the published diagonals are shown too, at every fourth level
BETWEEN = (-0.4, -0.2, 0.2, 0.4)  # levels from one of the bank's
BETWEEN_LEVELS = (4, 10, 16, 22)
BETWEEN_NOISES = ("1", "2")
FEWEST_PX = 50  # with an edge, for a level to count
WHITE_E = (5000.0, 2500.0, 1250.0)  # green electrons of white paper
CAMERA_PX = (160, 160)
EXPOSURE_S = 0.05  # for the dark signal; the light is set by WHITE_E
WHITE_PERCENTILE = 99.9  # of the sharp picture: its white paper
SMALL_BLUR = 4  # levels below this: where the paper says its advantage is largest
OURS = ("paper", "likelihood")
PRIOR = "chakrabarti-zickler"  # the closest prior work
COMPARED = (*OURS, PRIOR)
SCORES = {
    "paper": recon.PRESETS["paper"],
    "likelihood": recon.PRESETS["likelihood"],
    "chakrabarti-zickler": recon.PRESETS["chakrabarti-zickler"],
    "published-diagonals": recon.PRESETS["chakrabarti-zickler"].model_copy(update={"diagonals": "published"}),
}
COLOURS = {"paper": "#0072b2", "likelihood": "#009e73", "chakrabarti-zickler": "#d55e00"}
METHODS = bundled(*COMPARED)


def staircase(progress: ShareDone, seed: int = 0) -> Evidence:
    """Levels are estimated without bias, and with hardly more noise than the Cramer-Rao bound, on real textures.

    Rationale: Fig. 10 is the paper's measure of its depth estimation; the bound states how much better any estimator
    could be.

    Set-up: five photographs that ship with scikit-image, gravel (at all 29 levels), brick, grass, chelsea (fur) and
    coins (at every fourth), with full scale 1. Green and infrared are blurred with the kernels of the bank of da-mobile
    under D65 by scipy's convolution, without a mosaic. Noise is Gaussian, 0.5, 1, 2 and 4 % of full scale in both
    channels, or photon noise with 2,500 electrons in green, 750 in infrared and 3 electrons of read noise. The depth
    code of the pipeline runs on samples one pixel apart and is scored at every pixel that shows an edge, 45 px from a
    strip's borders. Presets paper, likelihood (levels scored by likelihood instead of NCC) and chakrabarti-zickler; at
    every fourth level of gravel also the diagonals of the latter's published code. The bound is that of each pixel's
    patch with the camera's own kernels, where the texture's spectrum is known and its strength and the gain of the
    channels are unknown. "Between" denotes levels 0.2 and 0.4 off those of the bank, blurred with the camera's own
    kernels.

    Expectation: the figures are means over the levels of the absolute bias and of the standard deviation, and the root
    mean square error relative to the bound, from level 1 on (near 0 a change of blur has no first-order effect), all
    over the pixels that show an edge. A ratio below 1 would mean that the truth leaks into the estimate, or that the
    estimate favours the levels of the bank, which biases it between these levels. The preset likelihood is biased in
    this way: at low noise, its error is below the bound at the levels of the bank, and 1.6 times the bound between
    them. The bound is therefore a limit between levels only. Even there, errors slightly below the bound (4 %) occur,
    because textures are not Gaussian processes, and where few pixels show an edge, these are the best of a strip.

    Limit: 0.05 / 0.1, 0.1 / 0.3 and 0.2 / 0.6 levels of bias / deviation at 0.5, 1 and 2 %, for the presets paper and
    likelihood on gravel; error over bound from 0.9 to 2.3 for preset paper on gravel at 0.5 to 2 % and with photon
    noise; between levels at least 0.9, and at most 2 for preset paper; everywhere less error than chakrabarti-zickler.

    Source: Fig. 10 and sec. 6.1; for the bound dasim/bounds.
    """
    camera = dasim.load_camera("da-mobile")
    bank = recon.calibrate(dasim.calibration_captures(camera))
    kernels = bank.kernel[bank.lights.index(LIGHT)]
    figures: list[Figure] = []
    tables: list[Any] = []
    estimates_by_case: dict[tuple[str, str, str], list[Estimates]] = {}
    for number, texture in enumerate((TEXTURE, *TEXTURES)):
        levels = range(0, BLUR_LEVELS, 1 if texture == TEXTURE else EVERY)
        subject = Strips(texture, levels, kernels[list(levels)], camera, LIGHT)
        for noise in NOISES:
            for name in COMPARED:
                estimates = subject.estimates(noise, kernels, SCORES[name], seed)
                estimates_by_case[texture, noise.name, name] = estimates
                figures += _figures(f"{name}.{texture}.{noise.name}", f"{texture}, {noise.label}, {name}", estimates)
                if texture == TEXTURE:
                    tables.append((f"{texture}, {noise.label}, {name}", *_rows(estimates)))
            figures.append(_ratio(texture, noise, estimates_by_case))
        progress(0.85 * (number + 1) / (1 + len(TEXTURES)))
    levels = range(0, BLUR_LEVELS, EVERY)
    subject = Strips(TEXTURE, levels, kernels[list(levels)], camera, LIGHT)
    for noise in (noise for noise in NOISES if noise.name in PUBLISHED):
        estimates = subject.estimates(noise, kernels, SCORES["published-diagonals"], seed)
        label = f"published-diagonals.{TEXTURE}.{noise.name}"
        figures += _figures(label, f"{TEXTURE}, {noise.label}, published diagonals", estimates)
    figures += _between(camera, kernels, seed)
    progress(1.0)
    caption = f"Mean and standard deviation of the estimated level against the true one, {TEXTURE} (compare Fig. 10)"
    pictures = [(caption, _fig_10({noise.name: noise.label for noise in NOISES}, estimates_by_case))]
    pictures.append(("Root mean square error over the Cramer-Rao bound, by texture", _by_texture(estimates_by_case)))
    return Evidence(figures, pictures=pictures, tables=tables)


def staircase_camera(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """With the complete camera, levels are estimated better than by the closest prior work.

    Rationale: the second half of Fig. 10 is a comparison with Chakrabarti and Zickler on equal terms.

    Set-up: the scene staircase:LEVEL (gravel) at each of the 29 levels, central 160 x 160 px of da-mobile focused at 2
    m, rendered once for all seeds. Exposures give 5,000, 2,500 and 1,250 green electrons on the texture's white paper;
    the sensor model adds mosaic and photon noise. Raw levels of the blocks of the colour planes are scored where they
    show an edge, 45 px from the border, at the same blocks for all methods; bank, patches and band of edges are the
    same for all. Presets paper and likelihood, and chakrabarti-zickler with the correct and with the published
    diagonals. The Cramer-Rao bound is that of the samples of two planes, green and infrared, from the spectrum of the
    sharp picture and the noise of the data sheet at its mean; it neglects aliasing in green near focus.

    Expectation: the figures are the mean absolute error over all levels, and over those below 4, relative to
    chakrabarti-zickler, and the root mean square error over the bound, from level 1 on.

    Limit: below 1 at every noise level; at small blur below 0.9 for the preset paper and below 0.7 for likelihood.
    Error over bound from 0.9 to 2.3 for preset paper.

    Source: sec. 6.1: more accurate, particularly when the blur is small, and more robust to noise.
    """
    rendering.needs_wave()
    camera = dasim.cropped(dasim.focused(dasim.load_camera("da-mobile"), dasim.load_scene("staircase")), *CAMERA_PX)
    rates = []
    for level in range(BLUR_LEVELS):
        scene = dasim.load_scene(f"staircase:{level}:{TEXTURE}", camera=camera)
        shot = photographed(scene, camera, level, spp="auto")
        rates.append((shot.truth.mean_e / shot.capture.exposure_s, shot.truth.sharp_e / shot.capture.exposure_s))
        progress(0.7 * (level + 1) / BLUR_LEVELS)
    green = CHANNELS.index("G")
    white = float(np.percentile([sharp[..., green] for _, sharp in rates], WHITE_PERCENTILE))
    bank = recon.calibrate(dasim.calibration_captures(camera))
    ours = methods == METHODS
    users: dict[str, Settings | NamedMethod] = {method.name: method for method in methods}
    estimators: dict[str, Settings | NamedMethod] = {**SCORES} if ours else {PRIOR: SCORES[PRIOR], **users}
    figures: list[Figure] = []
    tables: list[Any] = []
    estimates_by_case: dict[tuple[str, str, str], list[Estimates]] = {}
    for number, white_e in enumerate(WHITE_E):
        means = {}
        scaled = [(mean * white_e / white, sharp * white_e / white) for mean, sharp in rates]
        table = _camera_bounds(camera, np.stack([sharp for _, sharp in scaled]))
        for name, estimator in estimators.items():
            estimates = [
                _camera_levels(pair, camera, (level, seed), bank, estimator, table[:, level])
                for level, pair in enumerate(scaled)
            ]
            estimates_by_case[TEXTURE, f"{white_e:g}", name] = estimates
            label, case = f"{name}.white-{white_e:g}", f"white at {white_e:g} electrons, {name}"
            case_figures = _figures(label, case, estimates)
            small = [float(np.abs(one.error).mean()) for one in estimates[:SMALL_BLUR] if one.error.size]
            text = f"{case}: mean absolute error of levels below {SMALL_BLUR}"
            case_figures.append(Figure(f"{label}.error-small", float(np.mean(small)), "levels", text))
            means[name] = {one.id.rpartition(".")[2]: one.value for one in case_figures}
            if ours or name != PRIOR:
                figures += case_figures
                tables.append((case, *_rows(estimates)))
        prior = means[PRIOR]
        for name in OURS if ours else (method.name for method in methods):
            for key, error in (("ratio", "error"), ("ratio-small", "error-small")):
                text = f"{name}: mean absolute error over that of chakrabarti-zickler, white at {white_e:g} electrons"
                figures.append(Figure(f"{name}.white-{white_e:g}.{key}", means[name][error] / prior[error], "1", text))
        progress(0.7 + 0.3 * (number + 1) / len(WHITE_E))
    caption = "Mean and standard deviation of the estimated level against the true one, rendered (compare Fig. 10)"
    panels = {f"{white_e:g}": f"white at {white_e:g} electrons" for white_e in WHITE_E}
    return Evidence(figures, pictures=[(caption, _fig_10(panels, estimates_by_case))] if ours else [], tables=tables)


def _camera_levels(
    pictures: tuple[NDArray, NDArray],
    camera: Camera,
    level_and_seed: tuple[int, int],
    bank: PsfBank,
    estimator: Settings | NamedMethod,
    table: FloatArray,
) -> Estimates:
    """Raw levels of a noisy capture of mean electrons [h, w, channel]; the second of ``pictures`` is the sharp one.

    The settings of the pipeline's own score determine which pixels show an edge; a user's method takes those of the
    paper.
    """
    kernels = bank.kernel[bank.lights.index(LIGHT)]
    (mean_e, sharp_e), (level, seed) = pictures, level_and_seed
    raw, _ = sensor.expose(
        electronic_crosstalk(sensor.mosaic(mean_e.astype(np.float64), camera), camera),
        camera.sensor,
        EXPOSURE_S,
        level + BLUR_LEVELS * seed,
    )
    capture = Capture(raw, camera, EXPOSURE_S, 1.0, seed)
    electrons, _ = mosaic.linearise(capture)
    places, planes = mosaic.phases(camera), mosaic.planes(electrons, camera)
    collected = mosaic.planes(mosaic.collected(electrons, camera), camera)
    channels = []
    for name in strips.PAIR:
        plane = np.ascontiguousarray(planes[name])
        smooth = cv2.GaussianBlur(collected[name], (0, 0), 1.5)
        variance = mosaic.noise_variance(capture, name).at(smooth)
        channels.append(Channel(plane, places[name], variance, kernels[:, CHANNELS.index(name)]))
    settings = estimator if isinstance(estimator, Settings) else SCORES[OURS[0]]
    score_map, edge = strips.levels_of(channels[0], channels[1], settings, PLANE_SPACING_PX)
    green = sharp_e[..., CHANNELS.index("G")].astype(np.float64)
    spacing, border = round(PLANE_SPACING_PX), strips.BORDER_PX
    strength = strips.strength_of(green) * green.mean() / strips.patch_mean(green)  # shot noise rises with brightness
    # the planes' samples stand in the middle of blocks; the strength changes little over one
    inner = slice(round(border / spacing), -round(border / spacing))
    if isinstance(estimator, NamedMethod):
        score_map = on_blocks(estimated(capture, bank, estimator), bank)[0][inner, inner].astype(np.float64)
        edge = edge & np.isfinite(score_map)
    near = strength[::spacing, ::spacing][inner, inner][edge]
    return Estimates(float(level), score_map[edge] - level, strips.bound_of(table, near), float(edge.mean()))


def _camera_bounds(camera: Camera, sharp_e: NDArray) -> FloatArray:
    """Least standard deviation of the level, [strength, level], for sharp pictures [level, h, w, channel]."""
    pair = [CHANNELS.index(name) for name in strips.PAIR]
    spacing, side = PLANE_SPACING_PX, strips.BOUND_SHAPE[0]
    blurs = level_blur_px(camera)
    transfer, slope = cramer_rao.camera_transfers(camera, blurs, LIGHT, strips.BOUND_SHAPE, spacing_px=spacing)
    fine = (round(side * spacing), round(side * spacing))
    whole = np.mean([cramer_rao.picture_power(image[..., pair[0]].astype(float), fine) for image in sharp_e], axis=0)
    # of the finer grid's frequencies those of the planes; samples further apart see less of the density each
    power = np.concatenate([whole[: side // 2], whole[-side // 2 :]])[:, : side // 2 + 1] / spacing**2
    texture = [float(np.std(sharp_e[..., index])) for index in pair]
    variance = noise_variance(camera, sharp_e.mean(axis=(0, 1, 2)).astype(float), EXPOSURE_S)[pair]
    table = strips.bound_table(
        transfer[:, pair], slope[:, pair], power, variance, gain=(1.0, texture[1] / texture[0]), spacing_px=spacing
    )
    return np.asarray(table / blurs[1])


# --- figures of strips ---------------------------------------------------------------------------


def _figures(label: str, case: str, estimates: Sequence[Estimates]) -> list[Figure]:
    """Bias, deviation and error over the levels with enough edges, the share of these levels, and the error over the
    bound.
    """
    measurable = [one for one in estimates if one.error.size >= FEWEST_PX]
    share = float(np.mean([one.coverage for one in estimates]))
    what = f"{case}: mean over {len(measurable)} of {len(estimates)} levels of the"
    bias, deviation, error = (
        float(np.mean([measure(one.error) for one in measurable])) if measurable else float("nan")
        for measure in (lambda e: abs(e.mean()), np.std, lambda e: np.abs(e).mean())
    )
    return [
        Figure(f"{label}.bias", bias, "levels", f"{what} absolute bias"),
        Figure(f"{label}.deviation", deviation, "levels", f"{what} standard deviation"),
        Figure(f"{label}.error", error, "levels", f"{what} absolute error"),
        Figure(
            f"{label}.levels",
            len(measurable) / len(estimates),
            "1",
            f"{case}: share of levels with {FEWEST_PX} edge pixels",
        ),
        Figure(f"{label}.edges", share, "1", f"{case}: share of pixels that show an edge"),
        Figure(
            f"{label}.to-bound", to_bound(measurable), "1", f"{case}: root mean square error over the Cramer-Rao bound"
        ),
    ]


def to_bound(estimates: Sequence[Estimates]) -> float:
    """Root mean square error, averaged over the levels from 1 on, relative to the mean bound; NaN without any."""
    measurable = [one for one in estimates if one.error.size >= FEWEST_PX and one.level >= 0.5]
    if not measurable:
        return float("nan")
    return float(np.mean([np.sqrt(np.mean(e.error**2)) for e in measurable]) / np.mean([e.bound for e in measurable]))


def _ratio(texture: str, noise: Noise, estimates: dict[tuple[str, str, str], list[Estimates]]) -> Figure:
    """Error of preset paper relative to that of chakrabarti-zickler."""
    by_method, prior = (
        float(
            np.mean([np.abs(e.error).mean() for e in estimates[texture, noise.name, name] if e.error.size >= FEWEST_PX])
        )
        for name in ("paper", "chakrabarti-zickler")
    )
    case = f"{texture}, {noise.label}: mean absolute error of paper over that of chakrabarti-zickler"
    return Figure(f"paper.{texture}.{noise.name}.ratio", by_method / prior, "1", case)


def _between(camera: Camera, kernels: NDArray, seed: int) -> list[Figure]:
    """Errors over the bound at levels between those of the bank."""
    levels = [level + off for level in BETWEEN_LEVELS for off in BETWEEN]
    kernels_between = strips.own_kernels(camera, levels, LIGHT, kernels.shape[-1])
    subject = Strips(TEXTURE, levels, kernels_between, camera, LIGHT)
    figures = []
    for noise in (noise for noise in NOISES if noise.name in BETWEEN_NOISES):
        for name in OURS:
            estimates = subject.estimates(noise, kernels, SCORES[name], seed)
            case = f"{TEXTURE}, {noise.label}, {name}, {len(levels)} levels between the bank's"
            text = f"{case}: root mean square error over the Cramer-Rao bound"
            figures.append(Figure(f"{name}.between.{noise.name}.to-bound", to_bound(estimates), "1", text))
    return figures


def _rows(estimates: Sequence[Estimates]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of a table with one level per row."""
    head = ["level", "mean", "standard deviation", "bound", "share with an edge"]
    rows = []
    for one in estimates:
        mean, deviation = (one.error.mean(), one.error.std()) if one.error.size else (np.nan, np.nan)
        bound = f"{one.bound:.3f}" if one.level >= 0.5 else "-"
        rows.append([f"{one.level:g}", f"{one.level + mean:.3f}", f"{deviation:.3f}", bound, f"{one.coverage:.2f}"])
    return head, rows


# --- pictures ------------------------------------------------------------------------------------


def _fig_10(
    panels: dict[str, str], estimates: dict[tuple[str, str, str], list[Estimates]], texture: str = TEXTURE
) -> str:
    """Plot of mean and standard deviation against the true level (above), and of standard deviation
    and bound (below).
    """

    def draw(axes: Any) -> None:
        for column, (key, case) in enumerate(panels.items()):
            above, below = axes[0][column], axes[1][column]
            above.plot([0, BLUR_LEVELS - 1], [0, BLUR_LEVELS - 1], "--", color="#888888", linewidth=0.8)
            for shift, name in zip((-0.2, 0.0, 0.2), COMPARED, strict=True):
                measurable = [e for e in estimates[texture, key, name] if e.error.size >= FEWEST_PX]
                level, mean, deviation = (
                    np.array(part)
                    for part in (
                        [e.level for e in measurable],
                        [e.level + e.error.mean() for e in measurable],
                        [e.error.std() for e in measurable],
                    )
                )
                style: dict[str, Any] = {"color": COLOURS[name], "label": name, "markersize": 2.5}
                above.errorbar(level + shift, mean, deviation, fmt=".", elinewidth=0.9, **style)
                below.semilogy(level, np.maximum(deviation, 1e-3), ".-", linewidth=0.7, **style)
            known = [e for e in estimates[texture, key, OURS[0]] if e.error.size >= FEWEST_PX and e.level >= 0.5]
            bound = [[e.level for e in known], [e.bound for e in known]]
            below.semilogy(*bound, color="black", linewidth=1.4, label="Cramer-Rao bound")
            above.set(title=case.replace(", ", ",\n"), xlim=(-1, BLUR_LEVELS), ylim=(-3, BLUR_LEVELS + 2))
            below.set(xlabel="true level", xlim=(-1, BLUR_LEVELS), ylim=(5e-3, 12))
        axes[0][0].set(ylabel="estimated level, mean and std")
        axes[1][0].set(ylabel="standard deviation, levels")
        axes[1][0].legend(fontsize=7)

    return plot(draw, columns=len(panels), rows=2, size=(2.9, 2.7))


def _by_texture(estimates: dict[tuple[str, str, str], list[Estimates]]) -> str:
    """Plot of error over bound for every texture and preset, with one panel per noise."""

    def draw(axes: Any) -> None:
        textures = (TEXTURE, *TEXTURES)
        for panel, noise in zip(axes, NOISES, strict=True):
            for shift, name in zip((-0.2, 0.0, 0.2), COMPARED, strict=True):
                value = [to_bound(estimates[texture, noise.name, name]) for texture in textures]
                panel.semilogy(np.arange(len(textures)) + shift, value, "o", color=COLOURS[name], label=name)
            panel.axhline(1.0, color="black", linewidth=1.0)
            panel.set(title=noise.label.replace(", ", ",\n"), ylim=(0.2, 60))
            panel.set_xticks(range(len(textures)), textures, rotation=40)
        axes[0].set(ylabel="error over bound")
        axes[0].legend(fontsize=7)

    return plot(draw, columns=len(NOISES), size=(2.9, 2.7))
