"""Values print as one line that says what they hold."""

import dataclasses

import numpy as np
import pytest

import recon
from dasim.values import Capture, DepthEstimate
from tests.support import surfaces


@pytest.fixture
def truth(da_mobile):
    level = np.full((4, 6), 2.0)
    return surfaces.truth(da_mobile, level, np.ones((4, 6, 4)))


def test_a_capture_names_size_camera_exposure_and_light(da_mobile):
    capture = Capture(np.zeros((4, 6), np.uint16), da_mobile, 0.02, 2.0, 7, "D65")
    focus = f"{da_mobile.lens.focus_distance_m:g}"
    assert repr(capture) == f"Capture(6 x 4 px, da-mobile focused at {focus} m, 0.02 s, gain 2, seed 7, light D65)"


def test_a_truth_and_a_reconstruction_name_their_depths(truth, da_mobile):
    depth = f"depth {truth.depth_m[0, 0]:.3g} to {truth.depth_m[0, 0]:.3g} m"
    assert repr(truth) == f"Truth(6 x 4 px, {depth}, 0 objects, channels R G B IR)"
    result = dataclasses.replace(surfaces.exact_reconstruction(truth, da_mobile), settings={"score": "bands"})
    assert depth in repr(result) and repr(result).endswith("light D55, score bands)")
    assert repr(dataclasses.replace(result, method="mine:f")).endswith("method mine:f)")


def test_a_truth_without_surfaces_has_no_depth(truth):
    empty = dataclasses.replace(truth, valid=np.zeros((4, 6), bool), depth_m=np.full((4, 6), np.nan, np.float32))
    assert "no depth" in repr(empty)


def test_an_estimate_names_its_coverage():
    level = np.array([[1.0, np.nan], [3.0, 2.5]])
    assert (
        repr(DepthEstimate(level=level))
        == "DepthEstimate(2 x 2 px, level 1 to 3, coverage 75.0%, unknown sd, side assumed)"
    )


def test_a_bank_names_levels_and_lights(da_mobile):
    kernel = np.ones((2, 3, 4, 1, 1), np.float32)
    ones = np.ones((2, 4), np.float32)
    depths = np.array([0.4, 0.3, 0.2], np.float32)
    bank = recon.PsfBank(kernel, ("D65", "A"), ones, depths, depths, da_mobile, "wave")
    assert "3 levels, depth 0.2 to 0.4 m, lights D65, A, kernels of 1 px, wave" in repr(bank)
