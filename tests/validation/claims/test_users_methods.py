"""Every claim that accepts depth methods measures a user's, on a small stand-in for its photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dasim.simulation.exposure import Shot
from tests.support import recon_scenes
from tests.support.stand_ins import stand_in
from validation.claims.depth import depth_maps, disks, held_out, light_levels, scenes, side_of_focus, staircase, steps
from validation.claims.pictures import all_in_focus, scene_pictures
from validation.claims.table import CLAIMS
from validation.gates.claim import Evidence
from validation.methods import named

HEIGHT, WIDTH = 192, 256
NEAR_LEVEL = 7.34  # of a plane at 20 cm with the focus at 100 m: 3.6^2 mm^2 / 2.8 / 1.7 um / 20 cm (1 - 0.46)
# The example finds too little blur: the noise that the correction of crosstalk leaves is fine texture to it.
STEP_LEVELS = 4.0
EXAMPLE = f"laplacian={Path(__file__).parents[3] / 'examples' / 'depth_method.py'}:laplacian_ratio"
MODULES = (staircase, scenes, all_in_focus, steps, light_levels, depth_maps, disks, scene_pictures, side_of_focus)


@pytest.fixture(scope="module")
def slope() -> Shot:
    return stand_in(recon_scenes.slanted(HEIGHT, WIDTH, 1.0, 8.0))


@pytest.fixture
def small(monkeypatch, slope):
    """Each claim with one scene, few levels and few settings, on a stand-in focused as the stand-in's bank."""
    bank = recon_scenes.bank(("D65",))
    for module in MODULES:
        monkeypatch.setattr(module.rendering, "needs_wave", lambda: None)
        monkeypatch.setattr(module, "photographed", lambda *args, **options: slope)
    recipe = held_out.sets.Recipe("far", None, slope.capture.camera, None)
    monkeypatch.setattr(held_out.rendering, "needs_wave", lambda: None)
    monkeypatch.setattr(held_out.sets, "recipes", lambda name: [recipe])
    monkeypatch.setattr(held_out.sets, "capture", lambda one: slope)
    flat = [stand_in(np.full(staircase.CAMERA_PX, float(level))) for level in range(3)]
    monkeypatch.setattr(staircase, "photographed", lambda scene, camera, level, **options: flat[level])
    monkeypatch.setattr(staircase, "BLUR_LEVELS", len(flat))
    monkeypatch.setattr(staircase, "WHITE_E", (5000.0,))
    near = np.where(np.arange(WIDTH) < WIDTH / 2, NEAR_LEVEL, NEAR_LEVEL - STEP_LEVELS)
    halves = stand_in(np.broadcast_to(near, (HEIGHT, WIDTH)))
    monkeypatch.setattr("dasim.focused", lambda camera, scene: camera)
    monkeypatch.setattr("dasim.calibration_captures", lambda *args, **options: None)
    monkeypatch.setattr("recon.calibrate", lambda captures: bank)
    for module, values in {
        scenes: {"SCENES": ("desk",)},
        depth_maps.scene_set: {"SCENES": ("desk",)},
        all_in_focus: {"SHARP_SCENES": ("desk",)},
        steps: {"DEPTHS_CM": {"da-mobile": (20.0,)}, "STEPS": (STEP_LEVELS,), "photographed": lambda *a, **o: halves},
        light_levels: {"LIGHTS": ("D65", "energy-saving-3500K"), "LEVELS_LUX": (100.0, 10000.0), "SCENE": "desk"},
        disks: {"SHEETS": {"near": "5 cm"}, "INKS": ("yellow", "black")},
        scene_pictures: {"SCENES": {"desk": "near-black"}},
    }.items():
        for name, value in values.items():
            monkeypatch.setattr(module, name, value)


@pytest.mark.parametrize("claim", [name for name, measurement in CLAIMS.items() if measurement.methods])
def test_a_users_method_passes_through_the_claim(small, claim):
    """Expectation: figures of the user's method alone, each by its name, with numbers, and a table or a picture."""
    evidence = CLAIMS[claim].run(lambda share: None, methods=named([EXAMPLE]))
    assert isinstance(evidence, Evidence) and (evidence.tables or evidence.pictures)
    assert evidence.figures and all(figure.id.startswith("laplacian.") for figure in evidence.figures)
    assert len({figure.id for figure in evidence.figures}) == len(evidence.figures)
    assert np.isfinite([figure.value for figure in evidence.figures]).mean() > 0.5


def test_the_error_on_the_staircase_is_that_of_the_method(small, tmp_path):
    """Set-up: a method that answers level 1 everywhere, on the levels 0, 1 and 2.

    Expectation: bias and error are 2/3 of a level, the mean of 1, 0 and 1; the standard deviation is 0.
    """
    (tmp_path / "constant_one.py").write_text(
        "import numpy as np\nfrom dasim.values import DepthEstimate\n"
        "def one(capture, bank):\n    return DepthEstimate(level=np.ones(capture.raw_dn.shape))\n"
    )
    methods = named([f"one={tmp_path / 'constant_one.py'}:one"])
    values = {f.id: f.value for f in staircase.staircase_camera(lambda share: None, 0, methods).figures}
    for figure, expected in (("bias", 2 / 3), ("error", 2 / 3), ("deviation", 0)):
        assert values[f"one.white-5000.{figure}"] == pytest.approx(expected, abs=1e-6)
