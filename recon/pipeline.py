"""From a raw picture to colour, depth and an all-in-focus picture: Fig. 4 and section 5, one line a stage."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from dasim.base.errors import InputError
from dasim.camera.specification import Camera, channels
from dasim.files.banks import bank_identity
from dasim.spectra.colour import exposure_scale, to_srgb
from dasim.spectra.grid import CHANNELS
from dasim.typing import Float32Array, Progress
from dasim.values import Capture, Developed, PsfBank, Reconstruction
from recon.depth import scores, tiles
from recon.depth.regularise import regularise
from recon.picture import colour, denoise, infrared, mosaic
from recon.picture import develop as picture
from recon.settings import DEFAULT, PAPER, Settings
from recon.sharp import sharpen

PICTURE_STAGES = ("linearise", "light", "denoise", "infrared", "demosaic", "colour")
STAGES = (*PICTURE_STAGES[:-1], "depth", "regularise", "sharpen", "colour")
LIGHTS = ("D65", "D55", "A", "energy-saving-3500K")  # sec. 5.1, that white balance chooses from without a bank
NOISE_BLUR_PX = 1.5  # plane pixels: the signal that decides the noise is a local mean
FALLBACK_TRUST = 0.25  # of red or blue in place of infrared: their blur differs little (sec. 5.3)
FAR_LIGHT = 1.0  # in log-chromaticity: D65 and A are 1.46 apart, photographs within 0.5 of their own light
INTERPOLATED_NOISE_SHARE = 0.7  # of the sensor's noise that interpolation leaves, standard deviation
GRAINY_LEVEL = 3.0  # from here on, deconvolution starts from the picture before noise reduction alone
CERTAIN = 0.05  # confidence below which the picture fades to that captured: there the level is a guess
FOCUS_TOLERANCE = 0.01  # relative, in dioptres, between bank and capture


def reconstruct(
    capture: Capture,
    bank: PsfBank,
    settings: Settings = DEFAULT,
    *,
    flat: Capture | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Everything the paper makes of one capture: picture, depth, all-in-focus picture.

    ``flat`` is a capture of an even surface, from which the lens shading is undone in the pictures.
    ``progress`` is called with a stage's name and the share of stages done before it. Raises InputError where
    capture and bank do not belong together, or where the mosaic has no infrared.
    """
    _check(capture, bank)
    camera = capture.camera
    timings: dict[str, float] = {}

    stage = _stages(STAGES, timings, progress)
    image = picture.demosaiced(capture, bank.signature, settings, flat, stage)
    light, saturated = image.light, image.saturated
    assert image.ir_e is not None  # checked above
    variances = _variances(image.raw_e, capture)
    with stage("depth"):
        raw_level, trust = _raw_levels(
            image.raw_e, variances, saturated, camera, bank.kernel[light], settings, bank.signature[light]
        )
    with stage("regularise"):
        guide = _infrared_guide(image.ir_e, capture)
        smooth, evidence = regularise(raw_level, trust, guide, settings.regularise_bandwidth)
        level = _upsampled(smooth, camera.sensor.height_px, camera.sensor.width_px)
        confidence = _upsampled(evidence, *level.shape)
    notes = _notes(image.raw_e, saturated, camera, bank)
    separation = infrared.separation(camera, bank.lights[light], settings)
    clipped, white = picture.clipped(saturated, camera), bank.signature[light]
    linear_e = picture.without_infrared(image.full_e, image.ir_e, separation, clipped, white)
    ir_e = np.maximum(image.ir_e, 0)
    noise_e = sharpen.visible_noise(_noise_e(variances), separation)
    del image, variances, guide  # of large frames every plane counts
    with stage("sharpen"):
        kernels = sharpen.visible_kernels(bank.kernel[light], white, separation)
        stack = _grainy(capture, bank, settings, flat)
        grain = np.clip(level / GRAINY_LEVEL, 0, 1)  # in focus, noise reduction does better than the prior
        for index, smooth_e in enumerate((*np.moveaxis(linear_e, -1, 0), ir_e)):
            stack[index] = smooth_e + grain * (stack[index] - smooth_e)
        sharp_e = sharpen.sharpen(stack, level, kernels, noise_e, settings, mosaic.sole_phases(camera))
        del stack
        certain = np.clip(confidence / CERTAIN, 0, 1) * sharpen.away_from(
            clipped[..., 0] | clipped[..., 1] | clipped[..., 2]
        )
        sharp_e -= linear_e
        sharp_e *= certain[..., None]
        sharp_e += linear_e  # where the level is a guess, as captured
    with stage("colour"):
        matrix = colour.colour_matrix(camera, bank.lights[light], separation)
        scale = exposure_scale(linear_e, matrix)
        rgb, sharp_rgb = to_srgb(linear_e, matrix, scale), to_srgb(sharp_e, matrix, scale)
    if progress:
        progress("done", 1.0)
    return Reconstruction(
        rgb=rgb,
        sharp_rgb=sharp_rgb,
        linear_e=linear_e,
        sharp_e=sharp_e,
        ir_e=ir_e,
        level_raw=raw_level.repeat(2, axis=0).repeat(2, axis=1),
        level=level,
        depth_m=_depth_m(level, bank),
        confidence=confidence,
        camera=camera,
        light=bank.lights[light],
        settings=settings.model_dump(),
        timings_s=timings,
        bank=bank_identity(bank),
        notes=notes,
    )


def develop(
    capture: Capture,
    settings: Settings = PAPER,
    *,
    lights: Sequence[str] = LIGHTS,
    flat: Capture | None = None,
    progress: Progress | None = None,
) -> Developed:
    """The colour picture alone (sec. 4), of any mosaic that is known, without a PSF bank.

    White balance chooses among ``lights`` by the camera's response curves.
    """
    camera = capture.camera
    timings: dict[str, float] = {}
    stage = _stages(PICTURE_STAGES, timings, progress)
    signature = colour.signatures(camera, lights)
    image = picture.demosaiced(capture, signature, settings, flat, stage)
    light = lights[image.light]
    with stage("colour"):
        separation = infrared.separation(camera, light, settings)
        clipped = picture.clipped(image.saturated, camera)
        linear_e = picture.without_infrared(image.full_e, image.ir_e, separation, clipped, signature[image.light])
        matrix = colour.colour_matrix(camera, light, separation)
        rgb = picture.displayed(linear_e, matrix)
    if progress:
        progress("done", 1.0)
    ir_e = None if image.ir_e is None else np.maximum(image.ir_e, 0)
    return Developed(rgb, linear_e, ir_e, matrix, camera, light, settings.model_dump(), timings)


def _stages(names: Sequence[str], timings: dict[str, float], progress: Progress | None) -> picture.Stage:
    """Blocks that say their name and take their time."""

    @contextmanager
    def stage(name: str) -> Iterator[None]:
        if progress:
            progress(name, names.index(name) / len(names))
        start = time.perf_counter()
        yield
        timings[name] = time.perf_counter() - start

    return stage


def _check(capture: Capture, bank: PsfBank) -> None:
    """Refuse a bank of another camera or focus; the frame's size may differ."""
    if "IR" not in mosaic.grids(capture.camera):
        raise InputError(
            f"camera '{capture.camera.name}' has no infrared pixels, so that its captures show no depth; "
            "recon.develop makes the picture alone"
        )
    mine, banks = capture.camera, bank.camera
    wrong = [what for what, one, other in _optics(mine, banks) if one != other]
    if wrong:
        raise InputError(
            f"bank of camera '{banks.name}' does not fit a capture of camera '{mine.name}': they differ in "
            f"{', '.join(wrong)}; make one with 'dasim calibrate --camera'"
        )
    focus, bank_focus = mine.lens.focus_distance_m, banks.lens.focus_distance_m
    if abs(1 / focus - 1 / bank_focus) > FOCUS_TOLERANCE / bank_focus or (
        mine.lens.focal_length_mm, mine.lens.f_number
    ) != (banks.lens.focal_length_mm, banks.lens.f_number):  # fmt: skip
        raise InputError(
            f"bank is for a lens of {banks.lens.focal_length_mm:g} mm f/{banks.lens.f_number:g} focused at "
            f"{bank_focus:g} m, the capture has {mine.lens.focal_length_mm:g} mm f/{mine.lens.f_number:g} at "
            f"{focus:g} m; make a bank with 'dasim calibrate --focus {focus:g}'"
        )


def _notes(raw_e: Float32Array, saturated: NDArray, camera: Camera, bank: PsfBank) -> tuple[str, ...]:
    """What speaks against the bank's lights: the picture's white lies far from all of them, or cannot be told."""
    distance = colour.light_distances(mosaic.planes(raw_e, camera), picture.blocks_any(saturated), bank.signature)
    if distance is None:
        return (f"the picture is too dark or too bright to tell its light; {bank.lights[0]} is taken",)
    nearest = int(distance.argmin())
    if distance[nearest] < FAR_LIGHT:
        return ()
    return (
        f"the picture's white lies far from every light of the bank ({', '.join(bank.lights)}), the nearest is "
        f"{bank.lights[nearest]}; if it was taken under another light, add that with 'dasim calibrate --illuminant'",
    )


def _optics(mine: Camera, banks: Camera) -> list[tuple[str, Any, Any]]:
    """What decides kernels beside the lens, of two cameras."""
    one, other = ([stop.model_dump() for stop in camera.stops] for camera in (mine, banks))
    first, second = mine.sensor, banks.sensor
    return [
        ("stops", one, other),
        ("pixel_pitch_um", first.pixel_pitch_um, second.pixel_pitch_um),
        ("channels", channels(first), channels(second)),
        ("quantum_efficiency", first.quantum_efficiency, second.quantum_efficiency),
        ("cutoff_nm", first.cutoff_nm, second.cutoff_nm),
    ]


def _variances(raw_e: Float32Array, capture: Capture) -> dict[str, Float32Array]:
    """Noise variance of every colour plane's pixels: the data sheet's, raised where the picture shows more."""
    found = {}
    for name, plane in mosaic.planes(raw_e, capture.camera).items():
        smooth = cv2.GaussianBlur(plane, (0, 0), NOISE_BLUR_PX)
        variance = mosaic.noise_variance(smooth, capture).astype(np.float32)
        found[name] = variance * mosaic.noise_excess(plane, variance)
    return found


def _raw_levels(
    raw_e: Float32Array,
    variances: dict[str, Float32Array],
    saturated: NDArray,
    camera: Camera,
    kernels: NDArray,
    settings: Settings,
    white: NDArray | None = None,
) -> tuple[Float32Array, Float32Array]:
    """Eq. (12) for every block of the mosaic, NaN where neither infrared nor red nor blue has an edge; confidence."""
    places, planes = mosaic.phases(camera), mosaic.planes(raw_e, camera)

    def channel(name: str, box: tuple[slice, slice]) -> scores.Channel:
        plane = np.ascontiguousarray(planes[name][box])
        return plane, places[name], variances[name][box], kernels[:, CHANNELS.index(name)]

    leak = None if white is None else _leak("G", camera, white, settings)
    further = ["R"] if settings.score == "bands" and "R" in _fallbacks(camera) else []
    usable = scores.window_mean(picture.blocks_any(saturated).astype(np.float32), settings) < settings.saturated_share
    level = np.full(planes["G"].shape, np.nan, np.float32)
    confidence = np.zeros_like(level)
    open_ = usable.copy()  # where no channel has shown an edge yet
    for name in ["IR", *(_fallbacks(camera) if settings.fallback else [])]:
        box = _around(open_, round(settings.window_px / scores.PLANE_SPACING_PX) * 2)
        if box is None:
            break
        also: scores.Also = []
        if name == "IR" and white is not None:
            also = [(channel(n, box), _leak(n, camera, white, settings)) for n in further]
        best, trust, snr, green_snr = tiles.best_levels(
            channel(name, box), channel("G", box), settings, leak if name == "IR" else None, also
        )
        edge = open_[box] & (snr > settings.edge_snr) & (green_snr > settings.edge_snr)
        new = edge & (trust > 0) & (trust >= settings.least_confidence)
        level[box][new] = best[new]
        confidence[box][new] = (trust if name == "IR" else FALLBACK_TRUST * trust)[new]
        open_[box] &= (snr <= settings.edge_snr) & (green_snr > settings.edge_snr)
    return level, confidence


def _around(mask: NDArray, margin: int) -> tuple[slice, slice] | None:
    """The smallest part of a mask [h, w] that holds all of it and a margin; None where it is empty."""
    parts = []
    for axis in (1, 0):
        place = np.flatnonzero(mask.any(axis=axis))
        if not place.size:
            return None
        parts.append(slice(max(int(place[0]) - margin, 0), int(place[-1]) + margin + 1))
    return parts[0], parts[1]


def _leak(name: str, camera: Camera, white: NDArray, settings: Settings) -> scores.Leak:
    """What of infrared is in a channel, from eq. (8) or as measured, and in white [channel]."""
    alpha = infrared.crosstalk(camera) if settings.crosstalk is None else settings.crosstalk
    own = CHANNELS.index(name)
    return scores.Leak(float(alpha[own]), float(white[CHANNELS.index("IR")] / white[own]))


def _fallbacks(camera: Camera) -> list[str]:
    """Channels that stand in for infrared: those whose planes are sampled, not filled in between."""
    return [name for name in "RB" if mosaic.grids(camera)[name][0].step == 2]


def _infrared_guide(ir_e: Float32Array, capture: Capture) -> Float32Array:
    """Infrared at the blocks' centres in units of its noise, the guide of eq. (14)."""
    size = (ir_e.shape[1] // 2, ir_e.shape[0] // 2)
    blocks = np.asarray(cv2.resize(ir_e, size, interpolation=cv2.INTER_AREA), np.float32)
    return denoise.stabilise(blocks, mosaic.noise_coefficients(capture))


def _grainy(capture: Capture, bank: PsfBank, settings: Settings, flat: Capture | None) -> Float32Array:
    """R, G, B without infrared, and infrared, [4, h, w], from the raw picture without noise reduction.

    Deviation from Fig. 4: deconvolution has its own prior against noise, and misses the texture that nonlocal means
    take with it (+0.1 to 0.6 dB on the bundled scenes).
    """
    image = picture.demosaiced(
        capture, bank.signature, settings.model_copy(update={"denoise": False}), flat, lambda name: nullcontext()
    )
    separation = infrared.separation(capture.camera, bank.lights[image.light], settings)
    clipped, white = picture.clipped(image.saturated, capture.camera), bank.signature[image.light]
    assert image.ir_e is not None
    visible = picture.without_infrared(image.full_e, image.ir_e, separation, clipped, white)
    return np.concatenate([np.moveaxis(visible, -1, 0), image.ir_e[None]])


def _noise_e(variances: dict[str, Float32Array]) -> NDArray:
    """Standard deviation of the noise of R, G, B and IR in the full picture, its mean over the frame."""
    return INTERPOLATED_NOISE_SHARE * np.sqrt([variances[name].mean() for name in CHANNELS])


def _depth_m(level: Float32Array, bank: PsfBank) -> Float32Array:
    """Depth of fractional levels: the bank's depths, interpolated in dioptres, in which blur is linear."""
    return (1 / np.interp(level, np.arange(len(bank.depth_m)), 1 / bank.depth_m)).astype(np.float32)


def _upsampled(blocks: Float32Array, height: int, width: int) -> Float32Array:
    """From blocks to pixels, linear between the blocks' centres."""
    return np.asarray(cv2.resize(blocks, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
