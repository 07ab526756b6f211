"""Uses at the edge: threads of one process, stops without light, blur of a thousand pixels."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from dasim.camera import specification as cameras
from dasim.camera.dotted_keys import with_values
from dasim.simulation.simulate import simulate

RENDER_NOISE = 0.02  # 8 samples per pixel on a smooth wall under a dome
DOME = {"kind": "dome", "illuminant": "D55", "lux": 400.0}


@pytest.mark.slow
def test_threads_take_turns(da_mobile, renderer):
    """Rationale: the renderer has one state for a process; two threads within it end the process."""
    camera = cameras.cropped(da_mobile, 32, 24)
    with ThreadPoolExecutor(3) as pool:
        shots = list(pool.map(lambda seed: simulate("flat", camera, seed=seed, spp=4), [0, 1, 0]))
    assert np.array_equal(shots[0].capture.raw_dn, shots[2].capture.raw_dn)
    assert not np.array_equal(shots[0].capture.raw_dn, shots[1].capture.raw_dn)


@pytest.mark.slow
def test_a_stop_without_light_leaves_the_truth_of_the_others(renderer, da_mobile):
    """Set-up: ideal edges, and a sensor that is cut off where the hole begins to pass light."""
    stops = [stop.model_copy(update={"edge_width_nm": 0.1}) for stop in da_mobile.stops]
    camera = cameras.cropped(da_mobile.model_copy(update={"stops": tuple(stops)}), 32, 24)
    camera = with_values(camera, {"sensor.cutoff_nm": 620.0, "sensor.cutoff_width_nm": 0.1})
    truth = simulate("flat", camera, spp=16, diffraction="off").truth
    mean, sharp = (picture[..., :3].mean(axis=(0, 1), dtype=float) for picture in (truth.mean_e, truth.sharp_e))
    np.testing.assert_allclose(sharp, mean, rtol=0.1)
    assert truth.sharp_srgb.max() > 0.1


@pytest.mark.slow
def test_blur_of_a_thousand_pixels(jit, make_scene, da_mobile):
    """Set-up: a lens of 100 mm, focused at 5 m, in front of a wall at 40 cm. Expectation: as much light as sharp."""
    wall = {"name": "wall", "shape": "plane", "size_cm": (60, 60), "position_cm": (0, 0, 40), "material": "sand"}
    lens = {"lens.focal_length_mm": 100.0, "lens.f_number": 4.0, "lens.focus_distance_m": 5.0}
    camera = with_values(cameras.cropped(da_mobile, 32, 24), lens)
    truth = simulate(make_scene(wall, lights=[DOME]), camera, spp=8).truth
    assert truth.blur_px.min() > 1000
    mean, sharp = (picture.mean(axis=(0, 1), dtype=float) for picture in (truth.mean_e, truth.sharp_e))
    np.testing.assert_allclose(mean, sharp, rtol=RENDER_NOISE)
