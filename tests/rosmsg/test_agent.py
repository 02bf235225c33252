"""A robot out of a bag, on the wire: what the fleet is told of it."""

import threading

from fleetpose.protocol.codec import unpack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import CameraAnnouncement, Odometry, View
from fleetpose.protocol.transport import Link, SessionSettings, open_session
from fleetpose.robot_agent.agent import run_agent
from fleetpose.robot_agent.settings import RobotSettings
from tests.rosmsg import bag_makers as makers


def test_the_fleet_hears_recorded_views_with_their_own_stamps_and_odometry(router, tmp_path):
    path = makers.write_rgbd(tmp_path / "bag", makers.source(4))
    link, keys, heard = Link(open_session(SessionSettings(connect=(router,)))), Keys("demo"), []
    came = threading.Event()

    def note(kind):
        def store(sample):
            heard.append(unpack(kind, sample.payload, sample.encoding))
            came.set()

        return store

    link.on_latched(keys.camera("r1"), note(CameraAnnouncement))
    link.on_latched(keys.odometry("r1"), note(Odometry))
    link.subscribe_bulk(keys.cloud("r1"), note(View))
    settings = RobotSettings(
        name="r1", connect=(router,), camera="bag", data=str(path), rate_hz=20, speed=1.0
    )
    run_agent(settings, threading.Event())
    needed = {CameraAnnouncement, Odometry, View}
    while not needed <= {type(message) for message in heard}:
        assert came.wait(20), "nothing more came"
        came.clear()
    link.close()
    first = {kind: next(m for m in heard if type(m) is kind) for kind in needed}
    assert first[CameraAnnouncement].clock == "recorded"
    stamps = {makers.BEGIN_NS + k * makers.PERIOD_NS for k in range(4)}
    assert {m.stamp_ns for m in heard if isinstance(m, Odometry | View)} <= stamps
