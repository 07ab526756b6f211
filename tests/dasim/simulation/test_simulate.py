"""The whole chain: capture and truth fit each other, the sensor's noise on top, provenance, odd scenes."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.ndimage import convolve

import dasim
from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import noise
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.noise import Exposure
from dasim.camera.specification import Camera
from dasim.simulation.checks import diffraction_model
from dasim.simulation.simulate import simulate
from dasim.spectra.grid import CHANNELS

RENDER_NOISE = 0.02  # 36 samples per pixel on smooth surfaces under a dome: below 1 %
RAW_LIMIT = 0.12  # 3,072 pixels: a variance is known to 2.6 %
SEEDS = 8  # pictures of a camera: 14 degrees of freedom for the difference of two means
T_BEYOND_4 = 1.3e-3  # share of Student's t with 14 degrees of freedom beyond 4
DOME = {"kind": "dome", "illuminant": "D55", "lux": 400.0}


@pytest.fixture(scope="module")
def scene(make_scene, lamp):
    """A wall in focus, a card in front of its left half."""
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 40), "material": "sand"}
    card = {"name": "card", "shape": "plane", "size_cm": (6, 20), "position_cm": (-3, 0, 20), "material": "leaf-green"}
    return make_scene(wall, card, lights=[DOME, lamp])


@pytest.fixture(scope="module")
def shot(renderer, scene, da_mobile):
    return simulate(scene, cameras.cropped(da_mobile, 64, 48), seed=3, spp=36, diffraction="off")


def collected_e(truth, camera):
    """Mean electrons that the pixels collect, [h, w], after crosstalk between them."""
    return electronic_crosstalk(noise.mosaic(truth.mean_e.astype(float), camera), camera)


def test_lens_and_pinhole_pictures_are_registered(shot):
    """Expectation: away from the edge both have the same electrons in all channels; at the edge the lens's is blurred
    but the step stands at the same place: columns 31 and 32 lie on either side of the half height.
    """
    mean, sharp = shot.truth.mean_e, shot.truth.sharp_e
    even = ~shot.truth.boundary
    assert even[:, :8].all() and even[:, -8:].all()
    for part in (np.s_[:, :8], np.s_[:, -8:]):
        np.testing.assert_allclose(mean[part].mean(axis=(0, 1)), sharp[part].mean(axis=(0, 1)), rtol=RENDER_NOISE)
    green = sharp[..., 1].mean(axis=0)
    assert np.argmax(np.abs(np.diff(green))) == 31
    blurred = mean[..., 1].mean(axis=0)
    half = (blurred[:8].mean() + blurred[-8:].mean()) / 2
    assert (blurred[29] - half) * (blurred[34] - half) < 0
    assert np.abs(np.diff(blurred)).max() < 0.5 * np.abs(np.diff(green)).max(), "the lens blurs the near card's edge"


@pytest.mark.slow
def test_window_shows_what_the_frame_shows_there(jit, make_scene, da_mobile):
    """Set-up: a lens of 0.4 mm, so that 48 x 36 pixels reach 8 degrees off the axis; a card before a wall with its edge
    through the window, both out of focus; 8 seeds each, fixed exposure, the window in the frame's corner.

    Expectation: mean electrons pixel by pixel by Welch's t, as for two renderers in test_passes (t^2 below 1.5 in the
    mean, few beyond 4), the channels' sums within five standard deviations; depth is the same.
    """
    data = da_mobile.model_dump()
    data["lens"] |= {"focal_length_mm": 0.4, "focus_distance_m": 0.01}
    data["sensor"] |= {"width_px": 48, "height_px": 36}
    whole = parse(Camera, data, "short lens")
    window = cameras.cropped(whole, 20, 16, at_px=(28, 20))
    wall = {"name": "wall", "shape": "plane", "size_cm": (9, 9), "position_cm": (0, 0, 2), "material": "sand"}
    card = {
        "name": "card",
        "shape": "plane",
        "size_cm": (0.06, 9),
        "position_cm": (0, 0, 0.5),
        "material": "leaf-green",
    }
    scene, exposure = make_scene(wall, card, lights=[DOME]), Exposure(time_s=1.0)

    def pictures(camera):
        shots = [simulate(scene, camera, seed, spp=32, exposure=exposure).truth for seed in range(SEEDS)]
        return np.stack([truth.mean_e for truth in shots]).astype(float), shots[0].depth_m

    (ours, depth_m), (full, full_depth_m) = pictures(window), pictures(whole)
    full, full_depth_m = full[:, 20:, 28:], full_depth_m[20:, 28:]
    np.testing.assert_allclose(depth_m, full_depth_m, rtol=1e-5)
    assert 0.2 < (depth_m < 0.01).mean() < 0.8
    variance = (ours.var(axis=0, ddof=1) + full.var(axis=0, ddof=1)) / SEEDS
    difference = ours.mean(axis=0) - full.mean(axis=0)
    t = difference / np.sqrt(variance)
    assert np.mean(t**2) < 1.5
    assert np.mean(np.abs(t) > 4) < 5 * T_BEYOND_4
    assert (np.abs(difference.sum(axis=(0, 1))) < 5 * np.sqrt(variance.sum(axis=(0, 1)))).all()


def test_truth_is_whole_and_consistent(shot, da_mobile):
    truth = shot.truth
    for name in ("depth_m", "normal", "blur_px", "level", "mean_e", "mean_e_variance", "sharp_e", "focus_e"):
        assert np.isfinite(getattr(truth, name)).all(), name
    assert truth.valid.all()
    assert (truth.object_id[:, :32] == 2).all() and (truth.object_id[:, 32:] == 1).all()
    np.testing.assert_allclose(truth.depth_m[:, :32], 0.2, rtol=1e-5)
    np.testing.assert_allclose(truth.depth_m[:, 32:], 0.4, rtol=1e-5)
    np.testing.assert_allclose(truth.level, (1 - 0.46) * truth.blur_px, rtol=1e-5, atol=1e-5)
    assert (truth.mean_e >= 0).all() and (truth.sharp_e >= 0).all()


def test_raw_numbers_scatter_around_the_mean_as_the_sensor_says(shot):
    """Set-up: each pixel's number against the mean electrons that it collects.

    Expectation: standardised by shot, dark, read, pattern and rounding noise, mean 0 and variance 1.
    """
    camera = shot.capture.camera
    mean = collected_e(shot.truth, camera)
    step = 6000 / 959
    electrons = (shot.capture.raw_dn.astype(float) - 64) * step
    dark = 10.0 * shot.capture.exposure_s
    sigma = np.sqrt(mean + dark + 3.0**2 + 2.0**2 + (0.01 * mean) ** 2 + step**2 / 12)
    z = (electrons - mean - dark) / sigma
    assert abs(z.mean()) < 5 / np.sqrt(z.size)
    assert z.var() == pytest.approx(1.0, abs=RAW_LIMIT)
    top = max(np.percentile(mean[cameras.mosaic_channels(camera) == c], 99.5) for c in range(4))
    assert top == pytest.approx(0.85 * 6000, rel=1e-3), "automatic exposure"


def test_leaf_is_bright_in_the_near_infrared(shot):
    """Expectation: sand reflects more red than a leaf does, the leaf at least as much near-infrared as red (its 0.45
    against 0.04): the camera sees vegetation as vegetation.
    """
    leaf, sand = shot.truth.sharp_e[:, :30].mean(axis=(0, 1)), shot.truth.sharp_e[:, 34:].mean(axis=(0, 1))
    relative = leaf / sand
    red, green, blue, infrared = (relative[CHANNELS.index(name)] for name in CHANNELS)
    assert infrared > 1.5 * max(red, green, blue) and green < 0.8


def test_capture_says_where_it_comes_from(shot, renderer):
    capture = shot.capture
    assert capture.seed == 3 and capture.illuminant == "D65" and capture.gain == 1.0
    assert capture.raw_dn.shape == (48, 64) and capture.raw_dn.dtype == np.uint16
    about = capture.provenance
    assert about["renderer"] == renderer and about["diffraction"] == "off" and about["spp"] == 36
    assert [item["name"] for item in about["scene"]["objects"]] == ["wall", "card"]
    assert about["saturated_pixels"] == np.count_nonzero(capture.raw_dn == 1023)
    assert "folder" not in about["scene"], "no path of this computer in a data set"


def test_same_seed_same_bytes(scene, da_mobile, renderer):
    """Expectation: all of capture and truth; another seed changes raw numbers and rendering noise, not geometry."""
    camera = cameras.cropped(da_mobile, 16, 12)
    first, again, other = (
        simulate(scene, camera, seed=seed, spp=4, diffraction="off", exposure=Exposure(time_s=0.02))
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.capture.raw_dn, again.capture.raw_dn)
    np.testing.assert_array_equal(first.truth.mean_e, again.truth.mean_e)
    np.testing.assert_array_equal(first.truth.sharp_e, again.truth.sharp_e)
    assert (first.capture.raw_dn != other.capture.raw_dn).any()
    assert (first.truth.mean_e != other.truth.mean_e).any()
    np.testing.assert_array_equal(first.truth.depth_m, other.truth.depth_m)


def test_electrons_follow_time_and_numbers_follow_gain(scene, da_mobile, renderer):
    camera = cameras.cropped(da_mobile, 16, 12)

    def photograph(time_s, gain):
        exposure = Exposure(time_s=time_s, gain=gain)
        return simulate(scene, camera, spp=16, diffraction="off", exposure=exposure)

    short, long, gained = photograph(0.002, 1.0), photograph(0.004, 1.0), photograph(0.002, 4.0)
    np.testing.assert_allclose(long.truth.mean_e, 2 * short.truth.mean_e, rtol=1e-6)
    np.testing.assert_array_equal(gained.truth.mean_e, short.truth.mean_e)
    ratio = (gained.capture.raw_dn - 64.0).mean() / (short.capture.raw_dn - 64.0).mean()
    signal = float(noise.mosaic(short.truth.mean_e, camera).mean())
    assert ratio == pytest.approx(4.0, rel=5 * np.sqrt(2 / signal / 192) + 0.01)


def test_rounding_does_not_depend_on_the_light_level(scene, da_mobile, renderer):
    """Expectation: a seventh of the light gives a seventh of the electrons, but for the 22 bits to which they are
    rounded, in all three pictures. Rendered at their own levels, electrons differ by up to 4e-5.
    """
    camera, factor = cameras.cropped(da_mobile, 96, 72), 1 / 7
    dim = tuple(light.model_copy(update={"lux": light.lux * factor}) for light in scene.lights)
    bright, dark = (
        simulate(each, camera, 5, spp=16, exposure=Exposure(time_s=0.01)).truth
        for each in (scene, scene.model_copy(update={"lights": dim}))
    )
    for name in ("mean_e", "sharp_e", "focus_e"):
        ours, theirs = (getattr(truth, name).astype(float) for truth in (bright, dark))
        np.testing.assert_allclose(theirs, ours * factor, rtol=6e-7, err_msg=name)


def test_a_point_of_light_is_rendered(jit):
    """Rationale: the scene ``point`` has 4e7 times the radiance of a surface in its light, and black around it.

    Expectation: finite numbers, and all but a tenth of the green light within 4 px of the middle of the frame. (The
    scene needs many samples, and how much light there is takes more than these.)
    """
    scene = dasim.load_scene("point")
    mean = dasim.simulate(scene, dasim.focused(dasim.cropped("da-mobile", 48, 32), scene), spp=8).truth.mean_e
    assert np.isfinite(mean).all()
    green = mean[..., 1]
    assert green[12:20, 20:28].sum() > 0.9 * green.sum() > 0


def test_camera_that_looks_at_nothing_is_refused(make_scene, da_mobile, lamp, renderer):
    """Set-up: a ball beside the view. Expectation: one line that names the scene, before anything is rendered."""
    ball = {"name": "ball", "shape": "sphere", "radius_cm": 1, "position_cm": (30, 0, 30), "material": "brick"}
    stages = []
    with pytest.raises(InputError, match="scene 'test': the camera looks at nothing"):
        simulate(
            make_scene(ball, lights=[lamp]),
            cameras.cropped(da_mobile, 16, 12),
            spp=4,
            progress=lambda stage, share: stages.append(stage),
        )
    assert set(stages) == {"geometry"}


@pytest.mark.slow
def test_default_model_of_diffraction_spreads_light_and_keeps_it(make_scene, da_mobile, lamp, renderer):
    """Rationale: the default is wave-true in JIT variants, Airy in scalar_spectral; both conserve light.

    Set-up: a sheet with its edge in focus in the frame's middle. Expectation: the near-infrared's edge is wider than
    green's (2.7 against 0.9 px), far from it the electrons are those without diffraction.
    """
    sheet = {"name": "sheet", "shape": "plane", "size_cm": (40, 40), "position_cm": (-20, 0, 40), "material": "sand"}
    scene, camera = make_scene(sheet, lights=[lamp]), cameras.cropped(da_mobile, 48, 16)
    shot = simulate(scene, camera, spp=64, exposure=Exposure(time_s=0.01))
    assert shot.capture.provenance["diffraction"] == ("airy" if renderer.startswith("scalar") else "wave")
    rows = shot.truth.mean_e.mean(axis=0)
    np.testing.assert_allclose(rows[:6].mean(axis=0), shot.truth.sharp_e[:, :6].mean(axis=(0, 1)), rtol=0.03)
    relative = rows / rows[:6].mean(axis=0)
    green, infrared = relative[:, 1], relative[:, 3]
    assert infrared[25] > 2 * green[25] > 0, "a pixel and a half beyond the edge"
    assert np.isfinite(shot.truth.mean_e).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"spp": 0}, "spp is 0"),
        ({"spp": 2.5}, r"spp is 2\.5; it must be a whole number"),
        ({"spp": True}, "spp is True"),
        ({"spp": None}, "spp is None"),
        ({"spp": float("nan")}, "spp is nan"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 1.5}, r"seed is 1\.5; it must be 0 or"),
        ({"seed": None}, "seed is None"),
        ({"exposure": 0.01}, r"must be a dasim\.Exposure, not .*Exposure\(time_s"),
        ({"variant": "llvm_rgb"}, "variant 'llvm_rgb' is unknown"),
        ({"diffraction": "fourier"}, "diffraction 'fourier' is unknown; allowed are .*off"),
    ],
)
def test_mistakes_are_named(scene, da_mobile, renderer, change, message):
    with pytest.raises(InputError, match=message):
        simulate(scene, cameras.cropped(da_mobile, 16, 12), **change)


def test_each_variant_has_its_models_of_diffraction():
    assert diffraction_model(None, "llvm_ad_spectral") == "wave"
    assert diffraction_model(None, "scalar_spectral") == "airy"
    assert diffraction_model("off", "cuda_ad_spectral") == "off"
    for name, variant in (("airy", "llvm_ad_spectral"), ("wave", "scalar_spectral")):
        with pytest.raises(InputError, match=f"diffraction '{name}' is not available in {variant}"):
            diffraction_model(name, variant)


def test_crosstalk_reaches_the_raw_numbers_and_not_the_truth(shot, scene):
    """Set-up: the same photograph with 8 % to each neighbour, without noise of its own and with many bits.

    Expectation: the truth is what the lens sees, as before; the raw numbers scatter about the mean blurred by
    0, c, 0 / c, 1 - 4 c, c / 0, c, 0 with the nearest pixel beyond the border, as shot noise does.
    """
    changes = {"electronic_crosstalk": 0.08, "read_noise_e": 0, "dsnu_e": 0, "prnu": 0, "dark_current_e_s": 0}
    camera = shot.capture.camera
    leaky = camera.model_copy(update={"sensor": camera.sensor.model_copy(update={**changes, "adc_bits": 16})})
    time = Exposure(time_s=shot.capture.exposure_s)
    leaky_shot = simulate(scene, leaky, seed=3, spp=36, diffraction="off", exposure=time)
    np.testing.assert_array_equal(leaky_shot.truth.mean_e, shot.truth.mean_e)
    kernel = [[0, 0.08, 0], [0.08, 1 - 4 * 0.08, 0.08], [0, 0.08, 0]]
    mean = convolve(noise.mosaic(leaky_shot.truth.mean_e.astype(float), camera), kernel, mode="nearest")
    electrons = (leaky_shot.capture.raw_dn.astype(float) - 64) * 6000 / (65535 - 64)
    z = ((electrons - mean) / np.sqrt(mean))[mean < 5500]
    assert abs(z.mean()) < 5 / np.sqrt(z.size)
    assert z.var() == pytest.approx(1.0, abs=RAW_LIMIT)


def test_auto_renders_without_llvm():
    """Rationale: the stock plugins of ``scalar_spectral`` take as many samples in all pixels; ``auto`` asked them for
    samples by pixel, and failed.

    Expectation: in a process of its own, the target is met, with whole numbers of samples.
    """
    code = (
        "import dasim; camera = dasim.cropped(dasim.load_camera('da-mobile'), 24, 16);"
        "shot = dasim.simulate('desk', camera, spp='auto', noise_share=0.6, variant='scalar_spectral');"
        "about = shot.capture.provenance; assert about['renderer'] == 'scalar_spectral';"
        "assert max(about['rendering_noise_share_reached'].values()) <= 0.6, about;"
        "assert all(count % 1 == 0 for count in about['spp'].values()), about"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)


@pytest.mark.slow
def test_auto_takes_as_many_samples_as_the_sensor_needs(renderer, scene, da_mobile):
    """Expectation: the share of noise reached is stated for every channel, and is below what was asked."""
    camera = cameras.cropped(da_mobile, 32, 24)
    auto = simulate(scene, camera, seed=1, spp="auto", noise_share=0.5, diffraction="off")
    about = auto.capture.provenance
    assert set(about["rendering_noise_share"]) == {"50", "95", "99.5"}
    assert all(set(shares) == set(CHANNELS) for shares in about["rendering_noise_share"].values())
    assert set(about["spp"]) == {stop.name for stop in camera.stops} and min(about["spp"].values()) >= 32
    assert max(about["rendering_noise_share_reached"].values()) <= about["rendering_noise_share_wanted"] == 0.5
    assert about["rendering_noise_at"] == 50
    again = simulate(scene, camera, seed=1, spp="auto", noise_share=0.5, diffraction="off")
    np.testing.assert_array_equal(auto.capture.raw_dn, again.capture.raw_dn)
    with pytest.raises(InputError, match="'auto'"):
        simulate(scene, camera, spp="many")
    with pytest.raises(InputError, match="noise_share"):
        simulate(scene, camera, spp="auto", noise_share=0.0)
    with pytest.raises(InputError, match=r"noise_at is 100; a percentile of the pixels of 1 to 99\.9"):
        simulate(scene, camera, spp="auto", noise_at=100)


def test_a_given_number_of_samples_states_its_noise_and_warns(scene, da_mobile, renderer):
    """Expectation: shares by percentile and channel, as the map says; one line where they exceed a half, none where
    the sensor is loud; one sample cannot tell.
    """
    camera = cameras.cropped(da_mobile, 32, 24)
    few = simulate(scene, camera, spp=4, diffraction="off")
    about, truth = few.capture.provenance, few.truth
    sensor = noise.temporal_variance(camera.sensor, few.capture.exposure_s).at(truth.mean_e)
    ratio = np.sqrt(truth.mean_e_variance / sensor)
    for at, shares in about["rendering_noise_share"].items():
        np.testing.assert_allclose(list(shares.values()), np.percentile(ratio, float(at), axis=(0, 1)), rtol=1e-4)
    (note,) = [note for note in about["notes"] if "exceeds half" in note]
    assert "\n" not in note and "noise_at 95" in note and "4 samples" in note
    loud = camera.model_copy(update={"sensor": camera.sensor.model_copy(update={"read_noise_e": 2000.0})})
    quiet = simulate(scene, loud, spp=4, diffraction="off")
    assert not [note for note in quiet.capture.provenance["notes"] if "exceeds half" in note]
    one = simulate(scene, camera, spp=1, diffraction="off")
    assert "rendering_noise_share" not in one.capture.provenance
    if not renderer.startswith("scalar"):
        assert one.truth.mean_e_variance is None


@pytest.mark.slow
def test_an_independent_mean_shares_no_rendering_noise_with_the_raw_picture(scene, da_mobile, renderer):
    """Rationale: a denoiser that is trained on raw and ``mean_e`` must not learn to keep rendering noise.

    Set-up: few samples and no sensor noise, so that raw less the truth is rendering noise; the truth is ``mean_e`` of
    1,024 samples. Expectation: ``mean_e`` that shares samples has the error of raw; that of its own samples has an
    error of the same size and no correlation with it. All else is the same, byte for byte.
    """
    camera = cameras.cropped(da_mobile, 64, 48)
    changes = {"read_noise_e": 0, "dsnu_e": 0, "prnu": 0, "dark_current_e_s": 0, "adc_bits": 16}
    camera = camera.model_copy(update={"sensor": camera.sensor.model_copy(update=changes)})

    def silent(mean_e, sensor, time_s, seed, gain):
        return np.rint(mean_e * 8).astype(np.uint16), 0

    def shot(spp, seed, **options):
        exposure = Exposure(time_s=0.01)
        return simulate(scene, camera, seed, spp=spp, diffraction="off", noise=silent, exposure=exposure, **options)

    exact = collected_e(shot(1024, 9).truth, camera)
    shared, own = shot(4, 3), shot(4, 3, independent_mean=True)
    np.testing.assert_array_equal(own.capture.raw_dn, shared.capture.raw_dn)
    np.testing.assert_array_equal(own.truth.sharp_e, shared.truth.sharp_e)
    assert own.capture.provenance["independent_mean"] and not shared.capture.provenance["independent_mean"]
    errors = [own.capture.raw_dn / 8 - exact]
    errors += [collected_e(each.truth, camera) - exact for each in (shared, own)]
    correlation = np.corrcoef([error.ravel() for error in errors])[0]
    assert correlation[1] > 0.99 and abs(correlation[2]) < 4 / np.sqrt(errors[0].size)
    assert errors[2].std() == pytest.approx(errors[1].std(), rel=0.15)


def test_a_noise_model_of_ones_own_makes_the_raw_picture(renderer, scene, da_mobile, shot):
    """Expectation: the model's numbers are the capture's, its name stands in the provenance, the rest is the same."""

    def model(mean_e, sensor, time_s, seed, gain):
        return (np.rint(mean_e / 10) + 64).astype(np.uint16), 5

    camera = cameras.cropped(da_mobile, 64, 48)
    users_shot = simulate(scene, camera, seed=3, spp=36, diffraction="off", noise=model)
    mean = collected_e(users_shot.truth, camera)
    np.testing.assert_allclose(users_shot.capture.raw_dn, mean / 10 + 64, atol=0.51)
    assert users_shot.capture.provenance["saturated_pixels"] == 5
    assert users_shot.capture.provenance["noise"].endswith("makes_the_raw_picture.<locals>.model")
    assert shot.capture.provenance["noise"] == "dasim.camera.noise:expose"
    np.testing.assert_array_equal(users_shot.truth.mean_e, shot.truth.mean_e)
