"""Claim on other single-shot cameras: which tells depth best in the same light, from 100 to 10,000 lux."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import dasim
from dasim.camera.specification import Camera
from dasim.scene.specification import Scene, at_light_level
from dasim.simulation.exposure import Shot, expose
from dasim.simulation.relight import LONGEST_S, MOST_GAIN, hand_held, lit_by
from dasim.typing import BoolArray, ComplexArray, FloatArray, ShareDone
from dasim.values import Capture
from validation.gates.claim import Evidence
from validation.reports.plots import COLOURS, plot
from validation.rivals import designs, likelihood, windows
from validation.rivals.designs import DESIGNS, Design, shifted
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.rendering import seeds_of
from validation.subjects.shots import photographed
from validation.subjects.texture import white_electrons

LIGHT = "D65"
LEVELS_LUX = (100.0, 1000.0, 10000.0)
SIZE_PX = (288, 192)
BOARDS_CM = (12.0, 16.0, 21.0, 28.0, 40.0, 60.0)  # of three columns and two rows
FOCUS_CM = 80.0
TEXTURES = (
    "skimage:gravel",
    "skimage:grass",
    "skimage:brick",
    "pattern:dead-leaves:3",
    "skimage:coffee",
    "skimage:chelsea",
)
PRINTS = TEXTURES[4:]  # in colour; the others are black and white, with one contrast in all channels
TABLE = 2026  # seed of the random table top
SPP = 160
# Photographs of each scene. One is not enough for a comparison: rendering and photon noise of a single photograph moved
# the median error of the open lens on the boards between 0.27 and 0.51 1/m.
PHOTOGRAPHS = 3
OTHER_SEEDS = 100  # between photographs
LIT_LUX = 1000.0
SPREAD = 0.02  # 1/m within a window of one depth
FEWEST = 3  # windows that a figure needs
GREEN = 1
NORMAL_MEDIAN = 0.6745  # absolute value of a normal distribution's, over its standard deviation


class Measured(NamedTuple):
    """Windows of a design's pictures of a scene at one light level, [window].

    Attributes:
        error: of the estimated depth, 1/m
        bound: Cramer-Rao bound of its standard deviation, 1/m
        before, after: squared error of the captured and of the estimated sharp texture, over its square
    """

    error: FloatArray
    bound: FloatArray
    before: FloatArray
    after: FloatArray


def rivals(progress: ShareDone) -> Evidence:
    """Depth and sharpness of seven single-shot designs at the same illuminance, from 100 to 10,000 lux.

    Rationale: whoever chooses a camera asks for the alternatives: another aperture for one colour, axial colour, dual
    pixels, a coded aperture.

    Set-up: boards at 12 to 60 cm (four black and white textures, two prints in colour) and a random table top, 288 x
    192 px under D65, focused behind everything, photographed through one lens of 3.6 mm f/2.8 by each design:
    da-mobile; green through a smaller stop (chakrabarti-zickler); axial colour of 24 um (chromatic-mobile); the two
    halves of a dual-pixel sensor; a 7 x 7 coded aperture (coded-mobile); bayer-mobile; the same with a focus that
    sweeps from 80 to 12 cm during the exposure, in nine steps that share the samples. Exposure is automatic up to
    1/30 s, then gain up to 16; dual pixels share one exposure. Each scene is photographed three times with independent
    noise, and the windows of all three count. All designs use the same estimator: in windows of 31 px, every 16 px, the
    likelihood of the raw planes' spectra for each blur, with aliasing, a nearly free power in each ring of frequencies,
    and the measured covariance of the colours (``validation/rivals/likelihood.py``). It does not combine neighbouring
    windows, so that cameras are compared, not reconstructions. On the boards, only windows within one board count; on
    the table top, all windows.

    Expectation: errors decrease with more light and stay above the bound of their windows, except where the prior
    helps. Dual pixels win, because their pictures differ by a displacement and not only in blur, which is more
    informative. Two blurs distinguish a blurred texture from a smooth one: the dual aperture and the green stop have
    few outliers, other designs with one picture have many. A focal sweep blurs all depths equally, and so gives almost
    no depth.

    Limit: the median error of the dual aperture at 10,000 lux is at most that at 100 lux; on boards at 1,000 lux it is
    at most that of the open lens, of axial colour and of the coded aperture. All other figures are reported without a
    limit.

    Source: the project's own; Levin et al. 2007, Nagahara et al. 2008, Guichard et al. 2009, Chakrabarti and Zickler
    2012, Garg et al. 2019.
    """
    rendering.needs_wave()
    subjects = {"boards": boards(), "table": table()}
    figures = [figure for design in DESIGNS for figure in _light_figures(design)]
    rows: list[list[str]] = []
    errors: dict[str, dict[str, list[float]]] = {scene: {} for scene in subjects}
    steps, done = len(DESIGNS) * len(subjects), 0
    for design in DESIGNS:
        for name, scene in subjects.items():
            cameras = designs.cameras(design, SIZE_PX, scene)
            photographs = [
                [taken(scene, camera, first + number, design.sweep_um) for number, camera in enumerate(cameras)]
                for first in range(0, OTHER_SEEDS * PHOTOGRAPHS, OTHER_SEEDS)
            ]
            known = likelihood.model(cameras, LIGHT, sweep_um=design.sweep_um)
            curve = errors[name].setdefault(design.name, [])
            for level_lux in LEVELS_LUX:
                found = pooled([
                    measured(exposures(shots, level_lux, OTHER_SEEDS * number), shots, known)
                    for number, shots in enumerate(photographs)
                ])  # fmt: skip
                made, row = _figures(
                    f"{design.name}.{name}.{level_lux:g}lux", f"{design.text}, {name}, {level_lux:g} lux", found
                )
                figures += made
                rows.append([design.name, name, f"{level_lux:g}", *row])
                curve.append(made[0].value)
            done += 1
            progress(done / steps)
    figures += [
        Figure(
            f"{design}.{name}.order",
            curve[-1] / curve[0],
            "1",
            f"{design}, {name}: median error at 10,000 lux over that at 100",
        )
        for name, curves in errors.items()
        for design, curve in curves.items()
    ]
    ours = errors["boards"][DESIGNS[0].name][1]
    figures += [
        Figure(
            f"{DESIGNS[0].name}.over.{rival}",
            ours / errors["boards"][rival][1],
            "1",
            f"boards, 1,000 lux: median error of the dual aperture over that of {rival}",
        )
        for rival in errors["boards"]
        if rival != DESIGNS[0].name
    ]
    head = [
        "design",
        "scene",
        "lux",
        "median error, 1/m",
        "RMS error, 1/m",
        "bound, 1/m",
        "error over bound",
        "texture captured, dB",
        "sharp, dB",
    ]
    caption = "Median error of depth against the light, one window of 31 px at a time"
    return Evidence(figures, pictures=[(f"{caption}: {name}", _picture(curves)) for name, curves in errors.items()],
                    tables=[("Designs at the same illuminance", head, rows)])  # fmt: skip


def boards() -> Scene:
    """Six textured boards in three columns and two rows, which fill the frame, before an even wall."""
    camera = dasim.load_camera("da-mobile")
    share = camera.sensor.pixel_pitch_um * 1e-3 / camera.lens.focal_length_mm  # of the distance, per px
    objects: list[dict[str, Any]] = [
        {"name": "wall", "shape": "plane", "size_cm": [40, 40], "position_cm": [0, 0, 70], "material": "white-paper"}
    ]
    materials: dict[str, dict[str, Any]] = {}
    width, height = SIZE_PX[0] / 3, SIZE_PX[1] / 2
    for number, (depth, texture) in enumerate(zip(BOARDS_CM, TEXTURES, strict=True)):
        x, y = (number % 3 - 1) * width, (number // 3 - 0.5) * height
        if texture in PRINTS:
            materials[f"board{number}"] = {"kind": "print", "image": texture}
        else:
            materials[f"board{number}"] = {
                "kind": "blend", "image": texture, "repeat": [0.2, 0.2], "dark": "carbon-black", "bright": "white-paper"
            }  # fmt: skip
        scale = share * depth
        objects.append({"name": f"board{number}", "shape": "plane", "size_cm": [width * scale, height * scale],
                        "position_cm": [x * scale, y * scale, depth], "material": f"board{number}"})  # fmt: skip
    dome = {"kind": "dome", "illuminant": LIGHT, "lux": LIT_LUX}
    scene = rendering.make_scene(objects, [dome], materials)
    return _prepared(scene.model_copy(update={"focus_cm": FOCUS_CM}))


def table() -> Scene:
    """A random table top."""
    spec = dasim.RandomScenes(room_share=0.0)
    camera = dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX)
    return _prepared(dasim.random_scene(TABLE, 0, spec, camera))


def _prepared(scene: Scene) -> Scene:
    return lit_by(at_light_level(scene, LIT_LUX), LIGHT)


def taken(scene: Scene, camera: Camera, seed: int, sweep_um: Sequence[float] = (0.0,)) -> Shot:
    """A photograph, with the mean light of the moments of a sweep; as many samples in all as without one."""
    spp = -(-SPP // len(sweep_um))
    seeds = seeds_of(seed, len(sweep_um))
    moments = [photographed(scene, shifted(camera, um), own, spp=spp) for own, um in zip(seeds, sweep_um, strict=True)]
    first, count = moments[0], len(moments)
    if count == 1:
        return first
    times = [first.capture.exposure_s / moment.capture.exposure_s for moment in moments]
    truths = [moment.truth.scaled(share) for moment, share in zip(moments, times, strict=True)]
    mean_e = np.mean([truth.mean_e for truth in truths], axis=0)
    variances = [truth.mean_e_variance for truth in truths if truth.mean_e_variance is not None]
    variance = np.sum(variances, axis=0) / count**2 if len(variances) == count else None
    return Shot(first.capture, replace(first.truth, mean_e=mean_e, mean_e_variance=variance))


def exposures(shots: Sequence[Shot], level_lux: float, seed: int = 0) -> list[Capture]:
    """Captures of a design's shots at a light level, with the exposure that the first of them chooses.

    The noise of the n-th has the seed ``seed`` + n.
    """
    times = level_lux / LIT_LUX
    exposure = hand_held(shots[0], times, LONGEST_S, MOST_GAIN)
    numbered = enumerate(shots, start=seed)
    return [expose(shot, scale=times, exposure=exposure, seed=number).capture for number, shot in numbered]


def pooled(parts: Sequence[Measured]) -> Measured:
    """The windows of several photographs."""
    return Measured(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def measured(captures: Sequence[Capture], shots: Sequence[Shot], known: likelihood.Model) -> Measured:
    """What the estimator finds in the windows of a design's captures."""
    truth, camera = shots[0].truth, captures[0].camera
    spectra = windows.spectra(captures)
    dioptres, one_depth = true_dioptres(truth.depth_m, truth.valid)
    usable = spectra.usable & np.isfinite(dioptres)
    if one_depth.sum() >= FEWEST:
        usable &= one_depth
    seen = windows.Spectra(spectra.value[usable], spectra.noise[usable], spectra.usable[usable])
    found = likelihood.estimate(seen, known)
    blur = np.interp(found.place, np.arange(len(known.blur_px)), known.blur_px)
    error = likelihood.depth_of(camera, blur) - dioptres[usable]
    assert truth.sharp_e is not None
    sharp = texture(truth.sharp_e[..., GREEN])[usable]
    per_px = likelihood.depth_of(camera, np.ones(1))[0] - likelihood.depth_of(camera, np.zeros(1))[0]
    true_px = (dioptres[usable] - 1 / camera.lens.focus_distance_m) / per_px
    bound = [likelihood.deviation_px(known, *case) for case in zip(seen.noise, true_px, found.textures, strict=True)]
    energy = np.abs(sharp) ** 2 @ known.times
    green = [site.channel for site in windows.sites([capture.camera for capture in captures])].index("G")
    pictures = (seen.value[..., green], likelihood.sharp_texture(seen, known, found))
    before, after = (np.abs(picture - sharp) ** 2 @ known.times / energy for picture in pictures)
    return Measured(error, np.array(bound) * per_px, before, after)


def true_dioptres(depth_m: NDArray, valid: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Median depth in the middle of each window in 1/m, NaN where nothing is, and whether the window has one depth."""
    side = windows.SAMPLES * windows.SPACING_PX
    middles, single = [], []
    for y, x in windows.corners(depth_m.shape):
        part = np.where(valid, 1 / np.where(valid, depth_m, 1), np.nan)[y : y + side, x : x + side]
        middle = float(np.median(part[side // 2 - 4 : side // 2 + 4, side // 2 - 4 : side // 2 + 4]))
        middles.append(middle)
        single.append(bool((np.abs(part - middle) < SPREAD).all()))
    return np.array(middles), np.array(single)


def window_at_pixels() -> FloatArray:
    """Root of the window at every pixel, [64, 64], as high as that at a plane's samples."""
    side = windows.SAMPLES * windows.SPACING_PX
    place = np.arange(side) - (side - 1) / 2
    along = np.exp(-(place**2) * 12 / windows.WINDOW_PX**2 / 4)
    whole = along[:, None] * along
    return np.asarray(whole * (windows.taper().max() / whole.max()))


def texture(sharp_e: NDArray) -> ComplexArray:
    """Spectra of the windows of a sharp picture at the frequencies below the planes' limit, [window, frequency]."""
    side = windows.SAMPLES * windows.SPACING_PX
    window = window_at_pixels()
    density = window**2 / (window**2).sum()
    kept, _ = windows.half_plane()
    result = []
    for y, x in windows.corners(sharp_e.shape):
        part = sharp_e[y : y + side, x : x + side].astype(np.float64)
        mean = max(float((part * density).sum()), windows.LEAST_E)
        whole = np.fft.fft2(window * (part / mean - 1)).ravel()[likelihood.baseband()].reshape(windows.SAMPLES, -1)
        step = windows.SAMPLES // windows.FOLDED
        result.append(whole[::step, ::step].ravel()[kept] / (windows.FOLDED * windows.SPACING_PX**2))
    return np.array(result)


def _light_figures(design: Design) -> list[Figure]:
    """Light of a design: what visible light passes, and the electrons of white paper at 1,000 lux."""
    white = [white_electrons(dasim.load_camera(name), LIGHT, LIT_LUX) for name in design.cameras]
    rate = sum(electrons[GREEN] / time_s for electrons, time_s in white)
    return [
        Figure(
            f"{design.name}.open", designs.open_share(design), "1", f"{design.text}: share of the lens open to green"
        ),
        Figure(
            f"{design.name}.green",
            float(rate) / 1000,
            "1/ms",
            f"{design.text}: green electrons of white paper per ms at 1,000 lux",
        ),
    ]


def _figures(label: str, text: str, found: Measured) -> tuple[list[Figure], list[str]]:
    """Figures of a design, scene and light level, and their row of the table."""
    error, ratio = np.abs(found.error), np.abs(found.error) / found.bound / NORMAL_MEDIAN
    values = [
        ("error", float(np.median(error)), "1/m", "median absolute error of depth"),
        ("rms", float(np.sqrt(np.mean(found.error**2))), "1/m", "RMS error of depth"),
        ("bound", float(np.median(found.bound)), "1/m", "median Cramer-Rao bound"),
        ("over-bound", float(np.median(ratio)), "1", "median error over bound, as a normal distribution's"),
        (
            "captured",
            float(-10 * np.log10(np.median(found.before))),
            "dB",
            "texture over its error as captured, median",
        ),
        ("sharp", float(-10 * np.log10(np.median(found.after))), "dB", "texture over its error as estimated, median"),
    ]
    figures = [Figure(f"{label}.{name}", value, unit, f"{text}: {meaning}") for name, value, unit, meaning in values]
    return figures, [f"{value:.3g}" for _, value, _, _ in values]


def _picture(curves: dict[str, list[float]]) -> str:
    def draw(axes: Any) -> None:
        for colour, (name, errors) in zip(COLOURS, curves.items(), strict=False):
            axes.loglog(LEVELS_LUX, errors, "o-", color=colour, markersize=4, label=name)
        axes.set(xlabel="illuminance (lux)", ylabel="median error of depth (1/m)")
        axes.legend()

    return plot(draw)
