"""Claims of the all-in-focus picture: what deconvolution gains over the capture, in bins of blur."""

from __future__ import annotations

import numpy as np

import dasim
import recon
from dasim.values import Reconstruction, Truth
from validation import metrics, rendering
from validation.banks import simulated_bank
from validation.claim import Evidence, Progress
from validation.metrics import Figure, infrared_free, psnr
from validation.report import png_address

SHARP_SCENES = ("desk", "flowers", "adam")
SHARP_SIZE_PX = (384, 288)
SHARP_SPP = 256
JUDGED_PX = ((3.0, 10.0), (10.0, 25.0))  # visible blur
BIN_PX = 5.0
LARGEST_PX = 55.0
LEAST_SHARE = 0.02  # of the frame's pixels in a bin that counts


def all_in_focus(progress: Progress) -> Evidence:
    """The all-in-focus picture is nearer to the sharp truth than the capture is, at every blur.

    Rationale: deconvolution by a kernel that depth has told must not only look sharp, it must be right.

    Set-up: desk, flowers and adam, central 384 x 288 px of da-mobile with sensor noise; the preset paper on the raw
    mosaic with the level map it finds. PSNR of linear colours without infrared, capture and all-in-focus picture,
    each against the pinhole's ``sharp_e``, over pixels away from boundaries. Boundaries are reported apart.

    Expectation: a gain in dB in each bin of visible blur with at least 2 % of the frame's pixels.

    Limit: 2.5 dB at 3 to 10 px in all three scenes, 0.5 dB at 10 to 25 px in desk, no loss in any bin of 5 px.

    Source: sec. 5.4, Fig. 11.
    """
    rendering.needs_wave()
    figures, rows, pictures = [], [], []
    for number, name in enumerate(SHARP_SCENES):
        scene = dasim.load_scene(name)
        camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *SHARP_SIZE_PX), scene)
        shot = dasim.simulate(scene, camera, seed=0, spp=SHARP_SPP)
        result = recon.reconstruct(shot.capture, simulated_bank(camera))
        found, table = gains(name, result, shot.truth)
        figures += found
        rows += table
        pictures += [(f"{name}, captured", png_address(result.rgb)), (f"{name}, sharp", png_address(result.sharp_rgb))]
        progress((number + 1) / len(SHARP_SCENES))
    head = ["scene", "visible blur (px)", "share of the frame", "capture (dB)", "all in focus (dB)"]
    return Evidence(figures, pictures=pictures, tables=[("PSNR against the sharp truth", head, rows)])


def gains(name: str, result: Reconstruction, truth: Truth) -> tuple[list[Figure], list[list[str]]]:
    """Figures of one scene: gains in dB in the judged ranges, the least of all bins, and at boundaries; rows."""
    exact = infrared_free(truth.sharp_e, result.camera)
    blur, inner = np.abs(truth.blur_px), truth.valid & ~truth.boundary

    def measured(where: metrics.Mask) -> tuple[float, float]:
        return psnr(result.linear_e, exact, where), psnr(result.sharp_e, exact, where)

    figures, rows, losses = [], [], []
    for low in np.arange(0.0, LARGEST_PX, BIN_PX):
        where = inner & (blur >= low) & (blur < low + BIN_PX)
        if where.mean() >= LEAST_SHARE:
            before, after = measured(where)
            losses.append(after - before)
            rows.append([name, f"{low:g} to {low + BIN_PX:g}", f"{where.mean():.1%}", f"{before:.2f}", f"{after:.2f}"])
    for low, high in JUDGED_PX:
        where = inner & (blur >= low) & (blur < high)
        if where.mean() >= LEAST_SHARE:
            before, after = measured(where)
            text = f"{name}: gain in PSNR at {low:g} to {high:g} px of visible blur; the capture has {before:.1f} dB"
            figures.append(Figure(f"{name}.{low:g}-{high:g}", after - before, "dB", text))
    least = f"{name}: least gain of all 5-px bins with {LEAST_SHARE:.0%} of the pixels"
    figures.append(Figure(f"{name}.least", min(losses, default=float("nan")), "dB", least))
    before, after = measured(truth.valid & truth.boundary)
    figures.append(Figure(f"{name}.boundary", after - before, "dB", f"{name}: gain in PSNR at boundaries"))
    return figures, rows
