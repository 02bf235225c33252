"""Help on the screen: suggestions, labels, what is expected, points that move, themes, pages."""

import numpy as np
import pytest
from hmi_fakes import CAMERA, EPOCH, empty_view, fleet, pose, view
from screen_makers import picture, press, screen, selected, text

from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.tui.drawing import palette
from fleetpose.hmi_client.tui.panels.pages import Page
from fleetpose.protocol.clouds import encode_depth
from fleetpose.protocol.messages import Correspondence, PairCorrespondences, Question, Suggestion


def depths(robot):
    """A wall 4 m away."""
    cloud = encode_depth(np.full((CAMERA.height, CAMERA.width), 4.0))
    return Depths.of(empty_view(view(robot)).model_copy(update={"cloud": cloud}))


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


async def test_the_other_cursor_goes_where_the_poses_put_the_point(session):
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        session.hold_still()
        session.on_depths(depths("r1")), session.on_depths(depths("r2"))
        for robot, y in (("r1", 0.0), ("r2", 0.4)):
            session.on_pose(pose(robot, 0.0, y, n=9))
        await press(pilot, "space")
        assert app.focused is app.images[1] and app.view.desk.expected_at(1) is not None
        assert app.images[1].cursor == pytest.approx((320, 240 - 500 * 0.4 / 4.0), abs=1)
        assert "by the poses found so far" in text(app.images[1])
        assert "by the poses" not in text(app.images[0])


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
        assert "on its way" in text(app.list)
        await press(pilot, "v")
        assert len(session.open_updates()) == 1  # not again while it is on its way


async def test_a_point_of_another_view_moves_only_once_that_is_shown(session):
    session.on_correspondences(known_set(seq=3))
    async with screen(session) as (app, pilot):
        await selected(session, pilot)
        await press(pilot, "v")
        assert not session.open_updates()  # the same pixel of another moment is another point
        app.list.focus()
        await press(pilot, "enter")
        assert session.wanted_pictures() == (view("r1", 3), view("r2", 3))
        for robot in ("r1", "r2"):
            session.on_fetched(picture(robot, 3))
        await press(pilot)
        assert app.images[0].cursor == (10, 10) and app.images[1].cursor == (20, 20)
        app.images[0].focus()
        await press(pilot, "right", "v")
        [update] = session.open_updates()
        assert (update.view_i, tuple(update.pixel_i)) == (view("r1", 3), (11, 10))


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


def known_set(operator="anna", seq=7):
    item = Correspondence(
        id=4,
        operator=operator,
        view_i=view("r1", seq),
        view_j=view("r2", seq),
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
            assert said in app.screen._text(80)
            await press(pilot, "c")
            assert not isinstance(app.screen, Page)


async def test_the_reasons_of_every_robot_can_be_read(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "y")
        await press(pilot, "left")
        assert "r6 is not located: alive, but no pair of it" in app.screen._text(80)
        await press(pilot, "right", "right")
        assert "r2 is located" in app.screen._text(80)
