"""The text client, driven by keys and mouse through Textual's pilot."""

import pytest
from hmi_fakes import fleet, view
from screen_makers import Clock, press, screen, selected, text

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui.app import FleetApp


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
        assert "slow: nothing heard for 3 s" in text(app.status)
        clock.now += 3.0
        app.tick()
        assert "NO SERVER: nothing heard for 6 s" in text(app.status)


@pytest.mark.parametrize("size", [(160, 50), (100, 30)])
async def test_map_and_matrix_show_the_fleet(session, size):
    async with screen(session, size) as (app, _):
        for robot in ("r1", "r2", "r3", "r4", "r5?"):
            assert robot in text(app.map)
        assert "no pose: r6" in text(app.map) and "separate: r5" in text(app.map)
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
        assert [entry.status for entry in session.entries()] == ["pending"]


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
        assert "on its way" in text(app.list)
        await press(pilot, "u")
        assert "going" in text(app.list)
        await press(pilot, "r")
        assert [entry.status for entry in session.entries()] == ["pending"]


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
    app = FleetApp({"demo": session})
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
    app = FleetApp({"demo": session}, failure=lambda: ZeroDivisionError("a bug"))
    with pytest.raises(ZeroDivisionError):
        async with app.run_test() as pilot:
            await pilot.pause(0.5)
