"""The stage of the all-in-focus picture: its channels, its kernels, and where it fades to the captured picture.

Tested in tests/recon/sharp/test_restoration.py.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dasim.camera.specification import Camera
from dasim.spectra.grid import CHANNELS
from dasim.typing import BoolArray, Float32Array
from dasim.values import PsfBank
from recon.depth.peak import confidence_of, sd_of
from recon.picture import develop, field, mosaic
from recon.picture.field import Separation
from recon.settings import Settings
from recon.sharp import consistency, false_detail, layers, lost_detail, restoration, sharpen
from recon.sharp.samples import Samples

INTERPOLATED_NOISE_SHARE = 0.7  # noise after interpolation relative to the sensor's, standard deviations
GRAINY_LEVEL = 3.0  # level from which on eq. (15) is solved for the picture without noise reduction alone
# Error of a deconvolved picture due to wrong levels, kernels and occlusion, relative to bright white. Deconvolution and
# networks treat it as additional noise; otherwise a picture with little noise would be sharpened even where its level
# is wrong. Chosen on ``tune`` with full noise and with a tenth of it; larger values blur what is in focus. The networks
# were trained with it.
MODEL_ERROR = 0.007
# Factor on the noise that the networks are told. They were trained on dim scenes, too, and remove fine texture of
# photographs with the noise. 0.65 and 0.8 tie on ``tune``; the smaller one keeps more of photographs.
TOLD_NOISE = 0.65
# Visible blur per level, in pixels, of the cameras that the networks were trained with. All constants here that are in
# levels are in these.
TRAINED_PX = 1 / 0.54
SAME_LEVELS = 1e-3  # relative difference of levels that counts as none
CERTAIN = 0.05  # confidence below which the solution of eq. (15) fades to the captured picture
# Share of the captured picture in that of the networks at level 0, which falls to 0 at CAUTIOUS_LEVELS: near focus, a
# surface without the finest detail is often taken to be blurred. Chosen on ``tune``.
CAUTION, CAUTIOUS_LEVELS = 0.15, 4.0


class Frame(NamedTuple):
    """A captured frame and its levels."""

    raw_e: Float32Array  # [h, w] linear mosaic with the lens shading corrected, electrons
    linear_e: Float32Array  # [h, w, 3] captured picture without infrared, its noise reduced
    ir_e: Float32Array  # [h, w] captured infrared, likewise
    clipped: BoolArray  # [h, w, 3] pixels near saturation
    variances: dict[str, Float32Array]  # of each colour plane, [h/2, w/2]
    level: Float32Array  # [h, w], negative behind the focus
    confidence: Float32Array  # [h, w] of the level
    separation: Separation
    camera: Camera
    white: NDArray  # electrons of a white point, [channel]


def all_in_focus(
    frame: Frame, bank: PsfBank, light: str, settings: Settings, tile_px: int | None = None
) -> Float32Array:
    """All-in-focus colours without infrared, [h, w, 3] electrons; kernels of ``bank`` contain the axis' infrared share.

    Deconvolution and network work in tiles of ``tile_px`` per side; by default, each has its own tile size.
    """
    on_axis = frame.separation.on_axis
    measured, focus = of_both_sides(bank, light)
    kernels = sharpen.visible_kernels(measured, frame.white, on_axis)
    noise_e = sharpen.visible_noise(interpolated_noise_e(frame.variances), on_axis)
    stack = channels(frame)
    network = settings.sharpen_prior == "network"
    seen_e = stack.copy() if network else stack
    if network:
        noise_e = with_model_error(noise_e, stack, frame)
    near = in_trained_levels(frame, float(bank.blur_px[-1]) / (len(bank.blur_px) - 1))
    _soften_in_focus(stack, frame.linear_e, frame.ir_e, near.level)
    tile = tile_px or layers.TILE_PX
    if network:
        draft = sharpen.linear(stack, frame.level + np.float32(focus), kernels, noise_e, focus=focus, tile_px=tile)
        picture, phases = seen(near, seen_e, draft, TOLD_NOISE * noise_e), mosaic.phases(frame.camera)
        sharp_e = restoration.restored(picture, phases, tile_px or restoration.TILE_PX, settings.sharpen_networks)
        del draft, picture  # before more memory is needed
        if settings.sharpen_consistency:
            share = consistency.share_of(near.level, sd_of(near.confidence).astype(np.float32))
            consistency.add_unexplained(sharp_e, stack, frame.level, share, kernels, noise_e, focus=focus, tile_px=tile)
            del share
        _agree_with_samples(sharp_e, near, seen_e)
        _fade_to_captured(sharp_e, frame, 1 - CAUTION * np.clip(1 - np.abs(near.level) / CAUTIOUS_LEVELS, 0, 1))
    else:
        sharp = _deconvolved(stack, frame, kernels, noise_e, focus, settings, tile)
        sharp_e = np.ascontiguousarray(np.moveaxis(sharp[sharpen.COLOURS], 0, -1))
        _fade_to_captured(sharp_e, frame, np.clip(frame.confidence / CERTAIN, 0, 1))
    return sharp_e


def in_trained_levels(frame: Frame, px_per_level: float) -> Frame:
    """The frame with levels of ``TRAINED_PX`` of visible blur instead of ``px_per_level``, and their confidence."""
    scale = px_per_level / TRAINED_PX
    if abs(scale - 1) < SAME_LEVELS:
        return frame
    confidence = confidence_of(scale * sd_of(frame.confidence)).astype(np.float32)
    return frame._replace(level=np.float32(scale) * frame.level, confidence=confidence)


def with_model_error(noise_e: NDArray, stack: Float32Array, frame: Frame) -> NDArray:
    """Noise [channel] together with ``MODEL_ERROR``, electrons."""
    return np.hypot(noise_e, MODEL_ERROR * restoration.units(stack, _white_e(frame)))


def seen(frame: Frame, stack: Float32Array, draft: Float32Array, noise_e: NDArray) -> restoration.Picture:
    """Input of the network for a frame :func:`in_trained_levels`, from its :func:`channels` and their deconvolution.

    The network was trained on deconvolutions of channels without noise reduction; near focus, those of denoised
    channels give better results (0.1 to 0.5 dB below 3 px of blur).
    """
    sparse = mosaic.grids(frame.camera)["R"][0].step == mosaic.PERIOD_PX
    sd, units = sd_of(frame.confidence).astype(np.float32), restoration.units(stack, _white_e(frame))
    return restoration.Picture(stack, draft, frame.level, sd, noise_e, units, sparse)


def _white_e(frame: Frame) -> NDArray:
    """Electrons of a white point without infrared, and in infrared, [4]."""
    return np.append(frame.separation.on_axis @ frame.white, frame.white[3])


def _deconvolved(
    stack: Float32Array,
    frame: Frame,
    kernels: Float32Array,
    noise_e: NDArray,
    focus: int,
    settings: Settings,
    tile_px: int,
) -> Float32Array:
    """:func:`recon.sharp.sharpen.sharpen` of the channels of a frame by its levels, [4, h, w] electrons.

    ``kernels`` [level, channel, size, size] are in focus at the index ``focus``.
    """
    return sharpen.sharpen(
        stack, frame.level + np.float32(focus), kernels, noise_e, mosaic.sole_phases(frame.camera),
        steps=settings.sharpen_steps, strength=settings.sharpen_strength,
        passes=sharpen.PASSES if settings.sharpen_guide else sharpen.PLAIN_PASSES, focus=focus,
        tile_px=tile_px,
    )  # fmt: skip


def of_both_sides(bank: PsfBank, light: str) -> tuple[Float32Array, int]:
    """Kernels under a light from the last level behind the focus to the nearest, and the index of the focus."""
    kernels = bank.kernel[bank.lights.index(light)]
    if bank.behind is None:
        return kernels, 0
    behind = bank.behind.kernel[bank.lights.index(light)][:0:-1]
    return np.concatenate([behind, kernels]), len(behind)


def interpolated_noise_e(variances: dict[str, Float32Array]) -> NDArray:
    """Standard deviation of the noise of R, G, B and IR after interpolation, frame mean, [channel] electrons."""
    return INTERPOLATED_NOISE_SHARE * np.sqrt([variances[name].mean() for name in CHANNELS])


def channels(frame: Frame) -> Float32Array:
    """R, G, B without infrared, and infrared, of the mosaic without noise reduction, [4, h, w] electrons.

    Deviation from Fig. 4: the deconvolution has a prior against noise of its own, and benefits from the texture that
    nonlocal means remove with the noise (0.1 to 0.6 dB on the bundled scenes).
    """
    image = develop.demosaiced(frame.raw_e, frame.camera, frame.white, lambda name: nullcontext())
    assert image.ir_e is not None  # check_fits requires infrared pixels
    visible = develop.without_infrared(image, frame.separation, frame.clipped, frame.white)
    infrared_e = field.infrared_as_on_axis(image.ir_e, frame.separation)
    return np.concatenate([np.moveaxis(visible, -1, 0), infrared_e[None]])


def _soften_in_focus(stack: Float32Array, linear_e: Float32Array, ir_e: Float32Array, level: Float32Array) -> None:
    """Blend the picture without noise reduction, [4, h, w], with the denoised one near focus, in place.

    In focus, noise reduction gives smaller errors than the prior of the deconvolution. The weight of the denoised
    picture is 1 at level 0 and 0 from ``GRAINY_LEVEL`` on.
    """
    grain = np.clip(np.abs(level) / GRAINY_LEVEL, 0, 1)
    for index, smooth_e in enumerate((*np.moveaxis(linear_e, -1, 0), ir_e)):
        stack[index] = smooth_e + grain * (stack[index] - smooth_e)


def _agree_with_samples(sharp_e: Float32Array, frame: Frame, stack: Float32Array) -> None:
    """Near focus, take detail from the picture that the samples of the :func:`channels` do not confirm, and restore
    detail that they show and the picture lacks, in place.

    Channels sampled at every fourth pixel, red and blue of the 4x4 mosaic, are left unchanged: their samples are too
    sparse to determine the detail between them.
    """
    grids = mosaic.grids(frame.camera)
    matrices, place = frame.separation.matrices, frame.separation.place[::2, ::2]
    samples: list[Samples | None] = []
    for index, (name, rows) in enumerate(zip("RGB", np.moveaxis(matrices, 1, 0), strict=True)):
        if grids[name][0].step == mosaic.PERIOD_PX:
            samples.append(None)
            continue
        # At the samples of a channel, the other channels are interpolated.
        weights = np.where(np.arange(rows.shape[1]) == index, 1, INTERPOLATED_NOISE_SHARE**2) * rows**2
        variance = np.zeros(place.shape, np.float32)
        for other, of_rings in zip(CHANNELS, weights.T, strict=True):
            if of_rings.any():
                variance += field.on_grid(of_rings, place) * frame.variances[other]
        samples.append(Samples(mosaic.sites(grids[name], frame.level.shape), stack[index], variance))
    blur_px = np.float32(TRAINED_PX) * frame.level
    false_detail.remove(sharp_e, samples, frame.linear_e, blur_px)
    lost_detail.restore(sharp_e, samples, blur_px, np.float32(TRAINED_PX) * sd_of(frame.confidence).astype(np.float32))
    np.maximum(sharp_e, 0, out=sharp_e)  # restored detail may be negative in dark areas


def _fade_to_captured(sharp_e: Float32Array, frame: Frame, share: NDArray) -> None:
    """Mix the sharp picture [h, w, 3] with the captured one, in place: ``share`` [h, w] is its share, 0..1, which falls
    to 0 near clipped pixels.
    """
    linear_e = frame.linear_e
    unclipped = sharpen.ramp_around(frame.clipped[..., 0] | frame.clipped[..., 1] | frame.clipped[..., 2])
    sharp_e -= linear_e
    sharp_e *= (share * unclipped)[..., None]
    sharp_e += linear_e
