"""The page and the lines of a shape study."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support import browser, devtools
from validation.studies.shape import files, report
from validation.studies.shape.study import Study


def test_the_page_opens_in_a_browser_without_errors(study: Study, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text(report.page(study, files.slug), encoding="utf-8")
    assert browser.screenshot(page).std() > 10, "the page is blank"


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height", "most"), [(1280, 900, 6000), (390, 844, 12_000)])
def test_the_page_fits_the_screen(study: Study, tmp_path: Path, width: int, height: int, most: int) -> None:
    """Expectation: neither higher than allowed nor wider than the screen, dark in the dark theme."""
    (tmp_path / "report.html").write_text(report.page(study, files.slug), encoding="utf-8")
    with devtools.browsing(tmp_path / "profile") as page:
        page.screen(width, height, dark=True, touch=width < 500)
        page.open(tmp_path / "report.html", "true")
        assert page.run("document.documentElement.scrollHeight") < most
        page.run("document.querySelectorAll('details').forEach((one) => { one.open = true })")
        assert page.run("document.documentElement.scrollWidth") <= width
        assert (page.picture().max(axis=-1) < 60).mean() > 0.6
        assert page.messages == []


def test_lines_name_every_design_and_give_no_spread_to_a_bound(study: Study) -> None:
    text = list(report.lines(study))
    for row, line in zip(study.rows, text[1:], strict=False):
        assert line.startswith(row.name)
        assert f"{row.depth_dioptre:.4f}" in line
    bound = next(line for line in text if line.startswith("bound, periodic patch"))
    board = next(line for line in text if line.startswith("likelihood on rendered boards"))
    assert "+-" not in bound
    assert "+-" in board
