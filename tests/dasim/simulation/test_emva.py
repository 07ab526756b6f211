"""Frames of ``dasim emva`` before the public EMVA 1288 reference analyser, and its data sheet back into a camera."""

from __future__ import annotations

import json
import logging
import tomllib

import numpy as np
import pytest

from dasim.camera import datasheet, noise, response_curves
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.cli import run
from dasim.simulation import emva
from dasim.spectra import grid

# Limits of the figures. With 65,536 pixels a pair's variance is known to sqrt(2 / 65,536) = 0.55 %; the gain, from the
# 54 pairs below 70 % of saturation, to 0.1 %; a pattern of 65,536 values to 0.28 %; the read noise, from 80 dark pairs,
# to 0.1 %, and rounding's 1/12 holds to 0.3 % of it at 0.48 DN. So all these limits are ten sigma and more. The
# saturation capacity is the place of a flat maximum among steps of 1.3 %: 2,000 ladders drawn at random placed it with
# a standard deviation of 0.5 %.
GAIN_LIMIT = 0.02
READ_NOISE_LIMIT = 0.05
SATURATION_LIMIT = 0.02
PATTERN_LIMIT = 0.05
DARK_CURRENT_LIMIT = 0.05  # 10 electrons at the longest exposure, each mean known to 0.01: 0.1 %
EFFICIENCY_LIMIT = 0.02  # responsivity over gain

# The analyser leaves the descriptor's closing to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")


@pytest.fixture(scope="module")
def analyse():
    """The reference analyser's results of a measurement, without its plots and report.

    It calls ``np.asfarray``, which numpy 2 dropped; numpy's migration guide names the replacement that is set here.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(np, "asfarray", lambda values: np.asarray(values, dtype=float), raising=False)
        from emva1288 import process

        def results(folder):
            quiet = {"loglevel": logging.ERROR}
            described = process.ParseEmvaDescriptorFile(str(folder / "descriptor.txt"), **quiet)
            loaded = process.LoadImageData(described.images, **quiet)
            return process.Results1288(process.Data1288(loaded.data, **quiet).data, **quiet)

        yield results


def with_sensor(camera, **changes):
    changed = cameras.parse(sensors.Sensor, camera.sensor.model_dump() | changes, "test sensor")
    return camera.model_copy(update={"sensor": changed})


@pytest.fixture(scope="module")
def cases(da_mobile):
    """The paper's camera; a large pixel behind a better converter, warm, with crosstalk, seen through its IR; and the
    paper's without crosstalk.
    """
    large = with_sensor(
        da_mobile,
        full_well_e=20_000,
        read_noise_e=6.0,
        dsnu_e=9.0,
        prnu=0.006,
        dark_current_e_s=20.0,
        temperature_c=39.0,
        adc_bits=12,
        black_level_dn=200,
        dn_per_e=0.15,
        quantum_efficiency_scale=1.2,
        electronic_crosstalk=0.03,
    )
    apart = with_sensor(da_mobile, electronic_crosstalk=0.0)
    return {"da-mobile": (da_mobile, "G"), "large": (large, "IR"), "apart": (apart, "G")}


@pytest.fixture(scope="module")
def measured(cases, analyse, tmp_path_factory):
    """The analyser's results by the case's name, each measured once."""
    done = {}

    def of(name):
        if name not in done:
            camera, channel = cases[name]
            folder = tmp_path_factory.mktemp("emva") / name
            assert emva.write_measurement(folder, camera, channel=channel, seed=1) == []
            done[name] = analyse(folder)
        return done[name]

    return of


@pytest.mark.slow
@pytest.mark.parametrize("name", ["da-mobile", "large"])
def test_reference_analyser_recovers_the_sensor(cases, measured, name):
    """Rationale: the sensor's noise, judged by a tool that shares no line with it.

    Set-up: 80 steps from dark to past saturation, bright and dark pairs of 256 x 256 pixels, noise on; stacks of 64.
    Expectation: gain, temporal dark noise, PRNU and dark current (doubled every 7 K above 25 C) are the
    specification's; DSNU is that of pixels, rows, columns and the dark current of the spatial measurement's exposure,
    squares added. The full well is the signal of the last step, where every well is full, in electrons by the
    analyser's gain; the standard's own saturation capacity lies three standard deviations lower, where
    ``saturation_capacity_e`` says.
    """
    model, result = cases[name][0].sensor, measured(name)
    signal_dn = result.temporal["u_y"] - result.temporal["u_ydark"]
    assert result.K == pytest.approx(1 / noise.electrons_per_dn(model), rel=GAIN_LIMIT)
    assert result.sigma_d == pytest.approx(model.read_noise_e, rel=READ_NOISE_LIMIT)
    assert signal_dn[-1] / result.K == pytest.approx(model.full_well_e, rel=SATURATION_LIMIT)
    capacity_e = datasheet.saturation_capacity_e(model.full_well_e, model.prnu)
    assert capacity_e < 0.98 * model.full_well_e
    assert result.u_e_sat == pytest.approx(capacity_e, rel=SATURATION_LIMIT)
    assert result.PRNU1288 == pytest.approx(100 * model.prnu, rel=PATTERN_LIMIT)
    warm = 2 ** ((model.temperature_c - 25) / 7)
    ladder = emva.plan(*cases[name])
    dark_e = model.dark_current_e_s * warm * ladder.exposure_s[ladder.stack_step]
    parts = (model.dsnu_e, model.row_noise_e, model.column_noise_e, model.dark_current_spread * dark_e)
    assert result.DSNU1288 == pytest.approx(np.linalg.norm(parts), rel=PATTERN_LIMIT)
    assert result.u_I_mean == pytest.approx(model.dark_current_e_s * warm, rel=DARK_CURRENT_LIMIT)
    assert result.u_I_var == pytest.approx(model.dark_current_e_s * warm, rel=DARK_CURRENT_LIMIT)


@pytest.mark.slow
def test_quantum_efficiency_is_that_of_the_pixel_among_its_neighbours(cases, measured):
    """Expectation: green at its peak as the curve says, where nothing leaves a pixel; the infrared pixel of the large
    sensor, at its peak, keeps 88 % of its own electrons and gets 3 % of each neighbour's: red above and below, blue
    left and right (the mosaic is G R over B IR).
    """
    curves = response_curves.rgb_ir_quantum_efficiency()
    assert measured("apart").QE == pytest.approx(100 * curves[1].max(), rel=EFFICIENCY_LIMIT)
    model = cases["large"][0].sensor
    passed = curves * grid.short_pass(model.cutoff_nm, model.cutoff_width_nm)
    red, _, blue, infrared = 1.2 * passed[:, np.argmax(passed[3])]
    expected = 0.88 * infrared + 0.03 * (2 * red + 2 * blue)
    assert measured("large").QE == pytest.approx(100 * expected, rel=EFFICIENCY_LIMIT)


def test_gain_shows_a_read_noise_that_rounding_hides(da_mobile, analyse, tmp_path):
    """Set-up: 0.8 electrons of read noise, 0.13 DN at gain 1 and 1.0 DN at gain 8.

    Expectation: at gain 1 the note says so, and the analyser reports its lower limit, 2.5 electrons; at gain 8 the
    note says that the converter limits the saturation, and the read noise is right, also that of 64 x 64 pixels:
    80 pairs know it to 0.25 %.
    """
    quiet = with_sensor(da_mobile, read_noise_e=0.8)
    notes = emva.write_measurement(tmp_path / "low", quiet, size_px=(64, 64))
    assert len(notes) == 1 and "rounding hides it" in notes[0] and "--gain" in notes[0]
    assert analyse(tmp_path / "low").sigma_d > 2
    notes = emva.write_measurement(tmp_path / "high", quiet, gain=8.0, size_px=(64, 64))
    assert len(notes) == 1 and "converter is full before the well" in notes[0]
    result = analyse(tmp_path / "high")
    assert result.sigma_d == pytest.approx(0.8, rel=READ_NOISE_LIMIT)
    assert result.K == pytest.approx(8 * 959 / 6000, rel=GAIN_LIMIT)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["da-mobile", "apart"])
def test_data_sheet_round_trip(cases, measured, tmp_path, name):
    """Rationale: a data sheet is a way to describe one's own sensor.

    Set-up: the analyser's figures of da-mobile, with and without crosstalk between pixels, to four digits as sheets
    print them, in a table [sensor.emva1288] instead of the electrical values; dark current as if measured at 25 C.
    Expectation: the same sensor.
    """
    result, (camera, _) = measured(name), cases[name]
    figures = {
        "overall_system_gain_dn_per_e": result.K,
        "temporal_dark_noise_e": result.sigma_d,
        "saturation_capacity_e": result.u_e_sat,
        "dsnu1288_e": result.DSNU1288,
        "prnu1288_percent": result.PRNU1288,
        "dark_current_e_s": result.u_I_mean,
        "doubling_temperature_k": 7.0,
        "quantum_efficiency_percent": result.QE,
    }
    electrical = ("full_well_e", "read_noise_e", "dark_", "dsnu_e", "prnu")  # DSNU1288 is that of rows and columns too
    lines = (cameras.CAMERA_DIR / "da-mobile.toml").read_text().splitlines()
    lines += ["electronic_crosstalk = 0.0"] if name == "apart" else []
    table = ["[sensor.emva1288]", *(f"{key} = {value:.4g}" for key, value in figures.items())]
    path = tmp_path / "mine.toml"
    path.write_text("\n".join([line for line in lines if not line.startswith(electrical)] + table))
    loaded, model = cameras.load_camera(path).sensor, camera.sensor
    assert "full_well_e" not in tomllib.loads(path.read_text())["sensor"]
    assert noise.electrons_per_dn(loaded) == pytest.approx(noise.electrons_per_dn(model), rel=GAIN_LIMIT)
    assert loaded.read_noise_e == pytest.approx(model.read_noise_e, rel=READ_NOISE_LIMIT)
    assert loaded.full_well_e == pytest.approx(model.full_well_e, rel=SATURATION_LIMIT)
    assert loaded.dsnu_e == pytest.approx(model.dsnu_e, rel=PATTERN_LIMIT)
    assert loaded.prnu == pytest.approx(model.prnu, rel=PATTERN_LIMIT)
    assert loaded.dark_current_e_s == pytest.approx(model.dark_current_e_s, rel=DARK_CURRENT_LIMIT)
    assert loaded.quantum_efficiency_scale == pytest.approx(1.0, rel=EFFICIENCY_LIMIT)
    rest = {"dn_per_e", "read_noise_e", "full_well_e", "dsnu_e", "prnu", "dark_current_e_s", "quantum_efficiency_scale"}
    rest |= {"row_noise_e", "column_noise_e", "sensor_seed"}
    assert loaded.row_noise_e == loaded.column_noise_e == 0
    assert loaded.model_dump(exclude=rest) == model.model_dump(exclude=rest)


# --- the command ---------------------------------------------------------------------------------


def test_command_writes_what_it_says(tmp_path, monkeypatch, capsys):
    """Expectation: frames, descriptor and meta.json, the same bytes for the same seed, replaced as a whole."""
    monkeypatch.chdir(tmp_path)
    arguments = ["emva", "--camera", "da-mobile", "--size", "16x12", "--channel", "B", "--out"]
    assert run([*arguments, "one"]) == 0 and run([*arguments, "two"]) == 0
    assert "one/descriptor.txt" in capsys.readouterr().out
    first, second = (
        {p.name: p.read_bytes() for p in sorted((tmp_path / n / "frames").iterdir())} for n in ("one", "two")
    )
    assert first == second and len(first) == 4 * emva.STEPS + 2 * emva.STACK_FRAMES
    assert run([*arguments, "two", "--seed", "1"]) == 0
    assert {p.name for p in (tmp_path / "two").iterdir()} == {"meta.json", "descriptor.txt", "frames"}
    changed = {p.name: p.read_bytes() for p in (tmp_path / "two" / "frames").iterdir()}
    assert sum(changed[name] == first[name] for name in first) == 0
    steps = json.loads((tmp_path / "one" / "meta.json").read_text())["steps"]
    assert steps[0]["saturated_pixels"] == 0 and steps[-2]["saturated_pixels"] > 0.99 * 2 * 16 * 12


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--channel", "X"), ("--channel 'X'", "R, G, B, IR")),
        (("--gain", "0"), ("--gain", "0.0625")),
        (("--size", "4x4"), ("4x4", "8x8", "2048x1536")),
        (("--size", "big"), ("--size 'big'", "WxH")),
        (("--seed", "-1"), ("seed", "-1")),
        (("--camera", "leica"), ("leica", "da-mobile")),
    ],
)
def test_wrong_options_are_refused(tmp_path, capsys, options, message):
    assert run(["emva", "--out", str(tmp_path / "new"), *options]) == 2
    printed = capsys.readouterr().err
    assert len(printed.splitlines()) == 1 and all(part in printed for part in message), printed
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dark_current_e_s": 1e9, "temperature_c": 150.0}, None),
        ({"black_level_dn": 0}, "dark pixels are clipped at 0 DN"),
        ({"full_well_e": 1.0}, None),
        ({"prnu": 0.5, "read_noise_e": 1e6}, "dark pixels are clipped"),
        ({"prnu": 0, "dsnu_e": 0, "read_noise_e": 0, "dark_current_e_s": 0}, "rounding hides"),
    ],
)
def test_odd_but_legal_sensors_finish_and_say_so(da_mobile, tmp_path, changes, message):
    notes = emva.write_measurement(tmp_path / "odd", with_sensor(da_mobile, **changes), size_px=(8, 8))
    assert message is None or any(message in note for note in notes), notes
