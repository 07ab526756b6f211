"""Claim on sensor noise: the photon transfer curve of raw frames against the data sheet."""

from __future__ import annotations

import numpy as np

from dasim.camera import noise as sensor
from dasim.camera import specification as cameras
from dasim.camera.specification import Camera
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.reports.plots import plot
from validation.scores.figures import Figure

GAINS = (1.0, 8.0)  # analogue gain: photon noise dominates at 1, read noise contributes visibly at 8
COLOURS = ("#0072b2", "#d55e00")
SIZE_PX = (512, 512)
LEVELS = 24  # even light, from dark to SHARE_OF_FULL of full scale
SHARE_OF_FULL = 0.7
TIME_S = 1e-4  # short, so that dark current is negligible
ROUNDING_DN2 = 1 / 12  # variance of rounding to whole digital numbers


def photon_transfer(progress: ShareDone, seed: int = 0) -> Evidence:
    """The temporal noise of raw frames is photon noise, read noise and rounding, and nothing else.

    Rationale: depth, its confidence and every comparison of apertures depend on the noise of the raw values. A wrong
    factor between electrons and digital numbers, or noise added twice, would show nowhere else.

    Set-up: da-mobile at analogue gain 1 and 8 captures pairs of raw frames of even light, 512 x 512 px, at 24 levels
    from dark to 70 % of full scale, exposed for 0.1 ms. Half the variance of a pair's difference is the temporal
    variance, free of fixed patterns. A straight line is fitted to variance against mean (both in digital numbers, with
    weights 1 / variance^2).

    Expectation: the slope is the overall system gain K, because n electrons have a variance of n. In the dark the line
    has the variance of read noise and rounding, K^2 sigma_d^2 + 1/12. At the brightest level the signal-to-noise ratio
    is that of n photo-electrons with read noise, n / sqrt(n + sigma_d^2). Noise of neighbouring rows and columns is
    uncorrelated.

    Limit: 1 % for the slope, 2 % for read noise in electrons and for the signal-to-noise ratio, 0.01 for correlation.

    Source: EMVA 1288 release 4.0, sec. 6.
    """
    figures, curves = [], {}
    camera = cameras.load_camera("da-mobile")
    for number, analogue in enumerate(GAINS):
        name = f"gain-{analogue:g}"
        mean, variance, correlation = _transfer(camera, analogue, seed)
        weight = 1 / variance**2
        slope, dark = np.polyfit(mean, variance, 1, w=np.sqrt(weight))
        body = camera.sensor
        top_dn = 2**body.adc_bits - 1 - body.black_level_dn
        gain = analogue * (body.dn_per_e if body.dn_per_e is not None else top_dn / body.full_well_e)
        read = np.sqrt(max(dark - ROUNDING_DN2, 0)) / slope
        ratio = mean[-1] / np.sqrt(variance[-1])
        electrons = mean[-1] / gain
        expected = electrons / np.sqrt(electrons + body.read_noise_e**2)
        for key, value, text in (
            ("slope", slope / gain - 1, "relative error of the transfer curve's slope against the data sheet's gain"),
            ("read-noise", read / body.read_noise_e - 1, "relative error of read noise against the data sheet"),
            ("snr", ratio / expected - 1, f"relative error of the signal-to-noise ratio at {electrons:.0f} electrons"),
            ("correlation", correlation, "largest correlation of noise between neighbouring pixels"),
        ):
            figures.append(Figure(f"{name}.{key}", float(value), "1", f"analogue gain {analogue:g}: {text}"))
        curves[name] = (mean, variance, slope, dark)
        progress((number + 1) / len(GAINS))

    def draw(axes):  # type: ignore[no-untyped-def]
        for (name, (mean, variance, slope, dark)), colour in zip(curves.items(), COLOURS, strict=False):
            axes.plot(mean, variance, "o", color=colour, label=name, markersize=4)
            axes.plot(mean, slope * mean + dark, color=colour, linewidth=1)
        axes.set(xlabel="mean above black level in DN", ylabel="temporal variance in DN squared")
        axes.legend()

    return Evidence(figures, [("Photon transfer curves, measured (points) and fitted (lines)", plot(draw))])


def _transfer(camera: Camera, analogue: float, seed: int) -> tuple[FloatArray, FloatArray, float]:
    """Mean above black level and temporal variance in digital numbers, [level] each; the largest correlation.

    The correlation is that of the noise of neighbouring rows or columns, over all levels.
    """
    body = camera.sensor.model_copy(update={"width_px": SIZE_PX[0], "height_px": SIZE_PX[1]})
    full_e = sensor.full_scale_e(body, analogue)
    mean, variance, correlation = [], [], 0.0
    for step, share in enumerate(np.linspace(0, SHARE_OF_FULL, LEVELS)):
        light = np.full(SIZE_PX[::-1], share * full_e)
        frames = [sensor.expose(light, body, TIME_S, seed, gain=analogue, frame=2 * step + k)[0] for k in (0, 1)]
        pair = [frame.astype(np.float64) for frame in frames]
        difference = pair[0] - pair[1]
        mean.append(float(np.mean(pair)) - body.black_level_dn)
        variance.append(float(difference.var()) / 2)
        noise = (difference - difference.mean()) / difference.std()
        beside = (np.mean(noise[1:] * noise[:-1]), np.mean(noise[:, 1:] * noise[:, :-1]))
        correlation = max(correlation, *(abs(float(value)) for value in beside))
    return np.array(mean), np.array(variance), correlation
