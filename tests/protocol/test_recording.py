"""Recordings: bits come out as they went in, what was flushed outlives a kill, damage is told."""

import signal
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.protocol.recording import file as recording
from fleetpose.protocol.recording.file import Recorder, Recording, RecordingError
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import wait_until

SAMPLES = st.builds(
    Sample,
    st.sampled_from(["fleet/demo/robot/r1/cloud", "fleet/demo/fleet/state", "fleet/demo/pose/r2"]),
    st.binary(max_size=200),
    st.sampled_from(["application/msgpack;fleet.view.v3", "image/jpeg", ""]),
    st.none() | st.binary(max_size=20),
)
CHILD = """
import sys, time
from pathlib import Path
from fleetpose.protocol.recording.file import Recorder
from fleetpose.protocol.slots import Sample
recorder, n = Recorder(Path(sys.argv[1]), "demo", compressed=False), 0
while True:
    recorder.note("in", Sample("fleet/demo/robot/r1/cloud", n.to_bytes(4, "big") * 500, "x"))
    n += 1
    time.sleep(0.002)
"""


@settings(max_examples=20, deadline=None)
@given(st.lists(SAMPLES, max_size=20), st.booleans())
def test_bits_keys_encodings_and_attachments_come_out_as_they_went_in(
    tmp_path_factory, samples, compressed
):
    path = tmp_path_factory.mktemp("r") / "a.mcap"
    with Recorder(path, "demo", compressed=compressed) as recorder:
        recorder.token("fleet/demo/robot/r1/alive/0", True)
        for sample in samples:
            recorder.note("in", sample)
        recorder.token("fleet/demo/robot/r1/alive/0", False)
    first, *middle, last = Recording(path)
    assert [one.sample for one in middle] == samples
    assert (first.way, first.sample.payload) == ("token", recording.HERE)
    assert (last.way, last.sample.payload) == ("token", recording.GONE)
    assert [one.at_ns for one in middle] == sorted(one.at_ns for one in middle)
    assert not Recording(path).cut_off and recorder.written == len(samples) + 2


def test_what_was_flushed_outlives_a_kill(tmp_path):
    path = tmp_path / "a.mcap"
    child = subprocess.Popen([sys.executable, "-P", "-c", CHILD, str(path)])
    try:
        assert wait_until(lambda: path.exists() and path.stat().st_size > 50_000, 30)
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    opened = Recording(path)
    numbers = [int.from_bytes(one.sample.payload[:4], "big") for one in opened]
    assert opened.cut_off and numbers == list(range(len(numbers))) and len(numbers) > 10


def written(path, count=40):
    with Recorder(path, "demo", compressed=False) as recorder:
        for n in range(count):
            recorder.note("in", Sample("fleet/demo/pose/r1", bytes([n]) * 1000, "x"))
    return path.read_bytes()


def test_a_file_that_is_cut_anywhere_opens_to_there_or_says_that_it_is_none(tmp_path):
    whole, cut = written(tmp_path / "whole.mcap"), tmp_path / "cut.mcap"
    for length in range(0, len(whole), 997):
        cut.write_bytes(whole[:length])
        try:
            opened = Recording(cut)
        except RecordingError as error:
            assert "is no recording" in str(error)
        else:
            first = [one.sample.payload[0] for one in opened]
            assert opened.cut_off and first == list(range(len(first)))


def test_a_damaged_file_is_refused_in_one_sentence(tmp_path):
    whole, path = bytearray(written(tmp_path / "whole.mcap")), tmp_path / "damaged.mcap"
    whole[len(whole) // 2] ^= 1
    path.write_bytes(whole)
    with pytest.raises(RecordingError, match=r"damaged\.mcap is damaged .* copy it anew") as told:
        Recording(path)
    assert "\n" not in str(told.value)


def test_what_finds_no_room_is_counted_and_told(tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "_WAITING_BYTES", 1000)
    with Recorder(tmp_path / "a.mcap", "demo") as recorder:
        recorder.note("in", Sample("fleet/demo/pose/r1", bytes(2000), "x"))
        recorder.note("in", Sample("fleet/demo/pose/r1", bytes(500), "x"))
    assert (recorder.left_out, recorder.written) == (1, 1)
    assert "1 messages are missing" in recorder.report()
