"""Claims on the camera: spectral responses, depth of field, point spread functions, dynamic range."""

from __future__ import annotations

import numpy as np

from dasim.camera import geometry, noise, pointspread, radiometry, specification
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.spectra import grid, illuminants
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references.paper import STOP_RATIOS
from validation.references.transfer import disc_transfer, pixel_transfer, wave_mtf
from validation.reports.plots import CHANNEL_COLOURS, plot
from validation.scores.figures import Figure

LIGHT = "D65"
FIELD_BLURS_PX = np.linspace(-6.0, 24.0, 31)  # visible blur: from beyond the focal plane to well in front of it
CROSSING_CYCLES_PX = (0.05, 0.1, 0.15, 0.2)
GATED_CYCLES_PX = 0.1
CROSSING_PX, CROSSING_STEPS = (2.0, 12.0), 21  # range of visible blur searched for equal contrast of green and IR
KERNEL_SIZE_PX = 121
KERNEL_LEVELS = (7, 19)  # the blur levels of Fig. 7
KERNEL_LIGHT = "A"

RANGE_LIGHTS = ("energy-saving-3500K", "F11", "LED-B3", "D65", "D55", "A", "incandescent-2800K")
LITTLE_INFRARED = ("energy-saving-3500K", "F11", "LED-B3")  # those of RANGE_LIGHTS with little near-infrared
RANGE_CAMERAS = ("da-mobile", "bayer-mobile")
RANGE_PIXELS = (192, 192)
RANGE_STEPS = 12  # bisection steps
RANGE_S = 0.01  # exposure time
CLIPPED_SHARE = 1e-3  # largest share of a channel's pixels that may be clipped


def response_curves(progress: ShareDone) -> Evidence:
    """Each visible channel records part of the near-infrared: red nearly as much as the IR channel, green and blue
    less.

    Rationale: the crosstalk coefficients of eq. (8) determine how much infrared removal subtracts. The bundled response
    curves are synthetic, so their shape must match the one that the paper shows.

    Set-up: the response curves of da-mobile's sensor behind its 810 nm cut-off filter, and of the whole camera with
    lens and IR-cut disc. The coefficient alpha_i is the integral of channel i's curve over 650-810 nm divided by that
    of the IR channel.

    Expectation: alpha_R is close to 1 and the other two are well below it; the visible peaks follow in the order blue,
    green, red.

    Limit: alpha_R from 0.85 to 1.1; alpha_G and alpha_B at most half of alpha_R.

    Source: Fig. 2(d), eq. (8) and sec. 3.1. Measured silicon sensors behave in the same way: over 650-810 nm red
    collects 0.55 to 0.59 of what a clear pixel collects, green 0.19 to 0.20, blue 0.10.
    """
    camera = cameras.load_camera("da-mobile")
    body = camera.sensor
    curves = sensors.quantum_efficiency(body) * grid.short_pass(body.cutoff_nm, body.cutoff_width_nm)
    alpha = specification.crosstalk(camera)
    peak_nm = [float(grid.WAVELENGTH_NM[curve.argmax()]) for curve in curves]
    figures = [
        Figure(f"alpha.{name}", float(value), "1", f"alpha_{name} of eq. (8): near-infrared in {name} over that in IR")
        for name, value in zip("RGB", alpha, strict=True)
    ]
    figures += [
        Figure("green-over-red", float(alpha[1] / alpha[0]), "1", "alpha_G / alpha_R"),
        Figure("blue-over-red", float(alpha[2] / alpha[0]), "1", "alpha_B / alpha_R"),
        Figure(
            "order",
            float(peak_nm[2] < peak_nm[1] < peak_nm[0] < 650),
            "1",
            "1 if the peaks of B, G and R follow in this order, all below 650 nm",
        ),
    ]
    progress(0.5)
    through = radiometry.response(camera) / radiometry.response(camera).max()

    def draw(axes):  # type: ignore[no-untyped-def]
        for panel, curves_of_panel, title in zip(
            axes, (curves, through), ("sensor with its cut-off filter", "whole camera"), strict=True
        ):
            for name, curve in zip(CHANNELS, curves_of_panel, strict=True):
                panel.plot(grid.WAVELENGTH_NM, curve, color=CHANNEL_COLOURS[name], label=name)
            panel.axvspan(*grid.NEAR_INFRARED_NM, color="0.9", zorder=0)
            panel.set(title=title, xlabel="wavelength in nm", ylim=(0, None))
        axes[0].set_ylabel("electrons per photon")
        axes[1].set_ylabel("electrons per joule, relative")
        axes[0].legend()

    progress(1.0)
    caption = "Response curves; grey: the near-infrared band, 650-810 nm (compare Fig. 2(d))"
    return Evidence(figures, pictures=[(caption, plot(draw, columns=2, size=(4.4, 3.2)))])


def depth_of_field(progress: ShareDone) -> Evidence:
    """The near-infrared channel has the larger depth of field, but near focus diffraction makes it the blurrier one.

    Rationale: Fig. 3 shows a larger depth of field in IR. By geometry IR is never blurrier than green, and the paper
    repeats this (sec. 5). Diffraction contradicts it near focus: the hole works at f/6.1, and its Airy disc at 730 nm
    is 6.4 px wide, against 2.1 px for the open lens at 530 nm. The blur at which green and IR have equal contrast
    therefore bounds the depths at which a method may assume that IR is the sharper channel.

    Set-up: da-mobile focused at 40 cm, D65, 31 depths whose visible blur diameter runs from -6 to 24 px. The contrast
    at 0.1 cycles per pixel is computed from the wave-optical PSFs of ``dasim.psf``, and from geometric blur discs
    integrated over the pixel.

    Expectation: the visible blur at which green's contrast falls below that of IR is the same from ``dasim.psf`` and
    from Hopkins's integral over the same pupils and responses, which uses no PSF. Geometric blur has no such crossing.
    Beyond twice the crossing IR keeps more contrast than green at every depth.

    Limit: the two crossings differ by at most 0.1 px and lie within 4 to 7 px; the ratio of green's contrast to that
    of IR at 16 px is below 0.5.

    Source: Fig. 3, sec. 3.3; Hopkins 1955.
    """
    camera = cameras.load_camera("da-mobile")
    spectrum = illuminants.illuminant(LIGHT)
    frequency = np.array(CROSSING_CYCLES_PX)
    wave = _kernel_mtf(camera, FIELD_BLURS_PX, frequency)
    progress(0.5)
    geometric = np.stack([_geometric_mtf(camera, blur, spectrum, frequency) for blur in FIELD_BLURS_PX])
    figures, rows = [], []
    around = np.linspace(*CROSSING_PX, CROSSING_STEPS)
    by_kernel = _kernel_mtf(camera, around, frequency)
    by_theory = np.stack([wave_mtf(camera, blur, spectrum, frequency, 0.0) for blur in around])
    for place, cycles in enumerate(CROSSING_CYCLES_PX):
        crossing, theory = (_zero(around, mtf[:, 1, place] - mtf[:, 3, place]) for mtf in (by_kernel, by_theory))
        rows.append([f"{cycles:g}", f"{crossing:.2f}", f"{theory:.2f}"])
        if cycles == GATED_CYCLES_PX:
            what = "visible blur at which green and IR have equal contrast at 0.1 cycles per pixel"
            error_text = f"{what}: difference between PSFs and Hopkins's integral"
            figures.append(Figure("crossing", crossing, "px", what))
            figures.append(Figure("crossing-error", abs(crossing - theory), "px", error_text))
    place = CROSSING_CYCLES_PX.index(GATED_CYCLES_PX)
    in_focus, far_out = (int(np.abs(FIELD_BLURS_PX - blur).argmin()) for blur in (0.0, 16.0))
    figures += [
        Figure(
            "in-focus",
            float(wave[in_focus, 1, place] / wave[in_focus, 3, place]),
            "1",
            "contrast of green over that of IR, in focus",
        ),
        Figure(
            "at-16-px",
            float(abs(wave[far_out, 1, place] / wave[far_out, 3, place])),
            "1",
            "magnitude of green's contrast over that of IR, at 16 px of visible blur",
        ),
        Figure(
            "geometric",
            float((geometric[:, 1] - geometric[:, 3]).max()),
            "1",
            "largest contrast of green less that of IR, by geometry",
        ),
    ]

    def draw(axes):  # type: ignore[no-untyped-def]
        depth_cm = np.array([geometry.depth_of_blur_m(camera, blur) * 100 for blur in FIELD_BLURS_PX])
        for panel, mtf, title in zip(axes, (geometric, wave), ("geometric optics", "wave optics"), strict=True):
            for channel, name in enumerate(CHANNELS):
                panel.plot(depth_cm, mtf[:, channel, place], color=CHANNEL_COLOURS[name], label=name)
            panel.axvline(camera.lens.focus_distance_m * 100, color="0.7", lw=0.8)
            panel.set(title=title, xlabel="depth in cm", xscale="log", ylim=(-0.2, 1))
        axes[0].set_ylabel("contrast at 0.1 cycles per pixel")
        axes[0].legend()

    table = (
        "Visible blur at which green and IR have equal contrast",
        ["cycles per pixel", "from PSFs, px", "from Hopkins's integral, px"],
        rows,
    )
    caption = "Contrast against depth, focus at 40 cm (compare Fig. 3)"
    progress(1.0)
    return Evidence(figures, pictures=[(caption, plot(draw, columns=2, size=(4.4, 3.2)))], tables=[table])


def kernels(progress: ShareDone) -> Evidence:
    """A visible channel's PSF is a large blur disc from the open lens plus a small one from the hole; under
    incandescent light the small one is strongest in red.

    Rationale: crosstalk makes each visible PSF the sum of both apertures' PSFs, in proportions that depend on the
    illuminant (sec. 5.1). A PSF bank made under another illuminant would be wrong.

    Set-up: PSFs of da-mobile under illuminant A at blur levels 7 and 19. Each visible PSF is fitted by
    (1 - q) times the PSF of the same channel of bayer-mobile, whose sensor sees no near-infrared, plus q times the PSF
    of the IR channel.

    Expectation: q equals the share of the channel's electrons that arrive through the hole alone, which is an integral
    of the responses over 650-810 nm and uses no PSF.

    Limit: q within 0.02; q of red at least 1.5 times that of green and blue.

    Source: Fig. 7, sec. 5.1.
    """
    camera, twin = (cameras.load_camera(name) for name in RANGE_CAMERAS)
    spectrum = illuminants.illuminant(KERNEL_LIGHT)
    signal = grid.integrate(radiometry.response(camera) * spectrum)
    near = grid.integrate(radiometry.response(camera) * spectrum * (grid.WAVELENGTH_NM >= grid.NEAR_INFRARED_NM[0]))
    expected = near / signal
    fitted = np.empty((len(KERNEL_LEVELS), 3))
    tiles = []
    for row, level in enumerate(KERNEL_LEVELS):
        blur = float(geometry.level_blur_px(camera)[level])
        size = 2 * int(np.ceil(blur)) + 41
        both, alone = (
            pointspread.kernels(body, [blur], spectrum, size, "wave")(0, (0.0, 0.0), ...)[0] for body in (camera, twin)
        )
        tiles.append(both)
        for channel in range(3):
            difference, small = both[channel] - alone[channel], both[3] - alone[channel]
            fitted[row, channel] = (difference * small).sum() / (small**2).sum()
        progress((row + 1) / len(KERNEL_LEVELS))
    figures = []
    for channel, name in enumerate("RGB"):
        error = float(np.abs(fitted[:, channel] - expected[channel]).max())
        what = f"share of near-infrared in {name} under {KERNEL_LIGHT}"
        error_text = f"{what}: largest difference between the fit and the responses, which give {expected[channel]:.3f}"
        figures.append(Figure(f"share.{name}", float(fitted[:, channel].mean()), "1", f"{what}, fitted to the PSF"))
        figures.append(Figure(f"error.{name}", error, "1", error_text))
    ratio = float(fitted[:, 0].min() / fitted[:, 1:].max())
    text = "smallest share of near-infrared in red over the largest in green and blue"
    figures.append(Figure("red-over-others", ratio, "1", text))

    pictures = [
        (f"PSFs of level {level} under {KERNEL_LIGHT}, shown as square root (compare Fig. 7)", _kernel_row(tile))
        for level, tile in zip(KERNEL_LEVELS, tiles, strict=True)
    ]
    return Evidence(figures, pictures=pictures)


def _kernel_row(tile: FloatArray) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        for panel, kernel, name in zip(axes, tile, CHANNELS, strict=True):
            panel.imshow(np.sqrt(np.maximum(kernel, 0)), cmap="magma")
            panel.set_axis_off()
            panel.set_title(name, fontsize=9)

    return plot(draw, columns=4, size=(1.8, 2.0))


def dynamic_range(progress: ShareDone) -> Evidence:
    """Near-infrared crosstalk costs the visible channels dynamic range, red the most, and only under lights rich in
    near-infrared.

    Rationale: the near-infrared that a visible channel records fills its well and is subtracted afterwards.

    Set-up: da-mobile and the Bayer camera bayer-mobile capture an even white field with all noise under seven lights.
    Headroom is the largest signal at which at most 0.1 % of a channel's pixels are clipped, times the visible share of
    that signal (by eq. (7) on a dimmer frame). The noise floor is the standard deviation that eq. (7) leaves in a dark
    frame. Dynamic range is 20 log10 of headroom over noise floor.

    Expectation: crosstalk reduces headroom by -20 log10(1 - alpha_i IR / I_i), a closed form of the responses.
    Subtracting the infrared pixel's noise raises the floor by 10 log10(1 + alpha_i^2) under any light; the paper does
    not mention this loss, which its non-local means filter reduces.

    Limit: headroom and floor within 0.25 dB of the closed forms; at most 1 dB of headroom lost in any channel under
    lights poor in near-infrared (the paper: almost no impact); under the other lights red loses the most.

    Source: sec. 4.5.1.
    """
    cams = [cameras.load_camera(name) for name in RANGE_CAMERAS]
    alpha = np.array(specification.crosstalk(cams[0]))
    rows, figures = [], []
    errors, poor, red_most = {"headroom": 0.0, "floor": 0.0}, 0.0, True
    shares = []
    losses = np.empty((len(RANGE_LIGHTS), 3))
    for index, light in enumerate(RANGE_LIGHTS):
        spectrum = illuminants.illuminant(light)
        measured = np.array([_headroom_and_floor(camera, spectrum, alpha) for camera in cams])  # [camera, 2, 3]
        loss = 20 * np.log10(measured[1, 0] / measured[0, 0])
        rise = 20 * np.log10(measured[0, 1] / measured[1, 1])
        signal = grid.integrate(radiometry.response(cams[0]) * spectrum)
        share = alpha * signal[3] / signal[:3]
        shares.append(float(signal[3] / signal[1]))
        losses[index] = loss
        errors["headroom"] = max(errors["headroom"], float(np.abs(loss + 20 * np.log10(1 - share)).max()))
        errors["floor"] = max(errors["floor"], float(np.abs(rise - 10 * np.log10(1 + alpha**2)).max()))
        if light in LITTLE_INFRARED:
            poor = max(poor, float(loss.max()))
        else:
            red_most &= bool(loss.argmax() == 0)
        ranges = 20 * np.log10(measured[:, 0] / measured[:, 1])
        rows.append(
            [light, f"{shares[-1]:.2f}", *(f"{v:.1f}" for v in (*ranges[1], *ranges[0])), *(f"{v:.2f}" for v in loss)]
        )
        for channel, name in enumerate("RGB"):
            what = f"{light}: headroom of {name} lost to near-infrared"
            figures.append(Figure(f"{light}.{name}", float(loss[channel]), "dB", what))
        progress((index + 1) / len(RANGE_LIGHTS))
    figures += [
        Figure("headroom-error", errors["headroom"], "dB", "largest difference of lost headroom from its closed form"),
        Figure(
            "floor-error", errors["floor"], "dB", "largest difference of the noise floor's rise from its closed form"
        ),
        Figure("poor-lights", poor, "dB", "largest loss of headroom under lights poor in near-infrared"),
        Figure("red-most", float(red_most), "1", "1 if red loses the most under each of the other lights"),
    ]

    def draw(axes):  # type: ignore[no-untyped-def]
        order = np.argsort(shares)
        for channel, name in enumerate("RGB"):
            axes.plot(np.array(shares)[order], losses[order, channel], "o-", color=CHANNEL_COLOURS[name], label=name)
        for share, light, loss in zip(shares, RANGE_LIGHTS, losses, strict=True):
            axes.annotate(light, (share, loss.max()), fontsize=7, rotation=30)
        axes.set(xlabel="electrons of IR over green, white surface", ylabel="headroom lost in dB")
        axes.legend()

    head = ["light", "IR / G", *(f"{name}, {c}, dB" for name in ("Bayer", "dual aperture") for c in "RGB")]
    table = ("Dynamic range and lost headroom", [*head, *(f"headroom lost in {c}, dB" for c in "RGB")], rows)
    caption = "Headroom lost to near-infrared, against the ratio of IR to green electrons"
    return Evidence(figures, pictures=[(caption, plot(draw))], tables=[table])


def _headroom_and_floor(camera: Camera, spectrum: FloatArray, alpha: FloatArray) -> FloatArray:
    """Headroom and noise floor of R, G and B in electrons after infrared removal, [2, 3].

    ``alpha`` [3] are the coefficients of eq. (8); a camera without IR pixels subtracts nothing.
    """
    width, height = RANGE_PIXELS
    body = camera.sensor.model_copy(update={"width_px": width, "height_px": height})
    cropped = camera.model_copy(update={"sensor": body})
    names = sensors.channels(body)
    signal = grid.integrate(radiometry.response(cropped) * spectrum)
    places = cameras.mosaic_channels(cropped)
    infrared = alpha if "IR" in names else np.zeros(3)

    def planes(electrons: FloatArray) -> tuple[list[FloatArray], FloatArray]:
        """Recorded electrons of each channel's pixels, and the share of these pixels that is clipped."""
        frame = np.broadcast_to(electrons, (height, width, len(names)))
        raw, _ = noise.expose(noise.mosaic(frame, cropped), body, RANGE_S, seed=0)
        recorded = (raw.astype(np.float64) - body.black_level_dn) * noise.electrons_per_dn(body)
        clipped = [np.mean(raw[places == i] >= 2**body.adc_bits - 1) for i in range(len(names))]
        return [recorded[places == i] for i in range(len(names))], np.array(clipped)

    dim, _ = planes(signal / signal.max() * noise.saturation_e(body) / 4)  # unclipped, for the share of near-infrared
    share = infrared * (dim[3].mean() if "IR" in names else 0.0) / np.array([dim[i].mean() for i in range(3)])
    dark, _ = planes(np.zeros(len(names)))
    headroom, floor = np.empty(3), np.empty(3)
    for channel in range(3):
        low, high = 0.5, 2.0  # exposures, in units of the one that saturates this channel
        for _ in range(RANGE_STEPS):
            middle = (low + high) / 2
            _, clipped = planes(signal / signal[channel] * noise.saturation_e(body) * middle)
            low, high = (middle, high) if clipped[channel] <= CLIPPED_SHARE else (low, middle)
        brightest, _ = planes(signal / signal[channel] * noise.saturation_e(body) * low)
        headroom[channel] = brightest[channel].mean() * (1 - share[channel])
        channel_floor, other = dark[channel], dark[3] if "IR" in names else dark[channel]
        count = min(len(channel_floor), len(other))
        floor[channel] = (channel_floor[:count] - infrared[channel] * other[:count]).std()
    return np.stack([headroom, floor])


def _kernel_mtf(camera: Camera, blurs_px: FloatArray, frequency: FloatArray) -> FloatArray:
    """Signed MTF of every channel along a row, from the PSFs, [blur, channel, frequency].

    ``blurs_px`` are visible blur diameters, ``frequency`` is in cycles per pixel.
    """
    x = np.arange(KERNEL_SIZE_PX) - KERNEL_SIZE_PX // 2
    wave = np.cos(2 * np.pi * frequency[:, None] * x)
    make = pointspread.kernels(camera, blurs_px, illuminants.illuminant(LIGHT), KERNEL_SIZE_PX, "wave")
    contrast = []
    for index in range(len(blurs_px)):
        line = make(index, (0.0, 0.0), ...)[0].sum(axis=-2)
        contrast.append(line @ wave.T / line.sum(axis=-1, keepdims=True))
    return np.array(contrast)


def _zero(x: FloatArray, y: FloatArray) -> float:
    """The first x at which y falls through 0, by linear interpolation; NaN if it never does."""
    crossings = np.flatnonzero((y[:-1] > 0) & (y[1:] <= 0))
    if not len(crossings):
        return float("nan")
    i = int(crossings[0])
    return float(x[i] + (x[i + 1] - x[i]) * y[i] / (y[i] - y[i + 1]))


def _geometric_mtf(camera: Camera, blur_px: float, spectrum: FloatArray, frequency: FloatArray) -> FloatArray:
    """Signed MTF by geometric optics, [channel, frequency]: one uniform disc per stop, integrated over the pixel.

    Each stop's disc is weighted by its share of the channel's electrons under ``spectrum``.
    """
    signal = np.stack([grid.integrate(radiometry.stop_response(camera, stop) * spectrum) for stop in camera.stops])
    discs = np.stack([disc_transfer(ratio * abs(blur_px) * frequency) for ratio in STOP_RATIOS])
    return np.einsum("sc,sf->cf", signal / signal.sum(axis=0), discs) * pixel_transfer(frequency, 0.0)
