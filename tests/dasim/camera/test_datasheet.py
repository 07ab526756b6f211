"""A sensor described by its EMVA 1288 data sheet: units, the saturation capacity, what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from dasim.base.errors import InputError
from dasim.camera import datasheet, diffusion, noise, radiometry, response_curves, specification
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.spectra import grid


def test_saturation_capacity_is_where_the_variance_peaks():
    """Expectation: for equal pixels d/dm (m g(x)) = 0, with g' = 2 Q (x Phi + phi), the derivative of the variance of
    a normal variable cut off at x; and the full well comes back from the capacity.
    """

    def slope(mean, well):
        x = (well - mean) / np.sqrt(mean)
        q = ndtr(-x)
        g = ndtr(x) + x**2 * q - x * norm.pdf(x) - (x * q - norm.pdf(x)) ** 2
        return g - 2 * q * (x * ndtr(x) + norm.pdf(x)) * (np.sqrt(mean) + x / 2)

    for well in (1_000.0, 6_000.0, 100_000.0):
        peak, step = datasheet.saturation_capacity_e(well, 0.0), well / 2000
        assert slope(peak - step, well) > 0 > slope(peak + step, well)
        for prnu in (0.0, 0.01, 0.5):
            capacity = datasheet.saturation_capacity_e(well, prnu)
            assert datasheet.full_well_of_capacity_e(capacity, prnu) == pytest.approx(well, rel=1e-3)


def sheet(camera, table, *, without=()):
    data = camera.sensor.model_dump(exclude=set(without))
    return cameras.parse(cameras.Camera, camera.model_dump() | {"sensor": data | {"emva1288": table}}, "mine.toml")


def test_figures_in_their_units(da_mobile):
    """Expectation: percent become shares, a dark current of 80 e-/s at 46 C is 10 at 25 C (three doublings of 7 K),
    a quantum efficiency at 560 nm scales all curves by its ratio to green there, without crosstalk between pixels, and
    the response with them.
    """
    table = {"prnu1288_percent": 0.4, "dark_current_e_s": 80.0, "dark_current_temperature_c": 46.0}
    table |= {"quantum_efficiency_percent": 60.0, "wavelength_nm": 560.0}
    others = ("prnu", "dark_current_e_s", "quantum_efficiency_scale")
    apart = da_mobile.model_copy(update={"sensor": da_mobile.sensor.model_copy(update={"electronic_crosstalk": 0.0})})
    loaded = sheet(apart, table, without=others)
    green = np.interp(560.0, grid.WAVELENGTH_NM, response_curves.rgb_ir_quantum_efficiency()[1])
    assert loaded.sensor.prnu == pytest.approx(0.004)
    assert loaded.sensor.dark_current_e_s == pytest.approx(10.0)
    assert loaded.sensor.quantum_efficiency_scale == pytest.approx(0.6 / green)
    np.testing.assert_allclose(radiometry.response(loaded), radiometry.response(da_mobile) * 0.6 / green, rtol=1e-12)


@pytest.mark.parametrize("value", ["silicon", 0.05])
def test_quantum_efficiency_is_that_of_pixels_among_their_neighbours(da_mobile, value):
    """Rationale: a bench measures what pixels collect, after some of their electrons have changed places.

    Set-up: crosstalk between pixels, and a sheet with 48 % for green at 560 nm; 1,000 photons of that wavelength on
    each pixel of the sensor, and electrons that move. Expectation: green pixels hold 480 electrons.
    """
    table = {"quantum_efficiency_percent": 48.0, "wavelength_nm": 560.0}
    changed = da_mobile.model_copy(
        update={"sensor": da_mobile.sensor.model_copy(update={"electronic_crosstalk": value})}
    )
    camera = specification.cropped(sheet(changed, table, without=("quantum_efficiency_scale",)), 16, 16)
    index = int(np.argmin(np.abs(grid.WAVELENGTH_NM - 560.0)))
    channel = specification.mosaic_channels(camera)
    generated = 1000 * sensors.quantum_efficiency(camera.sensor)[channel, index]
    shares = (np.full(channel.shape, share[index]) for share in sensors.spectral_shares(camera.sensor))
    green = diffusion.spread(generated, *shares)[2:-2:2, 2:-2:2]
    np.testing.assert_allclose(green, 480.0, rtol=1e-9)


def test_system_gain_sets_the_numbers(da_mobile):
    """Set-up: 0.1 DN per electron, or 10 electrons per DN; 1,023 - 64 = 959 DN above black are 9,590 electrons.

    Expectation: 1,000 electrons are 100 DN. The well of 6,000 electrons is full first, at 664 DN, and from gain 2 on
    the converter, at 4,795 electrons; automatic exposure aims below whichever comes first.
    """
    model = sheet(da_mobile, {"overall_system_gain_dn_per_e": 0.1}, without=("dn_per_e",)).sensor
    model = model.model_copy(update={"electronic_crosstalk": 0.0})
    raw, full = noise.expose(np.array([[0.0, 1000.0, 6000.0, 9000.0]]), model, 1.0, 0, noise="off")
    assert raw.tolist() == [[64, 164, 664, 664]] and full == 2
    assert noise.saturation_e(model) == 6000 and noise.saturation_e(model, 2.0) == pytest.approx(4795)
    camera = cameras.cropped(da_mobile.model_copy(update={"sensor": model}), 8, 8)
    for gain, top in ((1.0, 6000.0), (2.0, 4795.0)):
        time_s = noise.auto_exposure_s(np.full((8, 8, 4), 100.0), camera, noise.Exposure(gain=gain))
        assert 100 * time_s == pytest.approx(0.85 * top)


@pytest.mark.parametrize(
    ("table", "without", "message"),
    [
        (
            {"temporal_dark_noise_e": 3},
            (),
            ["sensor: ", "emva1288.temporal_dark_noise_e and read_noise_e", "two spell"],
        ),
        ({"dark_current_e_s": 3}, (), ["emva1288.dark_current_e_s and dark_current_e_s"]),
        ({"read_noise_e": 3}, (), ["sensor.emva1288.read_noise_e: unknown key"]),
        ({"prnu1288_percent": 80}, ("prnu",), ["sensor.emva1288.prnu1288_percent", "(is 80)"]),
        ({"wavelength_nm": 530}, (), ["sensor.emva1288", "wavelength_nm says nothing without quantum_efficiency"]),
        (
            {"quantum_efficiency_percent": 80, "wavelength_nm": 620},
            ("quantum_efficiency_scale",),
            ["sensor: ", "quantum_efficiency_scale", "at most 1"],
        ),
        ({"saturation_capacity_e": "many"}, ("full_well_e",), ["sensor.emva1288.saturation_capacity_e", "many"]),
        (5, (), ["sensor.emva1288"]),
    ],
)
def test_what_is_wrong_in_a_data_sheet_is_named(da_mobile, table, without, message):
    with pytest.raises(InputError) as caught:
        sheet(da_mobile, table, without=without)
    assert "\n" not in str(caught.value)
    for part in ("mine.toml", *message):
        assert part in str(caught.value)


def test_curves_of_a_file_get_their_height_from_the_sheet(da_mobile, tmp_path):
    """Set-up: the bundled curves, relative to the highest, in a CSV file from 350 to 1,000 nm, beside a sheet with 60 %
    for green at 540 nm. Expectation: green has 60 % there, all channels keep their ratios, and what the file says
    beyond the simulated band plays no part; without green pixels the sheet's figure is refused.
    """
    ours = response_curves.rgb_ir_quantum_efficiency()
    nm = np.concatenate([[350.0, 380.0], grid.WAVELENGTH_NM, [850.0, 1000.0]])
    for head in ("wavelength_nm,R,G,B,IR", "wavelength_nm,R,L,B,IR"):
        curves = [np.concatenate([[0.9, c[0]], c, [c[-1], 0.9]]) for c in ours / ours.max()]
        rows = [",".join(f"{value:.9f}" for value in row) for row in np.transpose([nm, *curves])]
        (tmp_path / f"{head[16:17]}.csv").write_text("\n".join([head, *rows]) + "\n")
    data = da_mobile.model_dump()
    del data["sensor"]["quantum_efficiency_scale"]
    data["sensor"]["emva1288"] = {"quantum_efficiency_percent": 60.0, "wavelength_nm": 540.0}
    data["sensor"]["quantum_efficiency"] = {"file": "G.csv"}
    efficiency = sensors.quantum_efficiency(cameras.parse(cameras.Camera, data, "mine.toml", folder=tmp_path).sensor)
    green = np.interp(540.0, grid.WAVELENGTH_NM, ours[1])
    np.testing.assert_allclose(efficiency, ours * 0.6 / green, atol=1e-8)  # the file's nine digits
    data["sensor"] |= {"mosaic": [["L", "R"], ["B", "IR"]], "quantum_efficiency": {"file": "L.csv"}}
    with pytest.raises(InputError, match="the mosaic has no channel G"):
        cameras.parse(cameras.Camera, data, "mine.toml", folder=tmp_path)
