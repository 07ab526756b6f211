"""Calibration (sec. 5.1): point-spread functions measured from pictures of a point source."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy import fft, sparse
from scipy.optimize import nnls

from dasim.camera import Camera, channels, mosaic_channels
from dasim.errors import InputError
from dasim.sensor import electrons_per_dn, saturation_e
from dasim.values import PointPicture, PsfBank

FloatArray = NDArray[np.float64]
Progress = Callable[[str, float], None]

SATURATION_SHARE = 0.9  # of a pixel: above it, a picture of a longer exposure tells nothing
RIM_PX = 3  # width of the frame's rim that shows background alone
CORE_SHARE = 0.02  # of the peak: a channel's core, where its centre is measured
CORE_MARGIN_PX = 2
CENTRE_STEPS = 4  # the window of the centre of mass follows the centre; converges in two or three
RING_SNR = 4.0  # a ring's mean over its standard error: from the first ring below it, the tail is modelled
MIN_TAIL_START_PX = 3.0
RING_PX = 1.0
FINE_PX = 4.0  # the profile's knots are closer within this radius, where in-focus kernels lie
SUBPIXELS = 5  # per pixel and axis, for integrals over the pixel
NORMAL_REGULARISATION = 1e-6  # keeps knots that no pixel resolves from breaking the factorisation
ROUND_MISFIT = 0.15  # relative residual of the round model; above it the picture itself is moved


def calibrate(
    pictures: Iterable[PointPicture],
    camera: Camera,
    *,
    diffraction: str = "measured",
    progress: Progress | None = None,
) -> PsfBank:
    """Measure the camera's kernels from pictures of a point source, for every light and blur level.

    ``pictures`` cover one period of the mosaic by whole-pixel shifts for each light and level, so that each
    channel sees each pixel of its kernel. Frames are averaged; black level and background go; the positions
    are interleaved; the common centre of the four channels moves to the middle pixel; each kernel is
    normalised to unit sum. ``diffraction`` is recorded as a remark. Raises InputError where pictures lack.
    """
    groups: dict[tuple[str, int], list[PointPicture]] = {}
    for picture in pictures:
        groups.setdefault((picture.light, picture.level), []).append(picture)
    if not groups:
        raise InputError("calibration: no pictures; one for each light, blur level and mosaic position is needed")
    lights = tuple(dict.fromkeys(light for light, _ in groups))
    levels = sorted({level for _, level in groups})
    missing = [f"{light} level {level}" for light in lights for level in levels if (light, level) not in groups]
    if missing or levels != list(range(len(levels))):
        raise InputError(f"calibration: pictures lack {', '.join(missing) or 'levels from 0 on without a gap'}")
    centred: dict[tuple[str, int], FloatArray] = {}
    for done, (key, group) in enumerate(groups.items()):
        full, noise_e = _interleave(group, camera)
        moved = _centre(full)
        round_kernel = _round_kernels(full, noise_e, moved.shape[1] // 2)
        centred[key] = np.where(np.isnan(round_kernel), moved, round_kernel)
        if progress:
            progress("calibrate", (done + 1) / len(groups))
    half = min(min(image.shape[1:]) for image in centred.values()) // 2
    stacked = np.stack([[_crop(centred[light, level], half) for level in levels] for light in lights])
    electrons = np.maximum(stacked, 0.0)
    total = electrons.sum(axis=(-1, -2), keepdims=True)
    if not np.all(total > 0):
        raise InputError("calibration: a channel of a picture shows no point source above its background")
    names = channels(camera.sensor)
    reference = names.index("G") if "G" in names else 0
    ratio = (total / total[:, :, reference : reference + 1])[..., 0, 0].mean(axis=1)
    first = [groups[lights[0], level][0] for level in levels]
    return PsfBank(
        kernel=(electrons / total).astype(np.float32),
        lights=lights,
        signature=ratio.astype(np.float32),
        depth_m=np.array([picture.depth_m for picture in first], np.float32),
        blur_px=np.array([picture.blur_px for picture in first], np.float32),
        camera=camera,
        diffraction=diffraction,
    )


def _interleave(group: list[PointPicture], camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Electrons of every channel at every pixel, [channel, h, w], background removed, and their noise.

    In the shortest exposure's electrons; of several exposures every pixel has the sum of those that it stands.
    """
    sensor = camera.sensor
    height, width = group[0].frames_dn.shape[1:]
    local = camera.model_copy(update={"sensor": sensor.model_copy(update={"height_px": height, "width_px": width})})
    channel = mosaic_channels(local)
    scale = electrons_per_dn(sensor)
    shortest = min(picture.exposure_s for picture in group)
    shape = (len(channels(sensor)), height, width)
    electrons, variance, frames_s, count = np.zeros((4, *shape))  # sums over all frames that see a pixel
    seen = np.zeros(shape, bool)
    for picture in group:
        frames = picture.frames_dn.astype(np.float64)
        mean_e = (frames.mean(axis=0) - sensor.black_level_dn) * scale
        # A pixel that saturates in the longer exposures counts in the shorter alone; not by its noise in one frame.
        usable = (mean_e < SATURATION_SHARE * saturation_e(sensor)) | (picture.exposure_s == shortest)
        back = tuple(-s for s in picture.shift_px)
        for index in np.unique(channel):
            here = np.roll((channel == index) & usable, back, axis=(0, 1))
            seen[index] |= here
            value = np.roll(mean_e, back, axis=(0, 1))[here]
            electrons[index][here] += len(frames) * value
            variance[index][here] += len(frames) * (np.maximum(value, 0) + sensor.read_noise_e**2)
            frames_s[index][here] += len(frames) * picture.exposure_s / shortest
            count[index][here] += len(frames)
    if not seen.all():
        where = f"{group[0].light} level {group[0].level}"
        raise InputError(f"calibration: pictures of {where} do not cover one period of the mosaic by their shifts")
    image = electrons / frames_s
    noise = np.sqrt(variance + (sensor.dsnu_e * count) ** 2) / frames_s
    rim = np.ones((height, width), bool)
    rim[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = False
    return image - np.median(image[:, rim], axis=1)[:, None, None], noise


def _round_kernels(image: FloatArray, noise_e: FloatArray, half: int) -> FloatArray:
    """Kernels of round stops about the middle pixel, [channel, size, size], electrons; NaN where not round.

    Least squares for the radial density (non-negative, linear between knots) that, integrated over the pixels
    around the measured centre, gives the picture: pixels at many distances sample the profile more finely
    than their pitch, so moving the centre costs no sharpness. From the first ring that drowns in
    noise the profile goes on as r^-3, the mean diffraction tail of a round stop, on a constant background.
    """
    centre = _common_centre(image)
    size = 2 * half + 1
    measured = _subpixel_radius(image.shape[1:], centre)
    wanted = _subpixel_radius((size, size), np.array([half, half], float))
    kernels = np.full((len(image), size, size), np.nan)
    for index, (picture, sigma) in enumerate(zip(image, noise_e, strict=True)):
        start = _tail_start(picture, sigma, np.floor(measured.mean(axis=-1)).astype(int))
        knots = np.concatenate([np.arange(0, min(FINE_PX, start), FINE_PX / 8), np.arange(FINE_PX, start, RING_PX / 2)])
        knots = np.append(knots, start)
        basis = sparse.hstack([_basis(measured, knots), np.ones((measured.shape[0], 1))], format="csr")
        weighted = sparse.diags_array(1 / sigma.ravel()) @ basis
        normal = (weighted.T @ weighted).toarray()
        normal[np.diag_indices_from(normal)] *= 1 + NORMAL_REGULARISATION
        profile = _non_negative(normal, weighted.T @ (picture.ravel() / sigma.ravel()))
        unexplained = np.sum((basis @ profile - picture.ravel()) ** 2) - np.sum(sigma**2)
        if unexplained < ROUND_MISFIT**2 * np.sum((picture - profile[-1]) ** 2):
            kernels[index] = (_basis(wanted, knots) @ profile[:-1]).reshape(size, size)
    return kernels


def _subpixel_radius(shape: tuple[int, ...], centre: FloatArray) -> FloatArray:
    """Distance in pixels of SUBPIXELS^2 points of every pixel from the centre, [pixel, point]."""
    fine = [(np.arange(n * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5 - c for n, c in zip(shape, centre, strict=True)]
    radius = np.hypot(fine[0][:, None], fine[1][None, :])
    blocks = radius.reshape(shape[0], SUBPIXELS, shape[1], SUBPIXELS).swapaxes(1, 2)
    return blocks.reshape(shape[0] * shape[1], SUBPIXELS**2)


def _basis(radius: FloatArray, knots: FloatArray) -> sparse.csr_array:
    """Integral over each pixel of every knot's hat function, [pixel, knot]; the last goes on as r^-3."""
    inside = np.minimum(radius, knots[-1])
    upper = np.clip(np.searchsorted(knots, inside, side="right"), 1, len(knots) - 1)
    share = (inside - knots[upper - 1]) / (knots[upper] - knots[upper - 1])
    falloff = np.maximum(radius / knots[-1], 1.0) ** -3
    pixel = np.repeat(np.arange(len(radius)), radius.shape[1])
    parts = np.concatenate([((1 - share) * falloff).ravel(), (share * falloff).ravel()]) / radius.shape[1]
    place = (np.tile(pixel, 2), np.concatenate([upper.ravel() - 1, upper.ravel()]))
    return sparse.coo_array((parts, place), shape=(len(radius), len(knots))).tocsr()


def _tail_start(picture: FloatArray, sigma: FloatArray, ring: NDArray[np.int_]) -> float:
    """Radius in pixels of the first ring whose mean does not stand out of its own noise."""
    rings = int(min(picture.shape) // 2)
    count = np.bincount(ring, minlength=rings)[:rings]
    mean = np.bincount(ring, picture.ravel(), minlength=rings)[:rings] / np.maximum(count, 1)
    error = np.bincount(ring, sigma.ravel(), minlength=rings)[:rings] / np.maximum(count, 1) ** 1.5
    dark = np.flatnonzero(mean <= RING_SNR * error)
    return float(np.clip(dark[0] if dark.size else rings, MIN_TAIL_START_PX, rings - 1))


def _non_negative(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Non-negative least squares from its normal equations, through their Cholesky factor."""
    factor = np.linalg.cholesky(normal)
    return nnls(factor.T, np.linalg.solve(factor, right))[0]


def _common_centre(image: FloatArray) -> FloatArray:
    """Centre (y, x) in pixels of the point, from the centres of mass of all channels' cores together.

    Each channel counts with its electrons; one centre for all keeps lateral shifts between channels.
    """
    total = np.maximum(image, 0).sum(axis=0)
    y, x = np.indices(total.shape)
    core = total > CORE_SHARE * total.max()
    centre = np.array([y[core].mean(), x[core].mean()])
    extent = max(np.hypot(y[core] - centre[0], x[core] - centre[1]).max(), 1.0) + CORE_MARGIN_PX
    extent = min(extent, min(total.shape) / 2 - 2)
    signal = image.sum(axis=0)
    for _ in range(CENTRE_STEPS):
        # a soft rim: a pixel that enters or leaves the window must not move the centre by a step
        window = np.clip(extent + 0.5 - np.hypot(y - centre[0], x - centre[1]), 0, 1) * signal
        centre = np.array([(window * y).sum(), (window * x).sum()]) / window.sum()
    return centre


def _centre(image: FloatArray) -> FloatArray:
    """Move the common centre to the middle pixel of an odd frame, [channel, size, size], by the shift theorem."""
    centre = _common_centre(image)
    middle = np.rint(centre).astype(int)
    half = int(min(*middle, *(np.array(image.shape[1:]) - 1 - middle))) - 1
    if half < 1:
        raise InputError("calibration: the point source lies at the picture's edge; it must be near the middle")
    odd = image[:, : image.shape[1] // 2 * 2, : image.shape[2] // 2 * 2]
    padded = np.pad(odd, ((0, 0), (8, 8), (8, 8)))
    fy = fft.fftfreq(padded.shape[1])[:, None]
    fx = fft.rfftfreq(padded.shape[2])[None, :]
    dy, dx = middle - centre
    moved = fft.irfft2(fft.rfft2(padded) * np.exp(-2j * np.pi * (fy * dy + fx * dx)), s=padded.shape[1:])
    top, left = middle + 8
    return moved[:, top - half : top + half + 1, left - half : left + half + 1]


def _crop(image: FloatArray, half: int) -> FloatArray:
    """The central [channel, 2 half + 1, 2 half + 1]."""
    middle = image.shape[1] // 2
    return image[:, middle - half : middle + half + 1, middle - half : middle + half + 1]
