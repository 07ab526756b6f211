"""Claim on the number of rays: what the control variate and adaptive sampling save, and that they cause no bias."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import dasim
from dasim.camera.noise import Exposure
from dasim.camera.sensor import channels
from dasim.scene.mitsuba_scene import MitsubaScene
from dasim.scene.specification import Scene
from dasim.simulation import adaptive_sampling, exact, rendering, rendering_noise
from dasim.simulation.rendering import LensPicture, Sampling, SharpPictures, View
from dasim.simulation.simulate import prepare
from dasim.typing import FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.scores.chance import by_chance
from validation.scores.figures import Figure
from validation.subjects.rendering import block_means, needs_wave

SCENES = ("desk", "flowers")
RANDOM_SEED, RANDOM_SCENES = 0, 10
SIZE_PX = (192, 144)
PLAIN_SPP = (64, 256)
TARGETS = {"default": (adaptive_sampling.NOISE_SHARE, adaptive_sampling.NOISE_AT), "strict": (0.2, 95.0)}

BIAS_SCENE, BIAS_SIZE_PX = "desk", (96, 72)
BIAS_SEEDS, BIAS_SPP, BIAS_BLOCK_PX = 24, 256, 8


def fewer_rays(progress: ShareDone) -> Evidence:
    """With a control variate and samples where they are needed, a tenth of the rays reaches the noise target.

    Rationale: rays are the cost of a picture. An estimator that takes fewer of them must have the same expectation.

    Set-up: the bundled scenes ``desk`` and ``flowers`` and the first ten random scenes, central 192 x 144 px of
    da-mobile, wave-true blur. Rays are the samples per pixel of both stops that ``--spp auto`` takes, for the default
    target and for a fifth of the sensor's noise at the percentile 95 of the pixels. Without control variate and with
    equal samples in all pixels, the worst channel's share of noise is measured at 64 and 256 samples per pixel and
    stop, and the power law through both gives the number that reaches the target. For the bias, ``desk`` at 96 x 72 px:
    24 pictures of ``--spp auto`` against 24 with 256 equal samples and no control variate.

    Expectation: the figure is the ratio of both numbers of samples. For the bias, a permutation test
    compares the means over blocks of 8 x 8 pixels of both kinds of pictures. It exchanges whole pictures, because the
    blocks of a picture are not independent.

    Limit: at most a tenth of the rays; p at least 0.001 in each channel.

    Source: the same renderer without control variate and adaptive samples.
    """
    needs_wave()
    scenes: dict[str, Scene | MitsubaScene] = {name: dasim.load_scene(name) for name in SCENES}
    spec = dasim.RandomScenes(floating=True)  # the scenes that the figures were measured on
    scenes |= {f"random-{index}": dasim.random_scene(RANDOM_SEED, index, spec) for index in range(RANDOM_SCENES)}
    figures = []
    for number, (name, scene) in enumerate(scenes.items()):
        figures += ray_figures(name, scene)
        progress((number + 1) / (len(scenes) + 1))
    for target in TARGETS:
        ratios = [figure.value for figure in figures if figure.id.startswith(f"ratio.{target}.")]
        what = f"rays over those without, geometric mean of {len(ratios)} scenes, {_target(target)}"
        figures.append(Figure(f"mean.{target}", float(np.exp(np.mean(np.log(ratios)))), "1", what))
    return Evidence(figures + bias_figures(scenes[BIAS_SCENE]))


def _target(name: str) -> str:
    share, at = TARGETS[name]
    return f"noise of {share:g} of the sensor's at percentile {at:g}"


def ray_figures(name: str, scene: Scene | MitsubaScene) -> list[Figure]:
    """Rays to each target with control variate and adaptive samples, and their ratio to those without."""
    view = _view(scene, SIZE_PX)
    shares = {}
    for spp in PLAIN_SPP:
        sampling = Sampling(spp, 0.25, 50.0, 1)
        picture = _picture(view, _without(_sharp(view, sampling)), sampling)
        assert picture.variance is not None
        limit = rendering.sensor_variance(picture.rate, view.camera, Exposure())
        shares[spp] = rendering_noise.share(picture.variance, limit)
    figures = []
    for target, (share, at) in TARGETS.items():
        sampling = Sampling("auto", share, at, 1)
        ours = _picture(view, _sharp(view, sampling), sampling)
        rays = float(ours.spp.mean(axis=(1, 2)).sum())
        low, high = (float(rendering_noise.shares_at(shares[spp], [at]).max()) for spp in PLAIN_SPP)
        slope = np.log(high / low) / np.log(PLAIN_SPP[1] / PLAIN_SPP[0])
        plain = len(view.camera.stops) * PLAIN_SPP[1] * (share / high) ** (1 / slope)
        figures += [
            Figure(f"ratio.{target}.{name}", rays / plain, "1", f"{name}: rays over those without, {_target(target)}"),
            Figure(f"rays.{target}.{name}", rays, "1", f"{name}: samples per pixel of both stops, {_target(target)}"),
        ]
    return figures


def bias_figures(scene: Scene | MitsubaScene) -> list[Figure]:
    """P-values of equal means with and without control variate and adaptive samples."""
    view = _view(scene, BIAS_SIZE_PX)
    blocks: list[list[FloatArray]] = [[], []]
    for seed in range(BIAS_SEEDS):
        share, at = TARGETS["default"]
        auto, equal = Sampling("auto", share, at, seed), Sampling(BIAS_SPP, share, at, BIAS_SEEDS + seed)
        blocks[0].append(block_means(_picture(view, _sharp(view, auto), auto).rate, BIAS_BLOCK_PX))
        blocks[1].append(block_means(_picture(view, _without(_sharp(view, equal)), equal).rate, BIAS_BLOCK_PX))
    one, other = (np.stack(pictures) for pictures in blocks)
    difference = one.mean(axis=(0, 1, 2)) / other.mean(axis=(0, 1, 2)) - 1
    figures = []
    for channel, name in enumerate(channels(view.camera.sensor)):
        value = by_chance(*(part[..., channel].reshape(len(part), -1) for part in (one, other)))
        what = f"{BIAS_SCENE}, {name}: probability of such differences between block means by chance"
        figures.append(Figure(f"bias.p.{name}", value, "1", what))
        what = f"{BIAS_SCENE}, {name}: relative difference of the picture's mean"
        figures.append(Figure(f"bias.mean.{name}", float(difference[channel]), "1", what))
    return figures


def _view(scene: Scene | MitsubaScene, size_px: tuple[int, int]) -> View:
    camera = dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *size_px), scene)
    return prepare(scene, camera, None, None, _quiet)


def _sharp(view: View, sampling: Sampling) -> SharpPictures:
    return exact.sharp_pictures(view, sampling, _quiet)


def _without(sharp: SharpPictures) -> SharpPictures:
    """The same without control variates."""
    return replace(sharp, controls=[None] * len(sharp.controls))


def _picture(view: View, sharp: SharpPictures, sampling: Sampling) -> LensPicture:
    return rendering.lens_picture(view, sharp, sampling, Exposure(), _quiet)


def _quiet(stage: str, share: float) -> None:
    """Report no progress."""
