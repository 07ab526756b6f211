"""The page is one file that asks for nothing, and has a largest size."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from dasim.base.errors import InputError
from dasim.files.captures import save_capture
from tests.support import recon_scenes, viewed
from validation.reports.view import page as pages
from validation.reports.view.contents import of_reconstruction

LOADING = re.compile(
    r"https?://|\bfetch\s*\(|XMLHttpRequest|import\s*\(|importScripts|WebSocket|EventSource|@import|url\("
)


@pytest.fixture(scope="module")
def text():
    example = viewed.example()
    return pages.reconstruction_page(example.result, example.bank, example.capture, example.truth, slices=2)


class Sources(HTMLParser):
    """Addresses and embedded scripts of a page."""

    def __init__(self):
        super().__init__()
        self.addresses, self.tags = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in ("src", "href", "srcset", "action", "data")]


def data_of(text):
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)[1])


def test_page_loads_nothing(text):
    found = Sources()
    found.feed(text)
    assert found.addresses == ["data:,"], "the icon that browsers would ask for otherwise"
    assert not {"link", "iframe", "object", "embed", "base"} & set(found.tags) - {"link"}
    assert not LOADING.search(text.replace(json.dumps(data_of(text)), ""))
    assert "default-src 'none'" in text, "the browser refuses what a mistake would load"


def test_page_has_its_pictures(text):
    data = data_of(text)
    assert [row["f_number"] for row in data["stack"]] == [2.8, 4.0, 5.6, 8.0]
    assert {p["id"] for p in data["pictures"]} == {"captured", "all-in-focus", "truth"}
    assert {p["id"] for p in data["channels"]} == {"R", "G", "B", "IR"}


def test_text_of_others_stays_text(text):
    assert "a note &lt;b&gt;on&lt;/b&gt; it" in text
    assert "a note <b>" not in text


def test_every_label_names_a_control(text):
    """Expectation: sliders and menus have labels, and every id that the script or a label uses exists."""
    ids = set(re.findall(r'\bid="([\w-]+)"', text))
    assert set(re.findall(r'\bfor="([\w-]+)"', text)) <= ids
    used = set(re.findall(r'\$\("([\w-]+)"\)', "".join((pages.PARTS / n).read_text() for n in pages.SCRIPTS)))
    assert used <= ids


def test_size_is_limited(text):
    """Expectation: a lower quality where the best does not fit, and a line with both sizes where none does."""
    example = viewed.example()
    contents = of_reconstruction(example.result, example.bank, [], example.capture, example.truth)
    best, low = len(pages.page(contents).encode()), len(pages._page(contents, pages.QUALITIES[-1]).encode())
    assert low < best <= pages.MOST_BYTES == pages.most_bytes_of(example.result.camera)
    assert pages.most_bytes_of(recon_scenes.da_mobile(1536, 1152)) == 4 * pages.MOST_BYTES
    assert len(pages.page(contents, low).encode()) == low
    with pytest.raises(InputError, match=r"MB, more than .*--slices"):
        pages.page(contents, low - 1)


def test_capture_beside_a_reconstruction(tmp_path):
    """Expectation: the folder ``capture`` beside it, if its camera is the same; none otherwise."""
    example = viewed.example()
    folder = tmp_path / "recon"
    assert pages.capture_beside(folder, example.result) is None
    save_capture(tmp_path / "capture", example.capture, None)
    assert pages.capture_beside(folder, example.result) == tmp_path / "capture"
    found, truth = pages.capture_of(tmp_path / "capture")
    assert (found.raw_dn == example.capture.raw_dn).all() and truth is None
    other = replace(example.result, camera=recon_scenes.da_mobile(64, 48))
    assert pages.capture_beside(folder, other) is None


def test_page_of_a_capture():
    example = viewed.example()
    data = data_of(pages.capture_page(example.capture, example.truth))
    assert data["stack"] == [] and set(data["maps"]) == {"true_depth"} and data["mosaic"]
