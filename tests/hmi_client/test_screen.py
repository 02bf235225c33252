"""The text client, driven by keys and mouse through Textual's pilot."""

from contextlib import asynccontextmanager

import cv2
import numpy as np
import pytest
from hmi_fakes import EPOCH, fleet, view

from hmi_client.model import Picture
from hmi_client.session import OperatorSession
from hmi_client.text import palette
from hmi_client.text.app import FleetApp
from hmi_client.text.pages import Page
from protocol.messages import Correspondence, PairCorrespondences, Question, Suggestion


def picture(robot, seq=7, width=640, height=480):
    image = np.full((height, width, 3), 90, np.uint8)
    cv2.circle(image, (width // 2, height // 2), 60, (0, 0, 255), -1)
    return Picture(view(robot, seq), cv2.imencode(".jpg", image)[1].tobytes(), 1, 0.0)


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(clock):
    s = OperatorSession("anna", clock=clock)
    s.on_fleet(fleet(6))
    return s


@asynccontextmanager
async def screen(session, size=(160, 50)):
    app = FleetApp(session)
    async with app.run_test(size=size) as pilot:
        app.tick()
        await pilot.pause()
        yield app, pilot


def text(panel):
    return "\n".join(strip.text for strip in panel._strips).replace("\u00a0", " ")


async def press(pilot, *keys):
    await pilot.press(*keys)
    pilot.app.tick()
    await pilot.pause()


@pytest.mark.parametrize("size", [(160, 50), (100, 30), (60, 20)])
async def test_without_a_server_it_says_so(size):
    async with screen(OperatorSession("anna", clock=Clock()), size) as (app, _):
        assert "NO SERVER" in text(app.status)
        assert "select two" in text(app.images[0])


async def test_a_server_that_falls_silent_is_told_within_three_seconds(session, clock):
    async with screen(session) as (app, pilot):
        assert "NO SERVER" not in text(app.status)
        clock.now += 3.0
        app.tick()
        await pilot.pause()
        assert "NO SERVER: nothing heard for 3 s" in text(app.status)


@pytest.mark.parametrize("size", [(160, 50), (100, 30)])
async def test_map_and_matrix_show_the_fleet(session, size):
    async with screen(session, size) as (app, _):
        for robot in ("r1", "r2", "r3", "r4", "r5?"):
            assert robot in text(app.map)
        assert "no pose: r6" in text(app.map) and "apart: r5" in text(app.map)
        assert "1.0" in text(app.matrix) and "~" in text(app.matrix)


async def test_enter_selects_the_cell_under_the_cursor(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "down", "right", "enter")
        assert session.pair == ("r2", "r3")
        assert app.focused is app.images[0]


async def test_a_hidden_cell_can_be_selected(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "right", "enter")
        assert app.matrix._matrix.at("r1", "r3").text == "-"
        assert session.pair == ("r1", "r3")


async def test_the_diagonal_selects_nothing(session):
    async with screen(session) as (_, pilot):
        await press(pilot, "left", "enter")
        assert session.pair is None


async def test_a_click_in_the_matrix_selects_the_cell_under_the_mouse(session):
    async with screen(session) as (app, pilot):
        m = app.matrix
        x = m.head + 3 * m.pitch + m.pitch - 2  # the text of column 3 is right-aligned
        await pilot.click(m, offset=(x + m.gutter.left, 1 + 2 + m.gutter.top))
        await pilot.pause()
        assert session.pair == ("r3", "r4")


async def test_selected_robots_are_red_in_map_and_matrix(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "down", "right", "enter")
        red = {
            segment.text.strip()
            for panel in (app.map, app.matrix)
            for strip in panel._strips
            for segment in strip
            if segment.style.bgcolor.name == "#b00020"
        }
        assert {"r2", "r3", "2.0"} <= red


async def test_n_and_p_walk_through_the_questions(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "n")
        assert session.pair == ("r5", "r6")
        assert "it would join two parts of the fleet" in text(app.status)
        await press(pilot, "n")
        assert session.pair == ("r1", "r2")
        await press(pilot, "p")
        assert session.pair == ("r5", "r6")


async def selected(session, pilot, **size):
    session.select("r1", "r2")
    session.on_picture(picture("r1", **size)), session.on_picture(picture("r2", **size))
    pilot.app.tick()
    pilot.app.images[0].focus()
    await pilot.pause()


@pytest.mark.parametrize("size", [(160, 50), (100, 30)])
async def test_picks_by_keys_give_exactly_these_pixels(session, size):
    async with screen(session, size) as (app, pilot):
        await selected(session, pilot)
        await press(pilot, "right", "right", "right", "shift+down", "up", "space")
        assert session.half is not None and app.focused is app.images[1]
        await press(pilot, "shift+left", "left", "down", "enter")
        [update] = session.open_updates()
        assert tuple(update.pixel_i) == (323.0, 249.0)
        assert tuple(update.pixel_j) == (309.0, 241.0)
        assert (update.view_i, update.view_j) == (view("r1"), view("r2"))
        assert app.focused is app.images[0]
        assert "1 not confirmed yet" in text(app.status)
        assert "pending" in text(app.list)


async def test_the_pixel_does_not_depend_on_the_zoom(session):
    async with screen(session) as (_, pilot):
        await selected(session, pilot)
        await press(pilot, "plus", "plus", "plus", "right", "minus", "down", "space")
        assert session.half.pixel == (321.0, 241.0)


async def test_the_cursor_stays_inside_the_image(session):
    async with screen(session) as (_, pilot):
        await selected(session, pilot, width=30, height=20)
        await press(pilot, *["shift+right"] * 4, *["shift+up"] * 4, "space")
        assert session.half.pixel == (29.0, 0.0)


async def test_a_click_in_the_loupe_picks_that_pixel_exactly(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        panel = app.images[0]
        left, top, columns, rows = panel._arrangement.loupe
        column, row = columns // 2 + 3, rows // 2 - 2
        at = (left + column + panel.gutter.left, top + row + panel.gutter.top)
        await pilot.click(panel, offset=at)
        await pilot.pause()
        assert session.half.pixel == (323.0, 240.0 + 2 * row - rows)


async def test_a_click_in_the_image_moves_the_cursor_to_that_place(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        panel = app.images[0]
        u, v = panel._window.pixel(7, 2 * 5 + 0.5)
        await pilot.click(panel, offset=(7 + panel.gutter.left, 5 + panel.gutter.top))
        await pilot.pause()
        assert panel.cursor == (round(u), round(v)) and session.half is None


async def test_a_half_pick_shows_what_is_next_and_c_drops_it(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        await press(pilot, "space")
        assert "pick the same point in r2" in text(app.status)
        assert "FROZEN" in app.images[1].border_title
        await press(pilot, "c")
        assert session.half is None and "FROZEN" not in app.images[1].border_title


async def test_u_takes_a_pick_back_and_r_puts_it_back(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        await press(pilot, "space", "space")
        assert "pending" in text(app.list)
        await press(pilot, "u")
        assert "erasing" in text(app.list)
        await press(pilot, "r")
        assert "pending" in text(app.list)


async def test_picking_without_an_image_warns_and_sends_nothing(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "n", "space")
        assert session.half is None and session.open_updates() == ()
        assert "Waiting for the image of r5 and r6" in text(app.status)
        assert len(app._notifications) == 1


async def test_brackets_move_the_threshold(session):
    async with screen(session) as (app, pilot):
        for _ in range(15):
            await pilot.press("left_square_bracket")
        app.tick()
        await pilot.pause()
        assert session.threshold_m == pytest.approx(1.25**-15)
        assert "4.0" not in text(app.matrix)


async def test_m_shows_the_images_only(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        width = app.images[0].size.width
        await press(pilot, "m")
        assert not app.map.display or app.map.size.width == 0
        assert app.images[0].region.y == app.images[1].region.y
        await press(pilot, "m")
        assert app.images[0].size.width == width


async def test_what_has_not_changed_is_not_painted(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        await pilot.pause(0.6)
        before = app.map._strips
        app.tick()
        assert app.map._strips is before


@pytest.mark.parametrize("key", ["q", "ctrl+c"])
async def test_it_ends_by_key(session, key):
    app = FleetApp(session)
    async with app.run_test() as pilot:
        await pilot.press(key)
        await pilot.pause()
    assert app._exit


async def test_72_robots_can_be_walked_through(clock):
    session = OperatorSession("anna", clock=clock)
    session.on_fleet(fleet(72))
    async with screen(session) as (app, pilot):
        await press(pilot, *["shift+down"] * 9, *["shift+right"] * 9, "up", "enter")
        assert session.pair == ("r71", "r72")
        assert "r72" in text(app.matrix)


async def test_a_bug_of_the_connection_ends_the_app(session):
    app = FleetApp(session, failure=lambda: ZeroDivisionError("a bug"))
    with pytest.raises(ZeroDivisionError):
        async with app.run_test() as pilot:
            await pilot.pause(0.5)


def asked_with_suggestions(*pixels):
    """A fleet whose first question comes with points to confirm."""
    suggestions = tuple(Suggestion(pixel_i=a, pixel_j=b) for a, b in pixels)
    i, j = view("r1"), view("r2")
    question = Question(
        i="r1", j="r2", view_i=i, view_j=j, reason="weak", gain=0.1, suggestions=suggestions
    )
    return fleet(6, n=2, questions=(question,))


async def test_tab_shows_a_suggestion_accepts_it_corrected_and_shift_tab_skips(session):
    session.on_fleet(asked_with_suggestions(((100, 50), (110, 60)), ((300, 200), (310, 210))))
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        await press(pilot, "tab")
        assert "Suggestion 1 of 2" in text(app.status)
        assert [panel.cursor for panel in app.images] == [(100, 50), (110, 60)]
        await press(pilot, "shift+tab")
        assert "Suggestion 2 of 2" in text(app.status) and not session.open_updates()
        await press(pilot, "right", "tab")
        [update] = session.open_updates()
        assert (tuple(update.pixel_i), tuple(update.pixel_j)) == ((301, 200), (310, 210))
        assert (update.view_i, update.view_j) == (view("r1"), view("r2"))
        assert "Suggestion" not in text(app.status) and not session.frozen


async def test_suggestions_in_an_older_view_wait_for_its_pictures(session):
    session.on_fleet(asked_with_suggestions(((100, 50), (110, 60))))
    async with screen(session) as (app, pilot):
        session.select("r1", "r2")
        session.on_fleet(fleet(6, n=3, seq=9, questions=session.fleet.questions))
        session.on_picture(picture("r1", 9)), session.on_picture(picture("r2", 9))
        app.tick()
        app.images[0].focus()
        await press(pilot, "tab")
        assert "Fetching the two images" in text(app.status)
        assert session.wanted_pictures() == (view("r1"), view("r2"))
        for robot in ("r1", "r2"):
            session.on_fetched(picture(robot))
        await press(pilot)
        assert "Suggestion 1 of 1" in text(app.status)
        assert app.images[0]._picture.view == view("r1")
        await press(pilot, "c")
        assert "Suggestion" not in text(app.status) and not session.frozen


async def test_a_label_brings_the_cursor_to_what_stands_out(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        await press(pilot, "g")
        hints = app.images[0].hints
        assert hints is not None and len(hints.places) > 1 and session.frozen
        label, place = next(iter(hints.places.items()))
        await press(pilot, *label)
        assert app.images[0].hints is None
        assert app.images[0].cursor == pytest.approx(place)
        await press(pilot, "g", "escape")
        assert app.images[0].hints is None


async def test_the_other_cursor_goes_where_the_point_looks_alike(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        app.images[0].move_to(320, 180)  # the rim of the disc
        await press(pilot, "s", "space")
        assert app.focused is app.images[1]
        expected = app.images[1].expected
        if expected is not None:
            assert app.images[1].cursor == pytest.approx(expected.pixel)


async def test_a_moved_point_is_shown_as_unconfirmed_and_named_in_the_update(session):
    session.on_correspondences(known_set())
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        app.images[1].focus()
        app.images[1].move_to(50, 60)
        await press(pilot, "v")
        [update] = session.open_updates()
        assert (update.action, update.correspondence, update.base_revision) == ("move", 4, 3)
        assert (tuple(update.pixel_i), tuple(update.pixel_j)) == ((10, 10), (50, 60))
        assert "pending" in text(app.list)
        await press(pilot, "v")
        assert len(session.open_updates()) == 1  # not again while it is on its way


async def test_the_work_of_another_operator_carries_a_name(session):
    session.on_correspondences(known_set(operator="bob"))
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        assert "bob" in text(app.list)


@pytest.mark.parametrize("theme", ["dark", "light", "mono"])
async def test_every_theme_shows_the_same_texts(session, theme):
    palette.use(theme)
    try:
        async with screen(session) as (app, pilot):
            await selected(session, pilot)
            assert "r5?" in text(app.map) and "320, 240 px" in text(app.images[0])
            backs = {s.style.bgcolor.name for strip in app.map._strips for s in strip}
            assert (backs == {"default"}) == (theme == "mono")
    finally:
        palette.use("dark")


def known_set(operator="anna"):
    item = Correspondence(
        id=4,
        operator=operator,
        view_i=view("r1"),
        view_j=view("r2"),
        pixel_i=(10, 10),
        pixel_j=(20, 20),
        status="accepted",
        revision=3,
    )
    return PairCorrespondences(i="r1", j="r2", revision=3, items=(item,), server_epoch=EPOCH)


async def test_help_events_and_why_are_pages_that_go_away(session):
    async with screen(session) as (app, pilot):
        for key, said in (("?", "Shift-Tab"), ("l", "fleet solved"), ("y", "r1 is located")):
            await press(pilot, key)
            assert isinstance(app.screen, Page)
            assert said in app.screen._text()
            await press(pilot, "c")
            assert not isinstance(app.screen, Page)


async def test_the_reasons_of_every_robot_can_be_read(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "y")
        await press(pilot, "left")
        assert "r6 is not located: alive, but no pair of it" in app.screen._text()
        await press(pilot, "right", "right")
        assert "r2 is located" in app.screen._text()
