"""What hands do at the page: picking, touching, the list, a recording's clock, buttons."""

import cv2
import numpy as np
import pytest
import scenes
from pages import CENTRE, DESK, FREE, LEFT, SETTLED, TABLET, place, shot, until
from scenes import MARK

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
    page.evaluate(SETTLED)
    hidden = photo.screenshot()
    page.keyboard.up("h")
    page.evaluate(SETTLED)
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
    page.evaluate(SETTLED)
    assert page.inner_text(f"{LEFT} .place").startswith("100.0, 400.0 px")
    assert page.locator("#pair .row .pill").first.inner_text() == "1000"


# ---- what else hands do --------------------------------------------------------------------------


def test_labels_are_asked_for_as_far_apart_as_they_can_be_read_and_letters_bring_the_cross(
    opened,
    bridge,
):
    page = opened(FREE)
    page.keyboard.press("g")
    asked = bridge[0].wait_for("go")
    box = page.locator(f"{LEFT} canvas.photo").bounding_box()
    scale = min(box["width"] / scenes.WIDTH, box["height"] / scenes.HEIGHT)
    assert np.multiply(asked["apart"], scale) == pytest.approx((40, 24))
    assert asked["within"][0] <= 0 and asked["within"][2] >= scenes.WIDTH - 1
    places = {"as": (100.0, 80.0), "ad": (700.5, 300.25), "f": (50.0, 500.0)}
    hints = [{"label": k, "side": 0, "pixel": list(p)} for k, p in places.items()]
    bridge[0].say(scenes.assist(hints=hints))
    photo, loupe = (page.locator(f"{LEFT} canvas.{c}") for c in ("photo", "loupe"))
    page.wait_for_timeout(100)
    before, fine = photo.screenshot(), loupe.screenshot()
    shot(page, "labels")
    page.keyboard.press("a")
    page.evaluate(SETTLED)
    assert photo.screenshot() != before  # those that cannot be meant any more go
    assert loupe.screenshot() == fine  # none hides what lies under the cross
    page.keyboard.press("d")
    until(page, lambda: page.inner_text(f"{LEFT} .place").startswith("700.5, 300.3 px"))
    page.keyboard.press("f")
    assert bridge[0].wait_for("freeze")  # letters are commands again


_TOUCHED = """(button) => {
    const box = button.getBoundingClientRect();
    const at = { clientX: box.x + 5, clientY: box.y + 5 };
    const touch = new Touch({ identifier: 1, target: button, ...at });
    for (const [type, touches] of [['touchstart', [touch]], ['touchend', []]])
        button.dispatchEvent(new TouchEvent(type,
            { touches, changedTouches: [touch], bubbles: true, cancelable: true }));
}"""


def test_a_tap_counts_also_where_the_browser_makes_no_click_of_it(opened, bridge):
    page = opened(FREE, TABLET, touch=True)
    page.touchscreen.tap(*place(page, LEFT, "photo", (500.0, 300.0), CENTRE))
    page.locator("#touchbar .button", has_text="Snap").evaluate(_TOUCHED)
    assert bridge[0].wait_for("snap")
    page.locator("#touchbar .button", has_text="Snap").tap()  # of which it makes one
    until(page, lambda: [m["do"] for m in bridge[0].heard].count("snap") == 2)
    page.wait_for_timeout(400)
    assert [m["do"] for m in bridge[0].heard].count("snap") == 2


def test_tabs_rows_and_the_head_take_a_tap_without_a_click(opened, bridge):
    page = opened(scenes.wrong(), TABLET, touch=True)
    page.locator("#tabs [data-tab=pair]").evaluate(_TOUCHED)
    until(page, lambda: page.is_visible("#pair .fields"))
    page.locator("#pair .row", has_text="3").locator(".fields").first.evaluate(_TOUCHED)
    until(page, lambda: page.is_visible("#pair .row.current"))
    page.locator("#tabs [data-tab=matrix]").evaluate(_TOUCHED)
    until(page, lambda: page.is_visible("#matrix [data-at='0,1']"))
    page.locator("#matrix [data-at='0,1']").evaluate(_TOUCHED)
    assert bridge[0].wait_for("select")
    page.locator("#theme").evaluate(_TOUCHED)
    until(page, lambda: page.evaluate("document.documentElement.dataset.theme") == "light")
    page.locator("#help-button").evaluate(_TOUCHED)
    until(page, lambda: page.is_visible("#help .close"))
    page.locator("#help .close").evaluate(_TOUCHED)
    until(page, lambda: page.is_hidden("#help .close"))


def test_two_fingers_zoom_about_what_lies_between_them(opened, bridge):
    page = opened(FREE, TABLET, touch=True)
    x, y = (round(v) for v in place(page, LEFT, "photo", (500.0, 300.0), CENTRE))
    page.touchscreen.tap(x, y)
    page.locator("#touchbar .button", has_text="Snap").tap()
    middle = bridge[0].wait_for("snap")["pixel"]
    bridge[0].heard.clear()
    touch = page.context.new_cdp_session(page)
    for kind, reach in (("touchStart", 30), ("touchMove", 40), ("touchMove", 60), ("touchEnd", 0)):
        points = [{"x": x + s * reach, "y": y, "id": s + 1} for s in (-1, 1)] if reach else []
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        page.wait_for_timeout(40)
    box = page.locator(f"{LEFT} canvas.photo").bounding_box()
    scale = min(box["width"] / scenes.WIDTH, box["height"] / scenes.HEIGHT)
    page.touchscreen.tap(x + 60, y)
    page.locator("#touchbar .button", has_text="Snap").tap()
    found = bridge[0].wait_for("snap")["pixel"]
    assert found == pytest.approx((middle[0] + 60 / (2 * scale), middle[1]), abs=0.5)


def test_why_is_told_over_the_page_until_escape(opened, bridge):
    page = opened(scenes.half())
    told = {"t": "why", "robot": "r8", "lines": ["r8 is not located", "next: click <b>there</b>"]}
    for _ in range(2):
        page.keyboard.press("y")
        assert bridge[0].wait_for("why")
        bridge[0].say(told)
        until(page, lambda: page.is_visible("#log"))
        lines = page.locator("#log li").all_inner_texts()
        assert lines == ["r8 is not located", "next: click <b>there</b>"]
        bridge[0].heard.clear()
        page.keyboard.press("n")
        page.keyboard.press("Escape")
        assert not page.is_visible("#log")
        assert not [m for m in bridge[0].heard if m["do"] in ("next", "cancel")]


def test_a_recording_is_played_sought_and_sped_up(opened, bridge):
    clock = {"t": "clock", "s": 5.0, "of_s": 60.0, "paused": True, "speed": 1}
    page = opened([*scenes.half(), clock])
    page.click("#clock button")
    assert bridge[0].wait_for("play")["paused"] is False
    bridge[0].say(clock | {"paused": False, "s": 7.25, "speed": 4})
    until(page, lambda: page.inner_text("#clock .dim") == "7.3 of 60.0 s")
    assert page.inner_text("#clock button") == "Pause"
    assert page.input_value("#clock .speed") == "4"
    page.locator("#clock .seek").fill("30")
    assert bridge[0].wait_for("seek")["s"] == 30
    page.select_option("#clock .speed", "0.5")
    assert bridge[0].wait_for("speed")["value"] == 0.5
    shot(page, "replay")
    page.keyboard.press("n")
    assert bridge[0].wait_for("next")  # the keys are the page's again


def test_a_button_that_has_just_come_under_the_hand_is_not_pressed(opened, bridge):
    page = opened(scenes.half())
    page.wait_for_timeout(300)
    bridge[0].say(scenes.step("ask", "Something else", [], scenes.act("erase", "erase", "x", True)))
    until(page, lambda: page.inner_text("#bar h1") == "Something else")
    page.evaluate("document.querySelector('#bar .primary').click()")
    page.wait_for_timeout(300)
    assert not [m for m in bridge[0].heard if m["do"] == "erase"]
    page.click("#bar .primary")
    assert bridge[0].wait_for("erase")


def test_what_the_foot_of_the_page_names_can_be_clicked(opened, bridge):
    page = opened(scenes.half())
    page.click("footer .hint:first-child")
    assert bridge[0].wait_for("next")
    page.keyboard.press("Space")
    assert bridge[0].wait_for("pick")


def test_a_server_never_heard_is_waited_for_and_nothing_is_called_old(opened):
    never = scenes.health(server="gone", age_s=None, leg="server", kept=0, robots=0, located=0)
    page = opened([never], settled=False)
    until(page, lambda: page.inner_text("#bar h1") == "Waiting for a server")
    assert "not heard yet" in page.inner_text(".legs")
    assert page.locator(".stamp").all_inner_texts() == [""] * page.locator(".stamp").count()
    shot(page, "never")
