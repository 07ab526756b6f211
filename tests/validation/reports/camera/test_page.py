"""The page of a camera: its figures against closed forms, its files, and that it loads nothing."""

from __future__ import annotations

import csv
import json
import re

import cv2
import numpy as np
import pytest

from dasim.base.toml import parse
from dasim.camera import geometry, radiometry
from dasim.camera import sensor as sensors
from dasim.camera.specification import Camera, load_camera
from dasim.spectra import grid, illuminants
from validation.reports.camera import figures, optics, page

DIFFRACTION = 0.003  # of modulation: wavelengths in bands of 10 nm
TAIL, TAIL_CYCLES_PX = 0.01, 0.05  # missing light of the kernel beyond its frame, and where it matters


def changed(name: str, **parts: dict) -> Camera:
    data = load_camera(name).model_dump()
    for key, values in parts.items():
        data[key] = (data[key] or {}) | values
    return parse(Camera, data, name)


@pytest.mark.parametrize(
    ("name", "loss"),
    [("da-mobile", (1 - 0.46**2) / 4), ("chakrabarti-zickler", 2 * (1 - 0.59**2) / 4), ("bando", 1 - 0.5**2)],
)
def test_ideal_light_loss_is_that_of_the_paper(name, loss):
    """Expectation: the 20 %, 32.6 % and 75 % below eq. (1), from the camera files alone."""
    assert optics.ideal_light_loss(load_camera(name)) == pytest.approx(loss, rel=1e-6)


def test_light_kept_through_one_stop_is_its_area():
    """Rationale: what all light passes keeps the same share in every channel, whatever the light."""
    whole = load_camera("bayer-mobile")
    half = whole.model_copy(update={"stops": (whole.stops[0].model_copy(update={"radius_ratio": 0.5}),)})
    for light in ("D65", "A"):
        np.testing.assert_allclose(optics.light_kept(whole, light), 1.0)
        np.testing.assert_allclose(optics.light_kept(half, light), 0.25)


def test_transfer_in_focus_is_that_of_a_disc():
    """Expectation: the closed form of a disc, (2/pi)(acos v - v sqrt(1 - v^2)) with v = lambda N f / pitch, times the
    sinc of the pixel, weighted by the channel's electrons over wavelength.
    """
    camera = load_camera("bayer-mobile")
    got = optics.modulation_transfer(camera, np.zeros(1), "D65", figures.CYCLES_PX)[0]
    number = geometry.image_distance_m(camera) / geometry.aperture_m(camera)
    v = grid.WAVELENGTH_NM * 1e-3 * number / camera.sensor.pixel_pitch_um * figures.CYCLES_PX[:, None]
    disc = 2 / np.pi * (np.arccos(np.minimum(v, 1)) - v * np.sqrt(np.maximum(1 - v**2, 0)))
    weight = radiometry.response(camera) * illuminants.illuminant("D65")
    expected = (weight @ disc.T) / weight.sum(axis=-1, keepdims=True) * np.sinc(figures.CYCLES_PX)
    error = np.abs(got - expected)
    assert error.max() < TAIL and error[:, figures.CYCLES_PX > TAIL_CYCLES_PX].max() < DIFFRACTION


def test_transfer_far_out_of_focus_has_the_zero_of_a_disc():
    """Expectation: the first zero of 2 J1(x) / x, x = pi c f, at 3.8317: 0.0610 cycles/px for 20 px of blur, in the
    channel with the least diffraction, to half of its width by geometry.
    """
    camera = load_camera("bayer-mobile")
    cycles = np.linspace(0.03, 0.09, 61)
    curve = optics.modulation_transfer(camera, np.array([20.0]), "D65", cycles)[
        0, sensors.channels(camera.sensor).index("B")
    ]
    assert cycles[curve.argmin()] == pytest.approx(3.8317 / np.pi / 20, rel=0.1)


def test_field_and_levels_follow_the_geometry():
    """Expectation: cos^4 in the corner at the half diagonal of the field of view; levels (1 - alpha) c of one pixel."""
    camera = load_camera("da-mobile")
    corner = optics.field_points(camera)[-1]
    assert corner.angle_deg == pytest.approx(optics.field_of_view_deg(camera)[2] / 2, rel=1e-3)
    assert corner.relative_illumination == pytest.approx(np.cos(np.radians(corner.angle_deg)) ** 4, rel=2e-3)
    levels = optics.levels(camera)
    assert [level.visible_blur_px - level.smallest_stop_blur_px for level in levels] == pytest.approx(range(29))
    assert levels[0].distance_cm - levels[1].distance_cm == pytest.approx(levels[0].next_level_cm)
    assert np.isnan(levels[-1].next_level_cm)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cameras") / "small"
    camera = changed("da-mobile", levels={"count": 3, "max_blur_px": 6.0})
    page.write(folder, page.drawn(camera))
    return folder


def test_page_contains_everything_and_loads_nothing(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="(?!data:)[^"]*"', text) and "url(" not in text
    assert text.count("<img") == 5
    for part in ("Camera da-mobile", "<strong>19.7 %</strong>", "field of view", "650-810"):
        assert part in text


def test_files_are_read_by_others(written):
    names = {file.name for file in written.iterdir()}
    assert names == {
        *("report.html", "results.json", "levels.csv", "apertures.svg", "psf.svg", "psf.png", "mtf.svg"),
        *("responses.svg", "field.svg"),
    }
    assert cv2.imread(str(written / "psf.png")).std() > 5
    rows = list(csv.DictReader((written / "levels.csv").read_text(encoding="utf-8").splitlines()))
    assert [float(row["visible_blur_px"]) for row in rows] == [0.0, 3.0, 6.0]
    assert rows[-1]["next_level_cm"] == ""
    assert json.loads((written / "results.json").read_text())["light_loss_eq_1"] == pytest.approx(0.1971)
    assert "hole" in (written / "apertures.svg").read_text(encoding="utf-8")
    for file in written.glob("*.svg"):  # many programs know neither variables nor themes
        text = file.read_text(encoding="utf-8")
        assert "var(--" not in text and "prefers-color-scheme" not in text and "<svg " in text


def test_stops_of_all_shapes_are_drawn():
    """Expectation: a ring, a polygon and a mask each have a drawing of their own."""
    shapes = [
        {"shape": "annulus", "inner_ratio": 0.5, "outer_ratio": 0.9},
        {"shape": "polygon", "corners_ratio": [[-0.5, -0.5], [0.5, -0.5], [0, 0.6]]},
        {"shape": "mask", "mask": [[0, 1, 0, 0], [1, 1, 1, 0], [0, 0.5, 1, 0], [0, 0, 0, 0]]},
    ]
    drawings = set()
    for shape in shapes:
        data = load_camera("bayer-mobile").model_dump()
        stop = {"name": "open", "passes_nm": data["stops"][0]["passes_nm"], **shape}
        drawings.add(figures.apertures(parse(Camera, data | {"stops": [stop]}, "shape")))
    assert len(drawings) == len(shapes)
