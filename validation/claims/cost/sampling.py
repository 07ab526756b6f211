"""Claims on rendering noise: how fast it falls with the number of samples, and its cost in processor time."""

from __future__ import annotations

import time

import numpy as np
from scipy.stats import chi2

import dasim
from dasim.camera.specification import Camera
from dasim.scene import loading
from dasim.scene import specification as scenes
from dasim.spectra.grid import CHANNELS
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.references.paper import STOP_RATIOS
from validation.reports.plots import CHANNEL_COLOURS, plot
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.rendering import NotRun

SCENE = "desk"
MAX_BLUR_PX = 30.0  # more than the blur of the nearest object of desk

SLOPE_SIZE_PX = (96, 72)
SLOPE_SPP = (16, 64, 256, 1024)
SLOPE_SEEDS = 4

NOISE_SIZE_PX = (384, 288)
NOISE_SPP, NOISE_SEEDS = 256, 3

COST_SIZE_PX = (512, 384)
COST_NOISE = 0.01
COST_SPP = (36, 121)
COST_NAIVE_SPP = 16
COST_SEEDS, COST_NAIVE_SEEDS = 3, 12  # few naive rays pass the stop, so their variance needs more seeds


def relative_noise(pictures: FloatArray) -> FloatArray:
    """Median over pixels of the relative standard deviation over seeds, [channel], from [seed, h, w, channel].

    The median of the standard deviation from few seeds is biased low. The bias is corrected for normal noise, with the
    median of the chi-squared distribution.
    """
    count = len(pictures)
    mean = pictures.mean(axis=0)
    ratio = np.divide(pictures.std(axis=0, ddof=1), mean, out=np.zeros_like(mean), where=mean > 0)
    return np.median(ratio, axis=(0, 1)) / np.sqrt(chi2.ppf(0.5, count - 1) / (count - 1))


def desk(size_px: tuple[int, int]) -> tuple[dasim.Scene, Camera]:
    """The bundled scene ``desk`` and a central crop [width, height] of da-mobile, focused as the scene proposes."""
    scene = loading.load_scene(SCENE)
    return scene, dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *size_px), scene)


def noise_slope_off(progress: ShareDone) -> Evidence:
    """Without diffraction, rendering noise falls faster with the number of samples than it does for independent
    samples.

    Rationale: pictures with little rendering noise must be affordable. Independent samples give a slope of -0.5 of
    log noise against log samples.

    Set-up: a central crop of 96 x 72 px of the bundled scene ``desk``, da-mobile, both stops, with 16, 64, 256 and
    1,024 samples per pixel and stop, four seeds each, diffraction off. Noise is the median over pixels of the relative
    standard deviation over seeds.

    Expectation: the slope of the straight line through log noise against log samples is steeper than -0.5 in every
    channel.

    Limit: slope below -0.6 for each channel.

    Source: stratified sampling in several dimensions; the noise of independent samples falls as N^-0.5.
    """
    rendering.activate()
    return _noise_slope("off", progress)


def noise_slope_wave(progress: ShareDone) -> Evidence:
    """With wave-true blur, rendering noise falls faster with the number of samples than it does for independent
    samples.

    Rationale: the sample weights of wave optics must not cancel the gain of stratified sampling.

    Set-up: as in ``noise-slope-off``, with diffraction 'wave'.

    Expectation: the slope of the straight line through log noise against log samples is steeper than -0.5 in every
    channel.

    Limit: slope below -0.6 for each channel.

    Source: stratified sampling in several dimensions; the noise of independent samples falls as N^-0.5.
    """
    rendering.needs_wave()
    return _noise_slope("wave", progress)


def _noise_slope(model: str, progress: ShareDone) -> Evidence:
    from dasim.render import passes, translate

    scene, camera = desk(SLOPE_SIZE_PX)
    loaded, spectrum = translate.load(scene), scenes.light_spectrum(scene)
    count = np.array([passes.sample_count(spp) for spp in SLOPE_SPP])
    noise = np.empty((len(SLOPE_SPP), 4))
    for index, spp in enumerate(SLOPE_SPP):
        pictures = [
            rendering.stop_pictures(
                loaded, camera, spp, seed, diffraction=model, max_blur_px=MAX_BLUR_PX, spectrum=spectrum
            ).sum(axis=0)
            for seed in range(SLOPE_SEEDS)
        ]
        noise[index] = relative_noise(np.stack(pictures))
        progress((index + 1) / len(SLOPE_SPP))
    slopes = np.polyfit(np.log(count), np.log(noise), 1)[0]
    figures = []
    for channel, name in enumerate(CHANNELS):
        what = f"{name}: slope of log noise against log samples, {count[0]} to {count[-1]} samples per pixel and stop"
        figures.append(Figure(f"slope.{name}", float(slopes[channel]), "1", what))
    for channel, name in enumerate(CHANNELS):
        what = f"{name}: median relative noise at {count[2]} samples per pixel and stop"
        figures.append(Figure(f"noise.{name}", float(noise[2, channel]), "1", what))
    caption = "Median relative noise against samples per pixel and stop; grey: slope -0.6"
    return Evidence(figures, [(caption, _slope_plot(count, noise))])


def _slope_plot(count: FloatArray, noise: FloatArray) -> str:
    def draw(axes):  # type: ignore[no-untyped-def]
        for channel, name in enumerate(CHANNELS):
            axes.loglog(count, noise[:, channel], "o-", label=name, color=CHANNEL_COLOURS[name])
        axes.loglog(count, noise[0].max() * (count / count[0]) ** -0.6, color="0.7")
        axes.set(xlabel="samples per pixel and stop", ylabel="relative noise")
        axes.legend(ncols=2)

    return plot(draw, size=(5.0, 3.2))


def desk_noise(progress: ShareDone) -> Evidence:
    """Wave-true blur has at most three times the rendering noise of geometric blur, and below 0.6 % at 256 samples.

    Rationale: the sample weights of wave optics add noise, which must stay well below shot noise: a pixel with 1,000
    electrons has 3 %.

    Set-up: captures of the bundled scene ``desk`` by ``dasim.simulate``, central 384 x 288 px, da-mobile, 256 samples
    per pixel and stop, three seeds, with diffraction 'off' and 'wave'.

    Expectation: the noise of each channel, as the median over pixels of the relative standard deviation over seeds, is
    of similar size with and without diffraction.

    Limit: noise with 'wave' at most 3 times that with 'off', and below 0.6 %.

    Source: the limits are the project's own; plain weights w would multiply the variance by E[w^2], up to 1.6.
    """
    rendering.needs_wave()
    scene, camera = desk(NOISE_SIZE_PX)
    noise = {}
    for part, model in enumerate(("off", "wave")):
        pictures = []
        for seed in range(NOISE_SEEDS):
            pictures.append(rendering.capture_rate(scene, camera, NOISE_SPP, seed, diffraction=model))
            progress((part * NOISE_SEEDS + seed + 1) / (2 * NOISE_SEEDS))
        noise[model] = relative_noise(np.stack(pictures))
    figures = []
    for channel, name in enumerate(CHANNELS):
        wave, off = float(noise["wave"][channel]), float(noise["off"][channel])
        figures += [
            Figure(f"wave.{name}", wave, "1", f"{name}: median relative noise with 'wave', {NOISE_SPP} samples"),
            Figure(f"off.{name}", off, "1", f"{name}: median relative noise with 'off', {NOISE_SPP} samples"),
            Figure(f"ratio.{name}", wave / off, "1", f"{name}: noise with 'wave' over noise with 'off'"),
        ]
    return Evidence(figures)


def render_cost(progress: ShareDone) -> Evidence:
    """Rendering one pass per stop reaches 1 % noise in near-infrared at a fraction of a naive renderer's cost.

    Rationale: the simulator renders each stop in a separate pass because a ray that a stop blocks is wasted work.

    Set-up: the bundled scene ``desk``, central 512 x 384 px, da-mobile, diffraction off. Both renderers run in the same
    process with compiled kernels, and their cost is the processor time of all threads. Ours renders both stops with 36
    and 121 samples per pixel. The naive renderer (``validation.references.naive_render``) uses one pass with the
    ``independent`` sampler and four wavelengths per ray spread over 400 to 830 nm; its rays cover the open lens, and
    each is tested against the stops. Noise is the median over pixels of the relative standard deviation over three
    seeds (naive: twelve).

    Expectation: the figure is the processor time to 1 % noise in IR. For ours it follows from the power law through
    both measured points, for the naive renderer from one measured run and the law of independent samples, noise^2 ~ 1 /
    N and cost ~ N. The naive noise is at least that of the rejections at the stop alone, sqrt((1 / alpha^2 - 1) / N),
    which is 0.48 at 16 samples.

    Limit: ours at least 50 times cheaper.

    Source: the measured run itself; 1/N is the variance of a mean of independent samples.
    """
    from dasim.render import passes, translate
    from validation.references.naive_render import naive_picture

    if rendering.activate().startswith("scalar"):
        raise NotRun("the naive render is a ray loop of the JIT variants, and only scalar_spectral works here")
    scene, camera = desk(COST_SIZE_PX)
    loaded, spectrum = translate.load(scene), scenes.light_spectrum(scene)

    def ours(spp: int, seed: int) -> FloatArray:
        return rendering.stop_pictures(
            loaded, camera, spp, seed, diffraction="off", max_blur_px=MAX_BLUR_PX, spectrum=spectrum
        ).sum(axis=0)

    def naive(spp: int, seed: int) -> FloatArray:
        return naive_picture(loaded, camera, STOP_RATIOS, spp, seed)

    runs = [(ours, COST_SPP[0], COST_SEEDS), (ours, COST_SPP[1], COST_SEEDS), (naive, COST_NAIVE_SPP, COST_NAIVE_SEEDS)]
    pictures = []
    noise, cost = np.empty((len(runs), 4)), np.empty(len(runs))
    for index, (render, spp, seeds) in enumerate(runs):
        render(spp, seeds)  # compiles the kernels
        begin = time.process_time()
        renders = [render(spp, seed) for seed in range(seeds)]
        cost[index] = (time.process_time() - begin) / seeds
        noise[index] = relative_noise(np.stack(renders))
        pictures.append(np.mean(renders, axis=0).mean(axis=(0, 1)))
        progress((index + 1) / len(runs))
    infrared = CHANNELS.index("IR")
    slope = np.log(noise[1] / noise[0]) / np.log(cost[1] / cost[0])  # of log noise against log cost, overhead included
    ours_s = cost[0] * (COST_NOISE / noise[0]) ** (1 / slope)
    naive_s = cost[2] * (noise[2] / COST_NOISE) ** 2
    count = [passes.sample_count(spp) for spp in COST_SPP]
    figures = [
        Figure(
            "ratio", naive_s[infrared] / ours_s[infrared], "1", "processor time to 1 % noise in IR, naive over ours"
        ),
        Figure("ours", float(ours_s[infrared]), "s", "ours: processor time to 1 % noise in IR, by the power law"),
        Figure("naive", float(naive_s[infrared]), "s", "naive: processor time to 1 % noise in IR, by the law of 1/N"),
    ]
    for index, name in enumerate((f"ours-{count[0]}", f"ours-{count[1]}", f"naive-{COST_NAIVE_SPP}")):
        figures.append(Figure(f"{name}.noise", float(noise[index, infrared]), "1", "median relative noise in IR"))
        figures.append(Figure(f"{name}.cost", float(cost[index]), "s", "processor time per picture"))
    for channel, name in enumerate(CHANNELS):
        what = f"{name}: relative difference of the naive picture's mean from ours"
        figures.append(Figure(f"difference.{name}", float(pictures[2][channel] / pictures[1][channel] - 1), "1", what))
    return Evidence(figures)
