"""What a file of a study may say."""

from __future__ import annotations

import pytest

from dasim.base.errors import InputError
from dasim.cli import run
from tests.support.small_study import GRIDS, HOLE
from validation.studies.sweep import loading, report
from validation.studies.sweep.loading import load_study
from validation.studies.sweep.specification import Curve, points, units


@pytest.mark.parametrize("name", loading.names())
def test_bundled_studies_are_sound(name):
    for quick in (False, True):
        spec = load_study(name, quick=quick)
        assert spec.question and units(spec)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ('"camera.stops.hole.radius_rato" = [0.3]', ("radius_rato", "radius_ratio")),
        ('"camera.lens.f_numbr" = [2]\n"light.luks" = [3]', ("light.luks", "light.lux")),
        ('"light.lux" = []', ("light.lux", "empty")),
        ('"light.lux" = ["bright", 10.0]', ("light.lux", "words and numbers")),
        ("disc_edge_nm = [820.0]", ("disc_edge_nm = 820.0", "no light", "stop 'hole'")),
        ('"light.lux" = {log_grid = [0, 10, 3]}', ("log_grid", "above 0")),
        ('"light.lux" = {grid = [1, 10, 0]}', ("grid.2: must be greater than or equal to 1",)),
        ('"light.lux" = {grid = [1, 10, 1000000000]}', ("less than or equal to 10000",)),
        ("", ("parameters", "empty")),
        ('camera = ["bayer-mobile"]', ("bayer-mobile", "no infrared pixels")),
        ('"camera.stops.hole.radius_ratio" = [0.3, 1.5]', ("1.5",)),
        ('"camera.stops.hole.radius_ratio" = [0.0, 0.46]', ("0.0",)),
        ('"camera.sensor.cutoff_nm" = [300]', ("cutoff_nm",)),
        ('"light.illuminant" = ["D66"]', ("D66",)),
        ('"recon.window_px" = [31]\n"recon.no_such" = [1]', ("recon.no_such",)),
        ('camera = ["da-mobil"]', ("da-mobil",)),
        ('scene = ["dask"]', ("dask",)),
        ('"focus_m" = [-1]', ("focus_m = -1",)),
        ('"light.lux" = ["bright"]', ("bright", "number")),
        ("distance_cm = [20]", ("desk", "scenes of planes")),
        ('scene = ["staircase"]\ndistance_cm = [0]', ("distance 0 cm",)),
        ('mosaic = ["GR/BX"]', ("GR/BX", "GR/BI")),
        ('mosaic = ["GRB/IGR"]', ("IGR", "2048 x 1536")),
        ('mosaic = ["GI/RB"]', ("cannot be reconstructed", "diagonal")),
    ],
)
def test_wrong_studies_are_refused_before_the_first_render(tmp_path, capsys, parameters, message):
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n[parameters]\n{parameters}\n')
    assert run(["study", "sweep", str(tmp_path / "s.toml"), "--out", str(tmp_path / "new")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("dasim: ") and all(part in line for part in message), line
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '[[parameters]]\nfocus_m = [2]\n[[parameters]]\n"light.lux" = [9]',
            ("table 1", "light.lux", "table 2", "focus"),
        ),
        ("[design]\nfocus_n = 2\n[parameters]\nfocus_m = [2]", ("focus_n", "focus_m")),
        ('[parameters]\nfocus_m = [2]\n[[curves]]\nx = "focus_m"\ny = "psnt"', ("psnt", "psnr")),
        ('pareto = ["psnr", "dept-rmse"]\n[parameters]\nfocus_m = [2]', ("dept-rmse", "depth-rmse")),
        ("[parameters]\nfocus_m = [2]\n[quick]\nfocus = [2]", ("quick.focus",)),
    ],
)
def test_wrong_grids_and_curves_are_refused(tmp_path, text, message):
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n{text}\n')
    with pytest.raises(InputError) as refused:
        load_study(str(tmp_path / "s.toml"), quick=True)
    assert all(part in str(refused.value) for part in message), refused.value


def test_several_grids_stand_about_one_design(tmp_path):
    """Set-up: a base design; three holes and two levels of light about it; one hole of the three quick.

    Expectation: the union, the base design once; curves show what else is as in the base design.
    """
    (tmp_path / "s.toml").write_text(GRIDS)
    spec = load_study(str(tmp_path / "s.toml"))
    hole, light = HOLE, "light.illuminant"
    pairs = [(point[hole], point[light]) for point in points(spec)]
    assert pairs == [(0.3, "D65"), (0.46, "D65"), (0.6, "D65"), (0.46, "A")]
    assert spec.parameters == {hole: (0.3, 0.46, 0.6), light: ("D65", "A")}
    rows = [dict(point, number=number) for number, point in enumerate(points(spec))]
    panels = [report.about_design(Curve(x=x, y="psnr"), rows, spec) for x in (hole, light)]
    assert [[row["number"] for row in panel] for panel in panels] == [[0, 1, 2], [1, 3]]
    quick = load_study(str(tmp_path / "s.toml"), quick=True)
    assert [(point[hole], point[light]) for point in points(quick)] == [(0.6, "D65"), (0.46, "D65"), (0.46, "A")]


def test_all_problems_are_said_at_once(tmp_path):
    text = '"light.illuminant" = ["D66"]\n"camera.stops.hole.radius_ratio" = [2.0]'
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n[parameters]\n{text}\n')
    with pytest.raises(InputError, match=r"(?s)D66.*2\.0"):
        load_study(str(tmp_path / "s.toml"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('scene = "dask"\ncamera = "da-mobil"\npreset = "bandz"', ("'dask'", "'da-mobil'", "'bandz'")),
        ('camera = "bayer-mobile"', ("no infrared pixels",)),
        ("size_px = [0, 48]", ("size_px.0", "greater than or equal to 8")),
    ],
)
def test_what_no_point_can_be_made_of_is_said_once(tmp_path, text, message):
    """Expectation: camera, scene, preset and size of the study itself, once, not for each value of a parameter."""
    (tmp_path / "s.toml").write_text(f'name = "wrong"\n{text}\n[parameters]\nfocus_m = [2, 3]\n')
    with pytest.raises(InputError) as refused:
        load_study(str(tmp_path / "s.toml"))
    assert all(str(refused.value).count(part) == 1 for part in message), refused.value
    assert "focus_m" not in str(refused.value)


def test_an_unknown_study_is_answered_with_the_nearest(capsys, tmp_path):
    assert run(["study", "sweep", "hole-siz", "--out", str(tmp_path / "new")]) == 2
    assert "hole-size" in capsys.readouterr().err
