"""The result folder of a shape study."""

from __future__ import annotations

import json
from pathlib import Path

from dasim.files.folders import check_output
from validation.studies.shape.files import slug, write_study
from validation.studies.shape.pipeline import PRESETS
from validation.studies.shape.study import Study


def test_a_study_writes_its_masks_table_and_page(study: Study, tmp_path: Path) -> None:
    write_study(study, tmp_path / "out")
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["designs"]["disc-0-46"]["depth_ratio"] == 1
    check_output(tmp_path / "out", "study")  # raises where a second study could not replace the first
    names = {slug(row.name) for row in study.rows}
    assert len(names) == len(study.rows)
    for suffix in (".png", ".svg", ".toml"):
        assert {path.stem for path in (tmp_path / "out" / "masks").glob(f"*{suffix}")} == names
    assert len(results["pipeline"]) == 5 * len(PRESETS)
    assert set(results["patches"]) == {name.rpartition("-")[0] for name in results["pipeline"]}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "http" not in page.replace("http://www.w3.org/2000/svg", "")
    assert all(row.name.replace("&", "&amp;") in page for row in study.rows)
