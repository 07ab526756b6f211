"""The control variate: F against a direct integral, no bias whatever the picture, and less noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

from dasim.camera import specification as cameras
from dasim.render import control_variate
from dasim.render.control_variate import Fine

SIZE = 12, 10
SPP, SEEDS = 16, 24


@pytest.fixture(scope="module")
def picture():
    """A picture of fine texture, half of whose contrast is finer than a pixel, on a margin of 6 pixels."""
    random = np.random.default_rng(2)
    noise = ndimage.gaussian_filter(random.uniform(-1.0, 1.0, (*(4 * (extent + 12) for extent in SIZE), 2)), (1, 1, 0))
    return Fine(4, (0.6 + 0.1 * noise / noise.std()).astype(np.float32), 6)


@pytest.mark.parametrize(("blur_px", "limit"), [(3.0, 1e-4), (9.0, 3e-4)])
def test_the_mean_is_the_integral_of_the_kernel_over_the_picture_between_its_nodes(jit, picture, blur_px, limit):
    """Rationale: the estimate has no bias only if F is the mean of what the rays read.

    Set-up: noise with a standard deviation of 0.1; smooth kernels for a stop of half the lens, off its middle.
    Expectation: F of a pixel is the integral over the kernel of the picture, linear between its nodes
    (a sum over a fine grid), from the middles of the pixel's cells, within ``limit`` of a mean of 0.6.
    """
    width = 0.25 * blur_px + 1.2

    def profiles(levels, radius):
        return np.broadcast_to(
            np.exp(-0.5 * (radius / (0.45 * width)) ** 2)[:, None, None] * np.eye(2), (len(levels), len(radius), 2, 2)
        )

    blur = np.full(SIZE, blur_px)
    made = control_variate.control(picture, blur, 0.5, (0.25, 0.0), 2.2 * width, profiles)
    row, column = 4, 7
    steps = (np.arange(-120, 120) + 0.5) / 120 * 3.2 * width  # w along y
    x, y = np.meshgrid(steps, steps)
    kernel = np.exp(-0.5 * (np.hypot(x, y) / (0.45 * width)) ** 2) * (np.hypot(x, y) <= 0.25 * blur_px + 2.2 * width)
    shift = 0.25 * float(made.blur_px[0]) / 2
    pixel = (np.arange(4) + 0.5) / 4  # middles of the cells
    for channel in range(2):
        value = np.mean(
            [_read(picture, column + px - x + shift, row + py - y, channel, kernel) for px in pixel for py in pixel]
        )
        assert made.expected[row * SIZE[1] + column, channel] == pytest.approx(value, abs=limit)


def test_the_mean_is_exact_where_blur_is_large_and_its_edge_sharp(jit, picture):
    """Rationale: a sharp edge has fine frequencies at any blur, and a grid too coarse for them leaves a bias.

    Set-up: a disc with a diameter of 9 px, whose edge falls within 0.5 px, over the same noise. Expectation: the mean
    of F over 4 x 4 pixels is that of the integrals, within 3e-5 of a mean of 0.6.
    """
    radius_px = 4.5

    def disc(radius):
        return 0.5 - 0.5 * np.tanh((radius - radius_px) / 0.25)

    made = control_variate.control(
        picture,
        np.full(SIZE, 9.0),
        1.0,
        (0.0, 0.0),
        1.5,
        lambda levels, radius: np.broadcast_to(
            disc(radius)[:, None, None] * np.eye(2), (len(levels), len(radius), 2, 2)
        ),
    )
    steps = (np.arange(-120, 120) + 0.5) / 120 * 6.0
    x, y = np.meshgrid(steps, steps)
    place = 4
    block = np.ix_(range(place, place + 4), range(place, place + 4))
    found = made.expected.reshape(*SIZE, 2)[block].mean(axis=(0, 1))
    for channel in range(2):
        at = place + (np.arange(16) + 0.5) / 4
        value = np.mean([_read(picture, px - x, py - y, channel, disc(np.hypot(x, y))) for px in at for py in at])
        assert found[channel] == pytest.approx(value, abs=3e-5)


def test_a_whole_pixel_reads_the_mean_of_its_cells(jit, picture):
    """Rationale: a pixel that is a single cell has the same F as one of many cells.

    Set-up: 4,000 places and shifts. Expectation: what the pixel reads is the mean of what its 16 cells read there: each
    time to a step of half precision below 1, and in the mean to 2e-5.
    """
    import mitsuba as mi

    def profiles(levels, radius):
        return np.ones((len(levels), len(radius), 2, 2))

    without = dataclasses.replace(picture, edge_px=np.full([side + 12 for side in SIZE], -1.0, np.float32))
    of_cells, whole = (
        control_variate.control(fine, np.full(SIZE, 3.0), 0.5, (0.25, 0.0), 2.0, profiles)
        for fine in (picture, without)
    )
    np.testing.assert_array_equal(of_cells.expected, whole.expected)
    count = 4000
    random = np.random.default_rng(0)
    row, column = random.integers(SIZE[0], size=count), random.integers(SIZE[1], size=count)
    shift = mi.Point2f(*random.uniform(-3, 3, (2, count)).astype(np.float32))

    def read(control, x, y):
        place = mi.Point2f((column + x).astype(np.float32), (row + y).astype(np.float32))
        seen = control.at(mi.UInt32((row * SIZE[1] + column).astype(np.uint32)), place, shift)[0]
        return np.array([np.array(value) for value in seen])[:2]

    middles = (np.arange(4) + 0.5) / 4
    expected = np.mean([read(of_cells, x, y) for x in middles for y in middles], axis=0)
    found = read(whole, *random.uniform(0, 1, (2, count)))
    np.testing.assert_allclose(found, expected, atol=2.0**-11)
    np.testing.assert_allclose(found.mean(axis=1), expected.mean(axis=1), rtol=2e-5)


def test_rounding_does_not_carry_light_from_bright_places_to_dark_ones(jit):
    """Expectation: of a surface of 1 beside a lamp of 1e5 out of the kernel's reach, F stays 1 within 1e-6."""
    flat, lamp = np.ones((4 * 52, 4 * 52, 1), np.float32), np.ones((4 * 52, 4 * 52, 1), np.float32)
    lamp[:, -16:] = 1e5
    alone, beside = (
        control_variate.control(
            Fine(4, values, 6),
            np.full((40, 40), 6.0),
            1.0,
            (0.0, 0.0),
            1.0,
            lambda levels, radius: np.ones((len(levels), len(radius), 1, 1)),
        ).expected.reshape(40, 40)[:, :20]
        for values in (flat, lamp)
    )
    np.testing.assert_allclose(beside, alone, rtol=1e-6)


def test_lamps_in_view_are_within_half_precision(jit):
    """Set-up: a surface of 1, a dark one of 1e-3 and a lamp of 4e7, 600 times the largest number of half precision.

    Expectation: pixels read what the picture has, to a step of half precision, and in the mean what F is made of, also
    where the dark surface is some steps of the smallest number.
    """
    import mitsuba as mi

    ratio = np.ones((4 * 52, 4 * 52, 3), np.float32)
    ratio[:, :100] = 1e-3
    ratio[100:104, 180:184] = 4e7
    made = control_variate.control(
        Fine(4, ratio, 6, np.full((52, 52), -1.0, np.float32)),
        np.zeros((40, 40)),
        1.0,
        (0.0, 0.0),
        1.0,
        lambda levels, radius: np.ones((len(levels), len(radius), 3, 3)),
    )
    row, column = (each.ravel() for each in np.mgrid[:40, :40])
    place = mi.Point2f(*(np.stack([column, row]) + 0.5).astype(np.float32))
    seen = made.at(mi.UInt32((row * 40 + column).astype(np.uint32)), place, mi.Point2f(0.0))[0]
    found = np.array(seen[0]).reshape(40, 40)
    assert found.max() == pytest.approx(4e7, rel=1e-3)
    assert found[:, 22:].min() == pytest.approx(1.0, rel=1e-3)
    expected = made.expected.reshape(40, 40, 3)[..., 0]
    assert expected[:, :16] == pytest.approx(1e-3, rel=0.03)
    assert found[:, :16].mean() == pytest.approx(float(expected[:, :16].mean()), rel=1e-4)
    assert found[:, 22:30].mean() == pytest.approx(float(expected[:, 22:30].mean()), rel=1e-4)


def _read(picture, x, y, channel, kernel):
    """Mean of the picture at places in pixels from the frame's corner, weighted by a kernel."""
    at = [(place + picture.margin_px) * picture.cells - 0.5 for place in (y, x)]
    return (
        ndimage.map_coordinates(picture.ratio[..., channel], at, order=1, mode="nearest") * kernel
    ).sum() / kernel.sum()


@pytest.fixture(scope="module")
def pictures(jit, loaded, make_scene, lamp):
    """Pictures and their variates, [stop, seed, h, w, channel], of two boards whose edge crosses the frame."""
    import dasim
    from dasim.render import passes

    board = {"shape": "plane", "size_cm": [60, 60], "material": "stone"}
    stone = {"kind": "blend", "image": "skimage:gravel", "repeat": [12, 12], "dark": "soil", "bright": "ceramic-white"}
    far = board | {"name": "far", "position_cm": [0, 0, 60]}
    near = board | {"name": "near", "position_cm": [30.0, 0, 15], "rotation_deg": [0, 20, 0]}
    scene = loaded(make_scene(far, near, lights=[lamp], materials={"stone": stone}))
    camera = cameras.cropped("da-mobile", 40, 24)
    assert isinstance(camera, dasim.Camera)
    optics = {"diffraction": "wave", "max_blur_px": 26.0, "field": None}
    also = cameras.load_camera("bayer-mobile")
    sharp = passes.sharp_pass(scene, camera, passes.Sampling(32, 5), None, also, diffraction="wave", max_blur_px=26.0)
    values, variates = [], []
    for stop in camera.stops:
        control = passes.control_of(scene, camera, stop, sharp.fine, max_blur_px=26.0, field=None)
        parts = [
            passes.stop_ratios(
                scene, camera, stop, passes.Sampling(SPP, seed), illuminant="D65", control=control, **optics
            )
            for seed in range(SEEDS)
        ]
        values.append([part.value for part in parts])
        variates.append([part.variate for part in parts])
    return np.array(values), np.array(variates)


def test_the_variate_has_no_mean(pictures):
    """Rationale: what has a mean would change the picture.

    Set-up: two textured boards, one slanted, 24 seeds; pixels on both and beside the edge. Expectation: means over rows
    and seeds are zero within their scatter, corrected for their number.
    """
    from scipy.stats import norm

    _, variate = pictures
    column = variate.mean(axis=2)  # [stop, seed, column, channel]
    z = column.mean(axis=1) / (column.std(axis=1, ddof=1) / np.sqrt(SEEDS) + 1e-30)
    p = 2 * norm.sf(np.abs(z[np.isfinite(z)]).max() * 0.9)  # 24 seeds: the tail of Student's t
    assert p * z.size > 1e-3


def test_the_variate_takes_out_most_of_the_noise(pictures):
    """Expectation: on one surface, green's standard deviation falls to less than half, at half of the pixels."""
    value, variate = pictures
    for stop in range(2):
        plain, less = (part[stop, :, :, :12, 1].std(axis=0, ddof=1) for part in (value, value - variate))
        assert np.median(less / plain) < 0.5


@pytest.mark.parametrize(("points", "limit"), [(2, 3e-3), (4, 6e-4)])
def test_fine_kernels_need_a_fine_grid(jit, picture, points, limit):
    """Set-up: a kernel as fine as lambda N = 0.4 px, over noise with a standard deviation of 0.1.

    Expectation: F is the integral, within ``limit`` with four points per pixel, and not with two.
    """
    sigma = 0.14

    def profiles(levels, radius):
        profile = np.exp(-0.5 * (radius / sigma) ** 2)[:, None, None] * np.eye(2)
        return np.broadcast_to(profile, (len(levels), len(radius), 2, 2))

    made = control_variate.control(picture, np.zeros(SIZE), 1.0, (0.0, 0.0), 1.0, profiles, points)
    steps = (np.arange(-100, 100) + 0.5) / 100 * 0.8
    x, y = np.meshgrid(steps, steps)
    kernel = np.exp(-0.5 * (np.hypot(x, y) / sigma) ** 2)
    pixel = (np.arange(4) + 0.5) / 4  # middles of the cells
    errors = []
    for row, column in ((4, 7), (6, 2), (8, 5)):
        for channel in range(2):
            places = [(column + px - x, row + py - y) for px in pixel for py in pixel]
            value = np.mean([_read(picture, *place, channel, kernel) for place in places])
            errors.append(made.expected[row * SIZE[1] + column, channel] - value)
    worst = np.abs(errors).max()
    assert worst < limit if points == 4 else worst > limit


@pytest.mark.parametrize("cells", [2, 4])
def test_gratings_keep_the_contrast_that_rays_read(jit, cells):
    """Rationale: contrast that F has too much of is a bias, which means over noise do not show.

    Set-up: gratings of a contrast of one, seven frequencies up to 0.8 cycles per pixel, under a smooth kernel
    (sigma 0.45 px).
    Expectation: F is the mean over the pixel's cells of the linear interpolation, blurred, within 0.05 %
    of the contrast.
    """
    sigma, margin = 0.45, 6

    def profiles(levels, radius):
        return np.broadcast_to(np.exp(-0.5 * (radius / sigma) ** 2)[:, None, None], (len(levels), len(radius), 1, 1))

    steps = (np.arange(-200, 200) + 0.5) / 100
    kernel = np.exp(-0.5 * (steps / sigma) ** 2)
    for frequency in (0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8):
        x = (np.arange((16 + 2 * margin) * cells) + 0.5) / cells - margin
        wave = np.broadcast_to(np.cos(2 * np.pi * frequency * x + 0.3), (len(x), len(x)))
        fine = Fine(cells, np.ascontiguousarray(wave[..., None], dtype=np.float32), margin)
        made = control_variate.control(fine, np.zeros((16, 16)), 1.0, (0.0, 0.0), 2.0, profiles, 2)
        at = 8 + (np.arange(cells) + 0.5)[:, None] / cells - steps
        read = np.interp(at, x, wave[0])
        expected = (read * kernel).sum() / kernel.sum() / cells
        assert made.expected.reshape(16, 16)[8, 8] == pytest.approx(expected, abs=5e-4)


def test_the_grid_is_as_fine_as_the_kernels_ask():
    """Expectation: two for the bundled cameras (lambda N of 0.68 px in the shortest light), none where four are few."""
    found = [
        control_variate.points_of(*each) for each in ((0.68, 4), (0.68, 2), (0.5, 4), (0.5, 2), (0.29, 4), (0.25, 4))
    ]
    assert found == [2, 2, 4, None, 4, None]


def test_kernels_over_wavelengths_take_out_the_noise_of_colour(jit, loaded, make_scene, lamp, monkeypatch):
    """Rationale: rings of single wavelengths give each ray another colour of the surface.

    Set-up: a wall of one colour, whose reflectance rises steeply in near-infrared, in focus, through the hole; rays
    with the kernels of single wavelengths, and with those averaged over nearby ones.

    Expectation: the averaged ones leave less than 0.7 of the standard deviation of infrared.
    """
    from dasim.render import passes
    from dasim.render.radial_blur import RadialBlur

    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 40)}
    scene = loaded(make_scene(wall | {"material": "cotton-green"}, lights=[lamp]))
    camera = cameras.refocused(cameras.cropped("da-mobile", 24, 16), 0.4)
    also, hole = cameras.load_camera("bayer-mobile"), camera.stops[1]
    sharp = passes.sharp_pass(scene, camera, passes.Sampling(32, 5), None, also, diffraction="wave", max_blur_px=2.0)
    control = passes.control_of(scene, camera, hole, sharp.fine, max_blur_px=2.0, field=None)
    optics = {"diffraction": "wave", "max_blur_px": 2.0, "field": None, "illuminant": "D65"}

    def noise() -> float:
        part = passes.stop_ratios(scene, camera, hole, passes.Sampling(16, 3), control=control, **optics).value[..., 3]
        return float(part.std() / part.mean())

    averaged = noise()
    monkeypatch.setattr(RadialBlur, "over_wavelengths", lambda self: self)
    assert averaged < 0.7 * noise()


@pytest.mark.slow
@pytest.mark.parametrize("behind", [0.0, 1.5])
def test_kernels_over_wavelengths_keep_the_contrast(jit, monkeypatch, behind):
    """Rationale: averaged kernels differ from those of single wavelengths, and the difference is added.

    Set-up: a Siemens star in focus, and with the focus 1.5 dioptres behind it; the mean of 16 pictures of 64 samples
    through the hole, less the control variate, with the averaged kernels and with those of single wavelengths.

    Expectation: the contrast, by regression of one mean on the other, differs by at most 0.1 % in every channel. It is
    measured to 0.02 %.
    """
    import dasim
    from dasim.render.radial_blur import RadialBlur
    from dasim.simulation import exact, rendering
    from dasim.simulation.simulate import prepare

    def silent(*_):
        pass

    camera = dasim.focused(dasim.cropped("da-mobile", 96, 72), "siemens-star")
    vergence = 1 / camera.lens.focus_distance_m - behind
    lens = camera.lens.model_copy(update={"focus_distance_m": 1 / vergence})
    view = prepare(dasim.load_scene("siemens-star"), camera.model_copy(update={"lens": lens}), None, None, silent)
    sharp = exact.sharp_pictures(view, rendering.Sampling(32, 0.25, 50.0, 0), silent)
    spp = np.full((1, 1), 64)

    def mean() -> np.ndarray:
        parts = [rendering.stop_picture(view, sharp, 1, sharp.field, spp, seed, silent) for seed in range(16)]
        return np.mean([part.value - part.variate for part in parts], axis=0)

    averaged = mean()
    monkeypatch.setattr(RadialBlur, "over_wavelengths", lambda self: self)
    plain = mean()
    contrast = plain - plain.mean(axis=(0, 1))
    error = ((averaged - plain) * contrast).sum(axis=(0, 1)) / (contrast**2).sum(axis=(0, 1))
    np.testing.assert_allclose(error, 0.0, atol=0.001)


@pytest.mark.slow
def test_points_keep_their_peak(jit, monkeypatch):
    """Rationale: averaged kernels raise the peak of a point's picture, whatever the control variate's factor is.

    Set-up: the small source of claim ``lens-errors`` through the hole, with the kernels of single wavelengths, and with
    averaged ones with and without what these lack.
    Expectation: what they lack brings the peak to within 1 % of that of single wavelengths; without it, the peak is
    more than 2 % off.
    """
    from dasim.render.radial_blur import RadialBlur
    from validation.claims.optics import lens_errors

    def peak() -> float:
        return lens_errors._peak(lens_errors._camera("hole"), "IR")

    averaged = peak()
    made = control_variate.control
    monkeypatch.setattr(control_variate, "control", lambda *args: dataclasses.replace(made(*args), lacking=None))
    lacking = peak()
    monkeypatch.setattr(control_variate, "control", lambda *args: None)
    monkeypatch.setattr(RadialBlur, "over_wavelengths", lambda self: self)
    single = peak()
    assert averaged == pytest.approx(single, rel=0.01)
    assert abs(lacking / single - 1) > 0.02


@pytest.mark.slow
@pytest.mark.parametrize("f_number", [1.4, 2.8])
def test_the_variate_of_a_fast_lens_has_no_mean(jit, f_number):
    """Set-up: a Siemens star in focus, lambda N of 0.34 and 0.68 px in the shortest light, 8 pictures of 32 samples.

    Expectation: z of the pixels' means as of Student's t of 7 degrees of freedom, 1.18; it was 4.9 at f/1.4.
    """
    import dasim
    from dasim.simulation import exact, rendering
    from dasim.simulation.simulate import prepare

    camera = dasim.cropped(dasim.load_camera("bayer-mobile"), 48, 36)
    lens = camera.lens.model_copy(update={"f_number": f_number, "focus_distance_m": 0.4})
    camera = camera.model_copy(update={"lens": lens})

    def silent(*_):
        pass

    view = prepare(dasim.load_scene("siemens-star"), camera, None, None, silent)
    sharp = exact.sharp_pictures(view, rendering.Sampling(32, 0.25, 50.0, 0), silent)
    assert sharp.controls[0] is not None
    spp = np.full((1, 1), 32)
    found = [rendering.stop_picture(view, sharp, 0, sharp.field, spp, seed, silent).variate for seed in range(100, 108)]
    z = np.mean(found, axis=0) / (np.std(found, axis=0, ddof=1) / np.sqrt(8))
    assert np.sqrt(np.nanmean(np.minimum(z, 30) ** 2)) < 1.3
