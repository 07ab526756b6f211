"""Claim on sec. 3.3: the hole's radius as a compromise between near-infrared light and depth accuracy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import dasim
from dasim.bounds import cramer_rao
from dasim.camera import geometry, radiometry
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.reports.plots import plot
from validation.scores.figures import Figure
from validation.subjects import rendering, strips
from validation.subjects.texture import CONTRAST, MEAN_SHARE, noise_variance, white_electrons

CAMERA, THIN = "da-mobile", "da-mobile-thin"
THIN_ALPHAS = (0.2, 0.3, 0.4, 0.46, 0.6, 0.7, 0.8)
ALPHAS = (0.2, 0.3, 0.4, 0.46, 0.5, 0.6, 0.7, 0.8, 0.9)
PAPERS = 0.46
LIGHTS = ("D65", "A", "energy-saving-3500K", "LED-B3")
LEVELS_LUX = {"bright": 5000.0, "dim": 50.0}
FOCUS_M = 0.4  # the far end of the paper's first working range, 5 to 40 cm
BLURS_PX = np.array([3.0, 8.0, 14.0, 20.0, 26.0, 32.0, 40.0, 47.0])  # visible: 24 to 5 cm, about evenly in dioptres
TICKS = (0.2, 0.5, 1, 2, 4)  # on the axis of the depth error
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def balance(progress: ShareDone) -> Evidence:
    """A hole of radius ratio 0.46 has nearly the least possible depth error; in most light the optimum is larger.

    Rationale: by sec. 3.3 the hole should be large for light and low noise, and small for little crosstalk and a large
    depth of field in infrared; the paper chose 0.46 by experiment. This claim computes both sides of the compromise.

    Set-up: da-mobile focused at 40 cm with holes of radius ratio alpha = 0.2 to 0.9, including crosstalk and
    diffraction; four illuminants; 5,000 lux (white at the level of the automatic exposure) and 50 lux (exposure time at
    most 1/30 s). The texture has a natural power spectrum, a mean of 0.4 of white, a contrast of 15 % per octave and
    the extent of the paper's patch. The texture itself is unknown, so that only the difference in blur between the
    channels carries depth. The depth error is the Cramer-Rao bound from the samples of the green and the infrared
    plane, as the root mean square over visible blur diameters of 3 to 47 px (24 to 5 cm). It is stated in dioptres,
    which makes holes comparable.

    Expectation: the light loss, from the camera's spectral response with and without smaller stops, is that of eq. (1),
    (1 - alpha^2) / 4, which is 19.7 % at 0.46. The signal-to-noise ratio of infrared
    rises with alpha. The depth error has a minimum in between, since alpha = 1 leaves no difference in blur and
    alpha = 0 no light. The claim reports the minimum for each illuminant and level, and the error at 0.46 relative to
    it. By this criterion alone 0.65 to 0.75 is better in most light, clearly so in dim light; in bright light,
    under D65, 0.5 is as good, and under illuminant A, which is rich in near-infrared, crosstalk moves the optimum
    to 0.33. A hole of 0.46 lies at the small end of a flat minimum: it gives up little depth accuracy for a large
    depth of field in infrared, which the paper also asks for and the depth error does not measure. The figures of
    da-mobile-thin, whose infrared pixels collect 0.7 to 0.8 of the electrons, are reported beside. They hardly move
    the optimum: the infrared has more noise, but there is less of it in red and green.

    Limit: light loss at 0.46 from 0.195 to 0.205. At 5,000 lux, for each illuminant, the depth error at 0.46 is at most
    1.25 times the minimum; that of a hole of 0.2 is at least 1.2 times, and that of 0.9 at least 1.3 times, the error
    at 0.46.

    Source: sec. 3.3 and eq. (1); the criterion for depth is the project's own, since the paper gives none.
    """
    share = len(ALPHAS) / (len(ALPHAS) + len(THIN_ALPHAS))
    error, snr = depth_errors(CAMERA, ALPHAS, lambda done: progress(share * done))
    thin_error, thin_snr = depth_errors(THIN, THIN_ALPHAS, lambda done: progress(share + (1 - share) * done))
    camera = dasim.load_camera(CAMERA)
    loss = [radiometry.light_loss(with_hole(camera, alpha)) for alpha in ALPHAS]
    papers_place = ALPHAS.index(PAPERS)
    figures = [
        Figure(
            "light-loss",
            loss[papers_place],
            "1",
            "light lost with a hole of 0.46, by the spectral response",
        )
    ]
    rows = []
    for row, (name, level_lux) in enumerate(LEVELS_LUX.items()):
        for column, light in enumerate(LIGHTS):
            curve = error[row, column]
            best, least = minimum(np.array(ALPHAS), curve)
            label, case = f"{light}.{name}", f"{light}, {level_lux:g} lux"
            ratio_text = f"{case}: depth error at 0.46 over the minimum"
            figures += [
                Figure(f"{label}.best-hole", best, "1", f"{case}: radius ratio with the least depth error"),
                Figure(f"{label}.cost", float(curve[papers_place] / least), "1", ratio_text),
                Figure(
                    f"{label}.error",
                    float(curve[papers_place]),
                    "1/m",
                    f"{case}: depth error at 0.46, Cramer-Rao bound",
                ),
                Figure(
                    f"{label}.snr",
                    float(snr[row, column, papers_place]),
                    "1",
                    f"{case}: signal-to-noise ratio of IR at 0.46",
                ),
            ]
            if name == "bright":
                for key, index in (("small-hole", 0), ("large-hole", -1)):
                    text = f"{case}: depth error with a hole of {ALPHAS[index]} over that with 0.46"
                    figures.append(Figure(f"{label}.{key}", float(curve[index] / curve[papers_place]), "1", text))
            cells = [f"{best:.2f}", f"{curve[papers_place] / least:.2f}", f"{curve[papers_place]:.3f}"]
            rows.append([CAMERA, light, f"{level_lux:g}", *cells, f"{snr[row, column, papers_place]:.1f}"])
    thin_figures, thin_rows = _thin(thin_error, thin_snr)
    figures, rows = figures + thin_figures, rows + thin_rows
    head = [
        "camera",
        "light",
        "lux",
        "best radius ratio",
        "depth error at 0.46 over minimum",
        "depth error at 0.46, 1/m",
        "signal-to-noise ratio of IR at 0.46",
    ]
    caption = "Light loss, signal-to-noise ratio of IR, and depth error against the radius ratio of the hole"
    table = ("A hole of 0.46 against the best one", head, rows)
    return Evidence(figures, pictures=[(caption, _curves(loss, snr, error))], tables=[table])


def depth_errors(name: str, alphas: tuple[float, ...], progress: ShareDone) -> tuple[FloatArray, FloatArray]:
    """Depth error in dioptres and signal-to-noise ratio of infrared, [level, light, hole], of a camera."""
    camera = cameras.refocused(dasim.load_camera(name), FOCUS_M)
    error, snr = np.empty((2, len(LEVELS_LUX), len(LIGHTS), len(alphas)))
    for number, alpha in enumerate(alphas):
        holed = with_hole(camera, alpha)
        transfers = cramer_rao.camera_transfers(holed, BLURS_PX, LIGHTS, strips.BOUND_SHAPE, spacing_px=2.0)
        for row, level_lux in enumerate(LEVELS_LUX.values()):
            for column, light in enumerate(LIGHTS):
                part = (transfers[0][column], transfers[1][column])
                error[row, column, number], snr[row, column, number] = depth_error(holed, light, level_lux, part)
        progress((number + 1) / len(alphas))
    return error, snr


def _thin(error: FloatArray, snr: FloatArray) -> tuple[list[Figure], list[list[str]]]:
    """Figures and lines of the table for the camera with thin silicon."""
    figures, rows = [], []
    place = THIN_ALPHAS.index(PAPERS)
    for row, (name, level_lux) in enumerate(LEVELS_LUX.items()):
        for column, light in enumerate(LIGHTS):
            best, least = minimum(np.array(THIN_ALPHAS), error[row, column])
            own, ratio = float(error[row, column, place]), float(snr[row, column, place])
            for key, value, unit, text in (
                ("best-hole", best, "1", "radius ratio with the least depth error"),
                ("cost", own / least, "1", "depth error at 0.46 over the minimum"),
                ("error", own, "1/m", "depth error at 0.46, Cramer-Rao bound"),
                ("snr", ratio, "1", "signal-to-noise ratio of IR at 0.46"),
            ):
                label = f"{THIN}, {light}, {level_lux:g} lux: {text}"
                figures.append(Figure(f"thin.{light}.{name}.{key}", value, unit, label))
            cells = [f"{best:.2f}", f"{own / least:.2f}", f"{own:.3f}", f"{ratio:.1f}"]
            rows.append([THIN, light, f"{level_lux:g}", *cells])
    return figures, rows


def with_hole(camera: Camera, alpha: float) -> Camera:
    """The camera with its near-infrared hole changed to the radius ratio ``alpha``."""
    parts = [stop.model_dump() | ({"radius_ratio": alpha} if stop.name == "hole" else {}) for stop in camera.stops]
    return rendering.changed(camera, stops=parts)


def depth_error(
    camera: Camera, light: str, level_lux: float, transfers: tuple[NDArray, NDArray]
) -> tuple[float, float]:
    """Root mean square over blur of the Cramer-Rao bound of 1/z in dioptres, and the signal-to-noise ratio of IR.

    ``transfers`` are the transfer functions H and their derivatives dH/dc by blur diameter,
    [blur, channel, h, w/2 + 1], at the sample spacing of one colour plane of the mosaic (2 px).
    """
    pair = [CHANNELS.index(name) for name in strips.PAIR]
    white, time_s = white_electrons(camera, light, level_lux)
    mean = MEAN_SHARE * white[pair]
    variance = noise_variance(camera, MEAN_SHARE * white, time_s)[pair]
    power = cramer_rao.natural_power(strips.BOUND_SHAPE, spacing_px=2.0, contrast=CONTRAST * mean[0])
    deviation_px = cramer_rao.blur_deviation(
        transfers[0][:, pair],
        transfers[1][:, pair],
        power,
        variance,
        width=strips.BOUND_SHAPE[1],
        area_px=cramer_rao.window_area_px(strips.WINDOW_PX),
        spacing_px=2.0,
        gain=(1.0, mean[1] / mean[0]),
        texture="free",
    )
    per_dioptre = (
        geometry.aperture_m(camera) * geometry.image_distance_m(camera) / (camera.sensor.pixel_pitch_um * 1e-6)
    )
    return float(np.sqrt(np.mean(deviation_px**2)) / per_dioptre), float(mean[0] / np.sqrt(variance[0]))


def minimum(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Position and value of a curve's minimum, by a parabola through the logarithms of the three points around it.

    A minimum at either end of the curve is returned as it stands.
    """
    index = int(np.clip(np.argmin(y), 1, len(x) - 2))
    if np.argmin(y) != index:
        return float(x[np.argmin(y)]), float(y.min())
    near = slice(index - 1, index + 2)
    a, b, c = np.polyfit(x[near], np.log(y[near]), 2)
    return float(-b / (2 * a)), float(np.exp(c - b**2 / (4 * a)))


def _curves(loss: list[float], snr: FloatArray, error: FloatArray) -> str:
    def draw(axes: Any) -> None:
        axes[0].plot(ALPHAS, 100 * np.array(loss), ".-", color="black")
        axes[0].set(ylabel="light loss in %", ylim=(0, 26))
        for row, (style, level_lux) in enumerate(zip(("-", "--"), LEVELS_LUX.values(), strict=True)):
            for light, colour, ratio, depth in zip(LIGHTS, COLOURS, snr[row], error[row], strict=False):
                label = f"{light}, {level_lux:g} lux"
                axes[1].semilogy(ALPHAS, ratio, style, color=colour, label=label)
                axes[2].semilogy(ALPHAS, depth, style, color=colour, label=label)
        axes[1].set(ylabel="signal-to-noise ratio of IR")
        axes[2].set(ylabel="depth error (Cramer-Rao bound) in 1/m")
        axes[0].legend(*axes[1].get_legend_handles_labels(), fontsize=7, loc="lower left")
        axes[2].set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
        axes[2].minorticks_off()
        for panel in axes:
            panel.axvline(PAPERS, color="#888888", linewidth=0.8)
            panel.set(xlabel="radius ratio of the hole")

    return plot(draw, columns=3, size=(3.8, 3.2))
