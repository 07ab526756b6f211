"""Claim of sec. 3.3: where the radius of the near-infrared hole stands between light and depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import dasim
from dasim.bounds import cramer_rao
from dasim.camera import geometry, noise
from dasim.camera import specification as cameras
from dasim.camera import stops as aperture
from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.reports.plots import plot
from validation.scores.figures import Figure
from validation.subjects import rendering, strips
from validation.subjects.texture import CONTRAST, MEAN_SHARE, white_electrons

ALPHAS = (0.2, 0.3, 0.4, 0.46, 0.5, 0.6, 0.7, 0.8, 0.9)
PAPERS = 0.46
LIGHTS = ("D65", "A", "energy-saving-3500K", "LED-B3")
LEVELS_LUX = {"bright": 5000.0, "dim": 50.0}
FOCUS_M = 0.4  # the far end of the paper's first working range, 5 to 40 cm
BLURS_PX = np.array([3.0, 8.0, 14.0, 20.0, 26.0, 32.0, 40.0, 47.0])  # visible: 24 to 5 cm, even in dioptres
TICKS = (0.2, 0.5, 1, 2, 4)  # of the depth error's axis
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def balance(progress: ShareDone) -> Evidence:
    """A hole of 0.46 gives nearly the depth of the best one, which would be larger in most light.

    Rationale: sec. 3.3 wants the hole as large as possible for light and noise, as small as possible for crosstalk and
    a deep field of infrared, and found 0.46 by experiment. Here both sides are computed.

    Set-up: da-mobile focused at 40 cm with holes of 0.2 to 0.9, its own crosstalk and diffraction; four lights; 5,000
    lux (white at the automatic exposure's level) and 50 lux (at most 1/30 s). A texture of natural spectrum, mean 0.4
    of white, contrast 15 % an octave, in the paper's patch; nothing of the texture is known, so that the difference of
    blur alone tells depth. Depth error: the Cramer-Rao bound from the samples of the green and the infrared plane, root
    mean square over visible blurs of 3 to 47 px (5 to 24 cm), in dioptres: the same scale for every hole.

    Expectation: light loss (1 - alpha^2) / 4, 19.7 % at 0.46; infrared's signal over noise rises with alpha; the depth
    error has a minimum in between, since an alpha of 1 has no difference of blur and an alpha of 0 no light. Where it
    lies is reported for each light and level, and what 0.46 costs against it. By this criterion alone 0.65 to 0.75
    would be better in most light and clearly so in the dark; under A, rich in near-infrared, crosstalk asks for 0.33 in
    bright light. 0.46 stands at the small end of a flat minimum: it gives up little depth for a deep field of
    infrared, the paper's second wish, which the error of depth does not count.

    Limit: loss at 0.46 from 0.195 to 0.205; at 5,000 lux and each light the error at 0.46 at most 1.25 of the least, a
    hole of 0.2 at least 1.2 and one of 0.9 at least 1.3 times worse than 0.46.

    Source: sec. 3.3 and eq. (1); the criterion for depth is the project's own, the paper gives none.
    """
    camera = cameras.refocused(dasim.load_camera("da-mobile"), FOCUS_M)
    error, snr = np.empty((2, len(LEVELS_LUX), len(LIGHTS), len(ALPHAS)))
    for number, alpha in enumerate(ALPHAS):
        holed = with_hole(camera, alpha)
        transfers = cramer_rao.camera_transfers(holed, BLURS_PX, LIGHTS, strips.BOUND_SHAPE, spacing_px=2.0)
        for row, level_lux in enumerate(LEVELS_LUX.values()):
            for column, light in enumerate(LIGHTS):
                part = (transfers[0][column], transfers[1][column])
                error[row, column, number], snr[row, column, number] = depth_error(holed, light, level_lux, part)
        progress((number + 1) / len(ALPHAS))
    loss = [aperture.light_loss([(1, alpha)], 4) for alpha in ALPHAS]
    own = ALPHAS.index(PAPERS)
    figures = [Figure("light-loss", loss[own], "1", "light lost by a hole of 0.46, eq. (1)")]
    rows = []
    for row, (name, level_lux) in enumerate(LEVELS_LUX.items()):
        for column, light in enumerate(LIGHTS):
            curve = error[row, column]
            best, least = minimum(np.array(ALPHAS), curve)
            label, said = f"{light}.{name}", f"{light}, {level_lux:g} lux"
            figures += [
                Figure(f"{label}.best-hole", best, "1", f"{said}: radius ratio of the least depth error"),
                Figure(f"{label}.cost", float(curve[own] / least), "1", f"{said}: depth error at 0.46 over the least"),
                Figure(f"{label}.error", float(curve[own]), "1/m", f"{said}: depth error at 0.46, Cramer-Rao bound"),
                Figure(f"{label}.snr", float(snr[row, column, own]), "1", f"{said}: signal over noise of infrared"),
            ]
            if name == "bright":
                for key, index in (("small-hole", 0), ("large-hole", -1)):
                    text = f"{said}: depth error of a hole of {ALPHAS[index]} over that of 0.46"
                    figures.append(Figure(f"{label}.{key}", float(curve[index] / curve[own]), "1", text))
            cells = [f"{best:.2f}", f"{curve[own] / least:.2f}", f"{curve[own]:.3f}"]
            rows.append([light, f"{level_lux:g}", *cells, f"{snr[row, column, own]:.1f}"])
    head = ["light", "lux", "best hole", "0.46 over best", "error at 0.46, 1/m", "infrared signal / noise"]
    caption = "Light loss, infrared's signal over noise, and depth error against the radius of the hole"
    return Evidence(
        figures, pictures=[(caption, _curves(loss, snr, error))], tables=[("Where 0.46 stands", head, rows)]
    )


def with_hole(camera: Camera, alpha: float) -> Camera:
    """The camera with another radius of its near-infrared hole."""
    stops = [stop.model_dump() | ({"radius_ratio": alpha} if stop.name == "hole" else {}) for stop in camera.stops]
    return rendering.changed(camera, stops=stops)


def depth_error(
    camera: Camera, light: str, level_lux: float, transfers: tuple[NDArray, NDArray]
) -> tuple[float, float]:
    """Root mean square of the depth bound in dioptres, and the signal over noise of infrared.

    ``transfers`` H and dH/dc [blur, channel, h, w/2 + 1] of the planes of a mosaic.
    """
    pair = [CHANNELS.index(name) for name in strips.PAIR]
    white, time_s = white_electrons(camera, light, level_lux)
    mean = MEAN_SHARE * white[pair]
    variance = noise.variance(camera.sensor, time_s).at(mean)
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
    """Place and value of the least of a curve, by a parabola in the logarithm through the three lowest points."""
    index = int(np.clip(np.argmin(y), 1, len(x) - 2))
    if np.argmin(y) != index:
        return float(x[np.argmin(y)]), float(y.min())
    near = slice(index - 1, index + 2)
    a, b, c = np.polyfit(x[near], np.log(y[near]), 2)
    return float(-b / (2 * a)), float(np.exp(c - b**2 / (4 * a)))


def _curves(loss: list[float], snr: FloatArray, error: FloatArray) -> str:
    def draw(axes: Any) -> None:
        axes[0].plot(ALPHAS, 100 * np.array(loss), ".-", color="black")
        axes[0].set(ylabel="light lost, %", ylim=(0, 26))
        for row, (style, level_lux) in enumerate(zip(("-", "--"), LEVELS_LUX.values(), strict=True)):
            for light, colour, ratio, depth in zip(LIGHTS, COLOURS, snr[row], error[row], strict=False):
                label = f"{light}, {level_lux:g} lux"
                axes[1].semilogy(ALPHAS, ratio, style, color=colour, label=label)
                axes[2].semilogy(ALPHAS, depth, style, color=colour, label=label)
        axes[1].set(ylabel="signal over noise of infrared")
        axes[2].set(ylabel="depth error (Cramer-Rao), 1/m")
        axes[0].legend(*axes[1].get_legend_handles_labels(), fontsize=7, loc="lower left")
        axes[2].set_yticks(TICKS, [f"{tick:g}" for tick in TICKS])
        axes[2].minorticks_off()
        for panel in axes:
            panel.axvline(PAPERS, color="#888888", linewidth=0.8)
            panel.set(xlabel="radius of the hole over the lens's")

    return plot(draw, columns=3, size=(3.8, 3.2))
