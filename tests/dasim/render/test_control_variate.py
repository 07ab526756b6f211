"""The control variate: F against a direct integral, no bias whatever the picture, and less noise."""

from __future__ import annotations

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
    Expectation: F of a pixel is the integral over kernel and pixel of the picture, linear between its nodes (sums over
    fine grids), within ``limit`` of a mean of 0.6.
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
    pixel = (np.arange(8) + 0.5) / 8
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
