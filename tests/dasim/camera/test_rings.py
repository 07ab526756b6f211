"""Coatings off the axis: responses, crosstalk and rings against integrals on a fine grid of their own."""

from __future__ import annotations

import numpy as np
import pytest

from dasim.base.errors import InputError
from dasim.base.toml import parse
from dasim.camera import coatings, radiometry, response_curves
from dasim.camera import specification as cameras
from dasim.camera.lens import Lens
from dasim.camera.rings import at_pixels, rings, spacing_of, square_of_sine
from dasim.spectra import grid

FINE_NM = np.arange(400.0, 830.01, 0.05)
AREA = 1e-3  # of signals: the wavelength grid of 2 nm, and linear interpolation between rings
CORNER_DEG = 31.0


def fine_signal(angle_deg: float) -> np.ndarray:
    """Relative signal of R, G, B and IR of da-mobile for equal photons at an angle, from its data sheet alone."""
    factor = np.sqrt(1 - (np.sin(np.radians(angle_deg)) / 1.8) ** 2)

    def beyond(edge_nm: float) -> np.ndarray:
        return 1 / (1 + np.exp(-np.log(81) * (FINE_NM - factor * edge_nm) / 8))

    curves = np.stack(
        [np.interp(FINE_NM, grid.WAVELENGTH_NM, row) for row in response_curves.rgb_ir_quantum_efficiency()]
    )
    disc = (1 - beyond(650)) + 0.46**2 * beyond(650)
    return (curves * disc * (1 - beyond(810))).sum(axis=1)


def signal(response: np.ndarray) -> np.ndarray:
    return np.asarray(grid.integrate(response / grid.photons_per_joule()))


@pytest.mark.parametrize("angle_deg", [0.0, 8.5, 25.6, CORNER_DEG])
def test_signals_are_those_of_the_shifted_edges(da_mobile, angle_deg):
    """Expectation: what each channel keeps of its signal on the axis, by an integral at 0.05 nm."""
    kept = signal(radiometry.response(da_mobile, angle_deg)) / signal(radiometry.response(da_mobile))
    np.testing.assert_allclose(kept, fine_signal(angle_deg) / fine_signal(0.0), rtol=AREA)


def test_edges_lie_where_thin_films_put_them(da_mobile):
    """Expectation: 650 and 810 nm become 631 and 786 nm at 25.6 degrees, 623 and 776 nm at 31 degrees."""
    for angle_deg, edge_nm, cutoff_nm in ((25.6, 631, 786), (31.0, 623, 776)):
        assert cameras.near_infrared_nm(da_mobile, angle_deg) == pytest.approx((edge_nm, cutoff_nm), abs=0.5)


def test_crosstalk_of_red_grows_off_the_axis(da_mobile):
    """Expectation: as areas of the bundled curves between the shifted edges, at 0.05 nm; the axis is eq. (8)."""
    curves = response_curves.rgb_ir_quantum_efficiency()[[0, 3]]
    for angle_deg in (0.0, 25.6, CORNER_DEG):
        low, high = cameras.near_infrared_nm(da_mobile, angle_deg)
        nm = np.linspace(low, high, 4000)
        passed = 1 / (1 + np.exp(np.log(81) * (nm - high) / 8))
        red, infrared = (np.trapezoid(np.interp(nm, grid.WAVELENGTH_NM, row) * passed, nm) for row in curves)
        assert cameras.crosstalk(da_mobile, angle_deg)[0] == pytest.approx(red / infrared, rel=AREA)
    assert cameras.crosstalk(da_mobile, CORNER_DEG)[0] > 1.2 * cameras.crosstalk(da_mobile)[0]


def test_interpolated_rings_have_the_signal_of_every_angle(da_mobile):
    """Expectation: linear interpolation between rings gives each pixel the signal of its own angle."""
    angles, place = rings(da_mobile)
    of_rings = np.stack([signal(radiometry.response(da_mobile, angle)) for angle in angles])
    chosen = [(0, 0), (100, 300), (768, 1024), (768, 40), (500, 1500)]
    for row, column in chosen:
        angle = float(np.degrees(np.arcsin(np.sqrt(square_of_sine(da_mobile)[row, column]))))
        expected = signal(radiometry.response(da_mobile, angle))
        np.testing.assert_allclose(at_pixels(of_rings, place[row, column]), expected, rtol=AREA)


def test_no_edge_moves_by_more_than_half_its_width_between_rings(da_mobile):
    angles, _ = rings(da_mobile)
    edges = np.array([cameras.near_infrared_nm(da_mobile, angle)[1] for angle in angles])
    steps = -np.diff(edges)
    assert steps.max() == pytest.approx(4.0, rel=0.05) and len(angles) == 10


def test_a_crop_sees_what_the_frame_sees_there(da_mobile):
    """Expectation: the same rings, and the same place among them."""
    crop = cameras.cropped(da_mobile, 512, 384)
    angles, place = rings(crop)
    whole_angles, whole_place = rings(da_mobile)
    np.testing.assert_array_equal(place, whole_place[576:960, 768:1280])
    np.testing.assert_array_equal(angles, whole_angles[: len(angles)])


def test_coatings_of_index_0_do_not_shift(da_mobile):
    """Expectation: one ring, and the responses of the axis at every angle."""
    lens = da_mobile.lens.model_copy(update={"coating_index": 0.0})
    sensor = da_mobile.sensor.model_copy(update={"coating_index": 0.0})
    camera = da_mobile.model_copy(update={"lens": lens, "sensor": sensor})
    np.testing.assert_array_equal(radiometry.response(camera, CORNER_DEG), radiometry.response(da_mobile))
    np.testing.assert_array_equal(cameras.crosstalk(camera, CORNER_DEG), cameras.crosstalk(da_mobile))
    assert np.isinf(spacing_of(camera)) and len(rings(camera).angle_deg) == 1
    assert coatings.edge_factor(0.0, 80.0) == 1.0


@pytest.mark.parametrize("index", [1.0, -1.8, 5.0])
def test_impossible_index_is_refused(da_mobile, index):
    changed = da_mobile.lens.model_dump() | {"coating_index": index}
    with pytest.raises(InputError, match="coating_index: must be an effective index"):
        parse(Lens, changed, "lens")
