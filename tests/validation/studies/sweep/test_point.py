"""What one point of a sweep measures: light loss, limits, boards and depth."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from dasim.camera import geometry, radiometry
from dasim.camera import specification as cameras
from dasim.values import Capture
from tests.support import surfaces
from tests.support.small_study import STUDY
from validation.claims.optics.resolution import half_pixel_m
from validation.studies import criteria
from validation.studies.sweep import designs
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.point import FIGURES, depth_figures, limits, median_error
from validation.studies.sweep.specification import units

EDGES = 0.004  # of the light: coatings have edges of 8 nm, which eq. (1) has not


def test_the_median_of_normal_errors_of_several_spreads():
    """Expectation: 0.6745 of one spread; of two, what 400,000 drawn errors have."""
    assert median_error(np.full(7, 0.2)) == pytest.approx(0.6745 * 0.2, rel=1e-4)
    spreads = np.tile([0.1, 0.1, 3.0], 100)
    errors = np.random.default_rng(0).normal(size=(4000, 300)) * spreads
    assert median_error(spreads) == pytest.approx(np.median(np.abs(errors)), rel=0.01)


def test_every_design_of_a_study_is_calibrated_at_the_same_blurs(study):
    """Expectation: holes of 0.3 and 0.9 have the levels of the study's camera, not steps of 1.4 and 10 px."""
    study.write_text(STUDY.replace("[0.3, 0.46]", "[0.3, 0.9]"))
    spec = load_study(str(study))
    ladders = [
        geometry.level_blur_px(designs.camera_of(spec, {"camera.stops.hole.radius_ratio": hole})) for hole in (0.3, 0.9)
    ]
    np.testing.assert_allclose(ladders[0], ladders[1], rtol=1e-12)
    np.testing.assert_allclose(ladders[0], np.arange(29) / 0.54, rtol=1e-12)


@pytest.mark.parametrize("mosaic", ["GR/BI", "RG/IB", "BI/GR", "IB/RG", "GB/RI", "GIGI/RGBG/GIGI/BGRG"])
def test_mosaics_by_their_letters_have_a_quarter_of_infrared(da_mobile, mosaic):
    """Expectation: wherever it stands, and in the 4x4 block too, infrared loses (1 - alpha^2) / 4 of the light."""
    camera = designs.with_mosaic(da_mobile, mosaic)
    assert ["".join(name[0] for name in row) for row in camera.sensor.mosaic] == mosaic.split("/")
    assert radiometry.light_loss(camera) == pytest.approx((1 - 0.46**2) / 4, abs=EDGES)


BOARD = {"distance_cm": 10.0}


DESIGNS = ({}, {"camera.lens.focal_length_mm": 8.0}, {"camera.sensor.pixel_pitch_um": 3.0}, {"distance_cm": 90.0})


def test_a_board_keeps_its_picture(tmp_path):
    """Expectation: width times f / (z p), in pixels, is that of the scene's own file, and the distance the point's."""
    (tmp_path / "s.toml").write_text('name = "board"\nscene = "staircase"\n[parameters]\ndistance_cm = [10, 90]\n')
    spec = load_study(str(tmp_path / "s.toml"))
    widths = []
    for changes in DESIGNS:
        point = BOARD | changes
        camera, (board,) = designs.camera_of(spec, point), designs.scene_of(spec, point).objects
        assert board.position_cm[2] == pytest.approx(point["distance_cm"])
        pixels = camera.lens.focal_length_mm / (camera.sensor.pixel_pitch_um * 1e-3)
        widths.append(board.size_cm[0] / board.position_cm[2] * pixels)
    assert widths == pytest.approx([12.5 / 10 * 3.6 / 1.7e-3] * len(DESIGNS))


FAR_M = 100.0


FIRST_ORDER = 0.01  # (e / d)^2 of half a pixel, at most 0.005 here, and the focus at 100 m in the place of infinity


@pytest.mark.parametrize(("name", "depth_m"), [("da-mobile", 0.1), ("da-mobile", 0.4), ("da-8mm", 0.4)])
def test_half_a_pixel_is_worth_the_depth_of_fig_13(name, depth_m):
    """Expectation: the formula is half the distance of the depths whose blur is half a pixel more and less, which is
    found by inverting the camera's blur; and the bound of a board is the median of normal errors at its one depth.
    """
    camera = cameras.cropped(cameras.refocused(cameras.load_camera(name), FAR_M), 64, 48)
    depth = np.full((48, 64), depth_m)
    exact = surfaces.truth(
        camera, geometry.blur_px(camera, depth) / geometry.level_blur_px(camera)[1], np.ones((48, 64, 4))
    )
    figures = limits(Capture(np.zeros((48, 64), np.uint16), camera, 0.01, 1.0, 0), exact, "D65", 1000.0)
    assert figures["half-pixel-m"] == pytest.approx(half_pixel_m(camera, depth_m), rel=FIRST_ORDER)
    deviation = criteria.camera_bound(camera, geometry.blur_px(camera, depth_m), light="D65", level_lux=1000.0)
    assert figures["depth-bound-m"] == pytest.approx(
        0.6745 * float(deviation[0]) / criteria.dioptre_px(camera) * depth_m**2, rel=1e-4
    )


@pytest.mark.parametrize(("level", "share"), [(10.0, 1.0), (-3.0, 0.0), (40.0, 0.0)])
def test_depth_is_scored_where_the_bank_reaches(da_mobile, level, share):
    """Set-up: a board at a level of the bank, behind the focus, and nearer than the bank's nearest; exact depth.

    Expectation: no error; none is said where the pipeline has no such depth.
    """
    camera = cameras.cropped(cameras.refocused(da_mobile, 2.0), 64, 48)
    exact = surfaces.truth(camera, np.full((48, 64), level), np.ones((48, 64, 4)))
    estimate = surfaces.exact_reconstruction(exact, camera)
    figures = depth_figures(estimate, exact)
    assert figures["in-range"] == share
    assert figures.get("depth-median", math.nan) == pytest.approx(0.0 if share else math.nan, abs=1e-9, nan_ok=True)


@pytest.mark.slow
def test_a_point_is_photographed_and_scored(study, tmp_path, renderer):
    """Set-up: one design, two levels of light, tiny. Expectation: the same picture in more light has less noise."""
    from validation.studies.sweep.point import measure

    text = STUDY.replace("[0.3, 0.46]", "[0.46]").replace("seeds = 2", "seeds = 1\nsize_px = [64, 48]\nspp = 4")
    study.write_text(text)
    spec = load_study(str(study))
    rows = measure(spec, units(spec)[0])
    dim, _, bright = (row["figures"] for row in rows)
    assert set(dim) < set(FIGURES) and json.dumps(rows)
    assert bright["infrared-snr"] > 2 * dim["infrared-snr"]
