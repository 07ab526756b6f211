"""The page in headless Chromium: what it paints and says, with slider, mouse, keys and fingers.

Exercises ``validation.reports.view.page`` and the scripts in its ``parts``. Skipped where no browser is installed.
"""

from __future__ import annotations

import base64
import re

import cv2
import numpy as np
import pytest

import recon
from recon.files.reconstruction import displayed
from tests.support import devtools, viewed
from validation.reports.view import page as pages
from validation.reports.view.packing import lossy
from validation.scores.pictures import displayed as shown_pictures

PAINTED_DB = 35.0  # of a painted slice against what was computed: WebP, nothing else
DECODED_DB = 45.0  # of one WebP file decoded by two libraries
DEPTH_CM = 0.006  # the probe has two decimals
READY = "document.body.dataset.ready === 'yes'"
SHOWN = "document.getElementById('stage').dataset.shown"
PHONE, DESK = (390, 844), (1280, 860)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """The pages of a reconstruction and of a capture."""
    example, folder = viewed.example(), tmp_path_factory.mktemp("pages")
    whole = pages.reconstruction_page(example.result, example.bank, example.capture, example.truth)
    (folder / "recon.html").write_text(whole, encoding="utf-8")
    (folder / "capture.html").write_text(pages.capture_page(example.capture, example.truth), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def browser(files):
    with devtools.browsing(files / "profile") as page:
        yield page


@pytest.fixture
def page(browser, files):
    """The page of the reconstruction on a desktop; no message and no request may come of what a test does."""
    browser.messages.clear()
    browser.requests.clear()
    browser.screen(*DESK)
    browser.open(files / "recon.html", READY)
    yield browser
    browser.run("1")  # what was said meanwhile
    assert not browser.messages
    assert [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))] == []


def enter(page, mode):
    page.run(
        f"delete document.getElementById('stage').dataset.shown; document.querySelector('[data-mode={mode}]').click()"
    )
    page.until(SHOWN)


def choose(page, name, value):
    """Set a slider or a menu as a user does."""
    page.run(
        f"(() => {{ const one = document.getElementById('{name}'); one.value = '{value}'; "
        "one.dispatchEvent(new Event('input', {bubbles: true})); })()"
    )


def at(page, x, y):
    """Place in the window of a pixel's centre at full view."""
    box = page.run("(({left, top, width, height}) => [left, top, width, height])(document.getElementById('stage')"
                   ".getBoundingClientRect())")  # fmt: skip
    return box[0] + (x + 0.5) / viewed.WIDTH * box[2], box[1] + (y + 0.5) / viewed.HEIGHT * box[3]


def probe(page):
    return page.run("document.getElementById('probe').textContent")


def nearest_slice(page, x, y):
    """Number of the slice at the lens's own aperture that is closest in dioptres to the estimated depth of a pixel."""
    _, depths = data(page)[0]
    return int(np.argmin(np.abs(1 / np.array(depths) - 1 / viewed.example().result.depth_m[y, x])))


def data(page):
    return page.run(
        "(({stack}) => stack.map(({f_number, slices}) => [f_number, slices.map((s) => s.depth_m)]))"
        "(JSON.parse(document.getElementById('data').textContent))"
    )


def expected(f_number, depth_m):
    """Picture of ``recon.refocus``, [h, w, 3] BGR of 8 bits."""
    example = viewed.example()
    picture = displayed(recon.refocus(example.result, example.bank, depth_m, f_number), example.result)
    return np.rint(np.clip(picture, 0, 1) * 255).astype(np.uint8)[..., ::-1]


def test_sliders_show_what_refocus_computes(page):
    """Expectation: at every corner of focus and aperture, the canvas is the picture of that focus and no other."""
    stack = data(page)
    for aperture in (0, len(stack) - 1):
        choose(page, "aperture", aperture)
        f_number, depths = stack[aperture]
        for focus in (0, len(depths) - 1):
            choose(page, "focus", focus)
            page.until(f"{SHOWN} === 'slice {aperture} {focus}'")
            canvas = page.canvas("#stage")
            assert cv2.PSNR(canvas, np.ascontiguousarray(expected(f_number, depths[focus]))) > PAINTED_DB
            if aperture == 0:
                other = expected(f_number, depths[len(depths) - 1 - focus])
                assert cv2.PSNR(canvas, np.ascontiguousarray(other)) < PAINTED_DB - 5
            assert f"{depths[focus] * 100:.1f} cm" in page.run("document.getElementById('focus-value').textContent")


def test_click_focuses_at_a_pixel(page):
    """Expectation: the slice of this aperture that is closest in dioptres to the estimated depth of the pixel."""
    for x, y in ((45, 40), (10, 5)):
        page.click(*at(page, x, y))
        page.until(f"{SHOWN} === 'slice 0 {nearest_slice(page, x, y)}'")


def test_probe_reads_the_maps(page):
    """Expectation: depth, standard deviation, confidence, truth and raw number of the pixel under the pointer."""
    example = viewed.example()
    spread = page.run("JSON.parse(document.getElementById('data').textContent).sd.dioptres_per_level")
    for x, y in ((0, 0), (45, 40), (95, 71)):
        page.mouse("mouseMoved", *at(page, x, y))
        page.until(f"document.getElementById('probe').textContent.includes('Pixel {x}, {y}')")
        said = probe(page)
        depth_cm, sd_cm = (float(n) for n in re.search(r"Depth ([\d.]+) ± ([\d.]+) cm", said).groups())
        true_cm = float(re.search(r"True depth ([\d.]+) cm", said)[1])
        trust = float(re.search(r"Confidence ([\d.]+)", said)[1])
        dn, electrons = (int(n) for n in re.search(r"(\d+) DN, (-?\d+) e", said).groups())
        assert depth_cm == pytest.approx(example.result.depth_m[y, x] * 100, abs=DEPTH_CM)
        assert true_cm == pytest.approx(example.truth.depth_m[y, x] * 100, abs=DEPTH_CM)
        assert trust == pytest.approx(example.result.confidence[y, x], abs=6e-4)
        confidence, depth_m = float(example.result.confidence[y, x]), float(example.result.depth_m[y, x])
        exact = np.sqrt(1 / confidence - 1) * spread * depth_m**2 * 100
        assert sd_cm == pytest.approx(exact, abs=max(0.006, 0.05 * exact))
        assert dn == example.capture.raw_dn[y, x]
        assert electrons == pytest.approx((dn - 64) * 6000 / 959, abs=0.51)


def test_split_view_has_both_pictures(page):
    """Expectation: left of the divider one picture, right of it the other; slider, keys and mouse move it."""
    example = viewed.example()
    enter(page, "compare")
    choose(page, "split", 25)
    canvas, edge = page.canvas("#stage"), viewed.WIDTH // 4
    left, right = (np.rint(p * 255).astype(np.uint8)[..., ::-1] for p in (example.result.rgb, example.result.sharp_rgb))
    both = np.hstack([left[:, :edge], right[:, edge:]])
    assert cv2.PSNR(canvas, both) > PAINTED_DB
    assert cv2.PSNR(canvas, np.ascontiguousarray(left)) < PAINTED_DB - 5
    x, y = at(page, edge - 0.5, 36)
    page.drag((x, y), at(page, 71.5, 36))
    assert page.run("document.getElementById('split').value") == "75"
    choose(page, "left", "truth")
    choose(page, "split", 100)
    page.until(f"{SHOWN} === 'truth | all-in-focus'")
    stored = lossy(shown_pictures(example.result, example.truth)["truth"], pages.QUALITIES[0])
    truth = cv2.imdecode(np.frombuffer(base64.b64decode(stored), np.uint8), cv2.IMREAD_COLOR)
    assert cv2.PSNR(page.canvas("#stage"), truth) > DECODED_DB


def test_all_maps_and_channels_are_shown(page):
    enter(page, "depth")
    seen = []
    for name in ("depth", "true_depth", "confidence", "sd", "error"):
        choose(page, "map", name)
        page.until(f"{SHOWN} === '{name}'")
        seen.append(page.canvas("#stage").tobytes())
    enter(page, "channels")
    for number, name in enumerate(("R", "G", "B", "IR")):
        page.run(f"document.querySelectorAll('#channel button')[{number}].click()")
        page.until(f"{SHOWN} === '{name}'")
        seen.append(page.canvas("#stage").tobytes())
    assert len(set(seen)) == len(seen)


def test_mosaic_magnified_shows_single_pixels(page):
    """Expectation: at 8 times, a square of one colour for each pixel; infrared alone leaves three of four dark."""
    enter(page, "mosaic")
    choose(page, "shown", "IR")
    page.run("document.getElementById('stage').focus()")
    for _ in range(11):
        page.key("+")
    page.until(f"{SHOWN} === 'IR'")
    canvas = page.canvas("#stage")
    dark = (canvas.max(axis=-1) < 3).mean()
    assert 0.6 < dark < 0.9
    assert len(np.unique(canvas.reshape(-1, 3), axis=0)) < 60, "squares, not ramps"


def test_surface_turns_and_is_cut(page):
    """Expectation: at the first glance near the picture; turning changes it; less trust leaves fewer triangles."""
    enter(page, "solid")
    page.until("document.getElementById('stage').dataset.triangles > 0")
    first, faces = page.canvas("#stage"), int(page.run("document.getElementById('stage').dataset.triangles"))
    whole = 2 * (viewed.WIDTH - 1) * (viewed.HEIGHT - 1)
    assert 0.5 * whole < faces < whole, "cut around the box"
    page.drag(at(page, 40, 36), at(page, 60, 40))
    assert np.abs(page.canvas("#stage").astype(int) - first).mean() > 3
    choose(page, "least", 0.5)
    page.until(f"document.getElementById('stage').dataset.triangles < {0.8 * faces}")
    page.run("document.getElementById('reset').click()")


def test_keys(page):
    """Expectation: numbers change the view; brackets, comma and stop the slice; arrows the pixel."""
    stack = data(page)
    last = len(stack[0][1]) - 1
    page.key("[")
    page.until(f"{SHOWN} === 'slice 0 {last - 1}'")
    page.key(".")
    page.until(f"{SHOWN}.startsWith('slice 1')")
    for number, mode in enumerate(("refocus", "compare", "depth", "channels", "mosaic", "solid"), start=1):
        page.key(str(number))
        assert page.run(f"document.querySelector('[data-mode={mode}]').getAttribute('aria-pressed')") == "true"
    page.key("1")
    page.run("document.getElementById('stage').focus()")
    before = probe(page)
    page.key("ArrowRight", code="ArrowRight", shift=True)
    assert probe(page) != before and f"Pixel {viewed.WIDTH // 2 + 10}, {viewed.HEIGHT // 2}" in probe(page)


def test_touch(page, files):
    """Expectation: a tap focuses and marks; two fingers magnify."""
    page.screen(*PHONE, touch=True)
    page.open(files / "recon.html", READY)
    page.touch([at(page, 45, 40)])
    page.until("document.getElementById('probe').textContent.includes('Pixel 45, 40')")
    page.until(f"{SHOWN} === 'slice 0 {nearest_slice(page, 45, 40)}'")
    x, y = at(page, 48, 36)
    before = page.canvas("#stage")
    page.touch([(x - 20, y), (x + 20, y)], [(x - 40, y), (x + 40, y)], [(x - 80, y), (x + 80, y)])
    assert np.abs(page.canvas("#stage").astype(int) - before).mean() > 3


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize(("size", "touch"), [(DESK, False), (PHONE, True)])
def test_page_fits_and_follows_the_scheme(page, files, size, touch, dark):
    """Expectation: nothing is wider than the window in any view; one column on a phone; light or dark as asked."""
    page.screen(*size, touch=touch, dark=dark)
    page.open(files / "recon.html", READY)
    for mode in ("refocus", "compare", "depth", "channels", "mosaic", "solid"):
        enter(page, mode)
        assert page.run("document.documentElement.scrollWidth <= innerWidth"), mode
    corner = page.picture()[2, 2].mean()
    assert corner < 60 if dark else corner > 220
    below = page.run(
        "document.querySelector('aside').getBoundingClientRect().top >= document.querySelector('main')"
        ".getBoundingClientRect().bottom"
    )
    assert below == touch


def test_capture_page_offers_what_it_has(page, files):
    page.open(files / "capture.html", READY)
    usable = page.run(
        "[...document.querySelectorAll('#modes button')].filter((b) => !b.disabled).map((b) => b.dataset.mode)"
    )
    assert usable == ["compare", "depth", "channels", "mosaic", "solid"]
    assert "DN" in probe(page) and "Confidence" not in probe(page)


def test_without_webgl(files, tmp_path):
    """Expectation: a sentence, no 3D view, and the same pictures."""
    with devtools.browsing(tmp_path / "profile", "--disable-3d-apis") as flat:
        flat.screen(*DESK)
        flat.open(files / "recon.html", READY)
        assert "WebGL2" in flat.run("document.getElementById('sorry').textContent")
        assert flat.run("document.querySelector('[data-mode=solid]').disabled")
        flat.until(SHOWN)
        f_number, depths = data(flat)[0]
        picture = np.ascontiguousarray(expected(f_number, depths[-1]))
        assert cv2.PSNR(flat.canvas("#stage"), picture) > PAINTED_DB
