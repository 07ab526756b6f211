"""The bundled cameras load, are listed, render, and have the stated properties."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dasim
from dasim.base.toml import to_toml
from dasim.camera import sensor as sensors
from dasim.camera import specification as cameras
from dasim.camera import stops
from dasim.cli import run
from dasim.render import stock

ROOT = Path(__file__).parents[3]

NAMES = [
    *("bando", "bayer-mobile", "chakrabarti-zickler", "chromatic-mobile", "coded-mobile"),
    *("da-4x4", "da-8mm", "da-mobile", "da-mobile-thin", "dual-pixel-left", "dual-pixel-right"),
]
COMPARED = [name for name in NAMES if name != "da-mobile"]
NEED_JIT = ("bando", "chromatic-mobile", "coded-mobile", "dual-pixel-left", "dual-pixel-right")
ONE_STOP = ("coded-mobile", "dual-pixel-left", "dual-pixel-right")  # that closes a part of the lens to all light


def letters(name: str) -> list[str]:
    block = cameras.load_camera(name).sensor.mosaic
    return ["".join(channel[0] for channel in row) for row in block]  # I for IR


def areas(name: str) -> list[float]:
    return [stops.open_area(stop) for stop in cameras.load_camera(name).stops]


def test_all_are_listed():
    assert cameras.camera_names() == NAMES
    for name in NAMES:
        camera = cameras.load_camera(name)
        assert camera.name == name and camera.description


@pytest.mark.parametrize("name", NAMES)
def test_a_camera_written_as_toml_is_the_same_camera(name, tmp_path):
    """Expectation: nested tables, lists of tables and text with quotes come back; so do default values left out."""
    camera = cameras.load_camera(name).model_copy(update={"description": 'a "quoted" one\nwith é'})
    path = tmp_path / "camera.toml"
    path.write_text(to_toml(camera.model_dump(mode="json")), encoding="utf-8")
    assert cameras.load_camera(path) == camera


@pytest.mark.parametrize("name", NAMES)
def test_file_says_what_is_stated_and_what_is_inferred(name):
    head = (cameras.CAMERA_DIR / f"{name}.toml").read_text().partition("name =")[0]
    assert "Inferred: " in head and all(line.startswith("#") for line in head.splitlines())


def test_cameras_differ_from_da_mobile_where_they_say_so(da_mobile):
    """Rationale: comparisons are fair only if everything else is the same."""
    long_lens = cameras.load_camera("da-8mm")
    assert (long_lens.lens.focal_length_mm, long_lens.lens.f_number) == (8.0, 2.8)
    other = {"sensor_seed": da_mobile.sensor.sensor_seed}  # another sensor of the same type
    assert long_lens.sensor.model_copy(update=other) == da_mobile.sensor and long_lens.stops == da_mobile.stops
    other_mosaic = cameras.load_camera("da-4x4")
    assert other_mosaic.sensor.model_copy(update=other | {"mosaic": da_mobile.sensor.mosaic}) == da_mobile.sensor
    assert other_mosaic.stops == da_mobile.stops and other_mosaic.lens == da_mobile.lens
    for name in ("bayer-mobile", "chakrabarti-zickler", "bando"):
        camera = cameras.load_camera(name)
        dyes = {"coating_index": 0.0} if name != "bayer-mobile" else {}  # colour filters in the lens
        assert camera.lens == da_mobile.lens.model_copy(update=dyes) and camera.sensor.cutoff_nm == 650
        changes = other | {"mosaic": da_mobile.sensor.mosaic, "cutoff_nm": 810.0}
        assert camera.sensor.model_copy(update=changes) == da_mobile.sensor


def test_rivals_differ_from_the_bayer_camera_where_they_say_so():
    """Expectation: one lens and one sensor but for axial colour, and half of the full well in each half of a pixel."""
    twin = cameras.load_camera("bayer-mobile")
    for name in ("chromatic-mobile", "coded-mobile", "dual-pixel-left", "dual-pixel-right"):
        camera = cameras.load_camera(name)
        well = {"full_well_e": 3000.0} if name.startswith("dual") else {}
        assert camera.sensor == twin.sensor.model_copy(update=well | {"sensor_seed": camera.sensor.sensor_seed})
        assert camera.lens.model_copy(update={"focal_shift_um": ()}) == twin.lens
    left, right = (cameras.load_camera(f"dual-pixel-{side}").stops[0] for side in ("left", "right"))
    assert [(-x, y) for x, y in left.corners_ratio] == list(right.corners_ratio)


def test_coded_aperture_is_a_modified_uniformly_redundant_array():
    """Expectation: the periodic correlation of the array with its decoding array is a delta (Gottesman and Fenimore):
    +1 where open and -1 where closed, but +1 at the origin.
    """
    mask = np.array(cameras.load_camera("coded-mobile").stops[0].mask)[3:17:2, 3:17:2]
    decoder = np.where(mask > 0, 1, -1)
    decoder[0, 0] = 1
    correlation = np.fft.ifft2(np.fft.fft2(mask) * np.conj(np.fft.fft2(decoder))).real.round(9)
    assert correlation[0, 0] == mask.sum() == 24
    correlation[0, 0] = 0
    assert (correlation == 0).all()


def test_mosaics():
    assert letters("da-mobile") == letters("da-8mm") == ["GR", "BI"]
    assert letters("bayer-mobile") == letters("chakrabarti-zickler") == letters("bando") == ["GR", "BG"]
    assert letters("da-4x4") == ["GIGI", "RGBG", "GIGI", "BGRG"]


def test_stops():
    """Expectation: the areas of the stated ratios; each wavelength passes one stop, and at the edges two that add up to
    one.
    """
    assert areas("bayer-mobile") == [1.0]
    assert areas("chakrabarti-zickler") == pytest.approx([1.0, 0.59**2])
    assert areas("bando") == pytest.approx([0.25] * 3)
    assert areas("coded-mobile") == pytest.approx([96 * 0.01 / np.pi])  # 24 of 49 cells of 2 x 2 in 20 x 20
    halves = areas("dual-pixel-left") + areas("dual-pixel-right")
    assert halves == pytest.approx([0.5, 0.5], rel=1e-3)
    for name in set(NAMES) - set(ONE_STOP):
        whole = sum(stops.transmittance(stop) for stop in cameras.load_camera(name).stops)
        np.testing.assert_allclose(whole, 1.0, atol=1e-12)


def test_bando_centres_are_120_degrees_apart_at_half_the_radius():
    centres = np.array([stop.centre_ratio for stop in cameras.load_camera("bando").stops])
    np.testing.assert_allclose(np.hypot(*centres.T), 0.5, atol=1e-6)
    sides = np.linalg.norm(centres - np.roll(centres, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 0.5 * np.sqrt(3), atol=1e-6)


@pytest.mark.parametrize("name", COMPARED)
def test_each_photographs_the_desk(renderer, name, tmp_path):
    """Expectation: a picture that is neither dark nor saturated, in every channel, and comes back from its folder."""
    scene = dasim.load_scene("desk")
    camera = dasim.focused(dasim.cropped(dasim.load_camera(name), 32, 24), scene)
    if name in NEED_JIT and renderer.startswith("scalar"):
        pytest.skip("needs a JIT variant; that it is refused without one is tested in a process of its own")
    shot = dasim.simulate(scene, camera, seed=1, spp=16, diffraction="off")
    assert shot.truth.channels == sensors.channels(camera.sensor)
    # 16 samples per pixel are noisy, which a note says; one on saturated pixels would be another.
    assert all(note.startswith("rendering noise exceeds") for note in shot.capture.provenance["notes"])
    assert (shot.truth.mean_e.mean(axis=(0, 1)) > 100).all()
    dasim.save_capture(tmp_path / "shot", shot.capture, shot.truth)
    assert dasim.load_capture(tmp_path / "shot").camera == camera


def test_displaced_discs_are_refused_without_a_jit_variant(tmp_path):
    """Set-up: a process of its own, since a process keeps its variant.

    Expectation: exit status 2 and one line that says what is refused and what to install; the others pass the check.
    """
    command = [
        "render",
        "desk",
        "--camera",
        "bando",
        "--size",
        "32x24",
        "--variant",
        "scalar_spectral",
        "--out",
        "shot",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "dasim.cli", *command],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2, done.stderr
    message = done.stderr.splitlines()[-1]
    for part in ("dasim: camera 'bando'", "'red' is not a centred disc", "scalar_spectral", "install LLVM"):
        assert part in message, message
    assert "Traceback" not in done.stderr and not (tmp_path / "shot").exists()
    for name in NAMES:
        if name not in NEED_JIT:
            stock.check(cameras.load_camera(name))


def test_list_describes_every_camera(capsys):
    """Expectation: one block per camera with the shares of its stops, and eq. (8) if it has R, G, B and IR."""
    assert run(["list", "cameras", "--verbose"]) == 0
    output = capsys.readouterr().out
    assert "{" not in output and max(map(len, output.splitlines())) < 140
    blocks = dict(zip(NAMES, output.strip().split("\n\n"), strict=True))
    for name, block in blocks.items():
        assert block.startswith(f"{name} ")
        assert block.count("    stop ") == len(cameras.load_camera(name).stops)
        assert ("eq. (8)" in block) == name.startswith("da-")
    assert "hole: disc of 0.46, 21.2% of the lens's area, passes 650-830 nm" in blocks["da-mobile"]
    assert "centred at (-0.433, 0.25)" in blocks["bando"] and "400-496 and 590-830" in blocks["chakrabarti-zickler"]
