"""What a robot learns of its views: the server has them, or why it has none. One is on its way at a
time, and holds what the link carries.
"""

import logging
import re

import cv2
import numpy as np
import pytest

from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.messages import Heard, View
from fleetpose.protocol.transport import wait_until
from fleetpose.robot_agent import hearing
from fleetpose.robot_agent.cameras.base import ScatteredPoints
from fleetpose.robot_agent.client import FleetRobot
from fleetpose.robot_agent.on_way import MOST_WAIT_S, SHARES, SLOW_S, Budget, OnWay
from tests.robot_agent.slow_link import SlowLink
from tests.robot_agent.test_client import DEPTH, IMAGE, KEYS, MODEL, settings_for

LIVE, OTHER = "0" * 12, "f" * 12


@pytest.fixture
def robot(router):
    with FleetRobot("r1", settings_for(router), camera=MODEL) as opened:
        yield opened


def heard(n=0, seq=None, epoch=None, **changes):
    told = {"robot": "r1", "drops": {}, "version": "0.2.0", "reads": ("fleet.view.v3",)}
    return Heard(**{**told, "epoch": epoch, "seq": seq, "server_epoch": LIVE, "n": n, **changes})


@pytest.fixture
def ear(link):
    """Says what a server hears: `ear(heard(...))`; its token is there."""
    publisher = link.latched(KEYS.heard("r1"))
    link.token(KEYS.server_alive(LIVE))
    return lambda message: publisher.put(pack(message), encoding_of(Heard))


def test_views_that_the_server_has_are_no_silence(robot, ear, caplog, monkeypatch):
    monkeypatch.setattr(hearing, "UNHEARD_S", 0.2)
    caplog.set_level(logging.INFO)
    assert robot.heard_age_s is None
    assert wait_until(lambda: robot.server_alive, 30)
    robot.push(IMAGE, DEPTH)
    assert wait_until(lambda: "not heard for" in caplog.text, 30)
    ear(heard(n=1, seq=0, epoch=robot.epoch))
    assert wait_until(lambda: "the server hears this robot again" in caplog.text, 30)
    assert robot.heard_age_s < 5.0


@pytest.mark.parametrize(
    ("told", "cause"),
    [
        (None, "a server is there, but not for this robot .*rules know the name 'r1'"),
        ({}, "none of its views: may it publish under 'fleet/demo/robot/r1/cloud'"),
        ({"drops": {"view _ has _ points": 3}}, "refuses its views: view _ has _ points 3"),
        ({"reads": ("fleet.view.v9",)}, r"\(fleetpose 0.2.0\) does not read fleet.view.v3"),
        ({"epoch": "own", "seq": 0}, "no view since number 0: the link is slow, or lost"),
    ],
    ids=["denied", "cloud denied", "refused", "other version", "lost"],
)
def test_the_cause_of_a_silence_is_told(robot, ear, caplog, monkeypatch, told, cause):
    monkeypatch.setattr(hearing, "UNHEARD_S", 0.5)
    assert wait_until(lambda: robot.server_alive, 30)
    if told is not None:
        own = {"epoch": robot.epoch} if told.get("epoch") == "own" else {}
        ear(heard(n=1, **{**told, **own}))
        assert wait_until(lambda: robot._hearing.newest is not None, 30)
        if own:
            robot.push(IMAGE, DEPTH)
            assert wait_until(lambda: robot._sender._on_way._newest_sent == 0, 30)
    robot.push(IMAGE, DEPTH)
    assert wait_until(lambda: "not heard for" in caplog.text, 30)
    assert re.search(cause, caplog.text), caplog.text
    assert caplog.text.count("not heard for") == 1


def test_another_cause_of_the_same_silence_is_told_at_once(caplog, monkeypatch):
    monkeypatch.setattr(hearing, "ASKED_AGAIN_S", 0.05)
    monkeypatch.setattr(hearing, "_LOOK_S", 0.01)
    causes = ["nothing listens", *["view 1 is refused", "view 2 is refused"] * 5, "expired"]

    def cause() -> str:
        return causes.pop(0) if len(causes) > 1 else causes[0]

    watch = hearing.SilenceWatch(lambda: 9.0, lambda: True, cause, lambda _: "")
    watch.start()
    assert wait_until(lambda: "expired" in caplog.text, 30)
    watch.close()
    assert [one.message.rpartition(": ")[2] for one in caplog.records] == [
        *("nothing listens", "view 1 is refused", "expired")
    ]


def test_a_router_that_is_lost_is_told_before_any_view_is_missed(own_router, caplog, monkeypatch):
    monkeypatch.setattr(hearing, "LOST_S", 0.2)
    caplog.set_level(logging.INFO)
    with FleetRobot("r1", settings_for(own_router.endpoint), camera=MODEL):
        own_router.close()
        assert wait_until(lambda: "no router is reached" in caplog.text, 30), caplog.text
        own_router.start()
        assert wait_until(lambda: "hears this robot again" in caplog.text, 20), caplog.text


def test_what_another_says_is_heard_is_refused(robot, ear, link):
    ear(heard(n=1, seq=0, epoch=robot.epoch, server_epoch=OTHER))
    assert wait_until(lambda: robot.drops.total() == 1, 30)
    assert robot.heard_age_s is None
    false = link.latched(KEYS.heard("r1"))
    false.put(pack(heard(n=2, robot="r2")), encoding_of(Heard))
    assert wait_until(lambda: robot.drops.total() == 2, 30)


def test_one_view_at_a_time_is_on_its_way_where_the_server_confirms(robot, ear, link):
    clouds = link.on_bulk(KEYS.cloud("r1"))
    ear(heard(n=1))
    assert wait_until(lambda: robot._hearing.newest is not None, 30)
    robot.push(IMAGE, DEPTH)
    assert clouds.take(30) is not None
    for _ in range(3):
        robot.push(IMAGE, DEPTH)
    assert clouds.take(1.0) is None, "the first is not confirmed yet"
    ear(heard(n=2, seq=0, epoch=robot.epoch))
    sample = clouds.take(30)
    assert sample is not None
    assert unpack(View, sample.payload, sample.encoding).name.seq == 3, "the newest goes next"
    assert unpack(View, sample.payload, sample.encoding).on_way_s > 0.9


# ---- what the link carries -----------------------------------------------------------------------


def test_a_slow_link_gets_smaller_views_until_they_pass_in_time():
    budget, bytes_s, full = Budget(), 60e3, 150e3
    took_s = [full / bytes_s]
    for _ in range(10):
        budget.note(took_s[-1], 0.9)
        took_s.append(full * budget.share / bytes_s)
    assert took_s[0] > 2.0 and took_s[-1] < SLOW_S
    assert budget.points(1600) == round(1600 * budget.share) < 1600
    assert 30 <= budget.quality(85) < 85


def test_one_late_word_changes_nothing_and_a_fast_link_gets_all_again():
    budget = Budget()
    for took_s in (0.1, 1.9, 0.1, 1.9, 0.1):
        assert not budget.note(took_s, 0.9)
    budget.step = len(SHARES) - 1
    for _ in range(200):
        budget.note(0.05, 0.9)
    assert budget.share == 1.0 and budget.points(1600) == 1600 and budget.quality(85) == 85


def test_points_are_not_given_up_where_they_are_not_what_is_large():
    budget = Budget()
    for _ in range(10):
        budget.note(5.0, salient_part=0.1)
    assert budget.share == 1.0


def test_fewer_points_than_a_place_needs_are_never_sent():
    budget = Budget(step=len(SHARES) - 1)
    assert budget.points(1600) == 200 and budget.points(50) == 50 and budget.quality(30) == 30


def test_a_view_that_is_never_confirmed_holds_up_the_next_for_a_while_only():
    way = OnWay(waits=True)
    way.sent(0, 10.0, 1000, 0.9)
    assert way.free_in_s(10.0) == MOST_WAIT_S and way.free_in_s(10.0 + MOST_WAIT_S) == 0.0
    way.sent(1, 15.0, 1000, 0.9)
    assert way.took_s == 5.0 and way.silent_since_s == 10.0
    way.confirmed(1, 0.25, 16.0)
    assert (way.took_s, way.silent_since_s, way.confirmed_s) == (0.75, None, 16.0)
    way.confirmed(1, 0.0, 17.0)
    assert way.confirmed_s == 17.0 and way.free_in_s(17.0) == 0.0


def test_views_of_which_none_comes_in_time_shrink_but_not_while_nobody_listens():
    way = OnWay(waits=True)
    for n in range(4):
        way.sent(n, n * MOST_WAIT_S, 190_000, 0.9)
    assert way.budget.share < 0.2
    alone = OnWay(waits=False)
    for n in range(4):
        alone.sent(n, n * MOST_WAIT_S, 190_000, 0.9)
    assert alone.budget.share == 1.0 and alone.image_may_go(10**6, 0.0)


def test_images_get_a_part_of_a_slow_links_time_and_all_they_want_of_a_fast_one():
    def images_in_a_minute(bytes_s: float) -> int:
        way, sent = OnWay(waits=True), 0
        for now_s in range(60):
            way.sent(now_s, float(now_s), 40_000, 0.9)
            way.confirmed(now_s, 0.0, now_s + 40_000 / bytes_s)
            sent += way.image_may_go(60_000, now_s + 0.1)
        return sent

    assert images_in_a_minute(10e6) == 60
    slow = images_in_a_minute(50e3)
    assert 0 < slow * 60_000 / 50e3 < 60 * 0.2


def test_an_older_view_that_is_confirmed_again_is_no_news():
    way = OnWay(waits=True)
    for seq in (0, 1):
        way.sent(seq, float(seq), 1000, 0.9)
    way.confirmed(0, 0.0, 2.0)
    way.confirmed(0, 0.0, 9.0)
    assert (way.confirmed_s, way.silent_since_s) == (2.0, 2.0)


@pytest.mark.timeout(60)
def test_over_a_slow_link_views_shrink_until_each_takes_less_than_a_second(router, ear, link):
    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 256, (480, 640, 3), np.uint8), (0, 0), 1.5)
    points = ScatteredPoints(rng.uniform((0, 0), (639, 479), (4000, 2)), rng.uniform(1, 3, 4000))
    model = MODEL.model_copy(update={"width": 640, "height": 480})
    views: list[View] = []

    def confirm(sample):
        view = unpack(View, sample.payload, sample.encoding)
        views.append(view)
        ear(heard(n=len(views) + 1, seq=view.name.seq, epoch=view.name.epoch))

    link.subscribe_bulk(KEYS.cloud("r1"), confirm)
    ear(heard(n=1))
    with (
        SlowLink(router, bytes_s=70e3) as slow,
        FleetRobot("r1", settings_for(slow.endpoint), camera=model) as robot,
    ):
        assert wait_until(lambda: robot._hearing.newest is not None, 30)

        def passes():
            robot.push(image, points)
            return len(views) > 2 and views[-1].share < 1 and views[-1].on_way_s < SLOW_S

        assert wait_until(passes, 40, poll_s=0.2), [(v.share, v.on_way_s) for v in views]
    assert views[1].on_way_s > SLOW_S and views[1].share == 1.0
    assert views[-1].salient.count < views[0].salient.count
