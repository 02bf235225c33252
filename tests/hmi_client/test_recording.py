"""A recorded session comes out of its file as it was, also cut off, and plays as it was seen."""

import os
import re
from pathlib import Path

import pytest
from hmi_fakes import NO_DEPTH_U
from typer.testing import CliRunner

from fleetpose.hmi_client.cli.commands import app
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.hmi_client.recording.link import RecordedLink
from fleetpose.hmi_client.recording.player import PlayClock, PlayedSession, Player
from fleetpose.hmi_client.recording.timeline import timeline
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.recording.file import Recorder, Recording, RecordingError
from fleetpose.protocol.transport import Link, Sample, SessionSettings, open_session, wait_until

PAIR = ("r1", "r2")


@pytest.fixture
def recorded(serve, router, tmp_path):
    """A session against a server in its file, and the session as it was at the end."""
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
            for u in (100.0, 200.0, NO_DEPTH_U + 9, 300.0):
                assert wait_until(lambda: all(map(session.picture, PAIR)), 30)
                session.pick(0, (u, 50.0))
                session.pick(1, (u - 20.0, 60.0))
            assert wait_until(lambda: session.unconfirmed == 0, 30)
            assert wait_until(lambda: settled(session) == 3, 30)
            session.erase(PAIR, 1)
            assert wait_until(lambda: settled(session) == 2 and session.unconfirmed == 0, 30)
            session.toggle_freeze()
            assert wait_until(lambda: session.keeping("r1") == "pinned", 30)
    return path, session


def settled(session) -> int:
    return sum(1 for entry in session.entries() if entry.status == "accepted")


def played(path) -> tuple[PlayedSession, Player]:
    recording, clock = Recording(path), PlayClock()
    session = PlayedSession(recording, clock)
    player = Player(recording, session, clock)
    player.skip_to(recording.seconds)
    player.run()
    return session, player


def test_a_played_session_ends_as_the_recorded_one(recorded):
    path, live = recorded
    session, player = played(path)
    assert session.entries() == live.entries()
    assert (session.pair, session.operator) == (PAIR, "anna")
    assert session.confirmed == live.confirmed == 5
    assert session.unconfirmed == 0
    assert session.frozen_views() == live.frozen_views() != ()
    assert session.selection() == live.selection()
    assert session.poses().keys() == live.poses().keys()
    assert player.paused and player.at_s == player.seconds


def test_nothing_can_be_changed_in_a_recording(recorded):
    session, _ = played(recorded[0])
    before = session.entries()
    with pytest.raises(OperatorError, match="recording"):
        session.erase(PAIR, 2)
    with pytest.raises(OperatorError, match="recording"):
        session.pick(0, (10.0, 10.0))
    with pytest.raises(OperatorError, match="this is a recording"):
        session.undo()
    assert session.entries() == before
    session.select("r3", "r4")  # looking is free


def test_a_recording_that_is_cut_off_plays_to_its_end(recorded, tmp_path):
    path, _ = recorded
    whole = path.read_bytes()
    lengths = []
    for share in (0.2, 0.5, 0.9):
        cut = tmp_path / f"cut{share}.mcap"
        cut.write_bytes(whole[: int(len(whole) * share)])
        try:
            recording = Recording(cut)
        except RecordingError:  # too short to say whose it is
            continue
        lengths.append(sum(1 for _ in recording))
        played(cut)
    assert lengths == sorted(lengths) and lengths[-1] > 0


def test_the_list_tells_what_was_done_in_order(recorded):
    text = "\n".join(timeline(Recording(recorded[0])))
    steps = (
        *("looks at r1 and r2", r"adds r1 r2 \(100, 50\) - \(80, 60\)", "taken up to update"),
        *("refused: the pixel has no depth", r"erases 1 r1 r2", "held still"),
    )
    at = 0
    for step in steps:
        found = re.search(step, text[at:])
        assert found, f"{step} is not in\n{text[at:]}"
        at += found.start()
    result = CliRunner().invoke(app, ["replay", str(recorded[0])])
    assert result.exit_code == 0
    assert result.output.rstrip() == text


def test_samples_come_out_as_they_went_in(tmp_path):
    path = tmp_path / "a.mcap"
    samples = [
        Sample("fleet/demo/robot/r1/image", b"\xff\xd8", "image/jpeg", b"header"),
        Sample("fleet/demo/fleet/state", b"", "application/msgpack;x", None),
        Sample("fleet/demo/robot/r1/image", b"1", "image/jpeg", b""),
        Sample("fleet/demo/robot/r1/image", b"2", "other", None),
    ]
    with Recorder(path, "demo", "anna") as recorder:
        for sample in samples:
            recorder.note("in", sample)
        recorder.note("out", samples[1])
    got = list(Recording(path))
    assert [record.sample for record in got] == [*samples, samples[1]]
    assert [record.way for record in got] == ["in"] * 4 + ["out"]
    assert [r.at_s for r in got] == sorted(r.at_s for r in got)


def test_what_cannot_be_recorded_or_played_is_said(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"something else")
    with pytest.raises(RecordingError, match="is there already"):
        Recorder(path, "demo", "anna")
    with pytest.raises(RecordingError, match="is no recording"):
        Recording(path)
    with pytest.raises(RecordingError, match="cannot be read"):
        Recording(tmp_path / "none.mcap")
    with pytest.raises(RecordingError, match="cannot be written"):
        Recorder(tmp_path / "no" / "folder.mcap", "demo", "anna")


def test_a_full_disk_ends_the_recording_only(monkeypatch):
    monkeypatch.setattr(Path, "open", lambda *_: os.fdopen(os.open("/dev/full", os.O_WRONLY), "wb"))
    with Recorder(Path("any.mcap"), "demo", "anna") as recorder:
        for _ in range(3000):
            recorder.note("in", Sample("fleet/demo/fleet/state", os.urandom(4096), "x", None))
        assert wait_until(lambda: recorder.failure is not None, 30)
    assert "No space left" in recorder.report()
