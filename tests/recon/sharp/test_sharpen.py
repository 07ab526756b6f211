"""Deconvolution: its shrinkage against brute force, its gain at a known blur, and what it must leave unchanged."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from recon import fourier
from recon.picture import infrared
from recon.settings import PAPER
from recon.sharp import deconvolution, layers, sharpen
from tests.support import recon_scenes

NOISE_E = 10.0
KERNEL_MISFIT = 0.06  # of the bank's 3 % in encircled energy, counted on both sides
SEAM_TILE_PX, SEAM_NOISE_SHARE = 64, 0.01  # it is 0.0002, and 0.4 where tiles continue with their mirror image
RIM_PX = 12
RIM_FACTOR = 1.5  # the rim's texture is another than the middle's, and half its blur lies outside the frame
EDGE_PX = 16
EDGE_FACTOR = 2.0  # what replacing the other side's light gains at least; it is 4.6


def test_deconvolved_levels_are_as_far_from_the_focus_on_both_sides():
    """Expectation: those of a bank of one side, and their mirror image as far as the other side goes, whose last level
    is among them.
    """
    near = layers.levels_of_nodes(29)
    for behind in (0, 1, 5, 9):
        signed = [node - behind for node in layers.levels_of_nodes(29 + behind, behind)]
        assert [node for node in signed if node >= 0] == near
        mirrored = [-node for node in signed if node < 0][::-1]
        assert mirrored == sorted({node for node in near if 0 < node <= behind} | ({behind} - {0}))


@pytest.mark.parametrize("levels", [2, 7, 8, 9, 10, 28, 29, 30])
def test_the_last_level_is_deconvolved(levels):
    for focus in (0, levels // 2):
        nodes = layers.levels_of_nodes(levels, focus)
        assert nodes[0] == 0 and nodes[-1] == levels - 1 and nodes == sorted(set(nodes)) and focus in nodes


def test_shrinkage_is_the_minimum():
    """The table of shrinkage agrees with a bounded scalar minimisation of |u|^0.8 + (u - v)^2 / 2."""
    table = deconvolution.shrink_table()
    step = deconvolution.TABLE_LIMIT / (len(table) - 1)
    for index in (0, 100, 180, 260, 700, 3000, len(table) - 1):
        v = index * step
        candidates = np.linspace(0, v + 1e-9, 4001)
        start = candidates[np.argmin(candidates**0.8 + (candidates - v) ** 2 / 2)]
        minimum = minimize_scalar(
            lambda u: abs(u) ** 0.8 + (u - v) ** 2 / 2,  # noqa: B023
            bounds=(max(start - 0.1, 0), start + 0.1),
            method="bounded",
            options={"xatol": 1e-7},
        )
        best = minimum.x if minimum.fun < v**2 / 2 else 0.0
        assert abs(table[index] - best) < 1e-3


def captured(level, photo="astronaut"):
    """A noisy picture of visible light without crosstalk and of infrared [h, w, 4], and the same without blur and
    noise.
    """
    margin = recon_scenes.MARGIN_PX
    shape = level.shape
    visible, near = recon_scenes.textures(shape[0] + 2 * margin, shape[1] + 2 * margin, photo)
    mean = 4000 * recon_scenes.blurred(visible, near, level, "D65")
    _, _, signal = recon_scenes.stop_kernels("D65")
    inner = slice(margin, -margin)
    sharp = 4000 * (signal[0] * visible[inner, inner] + signal[1] * near[inner, inner, None])
    noise = NOISE_E * np.random.default_rng(1).standard_normal(mean.shape)
    return infrared_free(mean + noise).astype(np.float32), infrared_free(sharp)


@cache
def separation():
    return infrared.separation(recon_scenes.da_mobile(512, 384), "D65", PAPER)


def infrared_free(image):
    return np.concatenate([image @ separation().T, image[..., 3:]], axis=-1)


@cache
def kernels():
    bank = recon_scenes.bank()
    return sharpen.visible_kernels(bank.kernel[0], bank.signature[0], separation())


def sharpened(image, level, passes=sharpen.PASSES, tile_px=layers.TILE_PX):
    numbers = {"steps": PAPER.sharpen_steps, "strength": PAPER.sharpen_strength, "passes": passes, "tile_px": tile_px}
    sharp = sharpen.sharpen(np.moveaxis(image, -1, 0), level, kernels(), np.full(4, NOISE_E), **numbers)
    return np.moveaxis(sharp[sharpen.COLOURS], 0, -1)


def decibel(image, truth):
    return -10 * np.log10(np.mean((image - truth)[8:-8, 8:-8] ** 2))


def test_kernels_without_infrared_are_those_of_the_open_stop_alone():
    """White through both stops less the share of infrared has the kernels of the open stop, which are computed
    separately.
    """
    levels, alone, _ = recon_scenes.stop_kernels("D65")
    for level in (4, 10):
        mine = kernels()[level, 1]
        exact = alone[0, int(np.flatnonzero(levels == level)[0]), 1]
        half = mine.shape[-1] // 2
        middle = exact.shape[-1] // 2
        if half < middle:
            exact = exact[middle - half : middle + half + 1, middle - half : middle + half + 1]
        part = slice(half - middle, half + middle + 1) if half > middle else slice(None)
        assert np.abs(mine[part, part] - exact).sum() < KERNEL_MISFIT


def test_a_known_blur_is_undone():
    """At a blur of 4 to 8 px and a noise of 10 electrons, green gains at least 2.5 dB and every channel gains."""
    for level_value in (2.0, 3.5, 4.5):
        level = np.full((192, 256), level_value, np.float32)
        image, truth = captured(level)
        result = sharpened(image, level)
        gain = [decibel(result[..., c], truth[..., c]) - decibel(image[..., c], truth[..., c]) for c in range(3)]
        assert gain[1] > 2.5 and min(gain) > 0, (level_value, gain)


def test_infrared_tells_the_colours_where_edges_are():
    """On texture that colours and infrared share in part, the prior centred on the gradients of infrared is better than
    the paper's, centred on zero.
    """
    level = np.full((192, 256), 5.0, np.float32)
    image, truth = captured(level)
    guided, plain = (sharpened(image, level, passes) for passes in (sharpen.PASSES, sharpen.PLAIN_PASSES))
    assert decibel(guided[..., 1], truth[..., 1]) > decibel(plain[..., 1], truth[..., 1]) + 0.3


def test_layers_gain_on_both_sides_of_a_step():
    """Set-up: two depths. Expectation: away from the step, both sides are sharper than captured."""
    level = np.where(np.arange(256) < 128, 3.0, 14.0)[None, :].repeat(192, 0).astype(np.float32)
    image, truth = captured(level)
    result = sharpened(image, level)
    for part in (slice(8, 118), slice(138, 248)):
        before = decibel(image[:, part, 1], truth[:, part, 1])
        assert decibel(result[:, part, 1], truth[:, part, 1]) > before + 1


def test_a_flat_picture_stays_flat():
    """Kernels have unit sum, so that a constant is unchanged by deconvolution, up to float32 rounding."""
    level = np.linspace(0, 28, 128, dtype=np.float32)[None, :].repeat(96, 0)
    image = np.full((96, 128, 4), 1000, np.float32)
    np.testing.assert_allclose(sharpened(image, level), 1000, rtol=1e-4)


@cache
def slanted_picture():
    """Levels 4 to 6 and their picture."""
    level = np.linspace(4, 6, 320, dtype=np.float32)[None, :].repeat(256, 0)
    return level, captured(level)[0]


def seams():
    """Root mean square difference between tiles and one tile, in units of the noise."""
    level, image = slanted_picture()
    apart = sharpened(image, level, tile_px=SEAM_TILE_PX) - sharpened(image, level, tile_px=level.shape[1])
    return np.sqrt(np.mean(apart**2)) / NOISE_E


def test_tiles_leave_no_seams(monkeypatch):
    """Set-up: levels 4 to 6 in tiles of 64 px and in one. Expectation: they differ by a small part of the noise, which
    they do not where tiles know nothing of the picture around them.
    """
    assert seams() < SEAM_NOISE_SHARE
    cut_blended = fourier.cut_blended

    def alone(image, box, shape):
        inner = [slice(max(part.start + layers.MARGIN_PX, 0), part.stop - layers.MARGIN_PX) for part in box]
        moved = [slice(part.start - own.start, part.stop - own.start) for part, own in zip(box, inner, strict=True)]
        return cut_blended(image[..., *inner], moved, shape)

    monkeypatch.setattr(fourier, "cut_blended", alone)
    assert seams() > 10 * SEAM_NOISE_SHARE


@pytest.mark.parametrize("level", [0.0, 5.0, 14.0])
def test_linear_deconvolution_is_the_same_in_tiles(level, monkeypatch):
    """Set-up: one level, in tiles of 96 px and in one. Expectation: they differ by rounding, which they do not where
    filters reach farther than the margin.
    """
    levels = np.full((256, 320), level, np.float32)
    image = np.moveaxis(captured(levels)[0], -1, 0)

    def apart():
        noise_e = np.full(4, NOISE_E)
        tiles, whole = (sharpen.linear(image, levels, kernels(), noise_e, tile_px=size) for size in (96, 320))
        return np.abs(tiles - whole).max() / NOISE_E

    assert apart() < 1e-3
    parts = layers.parts

    def near(position, tile_px, margin_px, strip_px):
        return parts(position, tile_px, margin_px // 4, strip_px)

    monkeypatch.setattr(layers, "parts", near)
    assert apart() > 1e-2


def test_linear_deconvolution_inverts_the_blur_at_every_frequency_that_it_passes():
    """Set-up: a grating of 12 px at level 5 without noise. Expectation: it comes back with 0.8 to 1.05 of its contrast,
    of which the picture has less than 0.6; the mean is kept.
    """
    grating = 1000 + 300 * np.cos(2 * np.pi * np.arange(384) / 12)
    sharp = np.broadcast_to(grating, (4, 288, 384)).astype(np.float32)
    blurred = np.stack(
        [
            np.asarray(fourier.inverse(fourier.forward(p) * fourier.transfer(k, p.shape), p.shape))
            for p, k in zip(sharp, kernels()[5], strict=True)
        ]
    ).astype(np.float32)
    found = sharpen.linear(blurred, np.full((288, 384), 5.0, np.float32), kernels(), np.full(4, NOISE_E))
    inner = np.s_[:3, 96:-96, 96:-96]
    contrast = [image[inner].std() / sharp[inner].std() for image in (blurred, found)]
    assert contrast[0] < 0.6 and 0.8 < contrast[1] < 1.05, contrast
    np.testing.assert_allclose(found[inner].mean(), 1000, rtol=1e-3)


@pytest.mark.parametrize("tile_px", [24, 64, 200])
def test_shares_of_all_parts_are_one(tile_px):
    """Set-up: levels in speckles, tiles smaller than the strips in which they are blended, and larger ones."""
    position = np.random.default_rng(5).random((97, 130)).astype(np.float32) ** 4 * 6
    total = np.zeros(position.shape)
    for part in layers.parts(position, tile_px):
        total[part.core] += part.share(position)
        assert part.inner[0].stop - part.inner[0].start == part.core[0].stop - part.core[0].start
        assert all(side % 4 == 0 for side in (*part.shape, *(span.start for span in part.box)))
    np.testing.assert_allclose(total, 1, atol=1e-5)


def test_transfer_of_a_kernel_is_its_dft():
    """The DFT written as sums agrees with the FFT of the padded and rolled kernel."""
    kernel = np.random.default_rng(0).random((9, 9))
    padded = np.zeros((32, 40))
    padded[:9, :9] = kernel
    reference = np.fft.rfft2(np.roll(padded, (-4, -4), (0, 1)))
    np.testing.assert_allclose(fourier.transfer(kernel, (32, 40)), reference, atol=1e-4)


@pytest.mark.parametrize("phase", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_deconvolution_of_samples_is_the_least_squares_solution(phase):
    """One iteration on small gradients, all of them shrunk to 0, solves the dense linear system of blur, sampling and
    differences.
    """
    generator = np.random.default_rng(2)
    picture = (5 + generator.standard_normal((1, 8, 12))).astype(np.float32)
    kernel = generator.random((3, 3)).astype(np.float32)
    kernel /= kernel.sum()
    kappa = 3.0
    transfer = fourier.transfer(kernel[None], (8, 12))
    solution = deconvolution.half_quadratic_samples(
        picture, [phase], transfer, deconvolution.Prior(np.array([kappa])), 1
    )
    pixels = np.eye(96).reshape(96, 8, 12)
    shifts = [(dy, dx, kernel[dy + 1, dx + 1]) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    blur = sum(w * np.roll(pixels, (dy, dx), (1, 2)) for dy, dx, w in shifts)
    sampled = blur[:, phase[0] :: 2, phase[1] :: 2].reshape(96, -1).T
    steps = [(np.roll(pixels, -1, axis) - pixels).reshape(96, -1).T for axis in (1, 2)]
    beta = deconvolution.BETA_FIRST * kappa
    system = np.concatenate([sampled, *(np.sqrt(beta) * step for step in steps)])
    data = np.concatenate([picture[0, phase[0] :: 2, phase[1] :: 2].ravel(), np.zeros(192)])
    exact = np.linalg.lstsq(system, data)[0].reshape(8, 12)
    np.testing.assert_allclose(solution[0], exact, atol=2e-4)


def test_a_cache_that_another_thread_empties_changes_no_digit(monkeypatch):
    """Set-up: the phasors come from the cache, and from no cache, as when another thread drops them from it meanwhile;
    the arrays are large enough (256 KiB) for NumPy to reuse their memory. Expectation: the same bytes.
    """
    shape = (256, 320)
    generator = np.random.default_rng(4)
    picture = (5 + generator.standard_normal((1, *shape))).astype(np.float32)
    transfer = fourier.transfer(generator.random((1, 5, 5)).astype(np.float32) / 25, shape).astype(np.complex64)

    def solution():
        prior = deconvolution.Prior(np.array([3.0]))
        return deconvolution.half_quadratic_samples(picture, [(0, 1)], transfer, prior, 2)

    held = solution()
    monkeypatch.setattr(deconvolution, "_phase_factors", deconvolution._phase_factors.__wrapped__)
    np.testing.assert_array_equal(solution(), held)


def rim_and_middle(level_value):
    """Root mean square errors (rim, middle) of a picture that is bright on one side and dark on the other."""
    level = np.full((160, 224), level_value, np.float32)
    image, truth = captured(level)
    ramp = np.linspace(0.3, 1.5, 224, dtype=np.float32)[:, None]
    result = sharpened(image * ramp, level) - (truth * ramp)[..., :3]
    rim = np.ones(level.shape, bool)
    rim[RIM_PX:-RIM_PX, RIM_PX:-RIM_PX] = False
    return np.sqrt(np.mean(result[rim] ** 2)), np.sqrt(np.mean(result[~rim] ** 2))


def test_no_ringing_at_the_frames_border(monkeypatch):
    """The rim is about as accurate as the middle; with periodic borders, where bright meets dark, it is not."""
    rim, middle = rim_and_middle(6.0)
    assert rim < RIM_FACTOR * middle
    monkeypatch.setattr(fourier, "cut_blended", periodic)
    rim, middle = rim_and_middle(6.0)
    assert rim > RIM_FACTOR * middle


def periodic(image, box, shape):
    places = [
        np.arange(part.start, part.start + n) % m for part, n, m in zip(box, shape, image.shape[-2:], strict=True)
    ]
    return np.ascontiguousarray(image[..., places[0][:, None], places[1]], np.float32)


def edge_error():
    """Root mean square errors on both sides of a depth step, of the deconvolved picture and of the capture."""
    level = np.where(np.arange(224) < 112, 2.0, 12.0)[None, :].repeat(160, 0).astype(np.float32)
    image, truth = captured(level)
    near = (slice(16, -16), slice(112 - EDGE_PX, 112 + EDGE_PX))
    before, after = (a[near][..., :3] - truth[near][..., :3] for a in (image, sharpened(image, level)))
    return np.sqrt(np.mean(after**2)), np.sqrt(np.mean(before**2))


def test_no_ringing_at_depth_edges(monkeypatch):
    """Across a step of ten levels the picture gains; it rings if each layer keeps the other side of the step as
    captured.
    """
    after, before = edge_error()
    assert after < before
    monkeypatch.setattr(layers, "FEATHER_LEVELS", 1e6)
    ringing, _ = edge_error()
    assert ringing > EDGE_FACTOR * after
