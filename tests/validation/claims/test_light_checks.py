"""Checks on the checks of light and noise: each gate fails where what it is for is broken."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.camera import stops
from dasim.spectra import grid, illuminants
from tests.support.gates import entries, verdicts
from validation.claims.light import electrons as light
from validation.claims.light import field_colour, mixed, noise, pattern
from validation.claims.table import CLAIMS
from validation.gates.limits import GATES, gate_of, load_gates, within
from validation.scores.figures import Figure
from validation.subjects.rendering import seeds_of


def test_pictures_of_different_seeds_are_independent():
    """Expectation: no two pictures of a claim that several seeds measure have a seed in common."""
    of_claim = [seeds_of(seed, 12, part=part) for seed in range(8) for part in range(3)]
    assert len(set().union(*of_claim)) == 12 * len(of_claim)


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
