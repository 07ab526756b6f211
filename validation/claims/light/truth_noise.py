"""Claim on rendering noise in the truth: stated as it is, brought to its target, independent where it is asked for.

Tested in tests/validation/claims/test_truth_noise.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

import dasim
from dasim.camera import noise as sensor_noise
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera, mosaic_channels
from dasim.scene import loading
from dasim.scene.specification import Scene
from dasim.simulation.exposure import Shot
from dasim.spectra.grid import CHANNELS
from dasim.typing import BoolArray, FloatArray, ShareDone
from validation.gates.claim import Evidence
from validation.scores.figures import Figure
from validation.subjects import rendering
from validation.subjects.rendering import seeds_of

SIZE_PX = (64, 48)
SPP = 64
SEEDS = 12  # of the pictures whose scatter is measured
AUTO_SEEDS = 3
OWN_SPP = 4  # much rendering noise beside the sensor's, whose draws are the uncertainty of the slope
OWN_SEEDS = 4  # of the pictures whose errors are compared, against the others of the first
AUTO_AT, AUTO_SHARE = (50.0, 95.0), 0.4
WINDOW_PX = 3  # over which the scatter between seeds is averaged
PERCENTILES = {50.0: "median", 95.0: "p95", 99.5: "p995"}
EXPOSURE = Exposure(time_s=0.02)


class Scatter(NamedTuple):
    """Pictures of one view with different seeds: their measured scatter, and what each states."""

    measured: FloatArray  # [h, w, channel] variance of ``mean_e`` between seeds
    stated: FloatArray  # [seed, h, w, channel] ``mean_e_variance``
    sensor: FloatArray  # [h, w, channel] variance of the sensor's temporal noise
    boundary: BoolArray  # [h, w] where depth is discontinuous
    shares: FloatArray  # [seed, percentile, channel] as ``meta.json`` states them


def truth_noise(progress: ShareDone, seed: int = 0) -> Evidence:
    """Rendering noise of ``mean_e`` is stated as it is, meets the target of ``auto``, and can be independent of raw's.

    Rationale: ``raw`` contains the same rendering noise as ``mean_e``. The truth must state its size, and a denoiser
    trained on the pair must not learn to keep it.

    Set-up: pictures of dasim.simulate with 64 samples per pixel and 12 seeds, 64 x 48 px of da-mobile: the middle of
    desk, and a card before a wall under a dome, without texture or lamp, where most noise is that of the interpolated
    irradiance. Then desk with ``auto``, 3 seeds, with a target of 0.4 of the sensor noise at the 50th and the 95th
    percentile of the pixels; and, with 4 samples per pixel, 4 pictures of desk and 4 with an independently sampled
    ``mean_e``.

    Expectation: the variance between seeds equals the mean of the variance maps stated by single pictures, over all
    pixels and over those beside depth discontinuities. The shares in ``meta.json`` equal the percentiles of the scatter
    between seeds, averaged over 3 x 3 px; the noise that ``auto`` reaches in its worst channel is measured in the same
    way. The regression of the error of raw on that of ``mean_e``, each against the mean of four pictures of 64 samples,
    has the slope 1 if they share rendering noise, and otherwise 0.

    Limit: 15 % of the variance (7 % of the noise); 10 % of the shares in desk and 20 % under the dome, where pixels a
    few px apart share noise, so that a map fluctuates more; ``auto`` at most 10 % above its target and not below half
    of it; slopes within 0.1 of 0 and 1.

    Source: variance of a mean of independent pictures; nothing of it is computed from the sampling.
    """
    rendering.activate()
    figures: list[Figure] = []
    desk, camera = _desk()
    subjects = {"desk": (desk, camera), "dome": (_under_dome(camera), camera)}
    desk_shots: list[Shot] = []
    for number, (name, (scene, taken_by)) in enumerate(subjects.items()):
        shots = [_shot(scene, taken_by, own) for own in seeds_of(seed, SEEDS)]
        figures += map_figures(name, scatter(shots))
        desk_shots = desk_shots or shots
        progress((number + 1) / 4)
    for at in AUTO_AT:
        options = {"spp": "auto", "noise_share": AUTO_SHARE, "noise_at": at}
        shots = [_shot(desk, camera, own, **options) for own in seeds_of(seed, AUTO_SEEDS)]
        figures.append(auto_figure(at, scatter(shots)))
    progress(0.75)
    means = np.stack([shot.truth.mean_e.astype(np.float64) for shot in desk_shots[OWN_SEEDS:]])
    references = means[0::2].mean(axis=0), means[1::2].mean(axis=0)
    for name in ("shared", "independent"):
        options = {"spp": OWN_SPP, "independent_mean": name == "independent"}
        own = [_shot(desk, camera, one, **options) for one in seeds_of(seed, OWN_SEEDS)]
        figures.append(slope_figure(name, own, references))
    progress(1.0)
    return Evidence(figures)


def _desk() -> tuple[Scene, Camera]:
    scene = loading.load_scene("desk")
    return scene, dasim.focused(dasim.cropped(dasim.load_camera("da-mobile"), *SIZE_PX), scene)


def _under_dome(camera: Camera) -> Scene:
    """A card out of focus before a wall in focus, both of one colour, in the light of a sky and of each other."""
    far_cm = 100 * camera.lens.focus_distance_m
    wall = {"name": "wall", "shape": "plane", "size_cm": [400, 400], "position_cm": [0, 0, far_cm], "material": "sand"}
    card = {"name": "card", "shape": "plane", "size_cm": [100, 100], "material": "brick"}
    card |= {"position_cm": [-50, 0, far_cm / 2]}
    return rendering.make_scene([wall, card], [{"kind": "dome", "illuminant": "D65", "lux": 1000.0}])


def _shot(scene: Scene, camera: Camera, seed: int, **options) -> Shot:  # type: ignore[no-untyped-def]
    return dasim.simulate(scene, camera, seed, exposure=EXPOSURE, **{"spp": SPP, **options})


def scatter(shots: Sequence[Shot]) -> Scatter:
    """The scatter of pictures between seeds, and what they state about it."""
    first = shots[0]
    means = np.stack([shot.truth.mean_e.astype(np.float64) for shot in shots])
    stated = [shot.truth.mean_e_variance for shot in shots]
    temporal = sensor_noise.temporal_variance(first.capture.camera.sensor, first.capture.exposure_s)
    shares = [shot.capture.provenance["rendering_noise_share"] for shot in shots]
    return Scatter(
        measured=means.var(axis=0, ddof=1),
        stated=np.stack([np.asarray(each, np.float64) for each in stated]),
        sensor=temporal.at(means.mean(axis=0)),
        boundary=first.truth.boundary,
        shares=np.array([[[by[f"{at:g}"][name] for name in CHANNELS] for at in PERCENTILES] for by in shares]),
    )


def measured_shares(found: Scatter) -> FloatArray:
    """Percentiles over the pixels of the scatter's standard deviation over the sensor's, [percentile, channel]."""
    variance = ndimage.uniform_filter(found.measured, (WINDOW_PX, WINDOW_PX, 1))
    return np.asarray(np.percentile(np.sqrt(variance / found.sensor), [*PERCENTILES], axis=(0, 1)))


def map_figures(name: str, found: Scatter) -> list[Figure]:
    """Stated over measured variance, over all pixels and beside discontinuities, and stated over measured shares."""
    figures = []
    ratio = found.shares.mean(axis=0) / measured_shares(found)
    stated = found.stated.mean(axis=0)
    for index, channel in enumerate(CHANNELS):
        for region, where in (("all", np.ones_like(found.boundary)), ("boundary", found.boundary)):
            value = float(stated[where, index].sum() / found.measured[where, index].sum())
            text = f"{name}, {channel}, {region}: mean stated over mean measured variance of mean_e"
            figures.append(Figure(f"{name}.{channel}.{region}", value, "1", text))
        for place, (at, label) in enumerate(PERCENTILES.items()):
            text = (
                f"{name}, {channel}: stated over measured share of the sensor's noise, percentile {at:g} of the pixels"
            )
            figures.append(Figure(f"{name}.{channel}.share-{label}", float(ratio[place, index]), "1", text))
    return figures


def auto_figure(at: float, found: Scatter) -> Figure:
    """Rendering noise that ``auto`` reaches at its percentile in the worst channel, over what it was asked for."""
    value = float(measured_shares(found)[[*PERCENTILES].index(at)].max() / AUTO_SHARE)
    text = f"rendering noise at percentile {at:g} of the pixels, worst channel, over the target of spp 'auto'"
    return Figure(f"auto-{at:g}", value, "1", text)


def slope_figure(name: str, shots: Sequence[Shot], references: tuple[FloatArray, FloatArray]) -> Figure:
    """Slope of the error of raw against that of ``mean_e``, in green.

    The two ``references`` [h, w, channel] have independent noise, and so do both factors of each product: that of the
    references cancels.
    """
    products: list[FloatArray] = []
    for shot in shots:
        camera, gain = shot.capture.camera, shot.capture.gain
        own = mosaic_channels(camera) == CHANNELS.index("G")
        dark_e = sensor_noise.dark_e(camera.sensor, shot.capture.exposure_s)
        raw_e = sensor_noise.collected_e(shot.capture.raw_dn.astype(np.float64), camera.sensor, gain) - dark_e
        mean_e = sensor_noise.mosaic(shot.truth.mean_e.astype(np.float64), camera)
        first, second = (sensor_noise.mosaic(reference, camera) for reference in references)
        other = (mean_e - second)[own]
        products.append(np.array([np.sum((raw_e - first)[own] * other), np.sum((mean_e - first)[own] * other)]))
    shared, whole = np.sum(products, axis=0)
    slope = float(shared / whole)
    text = f"slope of raw's error against that of mean_e, {name} samples, green pixels"
    return Figure(f"{name}.slope", slope, "1", text)
