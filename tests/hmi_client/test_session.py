"""The operator's session without screen and network."""

import pytest
from hmi_fakes import EPOCH, fleet, pose, view

from fleetpose.hmi_client.cli.reports import entries_text
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.matrix import THRESHOLD_M, THRESHOLD_SHARE
from fleetpose.hmi_client.model.records import Picture, new_events
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import Correspondence, PairCorrespondences, Receipts, Rejection

A, B = (10.0, 20.0), (30.0, 40.0)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def session(clock):
    s = OperatorSession("anna", clock=clock)
    s.on_fleet(fleet(6))
    return s


def show(session, robot, seq=7):
    session.on_picture(Picture(view(robot, seq), b"jpeg", 1, session.clock()))


def receipts(session, n, *rejected, epoch=EPOCH):
    return Receipts(
        operator="anna",
        session=session.selection().session,
        n=n,
        rejections=tuple(Rejection(n=k, reason="the pixel has no depth") for k in rejected),
        server_epoch=epoch,
    )


def known(*ids_and_picks, revision=1, pair=("r1", "r2")):
    items = tuple(
        Correspondence(
            id=id,
            operator="anna",
            view_i=view(pair[0], seq),
            view_j=view(pair[1], seq),
            pixel_i=pixel_i,
            pixel_j=pixel_j,
            status="accepted",
            revision=3,
        )
        for id, seq, pixel_i, pixel_j in ids_and_picks
    )
    return PairCorrespondences(
        i=pair[0], j=pair[1], revision=revision, items=items, server_epoch=EPOCH
    )


def test_updates_are_numbered_from_one_without_gaps(session):
    for k in range(5):
        session.add(view("r1"), (k, 1.0), view("r2"), B)
    assert [u.n for u in session.open_updates()] == [1, 2, 3, 4, 5]
    assert len({u.session for u in session.open_updates()}) == 1


def test_two_lives_of_a_client_have_different_sessions():
    assert (
        OperatorSession("anna").selection().session != OperatorSession("anna").selection().session
    )


def test_updates_stay_open_until_a_receipt_covers_them(session):
    for k in range(3):
        session.add(view("r1"), (k, 1.0), view("r2"), B)
    session.on_receipts(receipts(session, 2))
    assert [u.n for u in session.open_updates()] == [3]
    assert session.confirmed == 2
    session.on_receipts(receipts(session, 1))  # an old receipt changes nothing
    assert [u.n for u in session.open_updates()] == [3]


def test_receipts_of_another_session_change_nothing(session):
    session.add(view("r1"), A, view("r2"), B)
    foreign = receipts(session, 1).model_copy(update={"session": "f" * 12})
    session.on_receipts(foreign)
    assert len(session.open_updates()) == 1


def test_numbers_go_on_after_receipts(session):
    session.add(view("r1"), A, view("r2"), B)
    session.on_receipts(receipts(session, 1))
    session.add(view("r1"), B, view("r2"), A)
    assert [u.n for u in session.open_updates()] == [2]


def test_a_rejection_is_final_and_shown_with_its_reason(session):
    session.select("r1", "r2")
    ticket = session.add(view("r1"), A, view("r2"), B)
    session.on_receipts(receipts(session, 1, 1))
    assert ticket.final and not ticket.accepted
    [entry] = session.entries()
    assert (entry.status, entry.note) == ("rejected", "the pixel has no depth")
    assert "the pixel has no depth" in session.events[-1]
    assert session.open_updates() == ()
    assert session.cancel() and session.entries() == []


def test_a_server_that_lost_its_journal_gets_open_updates_in_a_new_session(session):
    session.add(view("r1"), A, view("r2"), B)
    session.on_receipts(receipts(session, 1))
    ticket = session.add(view("r1"), B, view("r2"), A)
    old = session.selection().session
    session.on_fleet(fleet(6, server_epoch="f" * 12))
    session.on_receipts(receipts(session, 0, epoch="f" * 12))
    [update] = session.open_updates()
    assert update.n == 1 and update.session != old and ticket.update is update
    session.on_receipts(receipts(session, 1, epoch="f" * 12))
    assert ticket.accepted


def test_a_late_receipt_of_the_same_server_does_not_restart_the_numbers(session):
    session.add(view("r1"), A, view("r2"), B)
    session.on_receipts(receipts(session, 1))
    session.on_receipts(receipts(session, 0, epoch="e" * 12))  # of a server that is not there
    session.add(view("r1"), B, view("r2"), A)
    assert session.open_updates()[0].n == 2


def test_pairs_given_in_the_other_order_swap_views_and_pixels(session):
    session.add(view("r2", 5), B, view("r1", 4), A)
    [update] = session.open_updates()
    assert (update.i, update.j) == ("r1", "r2")
    assert (update.view_i, update.view_j) == (view("r1", 4), view("r2", 5))
    assert tuple(update.pixel_i) == A and tuple(update.pixel_j) == B


def test_the_order_is_that_of_names_not_of_numbers(session):
    session.on_fleet(fleet(10, n=2))
    session.select("r2", "r10")
    assert session.pair == ("r10", "r2")
    assert session.robots()[-1] == "r10"


def test_first_pick_freezes_both_pictures_and_the_commit_names_these_views(session):
    session.select("r2", "r1")
    show(session, "r1", 7), show(session, "r2", 7)
    assert session.pick(0, A) is None
    assert session.selection().view_i == view("r1", 7)
    assert session.selection().view_j == view("r2", 7)
    show(session, "r1", 8), show(session, "r2", 8)
    assert session.picture("r2").view == view("r2", 7)
    ticket = session.pick(1, B)
    assert (ticket.update.view_i, ticket.update.view_j) == (view("r1", 7), view("r2", 7))
    assert not session.frozen and session.half is None
    session.on_fleet(fleet(6, n=2, seq=8))
    assert session.picture("r2").view == view("r2", 8)
    assert session.selection().view_i is None


def test_picking_the_right_image_first_gives_the_same_correspondence(session):
    session.select("r1", "r2")
    show(session, "r1"), show(session, "r2")
    session.pick(1, B)
    ticket = session.pick(0, A)
    assert tuple(ticket.update.pixel_i) == A and tuple(ticket.update.pixel_j) == B


def test_a_second_pick_in_the_same_image_moves_the_first(session):
    session.select("r1", "r2")
    show(session, "r1"), show(session, "r2")
    session.pick(0, B)
    session.pick(0, A)
    assert tuple(session.pick(1, B).update.pixel_i) == A
    assert len(session.open_updates()) == 1


def test_a_picture_that_comes_after_the_freeze_is_frozen_too(session):
    session.select("r1", "r2")
    show(session, "r1")
    session.pick(0, A)
    with pytest.raises(OperatorError, match="has not arrived"):
        session.pick(1, B)
    show(session, "r2", 7), show(session, "r2", 8)
    assert session.selection().view_j == view("r2", 7)


def test_cancel_drops_the_half_pick_and_the_freeze(session):
    session.select("r1", "r2")
    show(session, "r1"), show(session, "r2")
    session.pick(0, A)
    assert session.cancel()
    assert session.half is None and not session.frozen and session.open_updates() == ()


def test_a_freeze_by_hand_lasts_over_several_picks(session):
    session.select("r1", "r2")
    show(session, "r1"), show(session, "r2")
    session.toggle_freeze()
    session.pick(0, A), session.pick(1, B)
    assert session.frozen
    session.toggle_freeze()
    assert not session.frozen


def test_pictures_of_robots_that_are_not_selected_are_not_kept(session):
    session.select("r1", "r2")
    show(session, "r3")
    session.select("r2", "r3")
    assert session.picture("r3") is None


def test_stale_pictures_are_not_offered_again(session, clock):
    session.select("r1", "r2")
    show(session, "r1")
    clock.now += 60
    session.select("r1", "r3")
    assert session.picture("r1") is None


def test_the_first_undo_drops_a_half_pick(session):
    session.select("r1", "r2")
    show(session, "r1"), show(session, "r2")
    session.pick(0, A), session.pick(1, B)
    session.pick(0, B)
    assert session.undo()
    assert session.half is None and len(session.open_updates()) == 1


def test_undo_of_a_known_pick_erases_it_by_its_id_and_revision(session):
    session.add(view("r1"), A, view("r2"), B)
    session.on_receipts(receipts(session, 1))
    session.on_correspondences(known((17, 7, A, B)))
    assert session.undo()
    [update] = session.open_updates()
    assert (update.action, update.correspondence, update.base_revision) == ("erase", 17, 3)
    assert [e.status for e in session.entries(("r1", "r2"))] == ["erasing"]


def test_undo_before_the_server_named_the_pick_waits_for_its_name(session):
    session.add(view("r1"), A, view("r2"), B)
    assert session.undo()
    assert [u.action for u in session.open_updates()] == ["add"]
    session.on_receipts(receipts(session, 1))
    session.on_correspondences(known((17, 7, A, B)))
    assert [(u.n, u.action, u.correspondence) for u in session.open_updates()] == [(2, "erase", 17)]


def test_undo_of_a_rejected_pick_erases_nothing(session):
    session.add(view("r1"), A, view("r2"), B)
    session.undo()
    session.on_receipts(receipts(session, 1, 1))
    assert session.open_updates() == ()


def test_redo_puts_the_pick_back_once(session):
    session.add(view("r1"), A, view("r2"), B)
    session.on_receipts(receipts(session, 1))
    session.on_correspondences(known((17, 7, A, B)))
    session.undo()
    assert session.redo() and not session.redo()
    assert [u.action for u in session.open_updates()] == ["erase", "add"]
    assert tuple(session.open_updates()[1].pixel_j) == B


def test_redo_of_an_undo_that_still_waits_sends_nothing(session):
    session.add(view("r1"), A, view("r2"), B)
    session.undo()
    session.redo()
    session.on_correspondences(known((17, 7, A, B)))
    assert [u.action for u in session.open_updates()] == ["add"]


def test_undo_of_an_erase_puts_the_correspondence_back(session):
    session.on_correspondences(known((17, 7, A, B)))
    session.erase(("r1", "r2"), 17)
    session.undo()
    erase, add = session.open_updates()
    assert (erase.action, add.action) == ("erase", "add")
    assert add.view_i == view("r1", 7) and tuple(add.pixel_i) == A


def test_clear_names_the_revision_of_the_set_and_can_be_undone(session):
    session.on_correspondences(known((17, 7, A, B), (18, 7, B, A), revision=9))
    session.clear(("r1", "r2"))
    [clear] = session.open_updates()
    assert (clear.action, clear.base_revision) == ("clear", 9)
    assert session.clear(("r1", "r2")) is None
    session.undo()
    assert [u.action for u in session.open_updates()] == ["clear", "add", "add"]


def test_a_rejected_erase_shows_the_correspondence_as_it_was(session):
    session.on_correspondences(known((17, 7, A, B)))
    session.erase(("r1", "r2"), 17)
    session.on_receipts(receipts(session, 1, 1))
    assert [e.status for e in session.entries(("r1", "r2"))] == ["accepted"]


def test_erasing_what_is_not_there_says_what_is(session):
    session.on_correspondences(known((17, 7, A, B)))
    with pytest.raises(OperatorError, match="it has: 17"):
        session.erase(("r1", "r2"), 5)


def test_an_accepted_pick_is_listed_until_its_set_arrives_and_only_once(session):
    ticket = session.add(view("r1"), A, view("r2"), B)
    session.on_receipts(receipts(session, 1))
    assert [e.status for e in session.entries(("r1", "r2"))] == ["pending"]
    session.on_correspondences(known((17, 7, A, B)))
    assert [(e.status, e.id) for e in session.entries(("r1", "r2"))] == [("accepted", 17)]
    assert session.find(ticket.pick) == 17


def test_an_older_set_does_not_replace_a_newer_one(session):
    session.on_correspondences(known((17, 7, A, B), revision=5))
    session.on_correspondences(known(revision=4))
    assert len(session.entries(("r1", "r2"))) == 1


def test_another_server_epoch_replaces_what_was_known(session):
    session.on_correspondences(known((17, 7, A, B)))
    session.on_fleet(fleet(6, server_epoch="f" * 12))
    assert session.entries(("r1", "r2")) == []


def test_older_poses_and_poses_of_other_servers_are_dropped(session):
    session.on_pose(pose("r1", 1.0, 0.0, n=5))
    session.on_pose(pose("r1", 2.0, 0.0, n=4))
    session.on_pose(pose("r1", 3.0, 0.0, n=9, server_epoch="f" * 12))
    assert session.poses()["r1"].n == 5


def test_next_question_follows_the_ranking_and_wraps(session):
    pairs = []
    for _ in range(3):
        assert session.next_question()
        pairs.append(session.pair)
    assert pairs == [("r5", "r6"), ("r1", "r2"), ("r5", "r6")]
    session.next_question(-1)
    assert session.pair == ("r1", "r2")


def test_a_question_that_was_passed_over_does_not_come_back_when_the_ranking_turns(session):
    first, second = session.fleet.questions[:2]
    session.next_question()
    session.on_fleet(fleet(n=session.fleet.n + 1, questions=(second, first)))
    session.next_question()
    assert session.pair == (second.i, second.j)
    session.on_fleet(fleet(n=session.fleet.n + 1, questions=(second, first)))
    session.next_question()
    assert session.pair == (first.i, first.j)


def test_the_threshold_follows_the_scene_until_the_operator_says_otherwise():
    session = OperatorSession("op")
    assert session.threshold_m == THRESHOLD_M  # nobody has told the depth yet
    for n, depth_m in enumerate((8.0, 0.5), 1):
        session.on_fleet(fleet(n=n, depth_m=depth_m))
        assert session.threshold_m == pytest.approx(THRESHOLD_SHARE * depth_m)
    session.set_threshold(0.2)
    session.on_fleet(fleet(n=3, depth_m=100.0))
    assert session.threshold_m == 0.2
    given = OperatorSession("op", threshold_m=0.3)
    given.on_fleet(fleet(depth_m=100.0))
    assert given.threshold_m == 0.3


def test_only_changed_topics_grow(session):
    before = session.revisions()
    session.set_threshold(0.2)
    changed = {t for t, n in session.revisions().items() if n != before.get(t, 0)}
    assert changed == {"settings"}
    assert session.wait_change(before, ("settings",), 0.0)
    assert not session.wait_change(session.revisions(), ("settings",), 0.0)


def test_selecting_one_robot_twice_or_an_unknown_one_is_refused(session):
    with pytest.raises(OperatorError, match="one robot"):
        session.select("r1", "r1")
    with pytest.raises(OperatorError, match="known robots: r1, r2"):
        session.select("r1", "nobody")


def test_silence_is_measured_by_the_injected_clock(session, clock):
    clock.now += 4.0
    assert session.silence_s == 4.0
    assert OperatorSession("anna", clock=clock).silence_s == float("inf")


def test_new_events_are_those_behind_the_overlap():
    assert new_events(("a", "b", "c"), ("b", "c", "d")) == ("d",)
    assert new_events(("a",), ("a",)) == ()
    assert new_events((), ("a", "b")) == ("a", "b")
    assert new_events(("a", "a"), ("a", "a", "a")) == ("a",)


def test_a_table_of_correspondences_shows_the_id_zero(session):
    session.on_correspondences(known((0, 7, A, B)))
    text = entries_text(("r1", "r2"), session.entries(("r1", "r2")))
    assert text.splitlines()[1].split()[:2] == ["0", "accepted"]


def test_the_state_tells_how_old_a_pose_has_become_and_an_older_one_changes_nothing(session):
    newest = session.poses()["r1"]
    aged = newest.model_copy(update={"age_s": 9.0, "located": False})
    state = fleet(6, n=2)
    robots = [r.model_copy(update={"pose": aged}) if r.robot == "r1" else r for r in state.robots]
    session.on_fleet(state.model_copy(update={"robots": tuple(robots)}))
    assert not session.poses()["r1"].located and session.poses()["r1"].age_s == 9.0
    session.on_pose(newest)  # a repeat of what was latched
    assert not session.poses()["r1"].located
