"""Claims of the paper on the camera itself: responses, depth of field, kernels, dynamic range."""

from __future__ import annotations

import numpy as np

from dasim.camera import geometry, noise, pointspread, radiometry, specification
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
FIELD_BLURS_PX = np.linspace(-6.0, 24.0, 31)  # visible blur: from behind the focus to well before it
CROSSING_CYCLES_PX = (0.05, 0.1, 0.15, 0.2)
GATED_CYCLES_PX = 0.1
CROSSING_PX, CROSSING_STEPS = (2.0, 12.0), 21  # visible blur between which green and infrared change places
KERNEL_SIZE_PX = 121
KERNEL_LEVELS = (7, 19)  # of Fig. 7
KERNEL_LIGHT = "A"

RANGE_LIGHTS = ("energy-saving-3500K", "F11", "LED-B3", "D65", "D55", "A", "incandescent-2800K")
LITTLE_INFRARED = ("energy-saving-3500K", "F11", "LED-B3")  # of RANGE_LIGHTS
RANGE_CAMERAS = ("da-mobile", "bayer-mobile")
RANGE_PIXELS = (192, 192)
RANGE_STEPS = 12  # of bisection
RANGE_S = 0.01
CLIPPED_SHARE = 1e-3  # of a channel's pixels


def response_curves(progress: ShareDone) -> Evidence:
    """Each visible channel records part of the near-infrared: red nearly all of what the IR pixel does, green and blue
    less.

    Rationale: the coefficients of eq. (8) decide what infrared removal subtracts; the curves are synthetic, so their
    shape has to be what the paper shows.

    Set-up: response curves of da-mobile's sensor behind its 810 nm cut-off, and through the lens with its disc; the
    coefficients as ratios of the integrals over 650-810 nm.

    Expectation: alpha_R near 1, the others well below; the visible peaks in the order blue, green, red.

    Limit: alpha_R 0.85 to 1.1; alpha_G and alpha_B at most half of it.

    Source: Fig. 2(d), eq. (8) and sec. 3.1. Measured silicon sensors behave alike: over 650-810 nm red collects 0.55 to
    0.59 of the clear pixel, green 0.19 to 0.20, blue 0.10.
    """
    camera = cameras.load_camera("da-mobile")
    body = camera.sensor
    curves = specification.quantum_efficiency(body) * grid.short_pass(body.cutoff_nm, body.cutoff_width_nm)
    alpha = specification.crosstalk(camera.sensor)
    peak_nm = [float(grid.WAVELENGTH_NM[curve.argmax()]) for curve in curves]
    figures = [
        Figure(f"alpha.{name}", float(value), "1", f"eq. (8): near-infrared in {name} over that in IR")
        for name, value in zip("RGB", alpha, strict=True)
    ]
    figures += [
        Figure("green-over-red", float(alpha[1] / alpha[0]), "1", "alpha_G / alpha_R"),
        Figure("blue-over-red", float(alpha[2] / alpha[0]), "1", "alpha_B / alpha_R"),
        Figure("order", float(peak_nm[2] < peak_nm[1] < peak_nm[0] < 650), "1", "1: peaks in order, and visible"),
    ]
    progress(0.5)
    through = radiometry.response(camera) / radiometry.response(camera).max()

    def draw(axes):  # type: ignore[no-untyped-def]
        for panel, shown, title in zip(
            axes, (curves, through), ("sensor behind its cut-off", "whole camera"), strict=True
        ):
            for name, curve in zip(CHANNELS, shown, strict=True):
                panel.plot(grid.WAVELENGTH_NM, curve, color=CHANNEL_COLOURS[name], label=name)
            panel.axvspan(*grid.NEAR_INFRARED_NM, color="0.9", zorder=0)
            panel.set(title=title, xlabel="wavelength in nm", ylim=(0, None))
        axes[0].set_ylabel("electrons a photon")
        axes[1].set_ylabel("relative electrons a joule")
        axes[0].legend()

    progress(1.0)
    caption = "Response curves; the near-infrared band 650-810 nm in grey (compare Fig. 2(d))"
    return Evidence(figures, pictures=[(caption, plot(draw, columns=2, size=(4.4, 3.2)))])


def depth_of_field(progress: ShareDone) -> Evidence:
    """Near-infrared has the deeper field; near focus, though, diffraction makes it the blurrier channel.

    Rationale: Fig. 3 shows a deeper field in IR. Geometry says that IR is never blurrier than green, and the paper
    repeats it (sec. 5); but the hole's f/6.1 at 730 nm has an Airy disc of 6.4 px against 2.1 px of the open lens at
    530 nm, so in focus IR is the worse picture. Which depths a method may compare follows from the crossing.

    Set-up: da-mobile focused at 40 cm, D65, 31 depths that stand for a visible blur of -6 to 24 px; contrast at 0.1
    cycles a pixel of the kernels of ``dasim.psf``, wave-true, and of geometric blur discs with the pixel.

    Expectation: the visible blur at which green falls below IR, from ``dasim.psf``, is that of Hopkins's integral over
    the same pupils and responses, where no kernel takes part; geometric blur crosses nowhere. Beyond twice the crossing
    IR keeps more contrast than green at every depth.

    Limit: both crossings within 0.1 px of each other, and within 4 to 7 px; green's contrast over IR's at 16 px
    below 0.5.

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
            what = "visible blur at which green and IR have equal contrast at 0.1 cycles a pixel"
            figures.append(Figure("crossing", crossing, "px", what))
            figures.append(Figure("crossing-error", abs(crossing - theory), "px", f"{what}: kernels against Hopkins"))
    place = CROSSING_CYCLES_PX.index(GATED_CYCLES_PX)
    in_focus, far_out = (int(np.abs(FIELD_BLURS_PX - blur).argmin()) for blur in (0.0, 16.0))
    figures += [
        Figure("in-focus", float(wave[in_focus, 1, place] / wave[in_focus, 3, place]), "1", "green over IR in focus"),
        Figure(
            "at-16-px", float(abs(wave[far_out, 1, place] / wave[far_out, 3, place])), "1", "|green over IR| at 16 px"
        ),
        Figure(
            "geometric", float((geometric[:, 1] - geometric[:, 3]).max()), "1", "green over IR at most, by geometry"
        ),
    ]

    def draw(axes):  # type: ignore[no-untyped-def]
        depth_cm = np.array([geometry.depth_of_blur_m(camera, blur) * 100 for blur in FIELD_BLURS_PX])
        for panel, shown, title in zip(axes, (geometric, wave), ("geometric", "wave-true"), strict=True):
            for channel, name in enumerate(CHANNELS):
                panel.plot(depth_cm, shown[:, channel, place], color=CHANNEL_COLOURS[name], label=name)
            panel.axvline(camera.lens.focus_distance_m * 100, color="0.7", lw=0.8)
            panel.set(title=title, xlabel="depth in cm", xscale="log", ylim=(-0.2, 1))
        axes[0].set_ylabel("contrast at 0.1 cycles a pixel")
        axes[0].legend()

    table = ("Visible blur of equal contrast in green and IR", ["cycles a pixel", "kernels, px", "Hopkins, px"], rows)
    caption = "Contrast against depth, focus at 40 cm (compare Fig. 3)"
    progress(1.0)
    return Evidence(figures, pictures=[(caption, plot(draw, columns=2, size=(4.4, 3.2)))], tables=[table])


def kernels(progress: ShareDone) -> Evidence:
    """A visible kernel is the open lens's and, within it, the small one of the hole; under lamplight mostly in red.

    Rationale: crosstalk makes a visible kernel the sum of both apertures' blurs, in shares that depend on the light
    (sec. 5.1); a bank of another light would be wrong.

    Set-up: ``dasim.psf`` of da-mobile under A at blur levels 7 and 19. Each visible kernel is fitted as
    (1 - q) times the same channel's kernel of bayer-mobile, whose sensor sees no near-infrared, plus q times the IR
    channel's kernel.

    Expectation: q is the share of the channel's electrons that come through the hole alone, an integral of the
    responses over 650-810 nm in which no kernel takes part.

    Limit: 0.02 of the channel's signal; red holds the most by a factor of 1.5 at least.

    Source: Fig. 7, sec. 5.1.
    """
    camera, twin = (cameras.load_camera(name) for name in RANGE_CAMERAS)
    spectrum = illuminants.illuminant(KERNEL_LIGHT)
    signal = grid.integrate(radiometry.response(camera) * spectrum)
    near = grid.integrate(radiometry.response(camera) * spectrum * (grid.WAVELENGTH_NM >= grid.NEAR_INFRARED_NM[0]))
    expected = near / signal
    found = np.empty((len(KERNEL_LEVELS), 3))
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
            found[row, channel] = (difference * small).sum() / (small**2).sum()
        progress((row + 1) / len(KERNEL_LEVELS))
    figures = []
    for channel, name in enumerate("RGB"):
        error = float(np.abs(found[:, channel] - expected[channel]).max())
        what = f"share of near-infrared in {name} under {KERNEL_LIGHT}"
        figures.append(Figure(f"share.{name}", float(found[:, channel].mean()), "1", f"{what}, by its kernel"))
        figures.append(
            Figure(f"error.{name}", error, "1", f"{what}: kernels against responses ({expected[channel]:.3f})")
        )
    ratio = float(found[:, 0].min() / found[:, 1:].max())
    figures.append(Figure("red-over-others", ratio, "1", "red's share over the larger of green's and blue's, at least"))

    pictures = [
        (f"Kernels of level {level} under {KERNEL_LIGHT}, square root of the light (compare Fig. 7)", _kernel_row(tile))
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
    """Near-infrared takes dynamic range from the visible channels, from red most, and only under lights rich in it.

    Rationale: what a channel records of the near-infrared fills its well and is subtracted afterwards.

    Set-up: da-mobile and its Bayer twin photograph even white under seven lights at rising exposure, with all noise;
    the largest signal at which no more than 0.1 % of a channel's pixels are clipped, times the share of it that is
    visible (by eq. (7) on a dimmer frame), and the standard deviation of what eq. (7) leaves in the dark. Dynamic range
    is 20 log10 of their ratio.

    Expectation: headroom falls by -20 log10(1 - alpha_i IR / I_i), in closed form from the responses; the floor rises
    by 10 log10(1 + alpha_i^2), the noise of the infrared pixel that is subtracted, under any light (the paper does not
    name it; its nonlocal means work against it).

    Limit: headroom and floor within 0.25 dB of the closed forms; at most 1 dB of headroom lost in any channel under
    lights poor in near-infrared (the paper: almost no impact); under the others red loses the most.

    Source: sec. 4.5.1.
    """
    cams = [cameras.load_camera(name) for name in RANGE_CAMERAS]
    alpha = np.array(specification.crosstalk(cams[0].sensor))
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
            what = f"dynamic range of {name} under {light}: headroom lost to near-infrared"
            figures.append(Figure(f"{light}.{name}", float(loss[channel]), "dB", what))
        progress((index + 1) / len(RANGE_LIGHTS))
    figures += [
        Figure("headroom-error", errors["headroom"], "dB", "largest difference of lost headroom and closed form"),
        Figure("floor-error", errors["floor"], "dB", "largest difference of the raised floor and closed form"),
        Figure("poor-lights", poor, "dB", "headroom lost at most under lights poor in near-infrared"),
        Figure("red-most", float(red_most), "1", "1: under the other lights red loses the most"),
    ]

    def draw(axes):  # type: ignore[no-untyped-def]
        order = np.argsort(shares)
        for channel, name in enumerate("RGB"):
            axes.plot(np.array(shares)[order], losses[order, channel], "o-", color=CHANNEL_COLOURS[name], label=name)
        for share, light, loss in zip(shares, RANGE_LIGHTS, losses, strict=True):
            axes.annotate(light, (share, loss.max()), fontsize=7, rotation=30)
        axes.set(xlabel="IR over green, electrons on white", ylabel="headroom lost in dB")
        axes.legend()

    head = ["light", "IR / G", *(f"{name}, {c} dB" for name in ("Bayer", "dual aperture") for c in "RGB")]
    table = ("Dynamic range, and headroom lost", [*head, *(f"lost in {c}, dB" for c in "RGB")], rows)
    caption = "Headroom that near-infrared takes, against its share of the light"
    return Evidence(figures, pictures=[(caption, plot(draw))], tables=[table])


def _headroom_and_floor(camera: Camera, spectrum: FloatArray, alpha: FloatArray) -> FloatArray:
    """Largest unclipped visible signal, and its noise in the dark, of R, G, B in electrons, [2, 3]."""
    width, height = RANGE_PIXELS
    body = camera.sensor.model_copy(update={"width_px": width, "height_px": height})
    cropped = camera.model_copy(update={"sensor": body})
    names = cameras.channels(body)
    signal = grid.integrate(radiometry.response(cropped) * spectrum)
    places = cameras.mosaic_channels(cropped)
    infrared = alpha if "IR" in names else np.zeros(3)

    def planes(electrons: FloatArray) -> tuple[list[FloatArray], FloatArray]:
        """Electrons of each channel's pixels, and the share of them that is clipped."""
        frame = np.broadcast_to(electrons, (height, width, len(names)))
        raw, _ = noise.expose(noise.mosaic(frame, cropped), body, RANGE_S, seed=0)
        found = (raw.astype(np.float64) - body.black_level_dn) * noise.electrons_per_dn(body)
        clipped = [np.mean(raw[places == i] >= 2**body.adc_bits - 1) for i in range(len(names))]
        return [found[places == i] for i in range(len(names))], np.array(clipped)

    dim, _ = planes(signal / signal.max() * noise.saturation_e(body) / 4)  # nothing is clipped: tells the share
    share = infrared * (dim[3].mean() if "IR" in names else 0.0) / np.array([dim[i].mean() for i in range(3)])
    dark, _ = planes(np.zeros(len(names)))
    headroom, floor = np.empty(3), np.empty(3)
    for channel in range(3):
        low, high = 0.5, 2.0  # exposures, in units of what fills this channel's well
        for _ in range(RANGE_STEPS):
            middle = (low + high) / 2
            _, clipped = planes(signal / signal[channel] * noise.saturation_e(body) * middle)
            low, high = (middle, high) if clipped[channel] <= CLIPPED_SHARE else (low, middle)
        found, _ = planes(signal / signal[channel] * noise.saturation_e(body) * low)
        headroom[channel] = found[channel].mean() * (1 - share[channel])
        own, other = dark[channel], dark[3] if "IR" in names else dark[channel]
        count = min(len(own), len(other))
        floor[channel] = (own[:count] - infrared[channel] * other[:count]).std()
    return np.stack([headroom, floor])


def _kernel_mtf(camera: Camera, blurs_px: FloatArray, frequency: FloatArray) -> FloatArray:
    """Signed contrast of every channel along a row, from the kernels, [blur, channel, frequency]."""
    x = np.arange(KERNEL_SIZE_PX) - KERNEL_SIZE_PX // 2
    wave = np.cos(2 * np.pi * frequency[:, None] * x)
    make = pointspread.kernels(camera, blurs_px, illuminants.illuminant(LIGHT), KERNEL_SIZE_PX, "wave")
    found = []
    for index in range(len(blurs_px)):
        line = make(index, (0.0, 0.0), ...)[0].sum(axis=-2)
        found.append(line @ wave.T / line.sum(axis=-1, keepdims=True))
    return np.array(found)


def _zero(x: FloatArray, y: FloatArray) -> float:
    """Where y first falls through 0, linear between its samples; NaN where it does not."""
    falls = np.flatnonzero((y[:-1] > 0) & (y[1:] <= 0))
    if not len(falls):
        return float("nan")
    i = int(falls[0])
    return float(x[i] + (x[i + 1] - x[i]) * y[i] / (y[i] - y[i + 1]))


def _geometric_mtf(camera: Camera, blur_px: float, spectrum: FloatArray, frequency: FloatArray) -> FloatArray:
    """The same of uniform discs, one a stop in the shares of its electrons, times the pixel."""
    signal = np.stack([grid.integrate(radiometry.stop_response(camera, stop) * spectrum) for stop in camera.stops])
    discs = np.stack([disc_transfer(ratio * abs(blur_px) * frequency) for ratio in STOP_RATIOS])
    return np.einsum("sc,sf->cf", signal / signal.sum(axis=0), discs) * pixel_transfer(frequency, 0.0)
