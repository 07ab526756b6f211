"""Absorption of silicon, and the camera that it limits."""

from __future__ import annotations

import numpy as np
import pytest

import dasim
from dasim.base.errors import InputError
from dasim.camera import radiometry, response_curves, silicon
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.spectra import grid


def at(nm: float, curve: np.ndarray) -> float:
    return float(np.interp(nm, grid.WAVELENGTH_NM, curve))


def test_absorption_is_that_of_other_tables():
    """Expectation: Schinke et al. (AIP Advances 5, 067168, 2015) measured 7,850, 2,510 and 850 per cm at 532, 660 and
    800 nm; the two tables differ by up to 5 %.
    """
    alpha_per_cm = 1e4 * silicon.absorption_per_um()
    for nm, measured in ((532.0, 7850.0), (660.0, 2510.0), (800.0, 850.0)):
        assert at(nm, alpha_per_cm) == pytest.approx(measured, rel=0.05)
    assert (np.diff(alpha_per_cm) < 0).all(), "silicon becomes clearer towards the infrared"


def test_absorptance_of_two_layers_is_that_of_one():
    """Expectation: what two layers of 1 and 2 um pass is the product of what each passes (Beer and Lambert); all light
    is absorbed in 1 mm below 800 nm.
    """
    one, two, three = (1 - silicon.absorptance(thickness) for thickness in (1.0, 2.0, 3.0))
    np.testing.assert_allclose(one * two, three, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(silicon.absorptance(1000.0)[grid.WAVELENGTH_NM < 800], 1, atol=1e-6)


def test_thin_silicon_limits_the_near_infrared_alone(da_mobile):
    """Expectation: up to 646 nm the curves of da-mobile, to the last bit; beyond, all four channels smaller by one
    factor, and the clear pixel's efficiency what 3 um absorb: 0.37 at 730 and 0.23 at 800 nm.
    """
    thick, thin = (response_curves.rgb_ir_quantum_efficiency(um) for um in (None, 3.0))
    visible = grid.WAVELENGTH_NM <= 646
    np.testing.assert_array_equal(thin[:, visible], thick[:, visible])
    factor = (thin / thick)[:, ~visible]
    np.testing.assert_allclose(factor, np.broadcast_to(factor[0], factor.shape), rtol=1e-12)
    assert (factor < 1).all()
    clear = 0.58 * np.exp(-0.5 * ((grid.WAVELENGTH_NM - 610) / 254) ** 2)
    for nm, efficiency in ((730.0, 0.37), (800.0, 0.225)):
        assert at(nm, clear * thin[3] / thick[3]) == pytest.approx(efficiency, abs=0.005)
    np.testing.assert_array_equal(sensors.quantum_efficiency(dasim.load_camera("da-mobile-thin").sensor), thin)
    np.testing.assert_array_equal(sensors.quantum_efficiency(da_mobile.sensor), thick)


def test_infrared_electrons_of_the_thin_camera(da_mobile):
    """Expectation: 0.73, 0.70 and 0.79 of da-mobile's under D65, A and the energy-saving lamp, as the readme says."""
    from dasim.spectra import illuminants

    thin = dasim.load_camera("da-mobile-thin")
    for light, share in (("D65", 0.73), ("A", 0.70), ("energy-saving-3500K", 0.79)):
        power = illuminants.illuminant(light)
        both = [grid.integrate(radiometry.response(camera) * power)[3] for camera in (thin, da_mobile)]
        assert both[0] / both[1] == pytest.approx(share, abs=0.005)


def test_curves_of_ones_own_have_their_limit(da_mobile):
    data = da_mobile.sensor.model_dump()
    data["silicon_um"] = 3.0
    data["quantum_efficiency"] = {
        "wavelength_nm": [400, 420], "channels": {name: [0.1, 0.1] for name in ("R", "G", "B", "IR")}
    }  # fmt: skip
    with pytest.raises(InputError, match="silicon_um limits the bundled response curves"):
        cameras.parse(sensors.Sensor, data, "test")


def test_thin_camera_is_da_mobile_in_other_silicon(da_mobile):
    """Expectation: the camera differs in silicon, and is another sensor; in nothing else."""
    thin = dasim.load_camera("da-mobile-thin")
    keys = ("silicon_um", "depletion_um", "sensor_seed")
    changes = {key: getattr(da_mobile.sensor, key) for key in keys}
    assert thin.sensor.model_copy(update=changes) == da_mobile.sensor
    assert (thin.lens, thin.stops, thin.levels) == (da_mobile.lens, da_mobile.stops, da_mobile.levels)
