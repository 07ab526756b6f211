"""Plots: colours that follow the reader's theme, in a headless browser, and ticks that are plain numbers."""

from __future__ import annotations

import base64

import numpy as np
import pytest

from tests.support import devtools
from validation.reports.plots import plot, themed

PAGE = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">
<style>:root { color-scheme: light dark } body { margin: 0 }</style>"""


def text_of(address: str) -> str:
    return base64.b64decode(address.split(",")[1]).decode()


def test_neutral_colours_depend_on_the_theme_and_others_do_not():
    svg = themed('<svg><defs></defs><path style="fill: #000000; stroke: #0072b2"/><rect style="fill: #ffffff"/></svg>')
    assert "stroke: #0072b2" in svg and "fill: var(--g00)" in svg and "fill: var(--gff)" in svg
    light, dark = svg.split("prefers-color-scheme:dark")
    assert "--g00:#1a1a1a" in light and "--gff:#ffffff" in light
    assert "--g00:#e8e8e8" in dark and "--gff:#161616" in dark


@pytest.mark.parametrize(
    ("low", "high", "some"),
    [(0.1, 2.0, ("0.1", "0.2", "0.5", "1", "2")), (0.01, 1000.0, ("0.01", "1", "1000")), (1e-9, 1e-3, ())],
)
def test_ticks_of_logarithmic_axes_are_plain_numbers(low, high, some):
    """Expectation: 0.2 and not 2 x 10^-1 where the numbers are short; powers where they are not."""
    svg = text_of(plot(lambda axes: axes.loglog([low, high], [low, high])))
    labels = [line.strip()[5:-4] for line in svg.splitlines() if line.strip().startswith("<!-- ")]
    assert set(some) <= set(labels)
    assert any("mathdefault" in label for label in labels) == (not some)


@pytest.mark.slow
def test_a_plot_is_dark_on_light_and_light_on_dark(tmp_path):
    """Set-up: a plot in a page. Expectation: its text and frame contrast with the page in either theme, its
    coloured line is the same in both.
    """
    page_file = tmp_path / "page.html"
    address = plot(lambda axes: axes.plot([0, 1], [0, 1], color="#d55e00", linewidth=8), size=(4, 3))
    page_file.write_text(f'{PAGE}<img src="{address}" alt="a plot">', encoding="utf-8")
    shots = []
    with devtools.browsing(tmp_path / "profile") as page:
        for dark in (False, True):
            page.screen(420, 320, dark=dark)
            page.open(page_file, "document.images[0].complete")
            shots.append(page.picture().astype(int))
        assert page.messages == []
    light, dark = shots
    ink, paper = 20, 12  # more than these levels from white or black: not background
    assert light[0, 0].min() > 255 - paper and dark[0, 0].max() < 22 + paper
    for shot, is_ink in ((light, light.max(axis=-1) < 60), (dark, dark.min(axis=-1) > 200)):
        assert is_ink.sum() > 500, shot.mean()
    orange = [np.abs(shot - (0, 94, 213)).max(axis=-1) < ink for shot in shots]
    assert orange[0].sum() > 1000 and orange[1].sum() == pytest.approx(orange[0].sum(), rel=0.1)
