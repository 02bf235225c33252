"""Restarts, lost messages and bad input between a client and a fake server, over real zenoh."""

import pytest
from hmi_fakes import CAMERA, view, wait_for
from hmi_server import Journal

from fleetpose.hmi_client.model.picture_decoder import decoded
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.codec import pack
from fleetpose.protocol.drops import MAX_REASONS, OTHER, Drops
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.messages import ImageHeader

NEXT_EPOCH = "f" * 12


def ready(client_of, serve, **options):
    server = serve(**options)
    session = OperatorSession("anna")
    client = client_of(session)
    wait_for(lambda: session.fleet is not None)
    return server, session, client


def click(session, k=1):
    return session.add(view("r1"), (10.0 * k, 2.0), view("r2"), (3.0, 4.0))


def both_pictures(session):
    session.select("r1", "r2")
    wait_for(lambda: session.picture("r1") and session.picture("r2"))


# ---- pictures ------------------------------------------------------------------------------------


def test_pictures_are_offered_when_the_server_has_their_views(client_of, serve):
    server, session, _ = ready(client_of, serve, behind=2, robots_forget=True)
    both_pictures(session)
    for robot in ("r1", "r2"):
        wait_for(lambda robot=robot: session.picture(robot).view.seq >= 9)
        assert session.picture(robot).view.seq <= server._seq - 2 + 1
    session.pick(0, (1.0, 2.0))
    wait_for(lambda: session.keeping("r1") == session.keeping("r2") == "pinned")


def test_views_that_the_server_does_not_keep_are_told(client_of, serve):
    _, session, _ = ready(client_of, serve, pins=False)
    both_pictures(session)
    session.toggle_freeze()
    wait_for(lambda: session.keeping("r1") == "not kept")
    events, _ = session.events_since(0)
    assert sum("does not keep" in event for event in events) == 2


def test_a_view_that_its_robot_forgot_comes_from_the_server_if_it_was_clicked_in(client_of, serve):
    server, session, client = ready(client_of, serve)
    ticket = click(session)
    wait_for(lambda: ticket.accepted)
    server.robots_forget = True
    picture = client.fetch_picture(view("r1"))
    assert picture.view == view("r1") and decoded(picture).shape == (480, 640, 3)
    with pytest.raises(UnreachableError, match="nobody clicked in view"):
        client.fetch_picture(view("r1", 99))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"payload": b"no jpeg"}, "these bytes are no JPEG"),
        ({"payload": b""}, "these bytes are no JPEG"),
        ({"cut": 50}, "it is cut off"),
        ({"encoding": "image/png"}, "no JPEG with its header"),
        ({"scale": 2}, "do not fit the camera's 640x480 px"),
        ({"of": "r2"}, "under the key of another robot"),
        ({"attachment": b"\xc1"}, "not msgpack"),
    ],
)
def test_a_bad_image_is_counted_and_told_and_the_next_good_one_shown(
    client_of, serve, change, reason
):
    server, session, client = ready(client_of, serve, live=False, robots_forget=True)
    session.select("r1", "r2")
    wait_for(lambda: server.image_wanted("r1"))
    wait_for(lambda: "r1" in client._intake._cameras)
    good = server.pictures("r1", 7)
    header = ImageHeader(
        view=view(change.get("of", "r1")), stamp_ns=0, scale=change.get("scale", 1)
    )
    payload = change.get("payload", good)[: -change.get("cut", -len(good) - 1)]
    server._images["r1"].put(
        payload, change.get("encoding", "image/jpeg"), change.get("attachment", pack(header))
    )
    wait_for(lambda: reason in session.picture_notice("r1"))
    assert session.picture_notice("r1").startswith("the image of r1 cannot be read: ")
    assert client.drops.total() == 1 and session.picture("r1") is None
    server._images["r1"].put(good, "image/jpeg", pack(ImageHeader(view=view("r1"), stamp_ns=0)))
    wait_for(lambda: session.picture("r1") is not None)
    assert session.picture_notice("r1") == ""


def test_a_camera_that_is_announced_anew_is_believed(client_of, serve):
    server, session, _ = ready(client_of, serve)
    both_pictures(session)
    server.announce("r1", CAMERA.model_copy(update={"width": 320, "height": 240}))
    wait_for(lambda: "fit the camera's 320x240" in session.picture_notice("r1"))
    assert session.picture("r1") is not None  # the previous one stays


# ---- drops ---------------------------------------------------------------------------------------


def test_drops_are_logged_once_per_key_and_reason(client_of, serve, caplog):
    server, session, client = ready(client_of, serve)
    garbage = server.link.latched(server.keys.pose("r1"))
    for n in range(1, 4):
        garbage.put(b"\xc1garbage", "application/msgpack;fleet.pose.v1")
        wait_for(lambda n=n: client.drops["not msgpack"] == n)
    garbage.put(b"x", "application/msgpack;fleet.pose.v9")
    wait_for(lambda: client.drops.total() == 4)
    assert session.drops is client.drops
    said = [r.getMessage() for r in caplog.records if "dropped" in r.getMessage()]
    assert len(said) == 2


def test_samples_that_were_overtaken_are_counted(client_of, serve):
    _, _, client = ready(client_of, serve)
    wait_for(lambda: client.session.status is not None)
    before = client.replaced
    with client.session._changed:  # the reader cannot feed the session meanwhile
        wait_for(lambda: client.replaced > before)


def test_reasons_are_few_whatever_is_sent():
    drops = Drops()
    for k in range(200):
        drops.note("key", f"'{k}' of {k} is wrong: {k}")
    assert drops == {"_ of _ is wrong": 200}
    for k in range(200):
        drops.note("key", "x" * (k % 50) + chr(97 + k % 26) + chr(97 + k // 26) + ": no")
    assert len(drops) <= MAX_REASONS + 1 and drops[OTHER] > 0 and drops.total() == 400


# ---- receipts ------------------------------------------------------------------------------------


def test_receipts_that_were_missed_come_by_repeating(client_of, serve):
    server, session, _ = ready(client_of, serve, lose=3)
    tickets = [click(session, k) for k in range(1, 3)]
    wait_for(lambda: all(t.accepted for t in tickets))
    assert [u.n for u in server.updates].count(1) >= 2  # it was repeated
    assert len(server.sets[("r1", "r2")].items) == 2


def test_two_clients_of_one_name_do_not_disturb_each_other(client_of, serve):
    server, one, _ = ready(client_of, serve)
    two = OperatorSession("anna")
    client_of(two)
    tickets = []
    for k in range(1, 11):
        tickets.append(click(one, k))
        tickets.append(two.add(view("r3"), (10.0 * k, 2.0), view("r4"), (3.0, 4.0)))
    wait_for(lambda: all(t.accepted for t in tickets))
    assert (one.confirmed, two.confirmed) == (10, 10)
    assert [len(s.items) for s in server.sets.values()] == [10, 10]


def test_an_overwritten_receipt_is_had_by_repeating(client_of, serve):
    """The other client's receipts take the place of mine each time but the third."""
    server, session, _ = ready(client_of, serve, lose=2)
    foreign = OperatorSession("anna").add(view("r3"), (1.0, 2.0), view("r4"), (3.0, 4.0)).update
    server.journal.done[foreign.session] = 1
    server.put(server.keys.receipts("anna"), server.receipts(foreign))
    ticket = click(session)
    wait_for(lambda: len(server.updates) >= 1)
    server.put(server.keys.receipts("anna"), server.receipts(foreign))
    wait_for(lambda: ticket.accepted)
    assert len(server.updates) >= 3 and session.confirmed == 1


def test_clear_after_own_clicks_is_never_rejected(client_of, serve):
    server, session, _ = ready(client_of, serve)
    for round_ in range(5):
        clicks = [click(session, 10 * round_ + k) for k in range(1, 4)]
        clear = session.clear(("r1", "r2"))
        wait_for(lambda clear=clear: clear.final)
        assert clear.accepted and all(c.accepted for c in clicks)
    assert server.sets[("r1", "r2")].items == ()


# ---- restarts ------------------------------------------------------------------------------------


def test_a_restarted_server_with_its_journal_goes_on_where_it_was(client_of, serve):
    server, session, _ = ready(client_of, serve)
    both_pictures(session)
    first = click(session, 1)
    wait_for(lambda: first.accepted)
    session.toggle_freeze()
    wait_for(lambda: server.selections[-1].view_i is not None)
    server.mute = True
    second = click(session, 2)
    wait_for(lambda: any(u.n == 2 for u in server.updates))
    server.close()
    third = click(session, 3)
    anew = serve(epoch=NEXT_EPOCH, journal=server.journal)
    wait_for(lambda: second.accepted and third.accepted)
    assert [u.n for u in session.open_updates()] == []
    assert len(anew.sets[("r1", "r2")].items) == 3
    wait_for(lambda: anew.selections and anew.selections[-1].view_i is not None)
    wait_for(lambda: session.keeping("r1") == "pinned")
    wait_for(lambda: len(session.entries(("r1", "r2"))) == 3)


def test_a_server_without_its_journal_gets_what_is_open_in_a_new_session(client_of, serve):
    server, session, _ = ready(client_of, serve)
    first = click(session, 1)
    wait_for(lambda: first.accepted)
    server.close()
    second = click(session, 2)
    anew = serve(epoch=NEXT_EPOCH, journal=Journal())
    wait_for(lambda: second.accepted)
    clicked = [tuple(c.pixel_i) for c in anew.sets[("r1", "r2")].items]
    assert clicked.count((20.0, 2.0)) == 1
    # what was confirmed may come again with the history of what was sent; else its loss is told
    told = "the server has lost its journal: open updates are sent anew" in session.events
    assert clicked.count((10.0, 2.0)) == (0 if told else 1)


def test_a_server_that_forgot_the_selection_is_told_again(client_of, serve):
    """A new epoch is told at once, also where no view is frozen."""
    server, session, _ = ready(client_of, serve)
    session.select("r1", "r2")
    wait_for(lambda: server.selections and server.selections[-1].j == "r2")
    told = len(server.selections)
    server.epoch = NEXT_EPOCH  # as a restart without a new subscription would be
    wait_for(lambda: len(server.selections) > told)
    assert server.selections[-1].j == "r2"


def test_selections_are_told_again_and_again(client_of, serve, monkeypatch):
    monkeypatch.setattr("fleetpose.hmi_client.network.sender.RETELL_S", 0.3)
    server, session, _ = ready(client_of, serve)
    both_pictures(session)
    session.toggle_freeze()
    wait_for(lambda: sum(s.view_i is not None for s in server.selections) >= 3)
    session.toggle_freeze()
    wait_for(lambda: server.selections[-1].view_i is None)
    told = len(server.selections)
    wait_for(lambda: len(server.selections) >= told + 3)
    assert {s.view_i for s in server.selections[told:]} == {None}


def test_a_restarted_router_costs_nothing_but_time(client_of, serve, own_router):
    server, session, client = ready(client_of, serve)
    both_pictures(session)
    own_router.close()
    wait_for(lambda: session.silent, 20.0)
    ticket = click(session, 1)
    own_router.start()
    wait_for(lambda: ticket.accepted, 30.0)
    n, seq = session.fleet.n, session.picture("r1").view.seq
    wait_for(lambda: session.fleet.n > n)
    wait_for(lambda: session.picture("r1").view.seq > seq)
    session.select("r2", "r3")
    wait_for(lambda: session.picture("r3"))
    assert client.failure is None and len(server.sets[("r1", "r2")].items) == 1
