"""Calibration (sec. 5.1): point-spread functions measured from pictures of a point source."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import fft, ndimage

from dasim.base.errors import InputError
from dasim.base.threads import mapped
from dasim.camera.sensor import channels
from dasim.camera.specification import Camera
from dasim.typing import Float32Array, FloatArray, Progress
from dasim.values import LevelsBehind, PointPicture, PsfBank
from recon import fourier
from recon.calibration.pictures import averaged, common_centre
from recon.calibration.round_kernel import RING_SNR, over_pixels, round_fit, subpixel_radius
from recon.calibration.unaligned import scattered
from recon.calibration.white import relative_to_axis

Key = tuple[str, int]  # light and blur level


def calibrate(
    pictures: Iterable[PointPicture],
    camera: Camera,
    *,
    diffraction: str = "measured",
    field_px: tuple[float, float] = (0.0, 0.0),
    progress: Progress | None = None,
) -> PsfBank:
    """Measure the camera's kernels from pictures of a point source, for every light and blur level.

    Frames are averaged, black level and background subtracted, and the positions of the source interleaved. The common
    centre of the channels is shifted to the middle pixel, and each kernel is normalised to unit sum. Raises InputError
    if pictures are missing.

    Args:
        pictures: for each light and level, pictures whose whole-pixel shifts cover one period of the mosaic, so that
            each channel samples each pixel of its kernel. Alternatively, pictures without ``shift_px``, with the source
            at any positions (one is enough); the centres are then measured, and the stops must be round.
        camera: the camera of the pictures.
        diffraction: a remark that is stored with the bank.
        field_px: (x, y) of the source's image from the optical axis, stored with the bank. The signature is that of
            the axis all the same.
        progress: called with the name of the stage and the share of it that is done, 0..1.
    """
    groups, lights, levels = _grouped(pictures)
    _check_sizes(groups, camera)
    centred: dict[Key, FloatArray] = {}

    def kernel_of(group: list[PointPicture]) -> FloatArray:
        if any(picture.shift_px is None for picture in group):
            return scattered(group, camera)
        return _interleaved_kernel(*_interleave(group, camera), on_axis=field_px == (0.0, 0.0))

    images = mapped(kernel_of, groups.values(), fourier.THREADS)
    for done, (key, image) in enumerate(zip(groups, images, strict=True)):
        centred[key] = image
        if progress:
            progress("calibrate", (done + 1) / len(groups))
    half = min(min(image.shape[1:]) for image in centred.values()) // 2
    stacked = np.stack([[_crop(centred[light, level], half) for level in levels] for light in lights])
    kernel, signature = _normalised(stacked, channels(camera.sensor))
    if field_px != (0.0, 0.0):
        signature = (signature / relative_to_axis(camera, lights, field_px)).astype(np.float32)
    first = [groups[lights[0], level][0] for level in levels]
    depth_m = np.array([picture.depth_m for picture in first], np.float32)
    blur_px = np.array([picture.blur_px for picture in first], np.float32)
    focus = -levels[0]  # index of level 0
    behind = None
    if focus:
        behind = LevelsBehind(kernel[:, focus::-1], depth_m[focus::-1], blur_px[focus::-1])
    return PsfBank(
        kernel=kernel[:, focus:],
        lights=lights,
        signature=signature,
        depth_m=depth_m[focus:],
        blur_px=blur_px[focus:],
        camera=camera,
        diffraction=diffraction,
        field_px=field_px,
        behind=behind,
    )


def _grouped(
    pictures: Iterable[PointPicture],
) -> tuple[dict[Key, list[PointPicture]], tuple[str, ...], range]:
    """Pictures by light and level, the lights in their order, and the levels, from 0 or from one behind the focus.

    Raises InputError if pictures of a light or level are missing.
    """
    groups: dict[Key, list[PointPicture]] = {}
    for picture in pictures:
        groups.setdefault((picture.light, picture.level), []).append(picture)
    if not groups:
        raise InputError("calibration: no pictures; give one per light, blur level and mosaic position")
    lights = tuple(dict.fromkeys(light for light, _ in groups))
    levels = sorted({level for _, level in groups})
    missing = [f"{light} level {level}" for light in lights for level in levels if (light, level) not in groups]
    known = range(min(levels[0], 0), len(levels) + min(levels[0], 0))
    if missing or levels != list(known) or 0 not in levels:
        raise InputError(
            f"calibration: no pictures of {', '.join(missing) or 'lower levels'}; give all levels from 0 on"
        )
    return groups, lights, known


def _check_sizes(groups: dict[Key, list[PointPicture]], camera: Camera) -> None:
    """Raise InputError unless the pictures of a light and level have one size, of whole blocks of the mosaic."""
    rows, columns = len(camera.sensor.mosaic), len(camera.sensor.mosaic[0])
    for (light, level), group in groups.items():
        sizes = {picture.frames_dn.shape[1:] for picture in group}
        if len(sizes) > 1 or any(height % rows or width % columns for height, width in sizes):
            shown = ", ".join(f"{width} x {height}" for height, width in sorted(sizes))
            raise InputError(
                f"calibration: pictures of {light} level {level} have {shown} pixels; all of a light and level need "
                f"one size, a multiple of the {columns} x {rows} mosaic"
            )


def _interleaved_kernel(full: FloatArray, noise_e: FloatArray, *, on_axis: bool) -> FloatArray:
    """Kernel about the middle pixel, [channel, size, size] electrons, of a picture [channel, h, w] and its noise.

    Channels whose kernel is not round are shifted, not fitted.
    """
    centre = common_centre(full)
    shifted = _centred(full, centre)
    round_kernel, rest = _round_kernels(full, noise_e, centre, shifted.shape[1] // 2)
    if not on_axis:  # diffraction is not round off the axis
        round_kernel += _interpolated(rest, centre, round_kernel.shape[1] // 2)
    return np.where(np.isnan(round_kernel), shifted, round_kernel)


def _normalised(electrons: FloatArray, names: tuple[str, ...]) -> tuple[Float32Array, Float32Array]:
    """Kernels [light, level, channel, y, x] of unit sum, and the signature of the lights, [light, channel].

    The signature is the channels' sum relative to G (else to the first channel), averaged over the levels.
    """
    positive = np.maximum(electrons, 0.0)
    total = positive.sum(axis=(-1, -2), keepdims=True)
    if not np.all(total > 0):
        raise InputError("calibration: a channel of a picture shows no point source above its background")
    reference = names.index("G") if "G" in names else 0
    ratio = (total / total[:, :, reference : reference + 1])[..., 0, 0].mean(axis=1)
    return (positive / total).astype(np.float32), ratio.astype(np.float32)


def _interleave(group: list[PointPicture], camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Electrons of every channel at every pixel without background, and their standard deviation, [channel, h, w]."""
    image, noise, sampled = averaged(group, camera, min(picture.exposure_s for picture in group))
    if not sampled.all():
        label = f"{group[0].light} level {group[0].level}"
        raise InputError(f"calibration: the shifts of the pictures of {label} do not cover one period of the mosaic")
    return image, noise


def _round_kernels(
    image: FloatArray, noise_e: FloatArray, centre: FloatArray, half: int
) -> tuple[FloatArray, FloatArray]:
    """Kernels of round stops about the middle pixel, [channel, size, size], electrons; NaN where not round.

    Also returns what they leave of the image where it is brighter than its noise, 0 elsewhere and where not round.

    The radial density is non-negative and linear between knots; it is fitted by least squares so that its integrals
    over the pixels around the measured centre give the picture. Pixels at many distances sample the profile more
    finely than the pixel pitch, so a subpixel shift of the centre costs no sharpness. From the first ring below the
    noise on, the profile is r^-3, the mean diffraction tail of a round stop, on a constant background.
    """
    size = 2 * half + 1
    measured = subpixel_radius(image.shape[1:], centre)
    target = subpixel_radius((size, size), np.array([half, half], float))
    kernels, rest = np.full((len(image), size, size), np.nan), np.zeros_like(image)
    for index, (picture, sigma) in enumerate(zip(image, noise_e, strict=True)):
        fit = round_fit(measured, picture.ravel(), sigma.ravel(), int(min(picture.shape) // 2))
        if fit is not None:
            kernels[index] = over_pixels(target, fit).reshape(size, size)
            model = fit.model.reshape(picture.shape)
            rest[index] = np.where(model > RING_SNR * sigma, picture - model, 0.0)
    return kernels, rest


def _interpolated(image: FloatArray, centre: FloatArray, half: int) -> FloatArray:
    """The surroundings of the centre by cubic splines, [channel, 2 half + 1, 2 half + 1]."""
    place = np.arange(-half, half + 1)
    places = np.meshgrid(centre[0] + place, centre[1] + place, indexing="ij")
    return np.stack([ndimage.map_coordinates(channel, places, order=3) for channel in image])


def _centred(image: FloatArray, centre: FloatArray) -> FloatArray:
    """Shift the centre to the middle pixel of an odd frame, [channel, size, size], by the shift theorem."""
    middle = np.rint(centre).astype(int)
    half = int(min(*middle, *(np.array(image.shape[1:]) - 1 - middle))) - 1
    if half < 1:
        raise InputError("calibration: the point source is at the picture's edge; it must be near the middle")
    odd = image[:, : image.shape[1] // 2 * 2, : image.shape[2] // 2 * 2]
    padded = np.pad(odd, ((0, 0), (8, 8), (8, 8)))
    fy = fft.fftfreq(padded.shape[1])[:, None]
    fx = fft.rfftfreq(padded.shape[2])[None, :]
    dy, dx = middle - centre
    shifted = fft.irfft2(fft.rfft2(padded) * np.exp(-2j * np.pi * (fy * dy + fx * dx)), s=padded.shape[1:])
    top, left = middle + 8
    return shifted[:, top - half : top + half + 1, left - half : left + half + 1]


def _crop(image: FloatArray, half: int) -> FloatArray:
    """The central part of a frame, [channel, 2 half + 1, 2 half + 1]."""
    middle = image.shape[1] // 2
    return image[:, middle - half : middle + half + 1, middle - half : middle + half + 1]
