"""Checks on the checks: each claim's gate fails where the thing that it is for is broken, and holds where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import stops
from dasim.spectra import grid, illuminants
from validation.claims.cost import datasets, scenes
from validation.claims.depth import ground_truth
from validation.claims.light import electrons as light
from validation.claims.light import field_colour, mixed, noise, pattern
from validation.claims.optics import bank, bundled_cameras, camera, diffraction, edges, lens_errors, off_axis
from validation.claims.optics import blur as lens
from validation.claims.pictures import colour
from validation.claims.table import CLAIMS
from validation.gates.claim import Claim
from validation.gates.limits import GATES, gate_of, judged_all, load_gates, within
from validation.scores.figures import Figure
from validation.subjects import mixed_room, rendering


def entries(name: str, run_claim) -> list[Claim]:
    return judged_all(name, run_claim(lambda share: None).figures, load_gates(GATES, CLAIMS))


def verdicts(name: str, run_claim) -> list[bool]:
    return [entry.passed for entry in entries(name, run_claim) if entry.passed is not None]


@pytest.mark.parametrize("factor", [1.0, 1.05])
def test_blur_off_by_5_percent_fails(renderer, monkeypatch, factor):
    """Set-up: two blurs, one lens, fewer samples; a lens whose diameter is 5 % too large, or is not."""
    from dasim.camera import geometry

    true = geometry.aperture_m
    monkeypatch.setattr(geometry, "aperture_m", lambda camera: factor * true(camera))
    monkeypatch.setattr(lens, "LENSES_MM", (3.6,))
    monkeypatch.setattr(lens, "BLUR_OFF_PX", (-5.0, 10.0))
    monkeypatch.setattr(lens, "BLUR_OFF_SPP", 1024 if renderer != "scalar_spectral" else 256)
    results = [
        entry.passed for entry in entries("blur-off", lens.blur_off) if entry.id.startswith("blur-off.lens-3.6mm.")
    ]
    assert len(results) == 4
    assert results == [True] * 4 if factor == 1 else not any(results)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["wave", "off"])
def test_edges_of_geometry_fail_the_wave_claim(jit, monkeypatch, model):
    """Set-up: one blur, 8 px of the near-infrared's own, fewer samples; rays of wave optics, or of geometry.

    Expectation: infrared shows the difference, because geometry is off by 0.2 there. Frequencies up to 0.2 cycles per
    pixel, where noise is low.
    """
    true = rendering.capture_rate

    def rate(*arguments, diffraction, **options):
        return true(*arguments, diffraction=model, **options)

    monkeypatch.setattr(rendering, "capture_rate", rate)
    monkeypatch.setattr(diffraction, "SFR_BLUR_PX", (17.4, 17.4))
    monkeypatch.setattr(diffraction, "SFR_CYCLES_PX", np.linspace(0.05, 0.2, 7))
    monkeypatch.setattr(diffraction, "EDGE_SPP", 256)
    monkeypatch.setattr(diffraction, "EDGE_SEEDS", 2)
    results = verdicts("wave-sfr", diffraction.wave_sfr)
    assert results[3] is (model == "wave")


def plain_mean(signal, control, beyond):
    """In place of layers.front_to_back: each ray weighted by its own depth alone, without a rest."""
    return sum(signal) / np.maximum(control[0] + beyond[0], 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
def test_weights_by_the_own_depth_of_each_ray_draw_an_edge_in_the_furnace(jit, monkeypatch, good):
    """Set-up: one step of 17 px; layers front to back, or each weighted by its own depth alone, without a rest."""
    from dasim.render import layers

    if not good:
        monkeypatch.setattr(layers, "front_to_back", plain_mean)
    monkeypatch.setattr(edges, "STEPS_PX", (17.0,))
    true = edges.furnaces
    monkeypatch.setattr(edges, "furnaces", lambda: {"two-17px": true()["two-17px"]})
    assert all(verdicts("depth-step-furnace", edges.depth_step_furnace)) is good


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
def test_one_layer_for_all_depths_changes_silhouettes(jit, monkeypatch, good):
    """Set-up: 17 px of blur, fewer seeds; layers as they are, or all rays of a pixel in one layer.

    Expectation: one layer draws no edge in a furnace, but its dark silhouettes in the infrared are wrong.
    """
    from dasim.render import layers

    if not good:
        monkeypatch.setattr(layers, "split", lambda blur_px: np.zeros(blur_px.shape, dtype=np.int64))
    monkeypatch.setattr(edges, "SILHOUETTE_BLUR_PX", (17.0,))
    monkeypatch.setattr(edges, "SILHOUETTE_SEEDS", 3)
    entry = next(e for e in entries("silhouette", edges.silhouette) if e.id.endswith("dark-on-bright.IR.worst"))
    assert entry.passed is good


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
def test_plain_means_of_weighted_rays_fail_with_a_colour_filtered_aperture(jit, monkeypatch, good):
    """Set-up: the camera ``bando`` alone; layers front to back, or each weighted by its own depth alone."""
    from dasim.render import layers

    if not good:
        monkeypatch.setattr(layers, "front_to_back", plain_mean)
    monkeypatch.setattr(bundled_cameras, "CAMERAS", ("bando",))
    monkeypatch.setattr(bundled_cameras, "SEEDS", 2)
    monkeypatch.setattr(mixed_room, "SEEDS", range(1, 3))
    monkeypatch.setattr(mixed_room, "TRACED_SPP", 64)
    passed = {e.id.split(".")[-1]: e.passed for e in entries("bundled-cameras", bundled_cameras.bundled_cameras)}
    assert [passed["depth-step"], passed["silhouettes"]] == [good, good]


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
def test_patterns_of_the_axis_fail_in_the_corner(jit, monkeypatch, good):
    """Set-up: infrared in focus in the full frame's corner; the field angle as it is, or ignored."""
    from dasim.render import field_angle

    if not good:
        monkeypatch.setattr(field_angle, "widened", lambda v, tangent: v)
        monkeypatch.setattr(field_angle, "foreshortened", lambda v, tangent: v)
        monkeypatch.setattr(field_angle, "mean_scale", lambda tangent: 1.0)
    monkeypatch.setattr(off_axis, "PLACES", {"frame-corner": off_axis.PLACES["frame-corner"]})
    monkeypatch.setattr(off_axis, "OWN_BLUR_PX", {"focus": 0.0})
    monkeypatch.setattr(off_axis, "COMPARED", {"IR": 1})
    passed = {entry.id: entry.passed for entry in entries("off-axis", off_axis.off_axis)}
    assert passed["off-axis.frame-corner.focus.IR.energy"] is good
    assert passed["off-axis.fwhm.frame-corner.tangential"], "the widths are those of dasim.psf, without rays"


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
def test_lens_errors_that_do_nothing_or_too_much_fail(jit, monkeypatch, good):
    """Set-up: one Zernike term, one step and the veil; or a wavefront of three quarters of its size, a hole without its
    step, and a veil of a tenth more light.
    """
    from dasim.camera import glare, wavefront
    from dasim.render import wave

    true_errors, true_spread = wavefront.coefficients, glare.spread
    if not good:
        wave._blur.cache_clear()
        monkeypatch.setattr(wavefront, "coefficients", lambda *at: tuple(0.75 * value for value in true_errors(*at)))
        monkeypatch.setattr(
            wavefront, "of_stop", lambda camera, stop, angle_deg=0.0: wavefront.of_lens(camera, angle_deg)
        )
        monkeypatch.setattr(glare, "spread", lambda picture, share, *radius: true_spread(picture, 1.1 * share, *radius))
    cases = lens_errors._cases()
    monkeypatch.setattr(lens_errors, "_cases", lambda: {name: cases[name] for name in ("spherical", "half-wave")})
    found = {entry.id: entry.passed for entry in entries("lens-errors", lens_errors.lens_errors) if "*" not in entry.id}
    wave._blur.cache_clear()
    failed = {name.removeprefix("lens-errors.") for name, passed in found.items() if passed is False}
    assert failed == (set() if good else {"strehl.spherical", "strehl.half-wave", "glare"})


@pytest.mark.parametrize(("ratio", "good"), [(0.46, True), (0.462, False)])
def test_a_hole_too_large_fails(renderer, monkeypatch, da_mobile, ratio, good):
    """Set-up: da-mobile, and with a hole 0.4 % too wide, so 0.9 % too large."""
    from dasim.camera import specification as cameras

    visible, hole = da_mobile.stops
    camera = da_mobile.model_copy(update={"stops": (visible, hole.model_copy(update={"radius_ratio": ratio}))})
    monkeypatch.setattr(cameras, "load_camera", lambda name: camera)
    assert verdicts("hole-alpha-squared", light.hole_alpha_squared) == [good] * 4


@pytest.mark.parametrize("good", [True, False])
def test_a_lens_without_natural_vignetting_fails_in_the_corner(renderer, monkeypatch, good):
    from dasim.camera import radiometry

    if not good:
        monkeypatch.setattr(radiometry, "relative_illumination", lambda camera: np.ones((36, 48)))
    assert verdicts("radiometry", light.absolute_electrons) == [True] * 4 + [good] * 4


def test_a_stop_of_another_size_changes_the_light_loss(jit, monkeypatch):
    """Set-up: Chakrabarti and Zickler's stop of 0.6 instead of 0.59 loses 0.6 percentage points less."""
    from dasim.camera import specification as cameras

    true = cameras.load_camera

    def wrong(name):
        camera = true(name)
        parts = [
            stop.model_copy(update={"radius_ratio": 0.6 if stop.name == "green" else 1.0}) for stop in camera.stops
        ]
        return camera.model_copy(update={"stops": tuple(parts)})

    monkeypatch.setattr(light, "REDUCTIONS", {"chakrabarti-zickler": ("chakrabarti-zickler", [(2, 0.59)])})
    monkeypatch.setattr(light, "LOSS_LIGHTS", ("D65",))
    for load, good in ((true, True), (wrong, False)):
        monkeypatch.setattr(cameras, "load_camera", load)
        figure = light.light_loss(lambda share: None).figures[0]
        gate = gate_of(f"light-loss.{figure.id}", load_gates(GATES, CLAIMS))
        assert within(figure.value, gate.limit) is good


def test_limits_of_light_loss_lie_around_eq_1():
    """Expectation: half a percentage point either way, to the limits' rounding."""
    gates = load_gates(GATES, CLAIMS)
    for name, (_, reductions) in light.REDUCTIONS.items():
        low, high = map(float, gate_of(f"light-loss.{name}", gates).limit.split(".."))
        expected = stops.light_loss(reductions, 4)
        assert low == pytest.approx(expected - 0.005, abs=1e-4) and high == pytest.approx(expected + 0.005, abs=1e-4)


def test_crosstalk_of_other_curves_fails(renderer, monkeypatch):
    """Set-up: coefficients of curves whose green passes 2 % more of the near-infrared than the rendered ones."""
    from dasim.camera import specification

    true = specification.crosstalk
    monkeypatch.setattr(specification, "crosstalk", lambda sensor: true(sensor) * (1.0, 1.02, 1.0))
    monkeypatch.setattr(light, "REAL_LIGHTS", ())
    assert verdicts("eq8-flat-field", light.eq8_flat_field) == [True, False, True]


def test_moments_of_a_known_picture():
    """Expectation: two lines of 3 and 1 at distance 4 have a second moment of 16 * 3/4 * 1/4 = 3 along one axis."""
    picture = np.zeros((9, 9, 4))
    picture[4, 2], picture[4, 6] = 3.0, 1.0
    np.testing.assert_allclose(lens.second_moments(picture), [[0.0, 3.0]] * 4, atol=1e-12)


@pytest.fixture(scope="module")
def checker_under_a(renderer):
    return colour.checker("da-mobile", "A")


@pytest.mark.slow
@pytest.mark.parametrize("broken", [None, "white balance", "gamma"])
def test_colours_that_are_wrong_fail(checker_under_a, monkeypatch, broken):
    """Set-up: the ColorChecker under A as da-mobile has it; white balance that always finds daylight, or the display's
    curve applied twice.
    """
    from recon.picture import colour as recon_colour

    monkeypatch.setattr(colour, "CHECKER_LIGHTS", ("A",))
    monkeypatch.setattr(colour, "CHECKER_CAMERAS", ("da-mobile",))
    monkeypatch.setattr(colour, "checker", lambda *arguments: checker_under_a)
    if broken == "white balance":
        monkeypatch.setattr(recon_colour, "choose_light", lambda *picture: 0)
    if broken == "gamma":
        true = colour.to_srgb
        monkeypatch.setattr(colour, "to_srgb", lambda e, matrix, scale: true(true(e, matrix, scale), np.eye(3), 1.0))
    figure = next(f for f in colour.colour(lambda share: None).figures if f.id == "A")
    gate = gate_of("colour.A", load_gates(GATES, CLAIMS))
    assert within(figure.value, gate.limit) is (broken is None)


@pytest.mark.parametrize("factor", [1.0, 2**0.5])
def test_noise_doubled_fails(monkeypatch, factor):
    """Set-up: electrons that come in pairs, so that photons' variance is twice their number; or do not."""
    from dasim.camera import noise as sensor

    true = sensor._generator

    class Paired:
        def __init__(self, generator):
            self.generator = generator

        def poisson(self, mean):
            return factor**2 * self.generator.poisson(np.asarray(mean) / factor**2)

        def __getattr__(self, name):
            return getattr(self.generator, name)

    monkeypatch.setattr(sensor, "_generator", lambda *key: Paired(true(*key)))
    monkeypatch.setattr(noise, "GAINS", (1.0,))
    monkeypatch.setattr(noise, "SIZE_PX", (256, 256))
    slope, _, ratio, _ = verdicts("photon-transfer", noise.photon_transfer)
    assert (slope, ratio) == ((True, True) if factor == 1 else (False, False))


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
def test_pattern_of_the_frames_seed_fails(renderer, monkeypatch, good):
    """Set-up: the sensor as it is, or, in smaller frames, with a fixed pattern that is drawn anew for each frame.

    Expectation: then the stacks share nothing, the variance from frame to frame is too large, and no flat corrects.
    """
    import itertools

    from dasim.camera import noise as sensor

    if not good:
        true, seeds = sensor.fixed_pattern, itertools.count()
        monkeypatch.setattr(
            sensor, "fixed_pattern", lambda s, shape: true(s.model_copy(update={"sensor_seed": next(seeds)}), shape)
        )
        monkeypatch.setattr(pattern, "SIZE_PX", (96, 72))
    verdict = {e.id: e.passed for e in entries("fixed-pattern", pattern.fixed_pattern)}
    assert len(verdict) == 6 and (all(verdict.values()) if good else True)
    assert [verdict[f"fixed-pattern.{name}"] for name in ("pattern", "temporal", "corrected")] == [good] * 3


@pytest.mark.parametrize("good", [True, False])
def test_depth_as_range_fails(renderer, monkeypatch, good):
    """Set-up: the truth's depth times the length of the ray with z = 1: range, for z."""
    import dasim

    true = dasim.simulate

    def ranged(*arguments, **options):
        from dataclasses import replace

        shot = true(*arguments, **options)
        depth = shot.truth.depth_m
        away = [np.arange(n) + 0.5 - n / 2 for n in depth.shape]
        image_px = 1e-3 / (1 / 3.6 - 1 / (1e3 * ground_truth.FOCUS_M)) / (ground_truth.PITCH_UM * 1e-6)
        length = np.sqrt(1 + (away[0][:, None] ** 2 + away[1][None] ** 2) / image_px**2)
        return shot if good else replace(shot, truth=replace(shot.truth, depth_m=depth * length))

    monkeypatch.setattr(dasim, "simulate", ranged)
    depth, *others = verdicts("ground-truth", ground_truth.ground_truth)
    assert depth is good and all(others)


@pytest.mark.parametrize("flip", [False, True])
def test_a_mirrored_truth_fails(renderer, monkeypatch, flip):
    import dasim

    true = dasim.simulate

    def mirrored(*arguments, **options):
        from dataclasses import fields, replace

        shot = true(*arguments, **options)
        arrays = {f.name: getattr(shot.truth, f.name) for f in fields(shot.truth)}
        turned = {key: a[:, ::-1] for key, a in arrays.items() if isinstance(a, np.ndarray) and a.ndim > 1}
        return replace(shot, truth=replace(shot.truth, **turned)) if flip else shot

    monkeypatch.setattr(dasim, "simulate", mirrored)
    assert all(verdicts("ground-truth", ground_truth.ground_truth)) is not flip


@pytest.mark.slow
@pytest.mark.parametrize("shift_px", [0.0, 0.5])
def test_infrared_half_a_pixel_off_fails(renderer, monkeypatch, shift_px):
    """Set-up: the light that comes through the hole alone moved along x, as a film of its own could be."""
    from scipy import ndimage

    from dasim.render import passes

    true = passes.stop_ratios

    def moved(loaded, camera_, stop, *arguments, **options):
        picture = true(loaded, camera_, stop, *arguments, **options)
        if stop.name != camera_.stops[-1].name or shift_px == 0:
            return picture
        return type(picture)(*(ndimage.shift(part, (0, shift_px, 0), order=1, mode="nearest") for part in picture))

    monkeypatch.setattr(passes, "stop_ratios", moved)
    monkeypatch.setattr(scenes, "GRID_BLURS_PX", (0.0,))
    results = {
        entry.id.removeprefix("registration.blur-0."): entry.passed
        for entry in entries("registration", scenes.registration)
    }
    assert results["mean_e.G"] and results["sharp_e.G"]
    assert results["mean_e.IR"] is (shift_px == 0)


@pytest.mark.slow
@pytest.mark.parametrize("good", [True, False])
@pytest.mark.parametrize("case", ["D65-F11", mixed.MITSUBA])
def test_one_irradiance_field_for_all_spectra_fails(jit, monkeypatch, good, case):
    """Set-up: one case; a field for each spectrum of the emitters, or one for all, over the spectrum of the first, or
    for the Mitsuba scene over that of the colours of its lights, D65.
    """
    from dasim.render import light_spectra

    true = light_spectra.lights_of

    def one(scene):
        fields = true(scene)
        d65 = np.interp(light_spectra.FINE_NM, grid.WAVELENGTH_NM, illuminants.illuminant("D65"))
        spectrum = d65 if case == mixed.MITSUBA else fields.spectra[0]
        return light_spectra.Lights(spectrum[None], tuple((emitter, (0,)) for emitter, _ in fields.emitters))

    if not good:
        monkeypatch.setattr(light_spectra, "lights_of", one)
    monkeypatch.setattr(mixed, "CASES", (case,))
    results = {
        entry.id.removeprefix(f"mixed-lights.{case}."): entry.passed
        for entry in entries("mixed-lights", mixed.mixed_lights)
    }
    assert len(results) == 12
    assert (
        all(results.values())
        if good
        else not (results["mean.R"] or results["rms.R"] or results["mean.G"] or results["rms.G"])
    )


@pytest.mark.slow
@pytest.mark.parametrize("broken", [None, "reconstruction", "renderer"])
def test_coatings_that_shift_in_one_of_two_places_fail(renderer, monkeypatch, broken):
    """Set-up: the field of the full frame in few large pixels, without the whole reconstruction; coatings that shift in
    the renderer and in the reconstruction, in the renderer alone, or in the reconstruction alone. A flat in the light
    of the picture corrects coatings that shift in the reconstruction's data sheet alone.
    """
    from dasim.camera import rings
    from dasim.render import wavelengths
    from recon.picture import field

    true = rings.rings

    def axis(*cameras):
        angles, place = true(*cameras)
        return rings.Rings(angles[:1], np.zeros_like(place))

    if broken:
        still = {"reconstruction": field, "renderer": wavelengths}[broken]
        monkeypatch.setattr(still, "rings", axis)
    size = {"width_px": 256, "height_px": 192, "pixel_pitch_um": 13.6}
    monkeypatch.setattr(field_colour, "SENSOR", size)
    monkeypatch.setattr(field_colour, "BLOCK_PX", 32)
    monkeypatch.setattr(field_colour, "LIGHTS", ("D65",))
    monkeypatch.setattr(field_colour, "_reconstructed", lambda shot, light: Figure("D65.reconstruct", 0.0, "dE00", ""))
    passed = {
        entry.id.removeprefix("field-colour."): entry.passed
        for entry in entries("field-colour", field_colour.field_colour)
    }
    lost = [passed[f"D65.{place}.{channel}"] for place in ("side", "corner") for channel in ("R", "IR")]
    assert lost == [broken != "renderer"] * 4
    assert passed["D65.cast"] is (broken is None) and passed["D65.flat"] is (broken != "reconstruction")


@pytest.mark.parametrize("good", [True, False])
def test_near_infrared_removed_from_red_fails(monkeypatch, good):
    """Set-up: a sensor whose red pixel is blind beyond 650 nm, as under a common camera's filter."""
    from dasim.camera import specification as cameras
    from dasim.spectra import grid

    true = cameras.quantum_efficiency
    response = np.ones((4, len(grid.WAVELENGTH_NM)))
    response[0, grid.WAVELENGTH_NM > 650] = 1 if good else 0.01
    monkeypatch.setattr(cameras, "quantum_efficiency", lambda body: true(body) * response)
    figures = [entry for entry in entries("response-curves", camera.response_curves) if entry.id.endswith("alpha.R")]
    assert [entry.passed for entry in figures] == [good]


@pytest.mark.slow
@pytest.mark.parametrize("levels", [0, 1])
def test_the_kernel_of_the_next_level_fails(monkeypatch, levels):
    """Set-up: a bank whose kernels are those of the level asked for, or of the next."""
    from dataclasses import replace

    import dasim
    import recon

    true = recon.calibrate

    def shifted(pictures, progress):
        captures = true(dasim.calibration_captures(pictures.camera, ("D65",)))
        count = captures.kernel.shape[1]
        return replace(captures, kernel=captures.kernel[:, np.minimum(np.arange(count) + levels, count - 1)])

    monkeypatch.setattr(recon, "calibrate", shifted)
    monkeypatch.setattr(bank, "LEVELS", (1, 8))
    results = verdicts("bank", bank.bank)
    assert all(results) if levels == 0 else not any(results)


def test_dataset_claim_fails_what_is_slow_large_or_leaks():
    """Each figure from made-up runs: at its limit it holds, and a tenth beyond it fails."""
    row = {"seconds": 24.0, "cpu_s": 24.0, "render_s": 20.5, "peak_mb": 1500.0}

    def run(**changes):
        return [row | changes] * 2

    def failing(tiny=(1000.0,) * 8, **runs) -> set[str]:
        ran = {"auto": run(), "two": run(), "one": run(seconds=20.5), "ray": run(seconds=26.6)} | runs
        figures = datasets.figures(ran, [row | {"peak_mb": peak} for peak in tiny])
        judged = judged_all("dataset-speed", figures, load_gates(GATES, CLAIMS))
        return {entry.id.removeprefix("dataset-speed.") for entry in judged if entry.passed is False}

    assert failing() == set()
    assert failing(auto=run(seconds=26.0, render_s=25.0)) == {"rate-auto"}
    assert failing(auto=run(render_s=18.0)) == {"outside-auto"}
    assert failing(one=run(seconds=18.0)) == {"two-over-one"}
    assert failing(ray=run(seconds=29.0)) == {"ray-over-local"}
    assert failing(one=run(seconds=20.5, peak_mb=1650.0)) == {"memory"}
    assert failing(tiny=[1000.0] * 4 + [1010.0, 1030.0, 1060.0, 1100.0]) == {"growth"}
