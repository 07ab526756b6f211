"""The report of a sweep: a Pareto front per light, drawings of designs, words with units, its height in a browser."""

from __future__ import annotations

import base64
import math

import cv2
import numpy as np
import pytest

from tests.support import devtools
from validation.studies.sweep import front, naming, report
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.point import FIGURES
from validation.studies.sweep.specification import StudySpec, points

HOLE, LUX = "camera.stops.hole.radius_ratio", "light.lux"


def rows_of(spec: StudySpec) -> list[dict]:
    """A row per point: larger holes lose less light and measure depth worse, and so does darkness."""
    rows = []
    for point in points(spec):
        hole, lux = float(point.get(HOLE, 0.46)), float(point.get(LUX, 1000.0))
        row = dict(point) | dict.fromkeys(FIGURES, 0.5) | {f"{key}:spread": 0.01 for key in FIGURES}
        rows.append(row | {"light-loss": (1 - hole**2) / 4, "depth-median": (1 + hole) / math.sqrt(lux)})
    return rows


@pytest.fixture(scope="module")
def spec() -> StudySpec:
    return load_study("hole-size")


def decoded(address: str) -> np.ndarray:
    picture = cv2.imdecode(np.frombuffer(base64.b64decode(address.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
    return picture[..., ::-1].astype(float) / 255


def test_pareto_front_by_hand():
    rows = [{"a": a, "b": b} for a, b in ((1, 5), (2, 3), (3, 4), (4, 1), (2, 3.5), (5, math.nan))]
    assert [(row["a"], row["b"]) for row in front.pareto(rows, "a", "b")] == [(1, 5), (2, 3), (4, 1)]


def test_each_light_has_a_front_of_its_own(spec):
    """Rationale: one front over all lights holds the brightest alone, whatever the design.

    Expectation: every hole is on the front of each of the nine lights, because none beats another in both figures.
    """
    rows = rows_of(spec)
    fronts = front.fronts(spec, rows)
    assert len(fronts) == 9 and "D65, 100 lux" in fronts
    for name, members in fronts.items():
        assert [row[HOLE] for row in members] == sorted(spec.parameters[HOLE], reverse=True), name
    mixed = {row[LUX] for row in front.pareto(rows, *spec.pareto)}
    assert mixed == {10000.0}, "mixed, the other lights have no design at all"


def test_points_of_the_front_are_labelled_and_axes_have_words(spec):
    svg = base64.b64decode(front.fronts_plot(spec, rows_of(spec)).split(",")[1]).decode()
    for text in (
        "0.46",
        "0.75",
        "share of the light lost",
        "median error of depth (1/m)",
        "D65, 100 lux",
        "Pareto front",
    ):
        assert f"<!-- {text} -->" in svg, text


@pytest.mark.parametrize("hole", [0.2, 0.46, 0.9])
def test_apertures_are_drawn_to_scale(spec, hole):
    """Expectation: the share of the lens that is white is that of the hole's area, alpha squared; the rest is blue."""
    text, drawn = front.drawings(spec, rows_of(spec))
    assert text.startswith("Apertures") and len(drawn) == 8
    picture = decoded(dict(drawn)[f"hole radius / lens radius {hole:g}"])
    size = len(picture)
    y, x = (np.indices((size, size)) + 0.5) * 2 / size - 1
    inside = np.hypot(x, y) < 1
    white, blue = picture[..., 0] > 0.8, picture[..., 2] > picture[..., 0] + 0.2
    assert (white & inside).sum() / inside.sum() == pytest.approx(hole**2, abs=0.02)
    assert (blue & inside).sum() / inside.sum() == pytest.approx(1 - hole**2, abs=0.04)


def test_mosaics_are_drawn_as_their_blocks():
    spec = load_study("mosaic")
    text, drawn = front.drawings(spec, rows_of(spec))
    assert "mosaic" in text and [name for name, _ in drawn] == list(spec.parameters["mosaic"])
    picture = decoded(drawn[0][1])  # GR/BI
    corners = picture[[5, 5, -5, -5], [5, -5, 5, -5]]
    assert corners.argmax(axis=1).tolist()[:3] == [1, 0, 2]


@pytest.mark.parametrize(
    ("key", "text"),
    [
        (HOLE, "hole radius / lens radius"),
        ("camera.lens.focal_length_mm", "focal length (mm)"),
        ("camera.sensor.read_noise_e", "read noise e"),
        ("camera.lens.bounce_gap_um", "bounce gap (um)"),
    ],
)
def test_parameters_in_words(key, text):
    assert naming.parameter(key) == text


@pytest.mark.parametrize("study", ["hole-size", "cut-wavelengths", "mosaic", "lens", "stereo"])
def test_bundled_studies_have_words_for_all_that_they_plot(study):
    """Expectation: axes are no keys of a file: neither dots nor underscores, nor hyphenated names of figures."""
    spec = load_study(study)
    for key in spec.parameters:
        assert not set("._") & set(naming.parameter(key)), key
    for curve in spec.curves:
        assert naming.figure(curve.y).split(" (")[0] != curve.y or curve.y in ("coverage", "psnr"), curve.y


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height", "most"), [(1280, 900, 6000), (390, 844, 12_000)])
def test_report_opens_in_a_browser(spec, tmp_path, width, height, most):
    """Expectation: not higher than allowed, no wider than the screen, dark where the reader's theme is; tables
    scroll inside themselves; no word on the console.
    """
    rows = [
        {key: row[key] for key in (*spec.parameters, *FIGURES)} | {"seed": seed}
        for row in rows_of(spec)
        for seed in range(2)
    ]
    (tmp_path / "report.html").write_text(report.page(spec, rows, {}), encoding="utf-8")
    with devtools.browsing(tmp_path / "profile") as page:
        page.screen(width, height, dark=True, touch=width < 500)
        page.open(tmp_path / "report.html", "true")
        assert page.run("document.documentElement.scrollHeight") < most
        page.run("document.querySelectorAll('details').forEach((one) => { one.open = true })")
        assert page.run("document.documentElement.scrollWidth") <= width
        assert page.run("[...document.querySelectorAll('.scroll')].every((one) => one.clientHeight < 700)")
        shot = page.picture(
            captureBeyondViewport=True, clip={"x": 0, "y": 0, "width": width, "height": 3000, "scale": 1}
        )
        assert (shot.max(axis=-1) < 60).mean() > 0.6
        assert page.messages == []
