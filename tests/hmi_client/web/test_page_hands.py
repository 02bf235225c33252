"""What hands do at the page beside picking: labels, two fingers, a recording's clock, buttons."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")

import scenes
from test_page import (  # noqa: F401 (fixtures)
    CENTRE,
    FREE,
    LEFT,
    TABLET,
    _until,
    bridge,
    browser,
    opened,
    place,
    shot,
)


def test_labels_are_asked_for_as_far_apart_as_they_can_be_read_and_letters_bring_the_cross(
    opened,  # noqa: F811
    bridge,  # noqa: F811
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
    page.wait_for_timeout(50)
    assert photo.screenshot() != before  # those that cannot be meant any more go
    assert loupe.screenshot() == fine  # none hides what lies under the cross
    page.keyboard.press("d")
    _until(page, lambda: page.inner_text(f"{LEFT} .place").startswith("700.5, 300.3 px"))
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


def test_a_tap_counts_also_where_the_browser_makes_no_click_of_it(opened, bridge):  # noqa: F811
    page = opened(FREE, TABLET, touch=True)
    page.touchscreen.tap(*place(page, LEFT, "photo", (500.0, 300.0), CENTRE))
    page.locator("#touchbar .button", has_text="Snap").evaluate(_TOUCHED)
    assert bridge[0].wait_for("snap")
    page.locator("#touchbar .button", has_text="Snap").tap()  # of which it makes one
    _until(page, lambda: [m["do"] for m in bridge[0].heard].count("snap") == 2)
    page.wait_for_timeout(400)
    assert [m["do"] for m in bridge[0].heard].count("snap") == 2


def test_two_fingers_zoom_about_what_lies_between_them(opened, bridge):  # noqa: F811
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


def test_why_is_told_over_the_page_until_escape(opened, bridge):  # noqa: F811
    page = opened(scenes.half())
    told = {"t": "why", "robot": "r8", "lines": ["r8 is not located", "next: click <b>there</b>"]}
    for _ in range(2):
        page.keyboard.press("y")
        assert bridge[0].wait_for("why")
        bridge[0].say(told)
        _until(page, lambda: page.is_visible("#log"))
        lines = page.locator("#log li").all_inner_texts()
        assert lines == ["r8 is not located", "next: click <b>there</b>"]
        bridge[0].heard.clear()
        page.keyboard.press("n")
        page.keyboard.press("Escape")
        assert not page.is_visible("#log")
        assert not [m for m in bridge[0].heard if m["do"] in ("next", "cancel")]


def test_a_recording_is_played_sought_and_sped_up(opened, bridge):  # noqa: F811
    clock = {"t": "clock", "s": 5.0, "of_s": 60.0, "paused": True, "speed": 1}
    page = opened([*scenes.half(), clock])
    page.click("#clock button")
    assert bridge[0].wait_for("play")["paused"] is False
    bridge[0].say(clock | {"paused": False, "s": 7.25, "speed": 4})
    _until(page, lambda: page.inner_text("#clock .dim") == "7.3 of 60.0 s")
    assert page.inner_text("#clock button") == "Pause"
    assert page.input_value("#clock .speed") == "4"
    page.locator("#clock .seek").fill("30")
    assert bridge[0].wait_for("seek")["s"] == 30
    page.select_option("#clock .speed", "0.5")
    assert bridge[0].wait_for("speed")["value"] == 0.5
    shot(page, "replay")
    page.keyboard.press("n")
    assert bridge[0].wait_for("next")  # the keys are the page's again


def test_a_button_that_has_just_come_under_the_hand_is_not_pressed(opened, bridge):  # noqa: F811
    page = opened(scenes.half())
    page.wait_for_timeout(300)
    bridge[0].say(scenes.step("ask", "Something else", [], scenes.act("erase", "erase", "x", True)))
    _until(page, lambda: page.inner_text("#bar h1") == "Something else")
    page.evaluate("document.querySelector('#bar .primary').click()")
    page.wait_for_timeout(300)
    assert not [m for m in bridge[0].heard if m["do"] == "erase"]
    page.click("#bar .primary")
    assert bridge[0].wait_for("erase")


def test_what_the_foot_of_the_page_names_can_be_clicked(opened, bridge):  # noqa: F811
    page = opened(scenes.half())
    page.click("footer .hint:first-child")
    assert bridge[0].wait_for("next")
    page.keyboard.press("Space")
    assert bridge[0].wait_for("pick")


def test_a_server_never_heard_is_waited_for_and_nothing_is_called_old(opened):  # noqa: F811
    never = scenes.health(server="gone", age_s=None, leg="server", kept=0, robots=0, located=0)
    page = opened([never], settled=False)
    _until(page, lambda: page.inner_text("#bar h1") == "Waiting for a server")
    assert "not heard yet" in page.inner_text(".legs")
    assert page.locator(".stamp").all_inner_texts() == [""] * page.locator(".stamp").count()
    shot(page, "never")
