"""Claims on the all-in-focus picture: the gain of deconvolution over the capture, and the quality of refocusing."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

import dasim
import recon
from dasim.camera import geometry
from dasim.camera import specification as cameras
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.simulation.exposure import Shot
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.typing import BoolArray, FloatArray, ShareDone
from dasim.values import PsfBank, Reconstruction, Truth
from recon.picture import colour, infrared
from validation.gates.claim import Evidence
from validation.methods import NamedMethod, bundled, prefix, reconstructed
from validation.reports.page import png_address
from validation.scores import pictures as picture_scores
from validation.scores.figures import Figure
from validation.scores.pictures import infrared_free, psnr
from validation.subjects import rendering
from validation.subjects.shots import photographed

SHARP_SCENES = ("desk", "flowers", "adam")
SHARP_SIZE_PX = (384, 288)
SHARP_SPP = 256
METHODS = bundled("best", "bands", "paper")  # the first has limits, the others are reported beside it
REFOCUSED = bundled("best")
JUDGED_PX = ((3.0, 10.0), (10.0, 25.0))  # visible blur
BIN_PX = 5.0
LARGEST_PX = 55.0
LEAST_SHARE = 0.02  # of the frame's pixels in a bin that counts
FOCUSED_SPP = 64  # of the reference pictures for refocusing, whose noise is 40 dB below the signal
REFERENCE_SEED = 1000  # other samples than those of any capture
LEAST_PX = 1000  # of an object away from boundaries, for the focus to be set on it


def _shot(name: str, seed: int) -> tuple[Shot, PsfBank]:
    """Capture, with sensor noise, of the central part of a bundled scene at its own focus, and the camera's bank."""
    rendering.needs_wave()
    scene = dasim.load_scene(name)
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *SHARP_SIZE_PX), scene)
    return photographed(scene, camera, seed, spp=SHARP_SPP), recon.calibrate(dasim.calibration_captures(camera))


def all_in_focus(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = METHODS) -> Evidence:
    """The all-in-focus picture is nearer to the sharp truth than the capture is, at every blur.

    Rationale: deconvolution with the kernel of an estimated depth must be right, not only look sharp.

    Set-up: desk, flowers and adam, central 384 x 288 px of da-mobile with sensor noise; the presets best, bands and
    paper on the raw mosaic. PSNR is that of linear colours without infrared, of the
    capture and of the all-in-focus picture, over pixels away from boundaries, each against ``sharp_e`` of the pinhole,
    and against ``focus_e``, which has the diffraction of the lens in focus and so nothing that an all-in-focus picture
    would have to invent. Boundaries are reported separately.

    Expectation: a gain in dB in each bin of visible blur that holds at least 2 % of the frame's pixels.

    Limit: for the preset best 2.5 dB at 3 to 10 px in all three scenes, 0.5 dB at 10 to 25 px in desk, and no loss in
    any bin of 5 px, against ``sharp_e``. The preset paper is reported without limit: it loses where its levels are
    wrong near the focus. So are all gains against ``focus_e``: near the focus, where the capture differs from it by
    noise alone, sharpening for the pinhole's picture leads away from it.

    Source: sec. 5.4, Fig. 11.
    """
    figures, rows, pictures = [], [], []
    for number, name in enumerate(SHARP_SCENES):
        shot, bank = _shot(name, seed)
        for method in methods:
            result = reconstructed(shot.capture, bank, method)
            gain_figures, table = gains(f"{method}.{name}", result, shot.truth)
            figures += gain_figures
            rows += table
            if method == methods[0]:
                pictures.append((f"{name}, captured", png_address(result.rgb)))
                pictures.append((f"{name}, all in focus, {method}", png_address(result.sharp_rgb)))
        progress((number + 1) / len(SHARP_SCENES))
    head = [
        "method and scene",
        "against",
        "visible blur (px)",
        "share of the frame",
        "capture (dB)",
        "all in focus (dB)",
    ]
    return Evidence(
        figures, pictures=pictures, tables=[("PSNR against the sharp truth and the truth in focus", head, rows)]
    )


def gains(name: str, result: Reconstruction, truth: Truth) -> tuple[list[Figure], list[list[str]]]:
    """Figures of one scene: gains in dB in the ranges with a limit, the least of all bins, and at boundaries; rows of a
    table.
    """
    figures, rows = [], []
    for suffix, exact in picture_scores.references(result, truth).items():
        of_reference, table = _gains(name, suffix, exact, result, truth)
        figures += of_reference
        rows += table
    return figures, rows


def _gains(
    name: str, suffix: str, exact: FloatArray, result: Reconstruction, truth: Truth
) -> tuple[list[Figure], list[list[str]]]:
    """Gains against one of the references, see :func:`gains`."""
    blur, inner = np.abs(truth.blur_px), truth.valid & ~truth.boundary
    against = picture_scores.REFERENCES[suffix]

    def measured(where: BoolArray) -> tuple[float, float]:
        return psnr(result.linear_e, exact, where), psnr(result.sharp_e, exact, where)

    figures, rows, losses = [], [], []
    for low in np.arange(0.0, LARGEST_PX, BIN_PX):
        where = inner & (blur >= low) & (blur < low + BIN_PX)
        if where.mean() >= LEAST_SHARE:
            before, after = measured(where)
            losses.append(after - before)
            bin_px, share = f"{low:g} to {low + BIN_PX:g}", f"{where.mean():.1%}"
            rows.append([name, against, bin_px, share, f"{before:.2f}", f"{after:.2f}"])
    for low, high in JUDGED_PX:
        where = inner & (blur >= low) & (blur < high)
        if where.mean() >= LEAST_SHARE:
            before, after = measured(where)
            text = f"gain in PSNR at {low:g} to {high:g} px of visible blur; the capture has {before:.1f} dB"
            figures.append(
                Figure(f"{name}.{low:g}-{high:g}{suffix}", after - before, "dB", f"{name}, {against}: {text}")
            )
    least = f"{name}, {against}: least gain of all 5-px bins with {LEAST_SHARE:.0%} of the pixels"
    figures.append(Figure(f"{name}.least{suffix}", float(np.min(losses)) if losses else float("nan"), "dB", least))
    before, after = measured(truth.valid & truth.boundary)
    text = f"{name}, {against}: gain in PSNR at boundaries"
    figures.append(Figure(f"{name}.boundary{suffix}", after - before, "dB", text))
    return figures, rows


def refocus(progress: ShareDone, seed: int = 0, methods: Sequence[NamedMethod] = REFOCUSED) -> Evidence:
    """A picture refocused after the shot looks as if the same lens had been focused there.

    Rationale: the paper shows refocused pictures (Fig. 1, 11); in simulation, the lens can be focused again for
    comparison.

    Set-up: desk, captured with its own focus on the wall, reconstructed by the preset best, and refocused to the depth
    of each object in view. The reference is the noise-free ``mean_e`` of the same lens focused there, without infrared,
    resampled for focus breathing: an image distance s' magnifies by s'/s about the principal point, and the electrons
    per pixel decrease with its square. Both pictures are converted to sRGB through the same colour matrix. Pixels away
    from the boundaries of either focus are scored; the object itself is reported separately.

    Expectation: PSNR and SSIM (Gaussian window of 1.5 px) of the display values.

    Limit: above 26 dB and 0.85 for every object.

    Source: Fig. 1(c, d), 11(d).
    """
    shot, bank = _shot("desk", seed)
    scene, camera, truth = dasim.load_scene("desk"), shot.capture.camera, shot.truth
    results = {prefix(method, REFOCUSED): reconstructed(shot.capture, bank, method) for method in methods}
    light, settings = (getattr(next(iter(results.values())), name) for name in ("light", "settings"))
    matrix = colour.colour_matrix(camera, light, infrared.separation(camera, light, recon.Settings(**settings)))
    inner = truth.valid & ~truth.boundary
    numbers = [n for n in range(len(truth.objects)) if np.sum(inner & (truth.object_id == n + 1)) >= LEAST_PX]
    figures, pictures = [], []
    for done, number in enumerate(numbers):
        name, surface = truth.objects[number], truth.object_id == number + 1
        depth_m = float(np.median(truth.depth_m[surface]))
        there = cameras.refocused(camera, depth_m)
        same = Exposure(time_s=shot.capture.exposure_s)
        reference = photographed(scene, there, seed + REFERENCE_SEED, spp=FOCUSED_SPP, exposure=same)
        exact, visible = _without_breathing(reference.truth, there, camera, light)
        mask = inner & visible
        scale = exposure_scale(exact[mask][None].astype(np.float32), matrix)
        by_lens = to_srgb(exact.astype(np.float32), matrix, scale)
        pictures.append((f"the lens focused on the {name}", png_address(by_lens)))
        for label, result in results.items():
            refocused = to_srgb(recon.refocus(result, bank, depth_m), matrix, scale)
            for what, where, text in (("", mask, "all pixels"), ("-object", mask & surface, "the object itself")):
                level, likeness = _likeness(refocused, by_lens, where)
                text = f"{label}focused on the {name}, {100 * depth_m:.1f} cm, {text}"
                figures.append(Figure(f"{label}{name}.psnr{what}", level, "dB", f"{text}: PSNR of sRGB"))
                figures.append(Figure(f"{label}{name}.ssim{what}", likeness, "1", f"{text}: SSIM of sRGB"))
            pictures.append((f"{label}refocused to the {name}", png_address(refocused)))
        progress((done + 1) / len(numbers))
    return Evidence(figures, pictures=pictures)


def _without_breathing(truth: Truth, there: Camera, camera: Camera, light: str) -> tuple[FloatArray, BoolArray]:
    """The lens's own picture without infrared at the magnification of another focus, and the mask [h, w] where it is
    valid.
    """
    ratio = geometry.image_distance_m(there) / geometry.image_distance_m(camera)
    height, width = truth.boundary.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    place = [(((p - n / 2) * ratio + n / 2) - 0.5).astype(np.float32) for p, n in ((x, width), (y, height))]
    inner = (truth.valid & ~truth.boundary).astype(np.float32)
    colours = infrared_free(truth.mean_e, there, light).astype(np.float32) * np.float32(ratio**2)
    moved = cv2.remap(colours, place[0], place[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    visible = cv2.remap(inner, place[0], place[1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(moved, np.float64), np.asarray(visible) == 1


def _likeness(image: NDArray, exact: NDArray, where: BoolArray) -> tuple[float, float]:
    """PSNR in dB and mean SSIM of display values over masked pixels; NaN if the mask is empty."""
    if not where.any():
        return float("nan"), float("nan")
    error = float(np.mean((image[where].astype(np.float64) - exact[where]) ** 2))
    return float(-10 * np.log10(error)), picture_scores.display_scores(image, exact, where)["ssim"]
