"""Checks on the checks of blur, edges and kernels: each gate fails where what it is for is broken."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.gates import entries, verdicts
from validation.claims.optics import bank, bundled_cameras, diffraction, edges, lens_errors, off_axis
from validation.claims.optics import blur as lens
from validation.subjects import mixed_room, rendering


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
