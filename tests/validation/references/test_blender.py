"""Cycles renders the claim's scene: its picture agrees with the simulator's, and does not where the scene differs."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.materials.surfaces import Diffuse, Mixture
from dasim.spectra.grid import WAVELENGTH_NM
from tests.validation.claims.test_broken import failed
from validation.claims.cost import cycles
from validation.gates.claim import Evidence
from validation.references import blender
from validation.subjects import rendering

COARSE = {"width_px": 96, "height_px": 72, "pixel_pitch_um": 1.7 * cycles.SIZE_PX[0] / 96}  # the claim's field of view
BLOCK_PX = 8


def test_a_texture_has_the_repeats_of_its_surface():
    """Every other copy is mirrored, beginning at the lower left; a texel is the mixture of both reflectances."""
    weight = np.array([[0.0, 0.25], [0.5, 1.0]], np.float32)
    dark, bright = (Diffuse(np.full(len(WAVELENGTH_NM), value)) for value in (0.1, 0.9))
    texture = blender._texture(Mixture(weight, dark, bright, (2.0, 2.0)), np.ones((1, len(WAVELENGTH_NM))))[..., 0]
    assert texture[2:, :2] == pytest.approx(0.1 + 0.8 * weight)
    assert texture[:2, :2] == pytest.approx(0.1 + 0.8 * weight[::-1])
    assert texture[2:, 2:] == pytest.approx(0.1 + 0.8 * weight[:, ::-1])


@pytest.mark.skipif(not blender.is_installed(), reason="needs bpy, of the extra 'cycles'")
@pytest.mark.parametrize(
    ("change", "failures"),
    [
        (None, set()),
        ("light", {"blocks", "mean"}),
        ("aperture", {"blocks"}),
        ("texture", {"blocks"}),
    ],
)
def test_another_scene_in_cycles_fails_the_agreement(renderer, monkeypatch, change, failures):
    """Set-up: the scene with steps in coarse pixels, as it is; or in Cycles twice as bright, through a lens of half the
    diameter (whose pictures are as bright, since they hold radiance), or with its textures upside down.
    """
    monkeypatch.setattr(cycles, "BLOCK_PX", BLOCK_PX)
    camera, scene = (
        rendering.changed(cycles.bayer_camera(cycles.SIZE_PX), sensor=COARSE),
        cycles.scene_of(cycles._STEPS),
    )
    shot = dasim.simulate(scene, camera, 0, spp=256, diffraction="off")
    if change == "light":
        true_radiance = blender.radiance_per_lux
        monkeypatch.setattr(blender, "radiance_per_lux", lambda lamp: 2 * true_radiance(lamp))
    if change == "aperture":
        true_aperture = blender.geometry.aperture_m
        monkeypatch.setattr(blender.geometry, "aperture_m", lambda camera: true_aperture(camera) / 2)
    if change == "texture":
        true_texture = blender._texture
        monkeypatch.setattr(blender, "_texture", lambda *arguments: true_texture(*arguments)[::-1])
    theirs = blender.renders(scene, camera, 256, [1]).pictures[0]
    ours = shot.truth.mean_e / shot.capture.exposure_s
    found = failed("against-cycles", Evidence(cycles._agreement("steps", ours, theirs)))
    assert {figure.split(".")[2] for figure in found if figure.startswith("steps.difference.")} == failures
