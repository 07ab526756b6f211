"""The report of the demo: one hero, eight figures, all else folded; its pictures, addresses and height."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest

from dasim.simulation.exposure import Shot
from tests.support import devtools, viewed
from validation import demo
from validation.reports import demo as report
from validation.reports.headlines import IDS
from validation.reports.view.page import reconstruction_page
from validation.scores.score import score

ABOUT = {
    "scene": {"name": "<tiny> & small"}, "saturated_pixels": 3, "renderer": "scalar_spectral", "spp": 4,
    "diffraction": "off",
}  # fmt: skip
DESK, PHONE = (1280, 900, 6000), (390, 844, 12_000)  # width, height, and the most that a page is high
ADDRESS = re.compile(r"data:image/(png|jpeg|svg\+xml);base64,([A-Za-z0-9+/=]*)")


class Page(HTMLParser):
    """What a page asks for from outside itself, its pictures, what is folded, and whether its elements nest."""

    VOID = frozenset({"meta", "link", "img", "br", "hr", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.pictures: dict[str, list[dict]] = {"shown": [], "folded": []}
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        attributes = dict(attrs)
        self.addresses += [
            attributes[k] for k in ("src", "href", "srcset", "data", "action", "poster") if attributes.get(k)
        ]
        if tag == "img":
            self.pictures["folded" if "details" in self.open else "shown"].append(attributes)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def shown():
    """A small capture, what is made of it, and the claims."""
    one = viewed.example()
    shot = Shot(replace(one.capture, provenance=ABOUT, illuminant="D65"), one.truth)
    return shot, one.result, demo.claims(score(one.result, shot.capture, shot.truth))


@pytest.fixture(scope="module")
def page_text(shown):
    return report.demo_page(*shown, {"render": 1.0, "reconstruct": 200.0})


@pytest.fixture
def page(page_text):
    parser = Page()
    parser.feed(page_text)
    parser.close()
    assert not parser.open, f"{parser.open} are not closed"
    return parser


def test_report_asks_for_nothing_from_outside(page, page_text):
    """Expectation: the page view.html beside it, and nothing else."""
    own = [address for address in page.addresses if address != "view.html"]
    assert own and all(address.startswith("data:") for address in own)
    assert len(page.addresses) - len(own) == 2
    without_data = ADDRESS.sub("", page_text)
    assert not re.search(r"https?://|//[a-z]+\.|@import|url\(", without_data)
    assert not {"script", "object", "embed", "base"} & page.tags


def test_capture_depth_and_sharp_picture_are_shown_and_the_others_folded(page):
    """Expectation: whole pictures with a text for those who do not see them; an error beside each map it belongs to."""
    assert (
        len(page.pictures["shown"]) == 3 and len(page.pictures["folded"]) == 6 + 3 + 5
    )  # this truth has no picture in focus
    for picture in page.pictures["shown"] + page.pictures["folded"]:
        kind, data = ADDRESS.fullmatch(picture["src"]).groups()
        decoded = base64.b64decode(data, validate=True)
        if kind == "svg+xml":
            assert b"</svg>" in decoded[-20:] and b"image/png;base64" in decoded
        else:
            assert cv2.imdecode(np.frombuffer(decoded, np.uint8), cv2.IMREAD_COLOR) is not None
    first, second, third = (picture["alt"].lower() for picture in page.pictures["shown"])
    assert "captured" in first and "depth" in second and "all in focus" in third
    captions = [picture["alt"].lower() for picture in page.pictures["folded"]]
    assert ["error" in caption for caption in captions[:6]] == [False, False, True] * 2
    for part in ("raw numbers", "filter", "infrared", "true depth", "estimated depth", "confidence", "pinhole"):
        assert any(part in caption for caption in captions), part


def test_raw_pixels_are_squares_and_never_reduced(page):
    """Expectation: crops of 72 px with one pixel of the picture per pixel of the sensor, in a box of fixed width."""
    crops = [one for one in page.pictures["folded"] if "filter" in one["alt"] or "raw numbers" in one["alt"].lower()]
    assert len(crops) == 2
    for crop in crops:
        decoded = cv2.imdecode(np.frombuffer(base64.b64decode(crop["src"].split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
        assert decoded.shape == (72, 72, 3)


def test_every_figure_is_there_and_eight_stand_out(page, page_text, shown):
    for claim in shown[2]:
        assert claim.id in page.text
    assert len(re.findall(r"<div><b>", page_text)) == len(IDS)
    assert "limit: at most 50 %" in page.text
    assert "<tiny> & small" in page.text, "names are escaped"
    assert "3 min" in page.text, "long times are minutes"


def test_report_of_a_capture_without_an_estimate(shown):
    """Rationale: a page is most needed where the reconstruction failed."""
    shot, result, _ = shown
    blank = replace(result, level_raw=np.full_like(result.level_raw, np.nan))
    entries = demo.claims(score(blank, shot.capture, shot.truth))
    assert "not measured" in report.demo_page(shot, blank, entries, {})


@pytest.mark.slow
@pytest.mark.parametrize(("width", "height", "most"), [DESK, PHONE])
@pytest.mark.parametrize("dark", [False, True])
def test_report_opens_in_a_browser(shown, page_text, tmp_path, width, height, most, dark):
    """Expectation: not higher than allowed, folded and unfolded; no wider than the screen; the embedded page opens;
    raw pixels are whole squares; no word on the console.
    """
    shot, result, _ = shown
    (tmp_path / "report.html").write_text(page_text, encoding="utf-8")
    view = reconstruction_page(result, viewed.example().bank, shot.capture, shot.truth, slices=2)
    (tmp_path / "view.html").write_text(view, encoding="utf-8")
    with devtools.browsing(tmp_path / "profile") as page:
        page.screen(width, height, dark=dark, touch=width < 500)
        page.open(tmp_path / "report.html", "true")
        page.run("document.querySelector('iframe').scrollIntoView()")
        page.until("document.querySelector('iframe').contentWindow.length === 0")
        assert page.run("document.documentElement.scrollHeight") < most
        page.run("document.querySelectorAll('details').forEach((one) => { one.open = true })")
        assert page.run("document.documentElement.scrollHeight") < most
        assert page.run("document.documentElement.scrollWidth") <= width
        sizes = page.run("[...document.querySelectorAll('.pixels img')].map((i) => [i.width, i.naturalWidth])")
        assert len(sizes) == 3 and all(shown_px == report.CROP_SCALE * own for shown_px, own in sizes)
        page.run("window.scrollTo(0, 0)")
        picture = page.picture().astype(float)
        assert picture.std() > 10, "the page is blank"
        assert picture[2, 2].max() < 40 if dark else picture[2, 2].min() > 250
        assert page.messages == []
        assert {url.split(":")[0] for url in page.requests} <= {"file", "data", "blob"}
