"""Exposing a kept shot again: what a rendering with the other values gives, byte for byte where it can be."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.camera import noise
from dasim.camera import specification as cameras
from dasim.camera.crosstalk import electronic_crosstalk
from dasim.camera.noise import Exposure
from dasim.simulation.exposure import Shot, expose, expose_series, frame_seed, to_precision
from dasim.simulation.simulate import simulate
from dasim.values import Capture

SIZE_PX = (32, 24)
DOME = {"kind": "dome", "illuminant": "D55", "lux": 400.0}
SINGLE = 5e-7, 1e-5  # relative, root mean square and largest: some tens of roundings along a path
VARIANCE_SINGLE = 1e-3  # relative: of a difference of two such sums
VARIANCE_LIMIT = 0.2  # 768 pixels: a variance is known to 5 %


@pytest.fixture(scope="module")
def camera(da_mobile):
    return cameras.cropped(da_mobile, *SIZE_PX)


@pytest.fixture(scope="module")
def scene_of(make_scene, lamp):
    """Function that makes a wall in focus with a card before its left half, its lights at ``scale`` times their lux."""
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 40), "material": "sand"}
    card = {"name": "card", "shape": "plane", "size_cm": (6, 20), "position_cm": (-3, 0, 20), "material": "leaf-green"}

    def make(scale=1.0):
        return make_scene(wall, card, lights=[light | {"lux": light["lux"] * scale} for light in (DOME, lamp)])

    return make


@pytest.fixture(scope="module")
def photographed(renderer, scene_of, camera):
    """Function that renders the scene; a longer exposure of the noise seed 3 saturates."""

    def render(exposure=None, scale=1.0, **options):
        # With few samples the factor of the control variate enlarges the rounding of single precision.
        return simulate(scene_of(scale), camera, seed=3, spp=64, exposure=exposure, **options)

    return render


@pytest.fixture(scope="module")
def shot(photographed):
    return photographed()


def assert_single_precision(ours: np.ndarray, theirs: np.ndarray, part: str) -> None:
    """Electrons or colours agree to ``SINGLE``.

    Each of the many terms of a pixel rounds by 2^-25 of itself, and those of control variates have both signs: the
    difference has no sharp bound in the pixel's own value, but few values are far from the typical one.
    """
    difference = np.abs(ours.astype(float) - theirs) / np.maximum(np.abs(theirs), 1e-6)
    assert np.sqrt(np.mean(difference**2)) < SINGLE[0], part
    assert difference.max() < SINGLE[1], part


def assert_equal(first: Shot, second: Shot) -> None:
    """Raw numbers, all of the truth, and everything that ``meta.json`` holds."""
    for field in fields(Capture):
        if field.name != "raw_dn":
            assert getattr(first.capture, field.name) == getattr(second.capture, field.name), field.name
    assert list(first.capture.provenance) == list(second.capture.provenance), "the same order of keys"
    np.testing.assert_array_equal(first.capture.raw_dn, second.capture.raw_dn)
    for field in fields(first.truth):
        ours, theirs = getattr(first.truth, field.name), getattr(second.truth, field.name)
        np.testing.assert_array_equal(ours, theirs, err_msg=field.name)


def test_a_rate_is_found_again_in_the_electrons_of_any_exposure():
    """Rationale: single precision has 24 bits; half a step of a rate of 22 bits is at least 2^-23 of it, the rounding
    of the electrons at most 2^-24. Expectation: exact for every exposure time; a rate of all 24 bits is not.
    """
    random = np.random.default_rng(1)
    rates = np.exp(random.uniform(np.log(1e-3), np.log(1e9), 200_000))
    times = np.exp(random.uniform(np.log(1e-9), np.log(3600), 200_000))
    for power in (1, 2):  # electrons, and their variance
        electrons = (to_precision(rates) * times**power).astype(np.float32)
        np.testing.assert_array_equal(to_precision(electrons * (1 / times) ** power), to_precision(rates))
    single = rates.astype(np.float32)
    again = ((single * times).astype(np.float32) / times).astype(np.float32)
    assert np.mean(again != single) > 0.05
    np.testing.assert_allclose(to_precision(rates), rates, rtol=2.0**-22)
    np.testing.assert_array_equal(to_precision(np.array([0.0, 1.0, 3.0])), [0.0, 1.0, 3.0])


def test_nothing_changed_is_the_same_shot(shot):
    assert_equal(expose(shot), shot)


@pytest.mark.parametrize(
    "exposure",
    [Exposure(time_s=1 / 250), Exposure(time_s=0.5), Exposure(time_s=0.01, gain=4.0), Exposure(auto_level=0.3)],
    ids=["short", "saturated", "gain", "automatic"],
)
def test_another_exposure_is_what_rendering_with_it_gives(photographed, shot, exposure):
    """Expectation: raw numbers, truth and provenance are equal, and so is the way back, also from a frame that
    saturates: ``mean_e`` is the light before saturation.
    """
    rendered = photographed(exposure)
    assert_equal(expose(shot, exposure=exposure), rendered)
    assert_equal(expose(rendered, exposure=Exposure()), shot)
    if exposure.time_s == 0.5:
        assert rendered.capture.provenance["saturated_pixels"] > 100
        assert noise.mosaic(rendered.truth.mean_e, rendered.capture.camera).max() > 6000.0, "beyond the full well"


@pytest.mark.parametrize("scale", [2.0, 0.3])
def test_other_light_is_rendering_with_it_but_for_single_precision(photographed, shot, scale):
    """Rationale: the renderer adds the light of a path in single precision, in which lights of other levels round
    elsewhere; one electron more or less may shift the draws of the noise of all following pixels. Set-up: ``lux`` of
    both lights together at automatic exposure, and a factor at a fixed time; raw numbers without noise.

    Expectation: electrons, exposure times and levels of the lights agree to that precision; raw numbers differ in few
    pixels, by one. The shares of noise, and what the exposure does not touch, agree too.
    """

    def noiseless(mean_e, sensor, time_s, seed, gain):
        return noise.expose(mean_e, sensor, time_s, seed, gain, noise="off")

    fixed = Exposure(time_s=shot.capture.exposure_s)
    for changes, exposure in (({"lux": scale * 1400.0}, None), ({"scale": scale, "exposure": fixed}, fixed)):
        ours, rendered = expose(shot, noise=noiseless, **changes), photographed(exposure, scale, noise=noiseless)
        assert ours.capture.exposure_s == pytest.approx(rendered.capture.exposure_s)
        for part in ("mean_e", "sharp_e", "focus_e", "sharp_srgb"):
            assert_single_precision(getattr(ours.truth, part), getattr(rendered.truth, part), part)
        variance, theirs = ours.truth.mean_e_variance, rendered.truth.mean_e_variance
        np.testing.assert_allclose(variance, theirs, rtol=VARIANCE_SINGLE)
        np.testing.assert_array_equal(ours.truth.depth_m, rendered.truth.depth_m)
        difference = np.abs(ours.capture.raw_dn.astype(int) - rendered.capture.raw_dn)
        assert difference.max() <= 1 and np.mean(difference > 0) < 0.01
        lights = [item.capture.provenance["scene"]["lights"] for item in (ours, rendered)]
        np.testing.assert_allclose(*([light["lux"] for light in each] for each in lights))
        for at, shares in ours.capture.provenance["rendering_noise_share"].items():
            expected = rendered.capture.provenance["rendering_noise_share"][at]
            assert shares == pytest.approx(expected, rel=VARIANCE_SINGLE)


def test_another_seed_is_other_noise_of_the_same_sensor(shot, camera):
    """Expectation: the truth is the same; two frames differ by twice the temporal variance alone, the fixed pattern
    cancels; the seed of the rendering stays in the provenance.
    """
    frames = list(expose_series(shot, [None], frames=40, seed=11))
    assert [frame.capture.seed for frame in frames] == [frame_seed(11, number) for number in range(40)]
    assert len({frame.capture.seed for frame in frames}) == 40 and frames[0].capture.seed == 11
    assert all(frame.capture.provenance["rendering_seed"] == 3 for frame in frames)
    np.testing.assert_array_equal(frames[0].truth.mean_e, shot.truth.mean_e)
    step = noise.electrons_per_dn(camera.sensor)
    raw = np.stack([frame.capture.raw_dn for frame in frames]) * step
    mean = electronic_crosstalk(noise.mosaic(shot.truth.mean_e.astype(float), camera), camera)
    unsaturated = mean < 5500
    temporal = noise.temporal_variance(camera.sensor, shot.capture.exposure_s).at(mean)
    ratio = raw.var(axis=0, ddof=1) / temporal
    assert ratio[unsaturated].mean() == pytest.approx(1.0, abs=5 * np.sqrt(2 / 39 / unsaturated.sum()))
    spatial = (raw.mean(axis=0) - mean)[unsaturated].var()
    fixed = noise.fixed_variance(camera.sensor, shot.capture.exposure_s).at(mean)
    expected = (fixed + temporal / 40)[unsaturated].mean()
    assert spatial == pytest.approx(expected, rel=VARIANCE_LIMIT), "40 frames do not average the pattern away"


def test_rendering_noise_is_stated_beside_the_new_exposures_noise(shot):
    """Rationale: of shot noise alone, the sensor's variance grows with the time and the rendering's with its square.

    Set-up: a sensor of shot noise alone, and a rendering of 0.3 of its noise. Expectation: 16 times the
    exposure, 4 times the share, and a note of one line; a sixteenth, a quarter of it, and none.
    """
    silent = {"read_noise_e": 0, "dsnu_e": 0, "prnu": 0, "dark_current_e_s": 0, "adc_bits": 16, "full_well_e": 1e6}
    camera = shot.capture.camera
    ideal = camera.model_copy(update={"sensor": camera.sensor.model_copy(update={**silent, "dn_per_e": 10.0})})
    kept = Shot(replace(shot.capture, camera=ideal), shot.truth)
    loud = max(expose(kept).capture.provenance["rendering_noise_share"]["95"].values())
    kept = replace(kept, truth=replace(shot.truth, mean_e_variance=shot.truth.mean_e_variance * (0.3 / loud) ** 2))
    level = {}
    for factor in (1 / 16, 1.0, 16.0):
        result = expose(kept, exposure=Exposure(time_s=factor * shot.capture.exposure_s)).capture.provenance
        level[factor] = np.array(list(result["rendering_noise_share"]["95"].values()))
        noted = [note for note in result["notes"] if "exceeds half of the sensor's own" in note]
        assert len(noted) == bool((level[factor] > 0.5).any()) and all("\n" not in note for note in noted)
    np.testing.assert_allclose(level[16.0], 4 * level[1.0], rtol=1e-3)
    np.testing.assert_allclose(level[1 / 16], level[1.0] / 4, rtol=1e-3)
    assert (level[16.0] > 0.5).any() and not (level[1 / 16] > 0.5).any()


def test_a_target_that_a_brighter_exposure_misses_is_noted(shot):
    """Set-up: the provenance of a shot of ``spp = "auto"`` whose target was met. Expectation: its share is stated anew
    at the same percentile; a note where the brighter exposure misses it.
    """
    reached = shot.capture.provenance["rendering_noise_share"]["95"]
    wanted = max(reached.values()) * 1.1
    auto = {"spp": {"open": 4, "hole": 4}, "rendering_noise_share_wanted": wanted, "rendering_noise_at": 95.0}
    about = shot.capture.provenance | auto | {"rendering_noise_share_reached": reached}
    kept = Shot(replace(shot.capture, provenance=about | {"notes": []}), shot.truth)
    same, bright = (
        expose(kept, exposure=Exposure(time_s=factor * shot.capture.exposure_s)).capture.provenance
        for factor in (1.0, 4.0)
    )
    assert same["rendering_noise_share_reached"] == pytest.approx(reached)
    assert not any("not enough" in note for note in same["notes"])
    assert bright["rendering_noise_share_reached"] == bright["rendering_noise_share"]["95"]
    (note,) = (note for note in bright["notes"] if "4 samples were not enough" in note)
    assert "percentile 95" in note


def test_an_independent_mean_is_no_longer_independent(photographed, shot):
    """Expectation: raw numbers repeat the noise of ``mean_e``; the provenance and a note say so."""
    own = photographed(Exposure(time_s=shot.capture.exposure_s), independent_mean=True)
    again = expose(own)
    assert own.capture.provenance["independent_mean"] and not again.capture.provenance["independent_mean"]
    assert any("repeats the rendering noise of mean_e" in note for note in again.capture.provenance["notes"])
    np.testing.assert_array_equal(again.truth.mean_e, own.truth.mean_e)
    assert (again.capture.raw_dn != own.capture.raw_dn).any()


def test_light_of_a_mitsuba_scene_has_a_factor_and_no_lux(jit, tmp_path, camera):
    """Set-up: a wall and a constant light, of radiance 1 and 2. Expectation: a factor of 2 is the other scene's
    picture; lux is refused.
    """
    text = (
        '<scene version="3.0.0"><sensor type="perspective"/><shape type="rectangle" id="wall">'
        '<transform name="to_world"><scale value="50"/><rotate y="1" angle="180"/><translate z="4"/></transform>'
        '<bsdf type="diffuse"><spectrum name="reflectance" value="0.5"/></bsdf></shape>'
        '<emitter type="constant"><spectrum name="radiance" value="LEVEL"/></emitter></scene>'
    )
    shots = []
    for level in ("1", "2"):
        (tmp_path / f"{level}.xml").write_text(text.replace("LEVEL", level))
        shots.append(simulate(tmp_path / f"{level}.xml", camera, spp=2, exposure=Exposure(time_s=1e-4)))
    bright = expose(shots[0], scale=2.0)
    np.testing.assert_array_equal(bright.truth.mean_e, shots[1].truth.mean_e)
    np.testing.assert_array_equal(bright.capture.raw_dn, shots[1].capture.raw_dn)
    assert bright.capture.provenance["light_scale"] == 2.0
    assert expose(bright, scale=2.0).capture.provenance["light_scale"] == 4.0
    with pytest.raises(InputError, match="no level in lux; give a factor, scale"):
        expose(bright, lux=100.0)


def test_a_noise_model_of_ones_own_is_given_again(shot):
    """Expectation: a capture with another model is not silently exposed with the bundled one."""

    def model(mean_e, sensor, time_s, seed, gain):
        return np.full(mean_e.shape, 77, np.uint16), 5

    own = expose(shot, noise=model)
    assert (own.capture.raw_dn == 77).all() and own.capture.provenance["saturated_pixels"] == 5
    with pytest.raises(InputError, match=r"has the noise model '.*model'; give it again"):
        expose(own)
    assert_equal(expose(own, noise=noise.expose), shot)


def test_a_capture_without_provenance_keeps_its_exposure(shot):
    """Set-up: a capture made by hand. Expectation: its time and gain; lux is unknown."""
    bare = Shot(replace(shot.capture, provenance={}), shot.truth)
    again = expose(bare)
    np.testing.assert_array_equal(again.capture.raw_dn, shot.capture.raw_dn)
    assert again.capture.exposure_s == shot.capture.exposure_s
    with pytest.raises(InputError, match="no level in lux"):
        expose(bare, lux=100.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lux": -5.0}, "lux is -5; it must be a number above 0"),
        ({"lux": float("nan")}, "lux is nan"),
        ({"lux": 100.0, "scale": 2.0}, "lux and scale: give one"),
        ({"lux": 1e9}, r"the lights would have 2\.85714e\+08 to 7\.14286e\+08 lux; 1e-06 to 1e\+07"),
        ({"scale": 0.0}, "the factor on the light is 0; 1e-09 to"),
        ({"seed": -1}, "seed is -1"),
        ({"lux": "3"}, "lux: must be a number"),
        ({"exposure": 0.1}, r"must be a dasim\.Exposure"),
    ],
)
def test_values_that_are_not_allowed(shot, options, message):
    with pytest.raises(InputError, match=message):
        expose(shot, **options)


def test_truth_without_light_is_refused(shot):
    with pytest.raises(InputError, match="mean_e") as refused:
        expose(Shot(shot.capture, replace(shot.truth, mean_e=None)))
    assert "meta.json" not in str(refused.value)


def test_truth_of_a_part_of_the_frame_is_refused(shot):
    part = replace(shot.truth, mean_e=shot.truth.mean_e[2:-2, 2:-2])
    with pytest.raises(InputError, match=r"mean_e is 28 x 20 pixels of 4 channels, raw\.png 32 x 24 of 4"):
        expose(Shot(shot.capture, part))
    with pytest.raises(InputError, match="frames is 0"):
        list(dasim.expose_series(shot, [None], frames=0))
