"""The operator's page in a real browser, beside a bridge that only says what a test wants.

`FLEETPOSE_SHOTS=DIR pytest tests/hmi_client/web/test_page.py` writes a picture of each state.
"""

import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")
pytest.importorskip("uvicorn", reason="uvicorn is not installed: pip install 'fleetpose[web]'")
CHROMIUM = shutil.which("chromium")
if CHROMIUM is None:
    pytest.skip("there is no chromium: apt-get install chromium", allow_module_level=True)

import scenes  # noqa: E402 (needs what may be missing)
from fake_bridge import FakeBridge  # noqa: E402
from scenes import MARK  # noqa: E402

DESK, TABLET = (1600, 1000), (1024, 768)
STATES = {
    "half": scenes.half,
    "suggestion": scenes.suggestion,
    "wrong": scenes.wrong,
    "gone": scenes.gone,
    "idle": scenes.idle,
    "without-image": scenes.without_image,
    "many": scenes.many,
}
STATES_OF_EVALUATION = Path(__file__).parents[3] / "evaluation" / "system" / "web" / "states"
AUDIT = (STATES_OF_EVALUATION / "audit.js").read_text()
SETTLED = """document.fonts.ready.then(() => new Promise((done) =>
    requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done)))))"""
FOCUSED = """document.activeElement.closest('section,header')?.id
    || document.activeElement.closest('[data-panel]')?.dataset.panel"""
LEFT, RIGHT = "[data-panel=left]", "[data-panel=right]"


@pytest.fixture(scope="module")
def bridge() -> Iterator[tuple[FakeBridge, str]]:
    fake = FakeBridge()
    with fake.serving() as url:
        yield fake, url


@pytest.fixture(scope="module")
def browser() -> Iterator:
    with sync_api.sync_playwright() as playwright:
        launched = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"]
        )
        yield launched
        launched.close()


@pytest.fixture
def opened(bridge, browser):
    """Opens the page in a state; no console error and no foreign request may come of it."""
    fake, url = bridge
    contexts, errors, foreign = [], [], []

    def open_page(scene, size=DESK, touch=False, ratio=1.0, theme="dark", settled=True):
        fake.show(scene, {"theme": theme})
        width, height = size
        context = browser.new_context(
            viewport={"width": width, "height": height}, has_touch=touch, device_scale_factor=ratio
        )
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda e: errors.append(str(e)))
        page.on("request", lambda r: foreign.append(r.url) if not r.url.startswith(url) else None)
        page.goto(url + "#token=let-me-in")
        if settled:
            sides = sum(isinstance(f, bytes) and f[0] == 1 for f in scene)
            _until(page, lambda: sum(m["do"] == "ack" for m in fake.heard) >= sides)
            _until(page, lambda: page.inner_text("#summary") != "")
            page.evaluate(SETTLED)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert errors == []
    assert [one for one in foreign if not one.startswith("blob:")] == []


def _until(page, done, timeout_ms: int = 3000) -> None:
    for _ in range(timeout_ms // 10):
        if done():
            return
        page.wait_for_timeout(10)
    raise AssertionError(f"not within {timeout_ms} ms")


def shot(page, name: str) -> None:
    if folder := os.environ.get("FLEETPOSE_SHOTS"):
        page.wait_for_timeout(150)
        page.screenshot(path=Path(folder) / f"{name}.png")


def place(page, side: str, canvas: str, pixel: tuple[float, float], middle: tuple[float, float]):
    """Where an image pixel is on the screen; for a loupe `middle` is the pixel under its cross."""
    box = page.locator(f"{side} canvas.{canvas}").bounding_box()
    centre = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    if canvas == "loupe":
        scale = 8.0
    else:
        scale = min(box["width"] / scenes.WIDTH, box["height"] / scenes.HEIGHT)
    return tuple(c + (p - m) * scale for c, p, m in zip(centre, pixel, middle, strict=True))


CENTRE = ((scenes.WIDTH - 1) / 2, (scenes.HEIGHT - 1) / 2)
FREE = [f for f in scenes.half() if not isinstance(f, dict) or f["t"] not in ("list", "assist")]
FREE.insert(0, scenes.listing((2, 7), []))
"""A pair with images and nothing clicked."""


# ---- each state says what to do ------------------------------------------------------------------


def test_after_the_first_click_the_other_image_shows_where_the_point_is_expected(opened, bridge):
    page = opened(scenes.half())
    assert "now pick the same point in r8" in page.inner_text("#bar h1")
    assert page.inner_text(f"{RIGHT} .tag") == "click the same point here"
    assert page.inner_text(f"{LEFT} .tag") == "picked"
    assert "active" in page.get_attribute(RIGHT, "class")
    assert page.inner_text(f"{RIGHT} .place").startswith("446.6, 503.1 px")
    assert page.locator("#bar .button").all_text_contents() == [
        "Pick hereSpace",
        "SnapS",
        "CancelC",
    ]
    shot(page, "half")
    page.keyboard.press("Space")
    sent = bridge[0].wait_for("pick")
    assert (sent["side"], sent["pixel"], sent["view"]) == (1, [446.6, 503.1], 38)
    assert sent["beside"] == 41


def test_tab_is_taken_only_while_a_suggestion_is_shown_and_escape_gives_it_back(opened, bridge):
    page = opened(scenes.suggestion())
    assert page.inner_text("#bar h1") == "Do both crosses show the same point?"
    shot(page, "suggestion")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Tab")
    assert bridge[0].wait_for("accept")
    moved = [m for m in bridge[0].heard if m["do"] == "cursor" and m["side"] == 1]
    assert moved[-1]["pixel"] == [scenes.P4[1][0] + 1, scenes.P4[1][1]]
    page.keyboard.press("Shift+Tab")
    assert bridge[0].wait_for("skip")
    page.keyboard.press("Escape")
    assert bridge[0].wait_for("cancel")
    before = len([m for m in bridge[0].heard if m["do"] == "accept"])
    page.keyboard.press("Tab")
    page.wait_for_timeout(50)
    assert len([m for m in bridge[0].heard if m["do"] == "accept"]) == before
    assert page.evaluate("document.activeElement !== document.body")


def test_tab_leaves_every_panel(opened):
    page = opened(scenes.half())
    seen = set()
    for _ in range(30):
        page.keyboard.press("Tab")
        seen.add(page.evaluate(FOCUSED))
    assert {"bar", "map", "matrix", "pair", "left", "right"} <= seen


def test_a_wrong_click_splits_the_loupe_and_offers_to_move_or_erase(opened, bridge):
    page = opened(scenes.wrong())
    assert "3.5 m off" in page.inner_text("#bar h1")
    captions = page.locator(f"{RIGHT} .caption").all_inner_texts()
    assert captions == ["as you clicked it", "where the others put it", "loupe 8×"]
    assert "does not fit the others" in page.inner_text("#pair .row.bad")
    shot(page, "wrong")
    at = place(page, RIGHT, "loupe", (0, 8), (0, 0))
    page.mouse.click(*at)
    page.wait_for_timeout(50)
    assert not [m for m in bridge[0].heard if m["do"] == "pick"]
    page.keyboard.press("v")
    sent = bridge[0].wait_for("move")
    assert (sent["id"], sent["side"], sent["pixel"]) == (2, 1, [203.2, 397.0])
    page.keyboard.press("x")
    assert bridge[0].wait_for("erase")["id"] == 2


def test_without_a_server_all_is_greyed_and_stamped_and_the_broken_leg_is_named(opened):
    page = opened(scenes.gone())
    assert page.inner_text("#bar h1") == "NO SERVER"
    assert "silent 14 s" in page.inner_text(".legs") or "silent 15 s" in page.inner_text(".legs")
    stamps = [s for s in page.locator(".panel .stamp").all() if s.is_visible()]
    assert len(stamps) >= 7
    assert all(s.inner_text().endswith("s old") for s in stamps)
    assert page.evaluate("getComputedStyle(document.querySelector('#map canvas')).filter") != "none"
    assert "2 clicks not confirmed yet" in page.inner_text("footer .kept")
    assert page.locator("#pair .say.pending").first.inner_text() == "kept here"
    shot(page, "gone")


def test_a_silent_bridge_is_said_within_four_seconds_and_the_page_comes_back(opened, bridge):
    page = opened(scenes.half())
    bridge[0].silent = True
    _until(
        page,
        lambda: page.evaluate(
            "document.querySelector('#bar h1')?.textContent.startsWith('No connection')"
        ),
        4500,
    )
    bridge[0].silent = False
    _until(
        page,
        lambda: page.evaluate(
            "document.querySelector('#link span').textContent.startsWith('Live')"
        ),
        2000,
    )


def test_half_a_pick_is_dropped_with_its_connection(opened, bridge):
    page = opened(FREE)
    page.keyboard.press("Space")
    bridge[0].wait_for("pick")
    _until(page, lambda: page.inner_text(f"{LEFT} .tag") == "picked")
    bridge[0].drop()
    _until(
        page,
        lambda: page.evaluate("!document.querySelector('[data-panel=left] .tag').textContent"),
        2000,
    )
    _until(page, lambda: page.inner_text("#link").startswith("Live"))
    assert page.inner_text(f"{LEFT} .tag") == ""


def test_a_page_that_comes_back_to_a_new_bridge_selects_its_pair_again(opened, bridge):
    opened(scenes.half())
    bridge[0].show(scenes.idle())  # a bridge that was started anew knows of no pair
    bridge[0].drop()
    sent = bridge[0].wait_for("select")
    assert (sent["a"], sent["b"]) == ("r3", "r8")


def test_a_button_stays_when_only_the_facts_change(opened, bridge):
    page = opened(FREE)
    picks = scenes.act("pick", "picks", "Space", True)
    bridge[0].say(scenes.step("ask", "Pick it", ["1 cm off"], picks))
    shown = lambda: page.inner_text("#bar .facts").replace("\xa0", " ")  # noqa: E731
    _until(page, lambda: "1 cm off" in shown())
    page.evaluate("document.querySelector('#bar .primary').dataset.same = 'yes'")
    bridge[0].say(scenes.step("ask", "Pick it", ["2 cm off"], picks))
    _until(page, lambda: "2 cm off" in shown())
    assert page.evaluate("document.querySelector('#bar .primary').dataset.same") == "yes"


def test_panels_keep_their_order_when_a_tablet_is_turned(opened):
    page = opened(scenes.half())
    order = "[...document.querySelectorAll('.middle > .panel')].map((node) => node.id)"
    before = page.evaluate(order)
    for width, height in (TABLET, DESK):
        page.set_viewport_size({"width": width, "height": height})
        page.evaluate(SETTLED)
    assert page.evaluate(order) == before == ["matrix", "pair", "events"]


def test_a_wrong_token_is_told_and_not_tried_again(opened, bridge):
    page = opened([], settled=False)
    bridge[0].refuse = True
    bridge[0].drop()
    _until(
        page,
        lambda: page.evaluate(
            "document.querySelector('#bar h1')?.textContent.startsWith('The token is not right')"
        ),
        2000,
    )
    bridge[0].refuse = False


def test_when_nothing_is_asked_the_points_take_the_images_place(opened):
    page = opened(scenes.idle())
    assert page.inner_text("#bar h1") == "All 8 robots are located."
    assert not page.is_visible("#images")
    box = page.locator("#scene canvas").bounding_box()
    assert box["width"] > 800 and box["height"] > 700
    shot(page, "idle")
    before = page.locator("#scene").screenshot()
    page.mouse.move(1200, 500)
    page.mouse.down()
    page.mouse.move(1300, 520)
    page.mouse.up()
    page.wait_for_timeout(50)
    assert page.locator("#scene").screenshot() != before


def test_200_000_points_are_drawn_within_50_ms_without_a_gpu(opened, bridge):
    page = opened([*scenes.idle(), *(scenes.cloud(k, 72) for k in range(8, 72))])
    took = page.evaluate("""async () => {
      const { Raster, cameraOf } = await import('/static/fleet/raster.js');
      const points = Float32Array.from({ length: 600000 }, (_, k) => Math.sin(k * 12.9898) * 10);
      const colours = new Uint8Array(600000), raster = new Raster();
      raster.resize(document.createElement('canvas').getContext('2d'), 820, 780);
      const camera = cameraOf({ azimuth: 1, elevation: 0.5, distance: 30, target: [0, 0, 0] },
        820, 780);
      raster.cloud(true, camera, points, colours);
      const from = performance.now();
      for (let k = 0; k < 5; k++) { raster.clear(0); raster.cloud(true, camera, points, colours); }
      return (performance.now() - from) / 5; }""")
    assert took < 50


def test_72_robots_are_a_heat_map_that_is_read_out(opened, bridge):
    page = opened(scenes.many())
    assert page.is_visible("#matrix .heat canvas")
    assert "r39 – r41" in page.inner_text("#readout")
    assert "hidden" in page.inner_text("#readout")
    shot(page, "many")
    page.focus("#matrix .heat")
    page.keyboard.press("ArrowDown")
    assert "r40 – r41" in page.inner_text("#readout")
    page.keyboard.press("Enter")
    sent = bridge[0].wait_for("select")
    assert {sent["a"], sent["b"]} == {"r40", "r41"}


def test_the_overview_lists_the_questions_and_the_missing(opened, bridge):
    page = opened(scenes.many())
    page.keyboard.press("o")
    page.wait_for_selector("main.over")
    assert page.inner_text("#bar h1") == "4 of 72 robots are missing"
    assert not page.is_visible("#images")
    shot(page, "overview")
    assert page.locator("#matrix .heat canvas").bounding_box()["width"] > 600
    page.locator(".question").nth(1).click()
    sent = bridge[0].wait_for("select")
    assert (sent["a"], sent["b"]) == ("r2", "r6")


def test_images_only_leaves_the_bar_and_both_images(opened):
    page = opened(scenes.half())
    page.keyboard.press("m")
    page.wait_for_selector("main.max")
    shot(page, "images-only")
    assert not page.is_visible("#matrix")
    assert page.locator(f"{LEFT} canvas.photo").bounding_box()["width"] > 700
    assert page.is_visible("#bar h1")


def test_a_missing_image_is_told(opened, bridge):
    page = opened(scenes.without_image())
    assert page.inner_text(f"{RIGHT} .empty") == "No image of r8 yet"
    shot(page, "without-image")
    page.locator(f"{RIGHT} canvas.photo").click()
    page.keyboard.press("Space")
    page.wait_for_timeout(50)
    assert all(m.get("side") != 1 for m in bridge[0].heard if m["do"] == "pick")


def test_help_shows_the_keys_of_hmi_client(opened):
    page = opened(scenes.half())
    page.keyboard.press("?")
    text = page.inner_text("#help")
    assert "the next question, the most useful one first" in text
    assert "where it is expected: a guess" in text
    shot(page, "keys")
    page.keyboard.press("Escape")
    assert not page.is_visible("#help")


# ---- picking is exact ----------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [1.0, 1.25, 2.0])
def test_a_click_means_the_pixel_under_it(opened, bridge, ratio):
    page = opened(FREE, ratio=ratio)
    worst_fit = worst_fine = 0.0
    for target in ((100.0, 80.0), (700.0, 300.0), (411.3, 555.7)):
        page.mouse.click(*place(page, LEFT, "photo", target, CENTRE))
        page.keyboard.press("s")
        cursor = bridge[0].wait_for("snap")["pixel"]
        bridge[0].heard.clear()
        worst_fit = max(worst_fit, np.hypot(*np.subtract(cursor, target)))
        near = (cursor[0] + 9.25, cursor[1] - 7.0)
        page.mouse.click(*place(page, LEFT, "loupe", near, cursor))
        picked = bridge[0].wait_for("pick")["pixel"]
        bridge[0].heard.clear()
        worst_fine = max(worst_fine, np.hypot(*np.subtract(picked, near)))
        bridge[0].say(scenes.listing((2, 7), []))
    assert worst_fit <= 0.71
    assert worst_fine <= 0.1


def brightest(part: np.ndarray, reach: float) -> np.ndarray:
    """The middle of what is bright around the brightest place, off its dark field: column, row."""
    columns, rows = np.meshgrid(*(np.arange(n) + 0.5 for n in part.shape[::-1]))
    row, column = np.median(np.argwhere(part > 235), axis=0)  # most of what is white
    near = np.hypot(columns - column, rows - row) < reach
    weight = np.where(near, np.clip(part.astype(float) - 60, 0, None), 0)
    return np.array(((weight * columns).sum(), (weight * rows).sum())) / weight.sum()


@pytest.mark.parametrize("ratio", [1.0, 1.25, 2.0])
def test_what_is_drawn_under_the_cross_is_the_pixel_that_is_picked(opened, bridge, ratio):
    page = opened(FREE, ratio=ratio)
    page.keyboard.down("h")
    at = place(page, LEFT, "photo", MARK, CENTRE)
    page.mouse.click(*at)
    page.keyboard.press("s")
    cursor = bridge[0].wait_for("snap")["pixel"]
    page.evaluate(SETTLED)
    for canvas, most in (("photo", 0.71), ("loupe", 0.1)):
        box = page.locator(f"{LEFT} canvas.{canvas}").bounding_box()
        scale = 8.0 if canvas == "loupe" else min(box["width"] / 960, box["height"] / 640)
        seen = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)
        assert seen is not None
        top, left = int(box["y"] * ratio), int(box["x"] * ratio)
        part = seen[top : top + int(box["height"] * ratio), left : left + int(box["width"] * ratio)]
        spot = brightest(part, (60 if canvas == "loupe" else 28) * ratio)
        spot = np.add(spot, (left, top)) / ratio
        middle = np.array((box["x"] + box["width"] / 2, box["y"] + box["height"] / 2))
        off = 8.0 * np.subtract(MARK, cursor)
        expected = middle + off if canvas == "loupe" else np.array(at)
        assert np.hypot(*(spot - expected)) / scale <= most
    page.keyboard.up("h")


@pytest.mark.parametrize("ratio", [1.0, 1.25, 2.0])
def test_a_finger_moves_the_picture_under_the_cross(opened, bridge, ratio):
    page = opened(FREE, TABLET, touch=True, ratio=ratio)
    target = (600.0, 200.0)
    page.touchscreen.tap(*place(page, LEFT, "photo", target, CENTRE))
    page.locator("#touchbar .button", has_text="Snap").tap()
    cursor = bridge[0].wait_for("snap")["pixel"]
    assert np.hypot(*np.subtract(cursor, target)) <= 0.71
    touch = page.context.new_cdp_session(page)
    x, y = place(page, LEFT, "loupe", (0, 0), (0, 0))
    for kind, points in (
        ("touchStart", [(x, y)]),
        ("touchMove", [(x - 20, y)]),
        ("touchMove", [(x - 20, y + 33)]),
        ("touchMove", [(x - 20, y + 33)]),
        ("touchEnd", []),
    ):
        page.wait_for_timeout(40)  # a finger that rests before it leaves flings nothing
        told = [{"x": a, "y": b} for a, b in points]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": told})
    page.locator("#touchbar .button", has_text="Pick here").tap()
    picked = bridge[0].wait_for("pick")["pixel"]
    assert np.hypot(*np.subtract(picked, (cursor[0] + 2.5, cursor[1] - 33 / 8))) <= 0.1


def test_zoomed_by_the_wheel_the_pixel_stays_under_the_pointer(opened, bridge):
    page = opened(FREE)
    at = [round(x) for x in place(page, LEFT, "photo", (700.0, 300.0), CENTRE)]  # as wheels tell it
    page.mouse.click(*at)
    page.keyboard.press("s")
    pixel = bridge[0].wait_for("snap")["pixel"]
    bridge[0].heard.clear()
    page.mouse.wheel(0, -900)
    page.mouse.click(*at)
    page.keyboard.press("s")
    assert bridge[0].wait_for("snap")["pixel"] == pytest.approx(pixel, abs=0.1)


def test_marks_live_in_image_pixels_and_h_hides_them(opened):
    page = opened(scenes.suggestion())
    photo = page.locator(f"{LEFT} canvas.photo")
    shown = photo.screenshot()
    page.keyboard.down("h")
    page.wait_for_timeout(50)
    hidden = photo.screenshot()
    page.keyboard.up("h")
    page.wait_for_timeout(50)
    assert hidden != shown
    assert photo.screenshot() == shown


def test_a_finger_hits_a_mark_from_farther_off_than_a_mouse(opened, bridge):
    for touch, size in ((False, DESK), (True, TABLET)):
        page = opened(scenes.suggestion(), size, touch=touch)
        x, y = place(page, LEFT, "photo", scenes.P1[0], CENTRE)
        (page.touchscreen.tap if touch else page.mouse.click)(x + 18, y)
        page.keyboard.press("x")
        assert bridge[0].wait_for("erase").get("id") == (1 if touch else None)


# ---- the list ------------------------------------------------------------------------------------


def test_of_1000_points_only_visible_rows_exist_and_a_row_brings_the_crosses(opened, bridge):
    points = [scenes.point(n, (n % 900, n % 600), (n % 800, n % 500)) for n in range(1, 1001)]
    scene = [
        f if not isinstance(f, dict) or f["t"] != "list" else scenes.listing((2, 7), points)
        for f in scenes.half()
    ]
    page = opened([f for f in scene if not isinstance(f, dict) or f["t"] != "assist"])
    assert page.locator("#pair .row").count() < 40
    page.click("#pair .sort")
    assert page.locator("#pair .row .pill").first.inner_text() == "1000"
    page.locator("#pair .fields").first.click()
    page.wait_for_timeout(50)
    assert page.inner_text(f"{LEFT} .place").startswith("100.0, 400.0 px")
    assert page.locator("#pair .row .pill").first.inner_text() == "1000"


# ---- everybody can read and reach it -------------------------------------------------------------


@pytest.mark.parametrize("name", STATES)
def test_words_stand_out_and_none_are_cut(opened, name):
    page = opened(STATES[name]())
    for width, height in (DESK, TABLET):
        page.set_viewport_size({"width": width, "height": height})
        for theme in ("light", "dark"):
            page.click("#theme")
            page.wait_for_timeout(60)
            assert page.evaluate("document.documentElement.dataset.theme") == theme
            assert page.evaluate(f"({AUDIT})('contrast', 4.5)") == []
            shot(page, f"{name}-{theme}-{width}")
        assert page.evaluate(f"({AUDIT})('cut')") == []
        assert page.evaluate(f"({AUDIT})('scroll bars')") == []


def test_the_audit_finds_what_it_looks_for(opened):
    page = opened(scenes.half(), TABLET)
    page.evaluate("document.querySelector('#bar h1').style.color = '#345'")
    page.evaluate(
        "document.querySelector('#map h2').style.cssText = 'width: 60px; overflow: hidden'"
    )
    page.evaluate("document.querySelector('#theme').style.width = '30px'")
    assert any("h1" in one for one in page.evaluate(f"({AUDIT})('contrast', 4.5)"))
    assert any("h2" in one for one in page.evaluate(f"({AUDIT})('cut')"))
    assert any("30x44" in one for one in page.evaluate(f"({AUDIT})('targets', 44)"))


def test_a_tablet_has_targets_of_44_pixels_in_every_tab(opened):
    page = opened(scenes.wrong(), TABLET, touch=True)
    for tab in ("map", "matrix", "pair", "scene"):
        page.locator(f"[data-tab={tab}]").tap()
        page.wait_for_timeout(50)
        assert page.evaluate(f"({AUDIT})('targets', 44)") == [], tab
        shot(page, f"tablet-{tab}")


def test_names_are_only_text(opened):
    evil = "<img src=x onerror=alert(1)>"
    page = opened(
        [
            f | {"title": evil} if isinstance(f, dict) and f["t"] == "step" else f
            for f in scenes.half()
        ]
    )
    assert page.inner_text("#bar h1") == evil
    assert page.locator("#bar img").count() == 0


def test_images_are_acknowledged_one_by_one_and_only_what_is_seen_is_wanted(opened, bridge):
    page = opened(scenes.half())
    for view in range(100, 130):
        bridge[0].say(scenes.image(0, view))
    _until(page, lambda: any(m["do"] == "ack" and m["view"] == 129 for m in bridge[0].heard))
    assert page.inner_text(f"{LEFT} h2 .wide").startswith("view 129")
    assert bridge[0].wait_for("want") == {
        "do": "want",
        "images": True,
        "clouds": True,
        "matrix": True,
    }
    page.keyboard.press("m")
    _until(page, lambda: bridge[0].wait_for("want")["clouds"] is False)
    page.keyboard.press("m")
    page.keyboard.press("o")
    _until(page, lambda: bridge[0].wait_for("want")["images"] is False)


def test_undo_names_its_deed(opened):
    page = opened(scenes.wrong())
    assert "take back: point 3 in r3 and r8" in page.inner_text("footer")
