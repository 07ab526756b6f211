"""From measurements of a camera to a scored depth map, with files and commands only, as a user works.

No real camera of this kind was available. The "hardware" is a simulated one that differs from every bundled camera in
the quantities that a user measures; the test uses nothing of it but the files.
"""

from __future__ import annotations

import csv
import itertools
import json

import numpy as np
import pytest

import dasim
from dasim.camera import radiometry, response_curves
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera.datasheet import saturation_capacity_e
from dasim.cli import run
from dasim.files.banks import load_bank
from dasim.files.png import write_png16
from dasim.simulation import calibration
from dasim.spectra import grid, illuminants
from recon.files import point_table
from recon.files.reconstruction import load_reconstruction
from recon.levels import level_of

LIGHT = "D55"
LEVELS = 8  # the scene lies at 2.5 and 6.2
SIZE = (160, 112)
GAIN_DN_PER_E, FULL_WELL_E, DARK_NOISE_E, BLACK_DN = 0.31, 11_000.0, 5.5, 168
SENSOR_TOLERANCE = 1e-4  # the saturation capacity is written to a tenth of an electron
# Straight lines between points h = 5 nm apart miss h^2 / 8 of the largest bend: of an edge, a logistic that rises
# over 14 nm, 0.0962 (ln 81 / 14 nm)^2 of its height.
CURVE_TOLERANCE = 5**2 / 8 * 0.0962 * (np.log(81) / 14) ** 2
# White of the bank against the spectra: the tails of weak pictures, as of the bank in memory.
WHITE_TOLERANCE = 0.06
# Mean of the reconstructed infrared over the true one: PRNU, noise reduction and the blur of the borders.
ELECTRONS_TOLERANCE = 0.05
MEDIAN_LEVELS = 1.0  # of the regularised depth at textured pixels; the scene's halves are 3.7 apart

SHEET = f"""
name = "bench camera"

[lens]
focal_length_mm = 3.6
f_number = 2.8
focus_distance_m = 0.4

[[stops]]
name = "open"
radius_ratio = 1.0
passes_nm = [[400, 655]]
edge_width_nm = 10

[[stops]]
name = "hole"
radius_ratio = 0.46
passes_nm = [[655, 830]]
edge_width_nm = 10

[sensor]
width_px = {SIZE[0]}
height_px = {SIZE[1]}
pixel_pitch_um = 1.7
mosaic = [["G", "R"], ["B", "IR"]]
cutoff_nm = 800
cutoff_width_nm = 8
adc_bits = 12
black_level_dn = {BLACK_DN}
quantum_efficiency = {{ file = "response.csv" }}

[sensor.emva1288]
overall_system_gain_dn_per_e = {GAIN_DN_PER_E}
temporal_dark_noise_e = {DARK_NOISE_E}
saturation_capacity_e = {saturation_capacity_e(FULL_WELL_E, 0.006):.1f}
dsnu1288_e = 1.5
prnu1288_percent = 0.6
dark_current_e_s = 64.0
dark_current_temperature_c = 46.0
doubling_temperature_k = 7.0
quantum_efficiency_percent = 48.0
wavelength_nm = 540
"""


def curves() -> np.ndarray:
    """Quantum efficiency of the hardware, [channel, wavelength]; red falls off towards the near-infrared."""
    ours = response_curves.rgb_ir_quantum_efficiency()
    fall = np.interp(grid.WAVELENGTH_NM, [600.0, 830.0], [1.0, 0.6])
    changed = ours * np.array([[0.8], [1.0], [1.25], [1.0]]) * fall
    green = np.interp(540.0, grid.WAVELENGTH_NM, changed[1])
    return changed * 0.48 / green


@pytest.fixture(scope="module")
def hardware():
    """The camera, of which the user has only the files."""
    data = cameras.load_camera("da-mobile").model_dump()
    for stop, band in zip(data["stops"], ((400.0, 655.0), (655.0, 830.0)), strict=True):
        stop |= {"passes_nm": (band,), "edge_width_nm": 10.0}
    table = dict(zip(grid.CHANNELS, (tuple(curve.tolist()) for curve in curves()), strict=True))
    data["sensor"] |= {
        "width_px": SIZE[0], "height_px": SIZE[1], "cutoff_nm": 800.0, "adc_bits": 12, "black_level_dn": BLACK_DN,
        "dn_per_e": GAIN_DN_PER_E, "full_well_e": FULL_WELL_E, "read_noise_e": DARK_NOISE_E, "dsnu_e": 1.5,
        "prnu": 0.006, "dark_current_e_s": 8.0,
        "quantum_efficiency": {"wavelength_nm": tuple(grid.WAVELENGTH_NM.tolist()), "channels": table},
    }  # fmt: skip
    return cameras.parse(cameras.Camera, data | {"name": "hardware"}, "hardware")


def write_response(path):
    """Write response curves relative to their peak, every 5 nm from 350 to 1,000 nm, as they are usually published."""
    nm = np.arange(350.0, 1000.1, 5.0)
    rows = [np.interp(nm, grid.WAVELENGTH_NM, curve) / curves().max() for curve in curves()]
    with path.open("w", newline="") as file:
        file.write("# relative response, monochromator\n")
        writer = csv.writer(file)
        writer.writerow(["wavelength_nm", "B", "G", "R", "IR"])
        writer.writerows(
            [[f"{value:.6f}" for value in row] for row in zip(nm, *(rows[k] for k in (2, 1, 0, 3)), strict=True)]
        )


def write_pictures(folder, hardware):
    """Write raw 12-bit files of a pinhole lit by one lamp, at four places per level."""
    captures = calibration.calibration_captures(hardware, (LIGHT,))
    rows = []
    folder.mkdir()
    for number, picture in enumerate(itertools.takewhile(lambda p: p.level < LEVELS, captures)):
        for frame, raw in enumerate(picture.frames_dn):
            name = f"p{number:04d}-{frame}.npy"
            np.save(folder / name, raw)
            place = "abcd"[2 * picture.shift_px[0] + picture.shift_px[1]]
            rows.append([name, LIGHT, f"{picture.depth_m:.4f}", picture.exposure_s, place])
    with (folder / "captures.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["file", "light", "depth_m", "exposure_s", "position"], *rows])


def packed12(raw):
    """MIPI RAW12: two high bytes, then both low halves in one byte."""
    pairs = raw.reshape(-1, 2).astype(np.uint16)
    low = (pairs[:, 0] & 15) | (pairs[:, 1] & 15) << 4
    return np.stack([pairs[:, 0] >> 4, pairs[:, 1] >> 4, low], axis=1).astype(np.uint8).tobytes()


@pytest.fixture(scope="module")
def bench(renderer, hardware, tmp_path_factory):
    """A user's folder with data sheet, response curves, pictures of a pinhole and a photograph, and the results of the
    commands.
    """
    folder = tmp_path_factory.mktemp("bench")
    model = "airy" if renderer.startswith("scalar") else "wave"
    (folder / "camera.toml").write_text(SHEET)
    write_response(folder / "response.csv")
    write_pictures(folder / "pinhole", hardware)
    scene = dasim.load_scene("depth-steps:15:9", camera=hardware)
    shot = dasim.simulate(scene, hardware, 3, spp=32, variant=renderer, diffraction=model)
    dasim.save_capture(folder / "truth", shot.capture, shot.truth)
    (folder / "photo.raw").write_bytes(packed12(shot.capture.raw_dn))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("DASIM_CACHE_DIR", str(folder / "cache"))
        patch.chdir(folder)
        measured = ["calibrate", "--camera", "camera.toml", "--captures", "pinhole", "--out", "bank.npz"]
        assert run(measured) == 0
        exposure = ["--exposure", f"{shot.capture.exposure_s:.6g}"]
        photo = ["recon", "photo.raw", "--format", "raw12", "--camera", "camera.toml", *exposure]
        assert run([*photo, "--bank", "bank.npz", "--out", "result"]) == 0
        assert run(["score", "result", "truth", "--json", "score.json"]) == 0
    return folder


def test_the_camera_file_is_the_hardware(bench, hardware):
    """Expectation: every measured quantity is in the field of the camera file that uses it, and equals that of the
    hardware.
    """
    stated, true = cameras.load_camera(bench / "camera.toml").sensor, hardware.sensor
    for name in ("dn_per_e", "read_noise_e", "full_well_e", "dsnu_e", "prnu", "dark_current_e_s", "black_level_dn"):
        assert getattr(stated, name) == pytest.approx(getattr(true, name), rel=SENSOR_TOLERANCE), name
    inside = grid.WAVELENGTH_NM < 810  # the cut-off's end
    mine, hardware_curve = (sensors.quantum_efficiency(sensor)[:, inside] for sensor in (stated, true))
    np.testing.assert_allclose(mine, hardware_curve, atol=CURVE_TOLERANCE * hardware_curve.max())


def test_the_bank_is_measured_from_the_pictures(bench, hardware):
    """Expectation: white equals that of the hardware under the lamp, computed from spectra; the depths are those of the
    table.
    """
    bank = load_bank(bench / "bank.npz")
    assert bank.lights == (LIGHT,) and bank.diffraction == "measured" and len(bank.depth_m) == LEVELS
    white = grid.integrate(radiometry.response(hardware) * illuminants.illuminant(LIGHT))
    np.testing.assert_allclose(bank.signature[0], white / white[1], rtol=WHITE_TOLERANCE)
    bundled = grid.integrate(radiometry.response(cameras.load_camera("da-mobile")) * illuminants.illuminant(LIGHT))
    assert np.abs(bundled / bundled[1] / bank.signature[0] - 1).max() > 2 * WHITE_TOLERANCE, "another camera's white"
    np.testing.assert_allclose(bank.depth_m, calibration.levels(hardware)[0][:LEVELS], atol=1e-4)


def test_electrons_are_those_of_the_sheet(bench):
    """Rationale: gain and black level convert raw values to electrons. Expectation: the mean of infrared is that of the
    truth.
    """
    result, truth = load_reconstruction(bench / "result"), dasim.load_truth(bench / "truth")
    assert result.ir_e.mean() == pytest.approx(truth.mean_e[..., 3].mean(), rel=ELECTRONS_TOLERANCE)


def test_the_depth_is_scored(bench):
    """Set-up: two textured halves at 15 and 24 cm. Expectation: an error below one level and below that of any constant
    map.
    """
    figures = json.loads((bench / "score.json").read_text())
    median = figures["regularised.textured.level-median"]["value"]
    assert median < MEDIAN_LEVELS
    assert median < figures["regularised.textured.level-median.constant"]["value"] / 2


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--captures", "pinhole", "--illuminant", "A"), "determine lights and diffraction"),
        (("--captures", "pinhole", "--diffraction", "off"), "determine lights and diffraction"),
        (("--captures", "pinhole", "--save-captures", "new"), "omit --illuminant, --diffraction"),
        (("--format", "raw12"), "give their folder with --captures"),
        (("--captures", "none"), "no table captures.csv"),
        (("--captures", "pinhole", "--focus", "0.2"), "is not the distance of a level"),
        (("--captures", "pinhole", "--camera", "da-mobile"), "has values of"),
        (("--save-captures", "new"), "omit --out"),
    ],
)
def test_options_that_contradict_each_other(bench, options, message, capsys, monkeypatch):
    """Expectation: exit status 2, one line and no bank; also for 12-bit pictures with a camera of 10 bits."""
    monkeypatch.chdir(bench)
    camera = () if "--camera" in options else ("--camera", "camera.toml")
    assert run(["calibrate", *camera, "--out", "new.npz", *options]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert message in lines[-1], lines[-1]
    assert not (bench / "new.npz").exists() and not (bench / "new").exists()


def test_measured_depths_judge_a_photograph(bench, capsys, monkeypatch):
    """Rationale: a photographer has no truth.exr, but may have measured depths.

    Set-up: those of the truth as NPY in metres and as 16-bit PNG in tenths of a millimetre, with half of the picture
    unknown.

    Expectation: away from boundaries, the figures equal those of the simulated truth where both judge the same pixels;
    from the PNG, up to its rounding. A map of another size, and a depth map without its camera, are refused.
    """
    monkeypatch.chdir(bench)
    depth_m = dasim.load_truth(bench / "truth").depth_m
    np.save("measured.npy", depth_m)
    assert run(["score", "result", "measured.npy", "--json", "own.json"]) == 0
    measured_score, simulated = (json.loads((bench / name).read_text()) for name in ("own.json", "score.json"))
    for region in ("all", "boundary"):
        for metric in ("share", "level-median", "rmse-dioptre", "level-median.constant"):
            key = f"regularised.{region}.{metric}"
            assert measured_score[key]["value"] == pytest.approx(simulated[key]["value"], rel=1e-4), (
                key
            )  # float32 levels
    assert not any(".textured." in key or ".untextured." in key for key in measured_score)
    half = np.where(np.arange(SIZE[0]) < SIZE[0] // 2, depth_m, 0)
    write_png16(bench / "measured.png", np.rint(half * 1e4).astype(np.uint16))
    assert run(["score", "result", "measured.png", "--scale", "1e-4", "--json", "png.json"]) == 0
    png = json.loads((bench / "png.json").read_text())
    assert png["regularised.inner.level-median"]["value"] < MEDIAN_LEVELS
    np.save("small.npy", depth_m[:-2])
    capsys.readouterr()
    for result, measured, label in (
        ("result", "small.npy", "is 160 x 112 pixels"),
        ("measured.npy", "measured.npy", "folder"),
    ):
        assert run(["score", result, measured]) == 2
        assert label in capsys.readouterr().err


def test_distances_are_printed_and_simulated_pictures_saved(tmp_path, capsys, monkeypatch):
    """Expectation: each printed distance is the depth of a level and lies within its bounds, and --captures accepts
    what --save-captures writes.
    """
    assert run(["calibrate", "--camera", "da-mobile", "--focus", "0.5", "--print-distances"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if not line.startswith("#")][1:]
    camera = dasim.refocused(cameras.load_camera("da-mobile"), 0.5)
    depths, _ = calibration.levels(camera)
    np.testing.assert_allclose([float(row[1]) for row in rows], depths, atol=5e-6)
    for level, row in enumerate(rows):
        for bound, side in ((row[2], 1), (row[3], -1)):
            place = level_of(float(bound), depths)
            assert place == pytest.approx(level + side * point_table.DEPTH_TOLERANCE, abs=0.02)  # five decimals
    few = itertools.islice(calibration.calibration_captures(camera, ("A",)), 2)
    monkeypatch.setattr("dasim.simulation.calibration.calibration_captures", lambda *arguments, **options: few)
    assert run(["calibrate", "--illuminant", "A", "--save-captures", str(tmp_path / "saved")]) == 0
    assert len((tmp_path / "saved" / "captures.csv").read_text().splitlines()) == 1 + 2 * calibration.FRAMES
