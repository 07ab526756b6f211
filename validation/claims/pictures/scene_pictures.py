"""Claim on the pictures that the paper shows of two scenes (Fig. 1, 11 and 12): all in focus, depth, refocused,
anaglyph.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.measure import blur_effect

import dasim
import recon
from dasim.simulation.exposure import Shot
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.spectra.grid import LUMINANCE
from dasim.typing import FloatArray, ShareDone
from dasim.values import PsfBank, Reconstruction, Truth
from recon.picture import colour, infrared
from recon.views import anaglyph as stereo
from validation.gates.claim import Evidence, Pair, Table
from validation.methods import NamedMethod, bundled, prefix, reconstructed
from validation.reports import pictures
from validation.scores.edges import gradients, slope
from validation.scores.figures import Figure
from validation.scores.pictures import infrared_free
from validation.subjects import rendering, scene_set
from validation.subjects.shots import photographed

SCENES = {"adam": "skin", "flowers": "daisy"}  # and the object to which they are refocused
METHODS = bundled("bands")
EDGE_BLUR_PX = ((0.0, 3.0), (3.0, 10.0))  # visible blur
STACK_STEP = 1.0  # levels between the pictures of a stack, beyond both ends by one
LOCAL_SIGMA_PX = 8.0  # of the patch in which sharpness is compared
STRONGEST_PX = 12.0  # largest shift between the two eyes
CLAMPED = 0.01  # share of the pixels at either end of the depths whose shifts are those of the range's ends
SHIFT_STEP_PX = 0.5
PATCH_SIGMA_PX, SHADING_SIGMA_PX = 5.0, 6.0  # of the blocks that are matched, and of the shading taken off before
LEAST_PX = 2000  # of an object in the table
MATCHED = 0.9  # correlation between red of one eye and green of the other that makes a match


def scene_pictures(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """The all-in-focus picture has steeper edges, a refocused one is sharpest at its focus, and anaglyphs show the
    depth.

    Rationale: these pictures are the purpose of the camera. The claims ``all-in-focus`` and ``refocus`` compare them
    with the truth pixel by pixel; this claim uses measures of visible quality that the reconstruction itself does not
    use.

    Set-up: the captures of adam and flowers of claim ``depth``, 512 x 384 px, da-mobile, preset bands. Edge slope is
    the regression of green's gradients on those of the sharp truth at its steepest tenth of pixels, away from
    boundaries (1: equally steep; noise does not affect it, being independent of the truth). Blur is that of Crete et
    al. 2007 on luminance, as the share of the difference between capture and sharp truth that is removed. The stack
    holds the picture refocused to every level; a pixel's level is that at which its patch has the largest gradient
    energy. In the anaglyph (12 px), red is matched with green, block by block, for the shift between the eyes; b (1/z_0
    - 1/z) of the reconstructed depth is expected.

    Expectation: slopes increase, but do not exceed 1 by more than their error. The levels of the stack agree with the
    true ones as well as the estimated depth does. The shifts agree with depth to the step of the search, behind or in
    front of the screen as requested.

    Shifts are scaled to the range of the estimated depths without the nearest and the farthest 1 % of the pixels, whose
    shifts are clipped to the ends of the range.

    Depth is least accurate for surfaces in focus: the brick wall of adam and the meadow of flowers, at level 0, are
    estimated up to 3 levels nearer (table), and a picture refocused to them is blurred there.

    Limit: a slope of at least 0.5 and 1.5 times the capture's at 3 to 10 px of blur, and 0.75 to 1.15 at 0 to 3 px;
    half of the blur removed; a median error of the stack of 0.5 level from the reconstruction's own levels and 0.8 from
    the true ones; shifts within 0.5 px, 0.95 of them on the right side of the screen.

    Source: Fig. 1, 11 and 12, sec. 5.4 and 6.2.
    """
    rendering.needs_wave()
    figures: list[Figure] = []
    panels: list[tuple[str, str]] = []
    pairs: list[Pair] = []
    tables: list[Table] = []
    for number, name in enumerate(SCENES):
        scene = dasim.load_scene(name)
        camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *scene_set.SIZE_PX), scene)
        shot = photographed(scene, camera, seed, spp=scene_set.SPP)
        bank = recon.calibrate(dasim.calibration_captures(camera, diffraction=shot.capture.provenance["diffraction"]))
        for method in methods:
            result, label = reconstructed(shot.capture, bank, method), f"{prefix(method, METHODS)}{name}"
            figures += [*edges(label, result, shot.truth), *sharpest(label, result, bank, shot.truth)]
            anaglyphs = {}
            for where in ("in", "out"):
                left, right = stereo.pair(result.sharp_rgb, result.depth_m, STRONGEST_PX, where)
                anaglyphs[where] = stereo.anaglyph(left, right)
                figures += eyes(f"{label}.{where}", anaglyphs[where], result.depth_m, where, shot.truth)
            head = ["object", "pixels", "true", "estimated"]
            tables.append((f"{label}: levels of objects", head, _rows(result, shot.truth)))
            pairs += _pairs(label, SCENES[name], result, bank, shot)
            panels += _pictures(label, result, anaglyphs, shot)
        progress((number + 1) / len(SCENES))
    return Evidence(figures, pictures=panels, tables=tables, pairs=pairs)


def edges(name: str, result: Reconstruction, truth: Truth) -> list[Figure]:
    """Figures of the steepness of edges and of the apparent blur of the pictures."""
    exact = gradients(infrared_free(truth.sharp_e, result.camera, result.light)[..., 1])
    before, after = gradients(result.linear_e[..., 1]), gradients(result.sharp_e[..., 1])
    figures = []
    for low, high in EDGE_BLUR_PX:
        blur = np.abs(truth.blur_px)
        where = truth.valid & ~truth.boundary & (blur >= low) & (blur < high)
        slopes = [slope(picture, exact, where) for picture in (before, after)]
        case = f"{name}: slope of edges at {low:g} to {high:g} px of blur over the sharp truth's"
        label = f"{name}.slope-{low:g}-{high:g}"
        figures += [
            Figure(label, slopes[1], "1", f"{case}, all-in-focus picture"),
            Figure(f"{label}.capture", slopes[0], "1", f"{case}, capture"),
            Figure(f"{label}.gain", slopes[1] / slopes[0], "1", f"{case}, ratio of both"),
        ]
    images = (result.rgb, result.sharp_rgb, truth.sharp_srgb)
    blurred, sharp, best = (float(blur_effect(np.asarray(i, np.float64) @ np.array(LUMINANCE))) for i in images)
    case = f"{name}: blur (Crete et al.)"
    return [
        *figures,
        Figure(f"{name}.blur.capture", blurred, "1", f"{case}, capture"),
        Figure(f"{name}.blur.sharp", sharp, "1", f"{case}, all-in-focus picture"),
        Figure(f"{name}.blur.truth", best, "1", f"{case}, sharp truth"),
        Figure(f"{name}.blur.way", (blurred - sharp) / (blurred - best), "1", f"{case}, share of the way to the truth"),
    ]


def sharpest(name: str, result: Reconstruction, bank: PsfBank, truth: Truth) -> list[Figure]:
    """Level at which each place in a stack of refocused pictures is sharpest, compared with estimated
    and true levels.
    """
    where = truth.valid & ~truth.boundary & np.isfinite(result.level_raw)
    levels = np.arange(0, np.ceil(float(np.nanmax(truth.level))) + 1 + STACK_STEP / 2, STACK_STEP)
    energy = []
    for level in levels:
        picture = recon.refocus(result, bank, depth_of(level, bank))[..., 1]
        energy.append(cv2.GaussianBlur((gradients(picture) ** 2).sum(axis=0), (0, 0), LOCAL_SIGMA_PX))
    best = levels[np.argmax(energy, axis=0)]
    case = f"{name}: level at which a refocused picture is sharpest, textured pixels away from boundaries"
    return [
        Figure(f"{name}.stack.{what}", float(np.median(np.abs(best - level)[where])), "level", f"{case}, {text}")
        for what, level, text in (
            ("own", result.level, "median distance from the reconstruction's own level"),
            ("true", truth.level, "median distance from the true level"),
        )
    ]


def depth_of(level: float, bank: PsfBank) -> float:
    """Depth in m of a blur level: linear in dioptres between the first and the last level of the bank."""
    vergence = 1 / bank.depth_m.astype(np.float64)
    return float(1 / (vergence[0] + (vergence[-1] - vergence[0]) * level / (len(vergence) - 1)))


def eyes(name: str, anaglyph: NDArray, depth_m: NDArray, where: str, truth: Truth) -> list[Figure]:
    """Shifts between the eyes of a red-cyan anaglyph, compared with those that correspond to depth."""
    shift, match = shifts(anaglyph[..., 0], anaglyph[..., 1])
    sure = (match > MATCHED) & truth.valid
    low, high = np.quantile(1 / depth_m.astype(np.float64), (CLAMPED, 1 - CLAMPED))
    screen, scale = high if where == "in" else low, STRONGEST_PX / (high - low)
    off, off_true = (
        np.abs(shift - scale * (screen - np.clip(1 / depth.astype(np.float64), low, high)))[sure]
        for depth in (depth_m, truth.depth_m)
    )
    side = shift[sure] * (1 if where == "in" else -1)
    case = f"{name.rpartition('.')[0]}, anaglyph, {where}"
    return [
        Figure(f"{name}.shift", _median(off), "px", f"{case}: median error of the shift, expected from found depth"),
        Figure(
            f"{name}.side",
            float(np.mean(side >= -SHIFT_STEP_PX)),
            "1",
            f"{case}: share on the right side of the screen",
        ),
        Figure(f"{name}.shift-true", _median(off_true), "px", f"{case}: median error of the shift, from true depth"),
        Figure(f"{name}.matched", float(sure.mean()), "1", f"{case}: share of pixels whose blocks match"),
    ]


def _median(values: NDArray) -> float:
    return float(np.median(values)) if values.size else float("nan")


def shifts(left: NDArray, right: NDArray) -> tuple[FloatArray, FloatArray]:
    """Displacement x_right - x_left between two pictures [h, w], px, and the correlation of the best-matching blocks,
    [h, w].

    Both pictures are moved by half of each candidate shift, so that the result is located halfway between both places.
    """
    height, width = left.shape
    pictures_ = [
        np.asarray(p, np.float32) - cv2.GaussianBlur(p.astype(np.float32), (0, 0), SHADING_SIGMA_PX)
        for p in (left, right)
    ]
    best = np.full((height, width), -np.inf)
    result = np.zeros((height, width))

    def mean(image: NDArray) -> NDArray:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), PATCH_SIGMA_PX))

    for shift in np.arange(-STRONGEST_PX - 2, STRONGEST_PX + 2 + SHIFT_STEP_PX / 2, SHIFT_STEP_PX):
        a, b = (
            cv2.warpAffine(
                p, np.array([[1, 0, move], [0, 1, 0]], np.float32), (width, height), borderMode=cv2.BORDER_REFLECT
            )
            for p, move in zip(pictures_, (shift / 2, -shift / 2), strict=True)
        )
        match = mean(a * b) / np.sqrt(mean(a * a) * mean(b * b) + np.float32(1e-9))
        better = match > best
        best[better], result[better] = match[better], shift
    return result, best


def _rows(result: Reconstruction, truth: Truth) -> list[list[str]]:
    """Name, number of pixels away from boundaries, and median true and estimated level of each larger object."""
    rows = []
    for number, name in enumerate(truth.objects):
        surface = (truth.object_id == number + 1) & ~truth.boundary
        if surface.sum() >= LEAST_PX:
            rows.append(
                [
                    name,
                    str(surface.sum()),
                    *(f"{np.median(level[surface]):.1f}" for level in (truth.level, result.level)),
                ]
            )
    return rows


def _pairs(name: str, item: str, result: Reconstruction, bank: PsfBank, shot: Shot) -> list[Pair]:
    """Two pairs for comparison: capture and all-in-focus picture; refocused to an object and to the focus of the
    capture.
    """
    separation = infrared.separation(result.camera, result.light, recon.Settings(**result.settings))
    matrix = colour.colour_matrix(result.camera, result.light, separation)
    scale = exposure_scale(result.linear_e, matrix)
    surface = shot.truth.object_id == shot.truth.objects.index(item) + 1
    places = {f"depth estimated for the {item}": float(np.median(result.depth_m[surface]))}
    places["focus of the capture"] = result.camera.lens.focus_distance_m
    focused = []
    for text, depth_m in places.items():
        picture = to_srgb(recon.refocus(result, bank, depth_m), matrix, scale)
        focused.append((f"focused at {100 * depth_m:.0f} cm, the {text}", pictures.photo_address(picture)))
    captured = ("captured", pictures.photo_address(result.rgb))
    sharp = ("all in focus", pictures.photo_address(result.sharp_rgb))
    return [(name, captured, sharp), (f"{name}, refocused after the shot", focused[0], focused[1])]


def _pictures(name: str, result: Reconstruction, anaglyphs: dict[str, NDArray], shot: Shot) -> list[tuple[str, str]]:
    truth = shot.truth
    maps = [("true", truth.depth_m), ("estimated", result.depth_m)]
    near, far = float(np.nanmin(truth.depth_m)), float(np.nanmax(truth.depth_m))
    case = {"in": "goes into the screen", "out": "comes out of the screen"}
    return [
        (f"{name}: depth, linear in dioptres; yellow is near", pictures.depth_panels(maps, near, far)),
        *(
            (f"{name} for red-cyan glasses (red left): the scene {case[where]}", pictures.photo_address(image))
            for where, image in anaglyphs.items()
        ),
    ]
