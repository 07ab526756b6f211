"""A control variate for pictures through the lens: the pinhole picture, blurred without rays.

Nearly all noise of a textured surface comes from which texel a ray hits and at which wavelengths. Let s be a pinhole
picture around a pixel at a few wavelengths, linear between them; x the centre of the cell of the pixel that a ray
passes, a quarter of a pixel wide, half of one in large frames, or a whole pixel (:mod:`dasim.render.one_surface`); w
the position in the blur for which the ray was sampled, with density q; h the kernel of a surface at one depth; and K
the mean of h over the wavelengths, separately for each wavelength of s. With C = response x light x h(w) / q(w) at
each wavelength of the ray,

    f = sum of C (s(x - w) - F) / sum of C,    F = mean over the pixel's cells of s, blurred by K,

has mean 0. It follows the contribution of the ray where the depth is close to that of the surface and s is close to the
picture. Subtracting the sum of f over the pixel's rays from the estimate does not change its expectation, whatever the
rays hit, and reduces its noise. (Both are ratios of sums, whose bias falls as 1 / samples.) Neither s nor the depth
needs to be correct for this, but F must match them: f interpolates s linearly between its nodes, and F is the integral
of exactly that function. The rays of s are not those whose picture it corrects.

Rays are weighted with h averaged over nearby wavelengths (``over_wavelengths`` of
:class:`dasim.render.radial_blur.RadialBlur`), in the picture and in f. What the picture then lacks is F with the h of
single wavelengths less F with the averaged one, which is added to it.

With one s per channel, the noise due to wavelength remained: more than half of the rays in three of four random scenes.

The depth is the one that the pixel centre sees, rounded to one of a few blur levels, so that F takes one convolution
per level.

Tested in tests/dasim/render/test_control_variate.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from dasim.camera.sensor import principal_point
from dasim.camera.specification import Camera
from dasim.render import one_surface
from dasim.render.control_picture import with_pixel_boxes
from dasim.render.frozen import HOST_ONLY
from dasim.render.host_threads import in_threads
from dasim.render.plugin import aligned, texture
from dasim.render.wavelengths import BANDS
from dasim.typing import Float32Array, FloatArray

CELLS, FEWER_CELLS = 4, 2  # nodes of s per pixel, along each axis, even; fewer in large frames
LARGE_FRAME_PX = 600_000
# Points per pixel and axis of the grid on which F is summed, and their margin above the cut-off frequency of the
# kernels, 1 / (lambda N), for the frequencies of the picture. With a margin smaller by 0.3, F of the finest texture is
# off by 1 %.
GRIDS, GRID_MARGIN = (2, 4), 0.5
LEVEL_STEP_PX, LEVEL_SHARE = 0.5, 0.04  # spacing of blur levels: the larger of a length and a fraction of the blur
RADIUS_STEP = 0.1  # step of the table of K, relative to the spacing of the grid points
# Visible blur of the farthest level; kernels of more would take gigabytes, and F need not be exact for a mean without
# bias.
MOST_BLUR_PX = 150.0
MOST_ROWS, STRIP_AREA_PX = 256, 200_000  # of what is blurred at once, which bounds the memory


def _linear(neighbours: int = 6, highest: float = 0.8) -> FloatArray:
    """Filter weights of a node and its neighbours with the frequency response of linear interpolation, sinc^2.

    They are a least-squares fit up to the fraction ``highest`` of the nodes' Nyquist frequency. The error is at most
    4e-4, and 1.2e-4 at half of that frequency.
    """
    frequency = np.linspace(0.0, highest / 2, 200)  # per node
    cosines = 2 * np.cos(2 * np.pi * np.outer(frequency, np.arange(neighbours + 1)))
    cosines[:, 0] /= 2
    half = np.linalg.lstsq(cosines, np.sinc(frequency) ** 2, rcond=None)[0]
    weights = np.concatenate([half[:0:-1], half])
    return np.asarray(weights / weights.sum())


LINEAR = _linear()


@dataclass(frozen=True)
class Fine:
    """A pinhole's picture of a frame and a margin around it, on a grid finer than the pixels."""

    cells: int  # nodes per pixel, along each axis
    ratio: NDArray[np.float32]  # [y, x, band] radiance over the lights' spectrum
    margin_px: int
    # [y, x] of the pixels of frame and margin, from :func:`one_surface.edge_blur_px`; None for edges everywhere
    edge_px: Float32Array | None = None


def cells_of(camera: Camera) -> int:
    """Nodes per pixel and axis for the frame of a camera."""
    return CELLS if camera.sensor.width_px * camera.sensor.height_px <= LARGE_FRAME_PX else FEWER_CELLS


def points_of(lambda_n_px: float, cells: int) -> int | None:
    """Points per pixel of the grid of F, at most ``cells``, for kernels whose shortest lambda N is ``lambda_n_px``;
    None if the kernels are too fine for such a grid.
    """
    enough = (points for points in GRIDS if 1 / lambda_n_px + GRID_MARGIN <= points <= cells)
    return next(enough, None)


def wider(camera: Camera, margin_px: int) -> Camera:
    """A camera that sees a margin around the frame."""
    sensor = camera.sensor
    size = {side: getattr(sensor, side) + 2 * margin_px for side in ("width_px", "height_px")}
    x, y = principal_point(sensor)
    changes = size | {"principal_point_px": (x + margin_px, y + margin_px)}
    return camera.model_copy(update={"sensor": sensor.model_copy(update=changes)})


@dataclass(frozen=True)
class Control:
    """The control variate of a stop."""

    # Texture of s over ``scale`` in half precision, a channel per band; below it, means over a pixel, see
    # :func:`control_picture.with_pixel_boxes`
    picture: Any
    scale: Any
    extent: Any  # size of the picture along x and y, pixels
    margin_px: Any
    cells: Any  # cells per pixel along each axis; s is read at their centres
    whole: Any  # 1 for each pixel of the frame that is a single cell, row by row
    level: Any  # blur level of each pixel of the frame, row by row
    blur_px: Any  # signed visible blur of each level
    reach_px: Any  # radius of the kernel of each level
    centre: Any  # centre of the stop, in radii of the lens
    expected: NDArray[np.float32] = field(metadata=HOST_ONLY)  # F, [pixel, channel]
    # What the kernels of the rays lack, [pixel, channel]; None for nothing
    lacking: NDArray[np.float32] | None = field(metadata=HOST_ONLY)

    def at(self, pixel: Any, place: Any, w: Any) -> tuple[list[Any], Any, Any]:
        """Values of s per band at positions w in the blur of each pixel; also the visible blur of the pixel's level and
        its reach.

        Args:
            pixel: index of the pixel in the frame.
            place: position of the ray on the film, in pixels from the frame's corner.
            w: position in the blur for which the ray was sampled, relative to the image of the stop's centre, in
                pixels.
        """
        import drjit as dr
        import mitsuba as mi

        level = dr.gather(mi.UInt32, self.level, pixel)
        blur = dr.gather(mi.Float, self.blur_px, level)
        whole, cells = self._is_whole(pixel), self.cells_at(pixel)
        place = (dr.floor(place * cells) + 0.5) / cells
        node = 0.5 / self.cells
        at = place - w + self.centre * (blur / 2) + self.margin_px + dr.select(whole, node, 0.0)
        at = dr.clip(at, node, self.extent - node)
        at.y += dr.select(whole, self.extent.y, 0.0)
        seen = self.picture.eval(at / mi.Point2f(self.extent.x, 2 * self.extent.y))
        return [value * self.scale for value in list(seen)[:BANDS]], blur, dr.gather(mi.Float, self.reach_px, level)

    def cells_at(self, pixel: Any) -> Any:
        """Cells per pixel and axis at pixels of the frame."""
        import drjit as dr

        return dr.select(self._is_whole(pixel), 1.0, self.cells)

    def _is_whole(self, pixel: Any) -> Any:
        import drjit as dr
        import mitsuba as mi

        return dr.gather(mi.UInt32, self.whole, pixel) > 0


def control(
    fine: Fine,
    blur_px: FloatArray,
    outer: float,
    centre: tuple[float, float],
    tail_px: float,
    profiles: Callable[[FloatArray, FloatArray], FloatArray],
    points: int = GRIDS[0],
    of_single: Callable[[FloatArray, FloatArray], FloatArray] | None = None,
) -> Control:
    """The control variate of a stop whose kernels are radial about its centre.

    Args:
        fine: the pinhole's picture, of the stop's bands.
        blur_px: signed visible blur of the open lens at the middle of each pixel, [h, w].
        outer: radius of the stop over that of the lens.
        centre: of the stop, in radii of the lens.
        tail_px: how far K reaches beyond the geometric blur.
        profiles: kernels [level, radius, band, channel] for visible blurs [level] at radii [radius], in pixels; of any
            scale per channel.
        points: per pixel of the grid of F, along each axis, see :func:`points_of`.
        of_single: the kernels of single wavelengths, as ``profiles``, if those are averaged.
    """
    import drjit as dr
    import mitsuba as mi

    # Of the blur of the stop, displacement included: the kernels of a small stop differ less from depth to depth.
    share = outer + float(np.hypot(*centre))
    own = share * np.clip(blur_px, -MOST_BLUR_PX, MOST_BLUR_PX)
    number, level = np.unique(_level(own), return_inverse=True)
    levels = _blur_of(number) / share
    reach = outer * np.abs(levels) / 2 + tail_px
    step_px = RADIUS_STEP / points
    radius = np.arange(0.0, reach.max() + 2 * step_px, step_px)
    kinds = [profiles] if of_single is None else [profiles, of_single]
    table = np.concatenate([kernels(levels, radius) for kernels in kinds], axis=-1)
    table *= (radius <= reach[:, None])[..., None, None]
    shift = np.multiply.outer(levels / 2, centre)
    picture, scale = with_pixel_boxes(fine.ratio, fine.cells)
    bands = np.moveaxis(picture[: len(fine.ratio), :, : fine.ratio.shape[-1]], -1, 0)
    expected, *others = np.split(
        _expected(fine, bands, scale, level.reshape(blur_px.shape), table, reach, shift, points), len(kinds), axis=-1
    )
    height, width = (extent / fine.cells for extent in fine.ratio.shape[:2])
    one = np.zeros(blur_px.shape, bool)
    if fine.edge_px is not None:
        one = one_surface.seen(fine.edge_px, fine.margin_px, outer)
    return Control(
        picture=texture(picture),
        scale=dr.opaque(mi.Float, scale),
        extent=mi.Point2f(dr.opaque(mi.Float, width), dr.opaque(mi.Float, height)),
        margin_px=dr.opaque(mi.Float, fine.margin_px),
        cells=dr.opaque(mi.Float, fine.cells),
        whole=mi.UInt32(aligned(one.astype(np.uint32))),
        level=mi.UInt32(aligned(level.astype(np.uint32))),
        # At least two entries: for an array of one entry, the compiler omits the lookup, which gives another kernel.
        blur_px=mi.Float(aligned(np.append(levels, levels[-1]))),
        reach_px=mi.Float(aligned(np.append(reach, reach[-1]))),
        centre=mi.Point2f(*(dr.opaque(mi.Float, value) for value in centre)),
        expected=expected,
        lacking=others[0] - expected if others else None,
    )


def _level(blur_px: FloatArray) -> NDArray[np.int64]:
    """Number of the level of a signed blur: 0 for none, opposite for the other side of the focus."""
    bend = LEVEL_STEP_PX / LEVEL_SHARE
    size = np.abs(blur_px)
    beyond = np.log(np.maximum(size, bend) / bend) / LEVEL_SHARE
    number = np.round(np.minimum(size, bend) / LEVEL_STEP_PX + beyond)
    return np.asarray(np.sign(blur_px) * number, dtype=np.int64)


def _blur_of(number: NDArray[np.int64]) -> FloatArray:
    """Signed blur of a level."""
    bend = LEVEL_STEP_PX / LEVEL_SHARE
    size = np.abs(number).astype(float)
    straight = np.minimum(size, bend / LEVEL_STEP_PX)
    return np.asarray(np.sign(number) * straight * LEVEL_STEP_PX * np.exp(LEVEL_SHARE * (size - straight)))


def _expected(
    fine: Fine,
    bands: NDArray[np.floating],
    scale: float,
    level: NDArray[np.intp],
    table: FloatArray,
    reach: FloatArray,
    shift: FloatArray,
    points: int,
) -> NDArray[np.float32]:
    """F for every pixel, [pixel, channel].

    The integral over w is a sum over a grid of ``points`` per pixel, exact where kernel and picture together have no
    frequencies beyond it. A grid of pixels leaves 0.1 % of bias in the means over 8 x 8 pixels of a fine texture, even
    where blur is large.

    Args:
        fine: cells and margin of s.
        bands: s over ``scale``, as the rays read it, [band, y, x].
        scale: of ``bands``.
        level: of each pixel, [h, w].
        table: K at radii of steps of ``RADIUS_STEP`` / ``points``, [level, radius, band, channel].
        reach: of each level, pixels.
        shift: of the image of the stop's centre by blur, [level, (x, y)] pixels.
        points: of the grid per pixel, along each axis.
    """
    most = int(np.ceil(reach.max() + np.abs(shift).max())) + 2
    spare = max(0, most - fine.margin_px)  # the picture continues with its border values, as the texture does
    around = fine.margin_px + spare

    def pixel_means(band: NDArray[np.floating]) -> NDArray[np.float32]:
        return _pixel_means(band.astype(np.float32) * np.float32(scale), fine.cells, spare, points)

    means = in_threads(pixel_means, bands)
    result = np.zeros((*level.shape, table.shape[-1]), np.float32)

    def add(number: int) -> None:
        here = level == number
        rows, columns = (np.flatnonzero(here.any(axis=axis)) for axis in (1, 0))
        left, right = columns[0], columns[-1] + 1
        half = int(np.ceil((reach[number] + np.abs(shift[number]).max()) * points))
        kernels = _sampled(table[number], half, shift[number], points)
        step = _strip_rows(right - left)
        for top in range(rows[0], rows[-1] + 1, step):
            bottom = min(top + step, rows[-1] + 1)
            inside = here[top:bottom, left:right]
            part = np.s_[
                (top + around) * points - half : (bottom - 1 + around) * points + half + 1,
                (left + around) * points - half : (right - 1 + around) * points + half + 1,
            ]
            blurred = _blurred([mean[part] for mean in means], kernels)
            result[top:bottom, left:right][inside] = blurred[:, ::points, ::points][:, inside].T

    in_threads(add, range(len(table)))
    return result.reshape(-1, result.shape[-1])


def _blurred(bands: list[NDArray[np.float32]], kernels: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sums over bands [y, x] blurred with kernels [band, channel, y, x] where these fit inside, [channel, y, x]."""
    extent, size = bands[0].shape, kernels.shape[2:]
    shape = [fft.next_fast_len(length, real=True) for length in extent]
    valid = tuple(slice(of - 1, whole) for of, whole in zip(size, extent, strict=True))
    # In single precision, the rounding of bright places spreads to dark ones: 1e-5 of their light.
    spectra = [fft.rfft2(band.astype(float), shape) for band in bands]
    result = np.zeros((kernels.shape[1], *(whole - of + 1 for of, whole in zip(size, extent, strict=True))), np.float32)
    for channel in range(len(result)):
        total = np.zeros_like(spectra[0])
        for spectrum, kernel in zip(spectra, kernels[:, channel], strict=True):
            if kernel.any():
                total += spectrum * padded_spectrum(kernel.astype(float), shape)
        result[channel] = fft.irfft2(total, shape)[valid]
    return result


def padded_spectrum(images: NDArray[np.floating], shape: Sequence[int]) -> NDArray[np.complexfloating]:
    """``rfft2`` of images [..., y, x] padded with zeros to ``shape`` (h, w), without transforming rows of zeros."""
    return np.asarray(fft.fft(fft.rfft(images, shape[1]), shape[0], axis=-2))


def _pixel_means(picture: NDArray[np.float32], cells: int, spare_px: int, points: int) -> NDArray[np.float32]:
    """Means of a picture [y, x] over the cells of a pixel, at ``points`` positions per pixel and axis; the first is
    centred on a pixel. ``spare_px`` pixels are added around the picture.

    The picture is sampled at its nodes only. An integral over all positions also contains the attenuation by linear
    interpolation between the nodes, which the filter :data:`LINEAR` applies to the samples.
    """
    weights = np.convolve(np.full(cells, 1 / cells), LINEAR).astype(np.float32)
    means, step = np.pad(picture, spare_px * cells + len(LINEAR) // 2, mode="edge"), cells // points
    for _ in range(2):  # along y, then along x
        count = (len(means) - len(weights)) // step + 1
        parts = (means[first : first + step * count : step] for first in range(len(weights)))
        first_weight, *others = weights
        total = first_weight * next(parts)
        for weight, part in zip(others, parts, strict=True):
            total += weight * part
        means = np.ascontiguousarray(total.T)
    return means


def _sampled(profiles: FloatArray, half: int, shift: FloatArray, points: int) -> NDArray[np.float32]:
    """Kernels on the grid up to ``half`` points from its middle, [band, channel, y, x]; each channel sums to 1 over all
    bands.

    The kernels are centred at -``shift``, see :meth:`Control.at`.
    """
    at = np.arange(-half, half + 1) / points
    kernels = on_grid(profiles, np.hypot(at[None, :] + shift[0], at[:, None] + shift[1]), RADIUS_STEP / points)
    total = kernels.sum(axis=(0, 1, 2))
    kernels /= np.where(total > 0, total, 1.0)
    return np.ascontiguousarray(np.moveaxis(kernels, (0, 1), (2, 3)), dtype=np.float32)


def on_grid(profiles: FloatArray, distance: FloatArray, step: float) -> FloatArray:
    """Profiles [radius, ...] in steps of a radius, at distances [y, x], linear between them, [y, x, ...]."""
    place = distance / step
    node = np.minimum(place.astype(int), len(profiles) - 2)
    along = np.clip(place - node, 0.0, 1.0).reshape(*place.shape, *[1] * (profiles.ndim - 1))
    return np.asarray(profiles[node] * (1 - along) + profiles[node + 1] * along)


def convolved(fine: Fine, kernels: NDArray[np.float32], points: int) -> NDArray[np.float32]:
    """The means over the frame's pixels of a picture that is convolved with kernels [band, channel, y, x] on a grid of
    ``points`` per pixel, [h, w, channel].
    """
    half = kernels.shape[-1] // 2
    spare = max(0, half // points + 2 - fine.margin_px)  # the picture goes on as at its border
    around = fine.margin_px + spare
    bands = np.moveaxis(fine.ratio, -1, 0)
    means = in_threads(lambda band: _pixel_means(band, fine.cells, spare, points), bands)
    height, width = (extent // fine.cells - 2 * fine.margin_px for extent in fine.ratio.shape[:2])
    result = np.empty((height, width, kernels.shape[1]), np.float32)
    columns = slice(around * points - half, (width - 1 + around) * points + half + 1)

    step = _strip_rows(width)

    def fill(top: int) -> None:
        bottom = min(top + step, height)
        rows = slice((top + around) * points - half, (bottom - 1 + around) * points + half + 1)
        blurred = _blurred([mean[rows, columns] for mean in means], kernels)
        result[top:bottom] = np.moveaxis(blurred[:, ::points, ::points], 0, -1)

    in_threads(fill, range(0, height, step))
    return result


def _strip_rows(width: int) -> int:
    """Rows of a picture of ``width`` pixels that are blurred at once."""
    return min(MOST_ROWS, -(-STRIP_AREA_PX // width))
