"""Narrow screens, paper, and curves too long to draw all their points, in a real Chromium."""

import io
import math
import re

import httpx
import numpy as np
import pytest
from PIL import Image

from engine.data import nile
from tests.e2e.browser import eventually, ready

pytestmark = pytest.mark.slow
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def post(chrome, address):
    """post(request) -> id of a job that has ended."""

    def posted(request):
        job = httpx.post(f"{address}/jobs", json=request, timeout=60).raise_for_status().json()
        url = f"{address}/jobs/{job['jobID']}"
        page = chrome.new_page()
        eventually(page, lambda: httpx.get(url).json()["status"] == "successful")
        page.close()
        return job["jobID"]

    return posted


@pytest.fixture(scope="module")
def diagnosis(post):
    options = {"effects": ["step"]}
    series = [{"y": nile().y.tolist(), "t": nile().t.tolist()}]
    return post({"kind": "diagnose", "model": "local-level", "series": series, "options": options})


@pytest.fixture(scope="module")
def long(post):
    return post(
        {"kind": "simulate", "model": "local-level", "options": {"samples": 100_000, "seed": 1}}
    )


def wider_than_the_screen(page):
    return page.evaluate("document.documentElement.scrollWidth - innerWidth")


def draw_all(page):
    """What is not in view yet is drawn as for printing, and fitted to the screen again."""
    for name in ("beforeprint", "afterprint"):
        page.evaluate("name => dispatchEvent(new Event(name))", name)


def test_narrow_screens_need_no_scrolling_to_the_side(visit, diagnosis):
    page = visit("/", viewport=PHONE)
    ready(page)
    page.click("#example")
    page.wait_for_selector("#channels .u-wrap canvas")
    page.click("#options summary")
    assert wider_than_the_screen(page) == 0
    page.goto(f"{visit.address}/jobs")
    page.wait_for_selector(f'[data-job="{diagnosis}"]')
    assert wider_than_the_screen(page) == 0
    assert page.is_visible(f'[data-job="{diagnosis}"] >> text=Remove')
    head = page.evaluate(
        "[...document.querySelector('.top').children].map(one => one.getBoundingClientRect().top)"
    )
    assert max(head) - min(head) < 20  # px: in one line
    page.goto(f"{visit.address}/jobs/{diagnosis}")
    page.wait_for_selector("#results .u-wrap canvas")
    draw_all(page)
    assert wider_than_the_screen(page) == 0
    sizes = page.evaluate(
        "[...document.querySelectorAll('svg text')].filter(one => one.getClientRects().length)"
        ".map(one => parseFloat(getComputedStyle(one).fontSize)"
        " * one.ownerSVGElement.getScreenCTM().a)"
    )
    assert min(sizes) > 8.5  # px


def test_paper_shows_whole_curves(visit, diagnosis):
    page = visit(f"/jobs/{diagnosis}")
    page.wait_for_selector("#results .u-wrap canvas")
    page.set_viewport_size({"width": 688, "height": 1000})  # A4 without its margins
    page.emulate_media(media="print")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    frames = "[...document.querySelectorAll('.chart-frame')].filter(one => one.clientWidth)"
    cut = f"{frames}.filter(one => one.scrollWidth > one.clientWidth).length"
    eventually(page, lambda: page.evaluate(f"{frames}.length") >= 6)
    eventually(page, lambda: page.evaluate(cut) == 0)
    assert wider_than_the_screen(page) == 0
    assert not page.is_visible("#repeat")


HEADING = re.compile(rb"/Title ([^\n]+)\n/Dest \[(\d+) 0 R /XYZ [-.\d]+ ([-.\d]+)")
LEAST = (
    75  # points from a heading's top to the edge of the paper, margin included: itself and a line
)
TALLEST = 990  # CSS pixels of what a page of A4 takes


def check_printed(page):
    """Folded parts are open on paper, nothing that must be whole is cut, no heading ends a page."""
    folded = "[...document.querySelectorAll('details > :not(summary)')].map(one => one.checkVisibility())"
    assert page.evaluate(folded)
    assert not any(page.evaluate(folded))
    printed = page.pdf(format="A4", prefer_css_page_size=True, outline=True, tagged=True)
    headings = HEADING.findall(printed)
    assert len({number for _, number, _ in headings}) >= 3  # pages
    assert [(title, top) for title, _, top in headings if float(top) < LEAST] == []
    page.set_viewport_size({"width": 688, "height": 1000})  # A4 without its margins
    page.emulate_media(media="print")
    assert all(page.evaluate(folded))
    whole = "[...document.querySelectorAll('.figure, .chart, .answer, .facts, table.numbers, tr')]"
    assert page.evaluate(f"{whole}.every(one => getComputedStyle(one).breakInside == 'avoid')")
    assert page.evaluate(f"Math.max(...{whole}.map(one => one.clientHeight))") < TALLEST
    page.emulate_media(media="screen")
    assert not any(page.evaluate(folded))


def test_paper_opens_what_is_folded_and_cuts_nothing(visit, diagnosis, tmp_path):
    page = visit(f"/jobs/{diagnosis}")
    page.wait_for_selector("#results .u-wrap canvas")
    check_printed(page)
    with page.expect_download() as kept:
        page.click("#report")
    kept.value.save_as(tmp_path / "report.html")
    check_printed(visit("", address=(tmp_path / "report.html").as_uri()))


def test_zoom_into_100_000_samples(visit, long):
    page = visit(f"/jobs/{long}")
    page.wait_for_selector("#results .u-wrap canvas")
    frame = page.locator(".chart-frame").first
    results = httpx.get(f"{visit.address}/jobs/{long}/results", timeout=60).json()
    y = results["simulation"]["series"][0]["y"]["flow"]

    def told():
        """Time and value under the cursor; nowhere while the chart is drawn anew."""
        before, colon, after = frame.get_attribute("aria-label").partition(":")
        place = before.split()[1:2]  # behind the name of the axis
        return (
            (float(place[0]), float(after.split()[-1])) if colon and place else (math.nan, math.nan)
        )

    def second_sample():
        page.keyboard.press("Home")
        page.keyboard.press("ArrowRight")
        return told()

    frame.focus()
    eventually(page, lambda: second_sample()[0] > 1)  # some rows are left out
    with page.expect_response("**/charts?*"):
        for _ in range(12):
            page.keyboard.press("+")
    eventually(page, lambda: page.is_visible(".chart-all"))
    # now none is
    eventually(page, lambda: second_sample() == (1.0, pytest.approx(y[1], rel=1e-4)))
    page.locator(".chart-all").first.click()
    page.wait_for_selector(".chart-all", state="hidden")
    eventually(page, lambda: second_sample()[0] > 1)


def test_drag_zooms_and_with_shift_moves(visit, long):
    page = visit(f"/jobs/{long}")
    page.wait_for_selector("#results .u-wrap canvas")
    asked = []
    page.on("request", lambda request: asked.append(request.url) if "charts?" in request.url else 0)

    def drag(start, end):
        box = page.locator(".u-over").first.bounding_box()
        height = box["y"] + box["height"] / 2
        page.mouse.move(box["x"] + start, height)
        page.mouse.down()
        page.mouse.move(box["x"] + end, height, steps=5)
        page.mouse.up()

    def middle():
        low, high = (float(part.split("=")[1]) for part in asked[-1].split("?")[1].split("&"))
        return 0.5 * (low + high)

    drag(200, 220)
    eventually(page, lambda: len(asked) == 1)
    first = middle()
    page.keyboard.down("Shift")
    drag(300, 60)
    page.keyboard.up("Shift")
    eventually(page, lambda: len(asked) > 1)
    assert middle() > first  # what was to the right came in


def test_fingers_zoom_and_scroll(visit, long):
    page = visit(f"/jobs/{long}", viewport=PHONE, has_touch=True, is_mobile=True)
    page.wait_for_selector("#results .u-wrap canvas")
    asked = []
    page.on("request", lambda request: asked.append(request.url) if "charts?" in request.url else 0)
    screen = page.context.new_cdp_session(page)

    def touch(kind, points):
        said = [{"x": x, "y": y, "id": i} for i, (x, y) in enumerate(points)]
        screen.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": said})

    def move(*ways):
        """Fingers go from a point of the chart to another, in parts of its width and in pixels down."""
        box = page.locator(".u-over").first.bounding_box()

        def points(part):
            return [
                (
                    box["x"] + (a + part * (b - a)) * box["width"],
                    box["y"] + 0.5 * box["height"] + part * downwards,
                )
                for (a, b), downwards in ways
            ]

        touch("touchStart", points(0.0))
        for step in range(1, 9):
            touch("touchMove", points(step / 8))
        touch("touchEnd", [])

    def shown():
        """From and to of the last part asked for: what is shown, and half as much on either side."""
        return [float(part.split("=")[1]) for part in asked[-1].split("?")[1].split("&")]

    page.locator(".u-over").first.scroll_into_view_if_needed()
    before = page.evaluate("scrollY")
    move(((0.5, 0.5), -150))
    eventually(page, lambda: page.evaluate("scrollY") > before + 50)
    page.wait_for_timeout(500)
    assert asked == []  # up and down is the page's
    page.evaluate("before => scrollTo(0, before)", before)

    move(((0.4, 0.6), 0))
    eventually(page, lambda: page.is_visible(".chart-all") and asked)
    low, high = shown()
    assert low == pytest.approx(30_000, abs=3_000)
    assert high == pytest.approx(70_000, abs=3_000)

    del asked[:]
    move(((0.45, 0.1), 0), ((0.55, 0.9), 0))  # apart
    eventually(page, lambda: asked and shown()[1] - shown()[0] < (high - low) / 6)
    page.wait_for_timeout(500)
    inner = shown()
    assert sum(inner) / 2 == pytest.approx((low + high) / 2, rel=0.05)
    move(((0.05, 0.75), 0), ((0.2, 0.9), 0))  # together to the right
    eventually(page, lambda: shown()[0] < inner[0] - 0.2 * (inner[1] - inner[0]))
    page.wait_for_timeout(
        1000
    )  # Chromium takes a tap right after two fingers for a part of their gesture
    page.locator(".chart-all").first.tap()
    page.wait_for_selector(".chart-all", state="hidden")


@pytest.fixture(scope="module")
def estimate(post):
    series = [{"y": nile().y.tolist(), "t": nile().t.tolist()}]
    request = {"kind": "estimate", "model": "local-level", "series": series, "tags": ["two words"]}
    options = {"method": "rts-em", "iterations": 3}
    return post(request | {"name": "a name of several words", "options": options})


BROKEN = """[...document.querySelectorAll('#jobs .tag, #jobs .badge, #jobs .model, #jobs dd, #jobs time')]
    .filter(one => one.getBoundingClientRect().height > 1.9 * parseFloat(getComputedStyle(one).lineHeight))
    .map(one => one.textContent)"""


def test_the_list_of_jobs_breaks_no_number_and_prints_units(visit, diagnosis, estimate):
    page = visit("/jobs")
    page.wait_for_selector(f'[data-job="{estimate}"] dd')
    assert page.evaluate(BROKEN) == []
    assert wider_than_the_screen(page) == 0
    row = page.locator(f'[data-job="{diagnosis}"]').inner_text()
    assert re.search(r"-258 ± \d+ × 10⁸ m³", row)
    assert "× 10¹⁶ m⁶" in page.locator(f'[data-job="{estimate}"]').inner_text()
    printed = """async (text) => (await import("/static/api.js")).printed(text)"""
    assert page.evaluate(printed, "2 +- 1 x 1e-8 m^2 s^-1.") == "2 ± 1 × 10⁻⁸ m² s⁻¹."


@pytest.mark.parametrize(
    ("screen", "shaded"), [({"width": 1280, "height": 900}, False), (PHONE, True)]
)
def test_only_what_scrolls_to_the_side_looks_as_if_it_did(visit, screen, shaded):
    """A shade at the right edge of a table says that there is more; elsewhere the edge is as the card is."""
    page = visit("/", viewport=screen, color_scheme="light")
    ready(page)
    page.click("#example")
    page.wait_for_selector("#parameters tbody tr")
    table = page.locator(".scroll:has(#parameters)")
    table.scroll_into_view_if_needed()
    scrolls = table.evaluate("one => one.scrollWidth > one.clientWidth")
    assert scrolls == shaded
    picture = Image.open(io.BytesIO(table.screenshot(animations="disabled"))).convert("L")
    edge = np.asarray(picture)[:, -6:]
    darkest = edge.min(axis=0).min() if not shaded else np.median(edge, axis=0).min()
    assert (darkest < 225) == shaded
