"""One thing to do at a time, with its reason and its keys, in every state."""

import pytest
from hmi_fakes import fleet, view
from screen_makers import picture
from test_desk import PLACES, asked, held, known
from test_desk import desk as desk

from fleetpose.hmi_client.assist.clicked_points import Wrong
from fleetpose.hmi_client.desk.advice import step
from fleetpose.hmi_client.desk.words import confirmation, farewell, plain, sentences
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import Answer, PairCell, Receipts, Rejection

REASON = (
    "Nothing joins r6 to the fleet yet; these two images may overlap. "
    "The chance that they show the same is 3%."
)


def commands(desk):
    return [action.do for action in step(desk).actions]


def test_without_a_pair_the_best_question_is_one_key_away(session, desk):
    session.pair = None
    now = step(desk)
    assert now.tone == "ask" and "r5 - r6" in now.title
    assert [(a.do, a.key, a.primary) for a in now.actions] == [("next", "n", True)]


def test_a_server_that_is_silent_is_named_with_what_is_kept(session, clock, desk):
    desk.where = "of hall at tcp/10.0.0.1:7447"
    session.add(view("r1"), PLACES[0], view("r2"), PLACES[0])
    clock.now += 3.0
    assert "slow" in step(desk).title and step(desk).tone == "gone"
    clock.now += 6.0
    assert step(desk).title == ("NO SERVER of hall at tcp/10.0.0.1:7447: nothing heard for 9 s")
    assert any(fact.startswith("1 click kept") for fact in step(desk).facts)


def test_a_question_about_a_robot_that_ended_says_so(session, desk):
    states = tuple(
        state.model_copy(update={"alive": state.robot != "r6"}) for state in fleet(6).robots
    )
    session.on_fleet(fleet(6, n=2, robots=states))
    session.select("r5", "r6")
    assert step(desk).title == "r6 ended: no image comes any more"
    assert commands(desk) == ["next", "why"]


def test_points_are_counted_and_what_they_lack_is_said(session, desk):
    facts = {}
    for count, pixels in enumerate(
        (PLACES[:1], (PLACES[0], (105.0, 100.0)), ((100.0, 100.0), (200.0, 150.0), (300.0, 201.0)))
    ):
        revision = held(*pixels).model_copy(update={"revision": count + 1})
        session.on_correspondences(revision)
        facts[count] = " | ".join(step(desk).facts)
    assert "1 of 3 points" in facts[0]
    assert "1 and 2 are within 12 px: pick farther apart" in facts[1]
    assert "these three lie on one line: pick one to the side" in facts[2]


def test_two_points_that_do_not_fit_are_told_with_both_distances(session, desk):
    known(session, desk, holes=[(PLACES[1], 16.0)])
    session.on_correspondences(held(*PLACES[:2]))
    desk.follow()
    assert step(desk).title == "1 and 2 do not fit: 3.20 m apart in r1, 14.42 m in r2"
    assert step(desk).tone == "warn" and "erase" in commands(desk)


def test_an_outlier_is_named_shown_and_can_be_moved_or_erased(session, desk):
    points = held(*PLACES, status="accepted", seq=3)
    second = points.items[1].model_copy(update={"status": "outlier", "residual_m": 3.5})
    items = (points.items[0], second, points.items[2])
    session.on_correspondences(points.model_copy(update={"items": items}))
    assert step(desk).title == "Point 2 does not fit the others: 3.50 m off"
    assert commands(desk) == ["look", "erase"]  # it was clicked in another view
    desk.do("look")
    for robot in ("r1", "r2"):
        session.on_fetched(picture(robot, 3))
    assert desk.cursor(0) == PLACES[1] and commands(desk) == ["move", "erase"]
    assert all(action.key for action in step(desk).actions)
    desk.do("erase", **step(desk).actions[1].args)
    assert session.entries()[1].status == "erasing"


def test_a_point_that_is_where_the_others_put_it_is_erased_not_moved(session, desk, monkeypatch):
    session.on_correspondences(held(*PLACES, status="accepted", seq=3))
    desk.do("show", number=2)
    for robot in ("r1", "r2"):
        session.on_fetched(picture(robot, 3))
    id = session.entries()[1].id
    for off_px, best in ((40.0, "move"), (0.5, "erase")):
        wrong = Wrong(id, 2, 0, PLACES[1], PLACES[1], 1.3, off_px)
        monkeypatch.setattr(desk, "wrong", lambda wrong=wrong: wrong)
        assert [action.do for action in step(desk).actions if action.primary] == [best]


def test_after_the_last_suggestion_was_refused_the_next_question_is_proposed(session, desk):
    session.on_fleet(asked((100.0, 100.0), (500.0, 120.0)))
    known(session, desk, holes=[((100.0, 100.0), 12.0)])
    for _ in range(3):  # shows the first, refuses both
        desk.do("accept" if desk.suggestions.current is None else "skip")
    assert step(desk).title == "None of the suggestions shows the same in r1 and r2"
    assert [action.do for action in step(desk).actions if action.primary] == ["next"]


def test_a_refused_point_says_why_until_it_is_cleared(session, desk):
    session.add(view("r1"), PLACES[0], view("r2"), PLACES[0])
    mine = {"operator": "anna", "session": session.selection().session}
    rejection = Rejection(n=1, reason="the pixel has no depth")
    epoch = session.fleet.server_epoch
    session.on_receipts(Receipts(**mine, n=1, rejections=(rejection,), server_epoch=epoch))
    assert step(desk).title == "Point 1 was refused: the pixel has no depth"
    desk.do("cancel")
    assert "refused" not in step(desk).title


def test_a_suggestion_tells_both_depths(session, desk):
    session.on_fleet(asked((100.0, 100.0), (500.0, 120.0)))
    known(session, desk, holes=[((100.0, 100.0), 12.0)])
    desk.do("accept")
    assert "Suggestion 1 of 2" in step(desk).title
    assert "4.00 m away in r1, 12.00 m away in r2" in step(desk).facts
    assert commands(desk) == ["accept", "skip", "cancel"]


def test_the_end_is_said(session, desk):
    answer = Answer(i="r1", j="r2", clicks=41, predicted=1, realised=1, joined=("r2",), text="41")
    session.on_correspondences(held(*PLACES, status="accepted"))
    session.on_fleet(fleet(6, n=2, questions=(), answered=(answer,)))
    now = step(desk)
    assert now.tone == "done" and now.title.startswith("r2 joined: 4 of 6 robots located")
    assert "3 points in r1 and r2" in now.facts


def test_a_pair_that_stays_plausible_says_that_nothing_confirms_it_yet(session, desk):
    cell = PairCell(i="r1", j="r2", state="tried", verdict="plausible", rmse_m=0.03)
    session.on_fleet(asked(*PLACES).model_copy(update={"pairs": (cell,)}))
    session.on_correspondences(held(*PLACES))
    assert "3 points clicked, not confirmed by the images yet" in step(desk).facts


@pytest.mark.parametrize("robots", [0, 1, 6])
def test_every_step_has_a_title_a_tone_and_at_most_three_actions(robots):
    session = OperatorSession("anna", clock=lambda: 0.0)
    session.on_fleet(fleet(robots))
    from fleetpose.hmi_client.desk.desk import Desk

    told = step(Desk(session)).as_json()
    assert told["title"] and len(told["actions"]) <= 3
    assert set(told) == {"tone", "title", "facts", "actions"}


# ---- words ---------------------------------------------------------------------------------------


def test_no_gain_and_no_chance_is_told_that_nobody_has_calibrated():
    assert sentences(plain(REASON)) == [
        "Nothing joins r6 to the fleet yet",
        "these two images may overlap",
    ]
    told = "the fleet is known 1.3 m better on average (0.00012 m expected)"
    assert plain(told) == "the fleet is known 1.3 m better on average"
    assert plain("something new") == "something new"
    late = "correspondence 3 was changed meanwhile: it is at revision 2, this was made at 1"
    assert plain(f"rejected: {late}") == "rejected: somebody has moved it meanwhile"
    assert plain("correspondence 3 of r1, r2 is not there") == "somebody has erased it meanwhile"


def test_confirmations_count_points_and_the_last_line_tells_what_was_done(session):
    session.on_correspondences(held(*PLACES))
    assert confirmation(session) == "3 points confirmed"
    assert farewell(session, {}) == "anna: nothing picked; 4 of 6 robots located"
    told = farewell(session, {"picked": 3, "erased": 1})
    assert told == "anna: 3 points picked, 1 erased, all confirmed; 4 of 6 robots located"
