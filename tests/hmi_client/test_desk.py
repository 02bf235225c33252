"""The desk: every command by its id, help beside the hand, and points by their depths."""

import time

import numpy as np
import pytest
from hmi_fakes import CAMERA, EPOCH, empty_view, fleet, pose, view
from screen_makers import picture, press, screen

from fleetpose.hmi_client.assist.clicked_points import rigid
from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.hints import Hints
from fleetpose.hmi_client.desk.keymap import COMMANDS, IDS, KeyMap
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.model.records import Entry, Pick
from fleetpose.hmi_client.tui.bindings import textual_keys
from fleetpose.protocol.clouds import encode_depth
from fleetpose.protocol.messages import (
    Answer,
    Correspondence,
    PairCorrespondences,
    Question,
    Suggestion,
)

PLACES = ((100.0, 100.0), (500.0, 120.0), (300.0, 400.0))


@pytest.fixture
def desk(session):
    made = Desk(session)
    session.select("r1", "r2")
    session.on_picture(picture("r1")), session.on_picture(picture("r2"))
    yield made
    made.close()


def known(session, desk, depth_m=4.0, holes=()):
    """Both images are held, and it is known how far everything is: around some pixels otherwise."""
    session.hold_still()
    for robot in ("r1", "r2"):
        z = np.full((CAMERA.height, CAMERA.width), depth_m)
        for (u, v), other_m in holes if robot == "r2" else ():
            z[int(v) - 20 : int(v) + 20, int(u) - 20 : int(u) + 20] = other_m
        cloud = encode_depth(z)
        session.on_depths(Depths.of(empty_view(view(robot)).model_copy(update={"cloud": cloud})))
    desk.settle()


def held(*pixels, status="unused", seq=7):
    """The server's set of these points, the same pixels in both images."""
    items = tuple(
        Correspondence(
            id=10 + k,
            operator="anna",
            view_i=view("r1", seq),
            view_j=view("r2", seq),
            pixel_i=pixel,
            pixel_j=pixel,
            status=status,
        )
        for k, pixel in enumerate(pixels)
    )
    return PairCorrespondences(i="r1", j="r2", revision=1, items=items, server_epoch=EPOCH)


def refused(desk, command, **args):
    with pytest.raises(OperatorError) as error:
        desk.do(command, **args)
    return str(error.value)


# ---- commands ------------------------------------------------------------------------------------


def test_every_command_of_the_keymap_is_known_to_the_desk(desk):
    for id in IDS:
        try:
            desk.do(id)
        except OperatorError as error:
            assert "no command" not in str(error)
    assert desk.left and refused(desk, "dance") == "there is no command 'dance'"


async def test_every_command_is_reached_by_its_key(session, monkeypatch):
    reached = []
    async with screen(session) as (app, pilot):
        monkeypatch.setattr(app.view.desk, "do", lambda command, **_: reached.append(command))
        panels = {"images": "4", "matrix": "2", "map": "1", "list": "3"}
        for command in COMMANDS:
            if not command.view:
                if command.place not in ("everywhere", app.view.place):
                    await pilot.press(panels[command.place])
                await pilot.press(textual_keys(command.keys).split(",")[0])
                assert command.id in reached, command


def test_pages_get_all_commands_with_their_keys():
    told = KeyMap({"next": ("f5",)}).as_json()
    assert len(told) == len(COMMANDS) and told[2]["id"] == "next" and told[2]["keys"] == ["f5"]
    assert set(told[0]) == {"id", "place", "keys", "label", "does", "shown"}


@pytest.mark.parametrize(
    ("command", "args"),
    [
        ("pick", {"side": 2}),
        ("pick", {"side": 0, "pixel": "ab"}),
        ("cursor", {"side": 0, "pixel": [1, float("nan")]}),
        ("cursor", {"side": 0}),
        ("erase", {"id": "x"}),
        ("select", {"a": "r1"}),
        ("select", {"a": "r1", "b": "nobody"}),
        ("quantity", {"value": "beauty"}),
        ("next", {"step": 1}),
        ("show", {"number": 99}),
        ("go", {"within": [1, 2, 3]}),
        ("why", {"robot": "nobody"}),
    ],
)
def test_what_a_page_should_not_send_is_refused_with_a_sentence(desk, command, args):
    assert len(refused(desk, command, **args)) > 5
    assert desk.session.half is None and not desk.session.open_updates()


def test_a_point_is_picked_by_two_commands_and_taken_back_by_name_at_its_pair(desk, session):
    desk.do("pick", side=0, pixel=(10, 20))
    assert desk.side == 1 and session.half.pixel == (10.0, 20.0)
    desk.do("pick", pixel=[30, 40])
    [entry] = session.entries()
    assert (entry.pick.pixel_i, entry.pick.pixel_j) == ((10.0, 20.0), (30.0, 40.0))
    desk.do("select", a="r3", b="r4")
    desk.do("undo")
    assert session.pair == ("r1", "r2")
    assert desk.notices_since(0)[0][-1].text == "took back: point 1 of r1-r2"
    desk.do("redo")
    assert "did again: point 1 of r1-r2" in desk.notices_since(0)[0][-1].text


def test_a_cursor_stays_in_the_image_and_belongs_to_its_robot(desk, session):
    assert desk.cursor(0) == (320, 240)
    desk.do("cursor", side=0, pixel=(9999, -5))
    assert desk.cursor(0) == (639, 0)
    desk.do("select", a="r2", b="r3")
    assert desk.cursor(0) == (320, 240) and desk.robot(0) == "r2"


# ---- help beside the hand ------------------------------------------------------------------------


def test_looking_for_the_other_half_does_not_hold_the_hand_up(desk, monkeypatch):
    monkeypatch.setattr(desk.guide, "expected", lambda: time.sleep(0.3))
    began = time.monotonic()
    desk.do("pick", side=0, pixel=(10, 10))
    desk.follow()
    assert time.monotonic() - began < 0.1


def test_the_expected_place_takes_no_cursor_that_a_hand_has_moved(desk, session):
    known(session, desk)
    for robot, y in (("r1", 0.0), ("r2", 0.4)):
        session.on_pose(pose(robot, 0.0, y, n=9))
    desk.do("pick", side=0, pixel=(320, 240))
    desk.do("cursor", side=1, pixel=(5, 5))
    desk.settle()
    assert desk.cursor(1) == (5, 5)
    assert desk.expected_at(1).pixel == pytest.approx((320, 190), abs=1)
    desk.do("cancel")
    desk.do("pick", side=0, pixel=(320, 240))
    desk.settle()
    assert desk.expected_at(0) is None


# ---- what depths tell of points ------------------------------------------------------------------


def test_distances_tell_which_point_is_wrong_and_where_the_others_put_it(desk, session):
    fourth = (320.0, 60.0)
    known(session, desk, holes=[(fourth, 12.0)])
    session.on_correspondences(held(*PLACES, fourth))
    desk.follow()
    misfits = desk.points.misfits(session.entries())
    assert {(m.a, m.b) for m in misfits} == {(1, 4), (2, 4), (3, 4)}
    wrong = desk.wrong()
    assert (wrong.id, wrong.number, wrong.clicked) == (13, 4, fourth)
    assert wrong.off_m == pytest.approx(8.0, rel=0.1)
    desk.turn(1)  # in the second image the others put it where it was clicked, but nearer
    assert desk.wrong().fits == pytest.approx(fourth, abs=1)


def test_points_that_agree_are_not_blamed(desk, session):
    known(session, desk)
    session.on_correspondences(held(*PLACES))
    desk.follow()
    assert not desk.points.misfits(session.entries()) and desk.wrong() is None
    assert not desk.points.on_one_line(session.entries())


@pytest.mark.parametrize("with_depths", [True, False])
def test_points_on_one_line_are_seen_with_and_without_depths(desk, session, with_depths):
    if with_depths:
        known(session, desk)
    session.on_correspondences(held((100.0, 100.0), (200.0, 150.0), (300.0, 201.0)))
    desk.follow()
    assert desk.points.on_one_line(session.entries())


def test_a_rigid_motion_is_found_again():
    rng = np.random.default_rng(3)
    p_j, T = rng.normal(size=(5, 3)), np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    T[:3, :3] *= np.sign(np.linalg.det(T[:3, :3]))
    T[:3, 3] = (1, 2, 3)
    assert np.allclose(rigid(p_j @ T[:3, :3].T + T[:3, 3], p_j), T)


# ---- suggestions ---------------------------------------------------------------------------------


def asked(*pixels):
    suggestions = tuple(Suggestion(pixel_i=p, pixel_j=p) for p in pixels)
    views = {"view_i": view("r1"), "view_j": view("r2")}
    question = Question(i="r1", j="r2", **views, reason="weak", gain=0.1, suggestions=suggestions)
    return fleet(6, n=2, questions=(question,))


def test_suggestions_learn_from_what_was_accepted(desk, session):
    near, wrong, far = (110.0, 105.0), (300.0, 300.0), (500.0, 120.0)
    session.on_fleet(asked((100.0, 100.0), near, wrong, far))
    known(session, desk, holes=[(wrong, 12.0)])
    desk.do("accept")
    desk.do("accept")
    assert desk.cursor(0) == far and desk.suggestions.dropped == 1
    desk.do("skip")
    assert desk.cursor(0) == near
    desk.do("back")
    assert desk.cursor(0) == far
    assert "before this one" in refused(desk, "back")  # the first was accepted


def test_suggestions_end_once_the_pair_is_joined(desk, session):
    session.on_fleet(asked((100.0, 100.0), (500.0, 120.0)))
    desk.do("accept")
    assert desk.suggestions.current is not None
    answer = Answer(i="r1", j="r2", clicks=3, predicted=1.0, realised=1.0, joined=("r2",), text="")
    session.on_fleet(fleet(6, n=3, questions=(), answered=(answer,)))
    desk.follow()
    assert desk.suggestions.current is None and not session.frozen


async def test_the_cursors_follow_the_list(session):
    session.on_correspondences(held(*PLACES))
    async with screen(session) as (app, pilot):
        session.select("r1", "r2")
        session.on_picture(picture("r1")), session.on_picture(picture("r2"))
        await press(pilot, "3", "down")
        assert [panel.cursor for panel in app.images] == [PLACES[1]] * 2


def test_an_entry_on_its_way_counts_and_a_rejected_one_does_not(desk, session):
    pick = Pick(view("r1"), view("r2"), PLACES[0], (PLACES[0][0] + 5, PLACES[0][1]))
    entries = [Entry(pick, "pending"), Entry(pick, "rejected")]
    assert desk.points.near(entries) is None
    assert desk.points.near([entries[0], entries[0]]) == (1, 2)


def test_labels_go_away_once_the_cursor_is_put_elsewhere(session, desk):
    for deed in ({"command": "cursor", "side": 0, "pixel": (9, 9)}, {"command": "pick"}):
        known(session, desk)
        desk.hints = Hints.of(PLACES)
        desk.do(**deed)
        assert desk.hints is None
