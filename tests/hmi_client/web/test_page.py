"""The operator's page in a real browser, beside a bridge that only says what a test wants.

`FLEETPOSE_SHOTS=DIR pytest tests/hmi_client/web/test_page.py` writes a picture of each state.
"""

from pathlib import Path

import pytest
import scenes
from pages import DESK, FREE, LEFT, RIGHT, SETTLED, TABLET, place, shot, until

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
FOCUSED = """document.activeElement.closest('section,header')?.id
    || document.activeElement.closest('[data-panel]')?.dataset.panel"""


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
    page.evaluate(SETTLED)
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
    page.evaluate(SETTLED)
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


def test_a_silent_bridge_is_said_and_the_page_comes_back(opened, bridge):
    page = opened(scenes.half())
    bridge[0].silent = True
    until(
        page,
        lambda: page.evaluate(
            "document.querySelector('#bar h1')?.textContent.startsWith('No connection')"
        ),
    )
    bridge[0].silent = False
    until(
        page,
        lambda: page.evaluate(
            "document.querySelector('#link span').textContent.startsWith('Live')"
        ),
    )


def test_half_a_pick_is_dropped_with_its_connection(opened, bridge):
    page = opened(FREE)
    page.keyboard.press("Space")
    bridge[0].wait_for("pick")
    until(page, lambda: page.inner_text(f"{LEFT} .tag") == "picked")
    bridge[0].drop()
    until(
        page,
        lambda: page.evaluate("!document.querySelector('[data-panel=left] .tag').textContent"),
    )
    until(page, lambda: page.inner_text("#link").startswith("Live"))
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
    until(page, lambda: "1 cm off" in shown())
    page.evaluate("document.querySelector('#bar .primary').dataset.same = 'yes'")
    bridge[0].say(scenes.step("ask", "Pick it", ["2 cm off"], picks))
    until(page, lambda: "2 cm off" in shown())
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
    until(
        page,
        lambda: page.evaluate(
            "document.querySelector('#bar h1')?.textContent.startsWith('The token is not right')"
        ),
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
    page.evaluate(SETTLED)
    assert page.locator("#scene").screenshot() != before


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
    page.evaluate(SETTLED)
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


# ---- everybody can read and reach it -------------------------------------------------------------


@pytest.mark.parametrize("name", STATES)
def test_words_stand_out_and_none_are_cut(opened, name):
    page = opened(STATES[name]())
    for width, height in (DESK, TABLET):
        page.set_viewport_size({"width": width, "height": height})
        for theme in ("light", "dark"):
            page.click("#theme")
            page.evaluate(SETTLED)
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
        page.evaluate(SETTLED)
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
    until(page, lambda: any(m["do"] == "ack" and m["view"] == 129 for m in bridge[0].heard))
    assert page.inner_text(f"{LEFT} h2 .wide").startswith("view 129")
    assert bridge[0].wait_for("want") == {
        "do": "want",
        "images": True,
        "clouds": True,
        "matrix": True,
    }
    page.keyboard.press("m")
    until(page, lambda: bridge[0].wait_for("want")["clouds"] is False)
    page.keyboard.press("m")
    page.keyboard.press("o")
    until(page, lambda: bridge[0].wait_for("want")["images"] is False)


def test_undo_names_its_deed(opened):
    page = opened(scenes.wrong())
    assert "take back: point 3 in r3 and r8" in page.inner_text("footer")
