"""The client between a session and a fake server, over real zenoh."""

import pytest
from hmi_fakes import alignment, fleet, pose, view, wait_for

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import FleetState, RobotPose
from fleetpose.protocol.transport import Link, Sample, SessionSettings, open_session

LIAR = "f" * 12


def ready(client_of, serve, **options):
    server = serve(**options)
    session = OperatorSession("anna")
    client = client_of(session)
    wait_for(lambda: session.fleet is not None)
    return server, session, client


def test_state_and_poses_reach_the_session(client_of, serve):
    _, session, _ = ready(client_of, serve)
    wait_for(lambda: session.status is not None)
    assert session.robots() == ["r1", "r2", "r3", "r4", "r5", "r6"]
    assert set(session.poses()) == {"r1", "r2", "r3", "r4", "r5"}
    assert session.silence_s < 2.5


def test_a_click_is_sent_with_its_views_and_receipted(client_of, serve):
    server, session, _ = ready(client_of, serve)
    session.select("r1", "r2")
    wait_for(lambda: session.picture("r1") and session.picture("r2"))
    views = [session.picture(r).view for r in ("r1", "r2")]
    session.pick(0, (12.0, 34.0))
    ticket = session.pick(1, (56.0, 78.0))
    wait_for(lambda: ticket.accepted)
    assert [server.updates[0].view_i, server.updates[0].view_j] == views
    assert tuple(server.updates[0].pixel_j) == (56.0, 78.0)
    wait_for(lambda: session.find(ticket.pick) is not None)
    assert [e.status for e in session.entries()] == ["accepted"]


def test_updates_are_offered_again_until_a_receipt_covers_them(client_of, serve):
    server, session, _ = ready(client_of, serve, mute=True)
    for u in (1.0, 2.0):
        session.add(view("r1"), (u, 2.0), view("r2"), (3.0, 4.0))
    wait_for(lambda: [u.n for u in server.updates].count(2) >= 2)
    assert [u.n for u in server.updates[:2]] == [1, 2]
    server.mute = False
    wait_for(lambda: session.confirmed == 2)
    assert len(server.sets[("r1", "r2")].items) == 2
    assert session.open_updates() == ()


def test_updates_made_before_the_server_is_there_reach_it(client_of, serve):
    session = OperatorSession("anna")
    client_of(session)
    session.add(view("r1"), (1.0, 2.0), view("r2"), (3.0, 4.0))
    server = serve()
    wait_for(lambda: session.confirmed == 1)
    assert len(server.sets[("r1", "r2")].items) == 1


def test_images_of_the_selected_pair_only_are_subscribed(client_of, serve):
    server, session, _ = ready(client_of, serve)
    assert not any(server.image_wanted(r) for r in session.robots())
    session.select("r2", "r3")
    wait_for(lambda: server.image_wanted("r2") and server.image_wanted("r3"))
    assert not server.image_wanted("r1")
    session.select("r1", "r2")
    wait_for(lambda: server.image_wanted("r1") and not server.image_wanted("r3"))
    assert server.image_wanted("r2")


def test_a_robot_that_sends_no_live_image_is_asked_for_its_newest_view(client_of, serve):
    _, session, _ = ready(client_of, serve, live=False)
    session.select("r1", "r2")
    wait_for(lambda: session.picture("r1") and session.picture("r2"))
    assert session.picture("r1").view == view("r1")


def test_the_server_hears_the_selection_and_the_frozen_views(client_of, serve):
    server, session, _ = ready(client_of, serve)
    session.select("r1", "r2")
    wait_for(lambda: server.selections and server.selections[-1].j == "r2")
    assert server.selections[-1].view_i is None
    wait_for(lambda: session.picture("r1") and session.picture("r2"))
    session.pick(0, (1.0, 2.0))
    wait_for(lambda: server.selections[-1].view_i is not None)
    assert server.selections[-1].view_j == session.picture("r2").view


def test_rejections_come_back_with_their_reason(client_of, serve):
    _, session, _ = ready(client_of, serve)
    ticket = session.add(view("r1"), (630.0, 2.0), view("r2"), (3.0, 4.0))
    wait_for(lambda: ticket.final)
    assert ticket.reason == "the pixel has no depth"


def test_correspondences_that_were_there_before_are_known(client_of, serve):
    _, first, _ = ready(client_of, serve)
    first.add(view("r1"), (1.0, 2.0), view("r2"), (3.0, 4.0))
    wait_for(lambda: first.confirmed == 1)
    second = OperatorSession("berta")
    client_of(second)
    wait_for(lambda: len(second.entries(("r1", "r2"))) == 1)


def test_garbage_is_counted_and_harmless(client_of, serve):
    server, session, client = ready(client_of, serve)
    garbage = server.link.latched(server.keys.pose("r1"))
    garbage.put(b"\xc1garbage", "application/msgpack;fleet.pose.v1")
    wait_for(lambda: client.drops["not msgpack"] == 1)
    n = session.fleet.n
    wait_for(lambda: session.fleet.n > n)


def test_of_states_that_come_fast_the_newest_is_told_and_a_damaged_one_counts_once(monkeypatch):
    session = OperatorSession("anna")
    client = Client(session, Keys("demo"), lambda: pytest.fail("nothing is connected to"))
    opened, intake = [], client._intake.open
    monkeypatch.setattr("fleetpose.hmi_client.network.client.STATE_SHARE", 1e-9)  # a large fleet
    monkeypatch.setattr(client._intake, "open", lambda s: opened.append(s) or intake(s))

    def said(payload):
        client._arrived(Sample(client.keys.state, payload, encoding_of(FleetState)))

    client._run("reads", client._read)
    try:
        for n in range(1, 51):
            said(pack(fleet(6, n=n)))
        wait_for(lambda: session.fleet is not None and session.fleet.n == 50)
        assert len(opened) < 25
        wait_for(lambda: not client._is_early())
        said(b"\xc1garbage")
        wait_for(lambda: client.drops["not msgpack"] == 1)
        for n in (100, 101):  # the reader goes round
            told = pose("r1", 100.0 + n, 0.0, n=n)
            client._arrived(Sample(client.keys.pose("r1"), pack(told), encoding_of(RobotPose)))
            wait_for(lambda n=n: session.poses()["r1"].n == n)
        said(pack(fleet(6, n=51)))
        wait_for(lambda: session.fleet.n == 51)
        assert client.drops["not msgpack"] == 1
        for payload in (pack(fleet(6, n=52)), b"\xc1garbage", b"\xc1garbage"):
            said(payload)
        assert session.fleet.n == 51
        wait_for(lambda: session.fleet.n == 52 and client.drops["not msgpack"] == 3)
    finally:
        client.close()


def test_what_another_process_says_for_the_server_is_refused_counted_and_changes_nothing(
    client_of, serve, router
):
    server, session, client = ready(client_of, serve)
    wait_for(lambda: set(session.poses()) == {"r1", "r2", "r3", "r4", "r5"})
    before = session.poses()["r1"].T_fleet_robot
    other = Link(open_session(SessionSettings(connect=(router,), timeout_s=5.0)))
    try:
        said = [
            (other.latched(key), message)
            for key, message in (
                (server.keys.pose("r1"), pose("r1", 100.0, 0.0, n=10**6, server_epoch=LIAR)),
                (server.keys.state, fleet(2, n=10**6, server_epoch=LIAR)),
                (server.keys.alignment("r1", "r2"), alignment("r1", "r2", server_epoch=LIAR)),
            )
        ]
        for publisher, message in said:

            def refused(publisher=publisher, message=message):
                """Said until it is opened: of states between two that are, only the newest is."""
                publisher.put(pack(message), encoding_of(type(message)))
                kind = type(message).__name__
                return client.drops[f"a {kind} of server _ that is not alive"] > 0

            wait_for(refused)
    finally:
        other.close()
    n = session.fleet.n
    wait_for(lambda: session.fleet.n > n)
    assert len(session.robots()) == 6 and ("r1", "r2") not in session.alignments("r1")
    assert (session.poses()["r1"].T_fleet_robot == before).all()


def test_operators_see_where_the_others_are_and_that_they_leave(client_of, serve):
    _, anna, _ = ready(client_of, serve)
    ben = OperatorSession("ben")
    client = client_of(ben)
    wait_for(lambda: ben.fleet is not None)
    ben.select("r3", "r4")
    wait_for(lambda: anna.others() == {("r3", "r4"): ("ben",)})
    anna.select("r3", "r4")
    wait_for(lambda: ben.others() == {("r3", "r4"): ("anna",)})
    assert anna.others() == {("r3", "r4"): ("ben",)}  # not oneself
    client.close()
    wait_for(lambda: anna.others() == {})


def test_a_screen_takes_poses_from_the_state_and_does_not_hear_each(client_of, serve, router):
    server, watching, _ = ready(client_of, serve)
    screen = OperatorSession("ben")
    settings = SessionSettings(connect=(router,), timeout_s=5.0)
    with Client(screen, Keys("demo"), lambda: Link(open_session(settings)), each_pose=False):
        wait_for(lambda: set(screen.poses()) == {"r1", "r2", "r3", "r4", "r5"})
        server.put(server.keys.pose("r1"), pose("r1", 1.0, 2.0, n=50))  # the state tells the first
        wait_for(lambda: watching.poses()["r1"].n == 50)
        assert screen.poses()["r1"].n == 1
