"""A recorded session in a page: it plays, stands still, and goes back."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="starlette is not installed: pip install 'fleetpose[web]'")
sys.path.insert(0, str(Path(__file__).parent))

from real_bridge import real_bridge

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.hmi_client.recording.link import RecordedLink
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.recording.file import Recorder
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until

PAIR = ("r1", "r2")


@pytest.fixture
def recorded(serve, router, tmp_path):
    serve(count=6)
    path = tmp_path / "session.mcap"
    with Recorder(path, "demo", "anna") as recorder:
        session = OperatorSession("anna")

        def open_link() -> Link:
            settings = SessionSettings(connect=(router,), timeout_s=5.0)
            return RecordedLink(Link(open_session(settings)), recorder)

        with Client(session, Keys("demo"), open_link):
            assert wait_until(lambda: session.robots() != [], 30)
            session.select(*PAIR)
            for u in (100.0, 200.0):
                assert wait_until(lambda: all(map(session.picture, PAIR)), 30)
                session.pick(0, (u, 50.0))
                session.pick(1, (u - 20.0, 60.0))
            assert wait_until(lambda: session.unconfirmed == 0, 30)
            assert wait_until(lambda: len(session.entries()) == 2, 30)
    return path


def points(page) -> int:
    return len(page.texts.get("list", {}).get("points", ()))


def test_a_recording_plays_stands_still_and_goes_back(recorded, router, tmp_path):
    with real_bridge(router, tmp_path, replay=recorded) as bridge:
        page = bridge.page()
        page.wait(lambda p: "clock" in p.texts and p.texts["welcome"]["replay"])
        assert page.texts["welcome"]["operator"] == "anna"
        page.wait(lambda p: points(p) == 2)
        end_s = page.texts["clock"]["of_s"]
        page.say(do="seek", s=end_s)
        page.wait(lambda p: p.texts["clock"]["s"] == end_s)
        page.say(do="erase", id=1)
        page.wait(lambda p: "recording" in p.texts.get("notice", {}).get("text", ""))
        page.say(do="play", paused=True)
        page.say(do="seek", s=0)
        page.wait(lambda p: points(p) == 0 and p.texts["clock"]["s"] < 0.2)
        page.say(do="speed", value=100)
        page.say(do="play", paused=False)
        page.wait(lambda p: points(p) == 2 and p.texts["clock"]["speed"] == 100)
