"""Whatever is said under the server's and the robots' keys: a drop each, nothing else."""

import time

import pytest
from hmi_fakes import view, wait_for
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.hmi_client.cli.reports import Watcher, sentence
from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.jpeg import MAX_PIXELS, frame_of
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.message_decoder import opened, picture_in
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Alignment,
    CameraAnnouncement,
    FleetState,
    ImageHeader,
    PairCorrespondences,
    Receipts,
    RobotPose,
    ServerStatus,
)
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.transport import Sample
from tests.hmi_client.conftest import checkered
from tests.protocol.message_examples import EXAMPLES

KEYS = Keys("demo")
few = settings(max_examples=80, deadline=None)
EXPECTED: dict[str, type[Message]] = {
    KEYS.state: FleetState,
    KEYS.status: ServerStatus,
    KEYS.pose("r1"): RobotPose,
    KEYS.alignment("r1", "r2"): Alignment,
    KEYS.correspondences("r1", "r2"): PairCorrespondences,
    KEYS.receipts("op"): Receipts,
    KEYS.camera("r1"): CameraAnnouncement,
}
OTHERS = {
    KEYS.pose("r1"): KEYS.pose("r2"),
    KEYS.alignment("r1", "r2"): KEYS.alignment("r1", "r3"),
    KEYS.correspondences("r1", "r2"): KEYS.correspondences("r2", "r3"),
    KEYS.receipts("op"): KEYS.receipts("eve"),
    KEYS.camera("r1"): KEYS.camera("r2"),
}
GOOD_JPEG = checkered("r1", 7)


def good(key: str) -> Sample:
    kind = EXPECTED[key]
    return Sample(key, pack(EXAMPLES[kind]), encoding_of(kind))


@pytest.mark.parametrize("key", EXPECTED)
def test_each_key_has_its_message(key):
    assert type(opened(KEYS, good(key))) is EXPECTED[key]


@pytest.mark.parametrize("key", OTHERS)
def test_a_good_message_under_anothers_key_is_refused(key):
    stolen = good(key)
    with pytest.raises(CodecError, match="not its own"):
        opened(KEYS, Sample(OTHERS[key], stolen.payload, stolen.encoding))


@few
@given(
    key=st.sampled_from(sorted(EXPECTED)) | st.text(max_size=40),
    payload=st.binary(max_size=300),
    encoding=st.sampled_from([encoding_of(kind) for kind in EXPECTED.values()]) | st.text(),
)
def test_any_bytes_under_any_key_are_refused(key, payload, encoding):
    with pytest.raises(FleetPoseError):
        opened(KEYS, Sample(key, payload, encoding))


# ---- images --------------------------------------------------------------------------------------


@few
@given(st.binary(max_size=400) | st.binary(max_size=100).map(lambda b: b"\xff\xd8\xff" + b))
def test_any_bytes_are_no_jpeg_or_a_small_one(jpeg):
    try:
        frame = frame_of(jpeg)
    except PictureError:
        return
    assert 0 < frame.width * frame.height <= MAX_PIXELS


@few
@given(st.data())
def test_a_damaged_jpeg_is_refused_or_of_a_size_that_can_be_shown(data):
    damaged = bytearray(GOOD_JPEG)
    for _ in range(data.draw(st.integers(1, 5))):
        place = data.draw(st.integers(0, 700) | st.integers(0, len(damaged) - 1))
        damaged[place] = data.draw(st.integers(0, 255))
    try:
        frame = frame_of(bytes(damaged))
    except PictureError:
        return
    assert 0 < frame.width * frame.height <= MAX_PIXELS


def jpeg_of(width: int, height: int, scans: int) -> bytes:
    """The header of a progressive JPEG of that size, with so many empty scans."""
    at = GOOD_JPEG.find(b"\xff\xc0")
    size = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    head = GOOD_JPEG[:at] + b"\xff\xc2" + GOOD_JPEG[at + 2 : at + 5] + size + GOOD_JPEG[at + 9 :]
    scan = head.find(b"\xff\xda")
    return head[:scan] + b"\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00" * scans + head[scan:]


def test_many_scans_are_read_of_a_small_image_and_few_of_a_large_one():
    assert frame_of(jpeg_of(640, 480, 100)).width == 640
    assert frame_of(jpeg_of(7000, 5000, 9)).width == 7000
    for bomb in (jpeg_of(640, 480, 300), jpeg_of(7000, 5000, 50)):
        with pytest.raises(PictureError, match="too many scans"):
            frame_of(bomb)


@pytest.mark.parametrize("size", [(65535, 65535), (7001, 6000), (0, 480), (640, 0)])
def test_a_few_bytes_that_declare_a_huge_image_are_refused(size):
    with pytest.raises(PictureError):
        frame_of(jpeg_of(*size, 1))


@few
@given(st.none() | st.binary(max_size=80))
def test_an_image_needs_its_header(attachment):
    with pytest.raises((PictureError, CodecError)):
        picture_in(Sample(KEYS.image("r1"), GOOD_JPEG, "image/jpeg", attachment), "r1", None, 0.0)


def test_a_whole_image_of_its_robot_is_a_picture():
    header = pack(ImageHeader(view=view("r1"), stamp_ns=0))
    sample = Sample(KEYS.image("r1"), GOOD_JPEG, "image/jpeg", header)
    assert picture_in(sample, "r1", None, 3.0).received_s == 3.0


# ---- in a running client -------------------------------------------------------------------------


def test_damaged_input_takes_the_place_of_nothing_good(client_of, serve):
    """Bad sets and alignments right behind good ones, before anybody has read these."""
    server = serve()
    session = OperatorSession("anna")
    client = client_of(session)
    wait_for(lambda: session.fleet is not None)
    alignment = EXAMPLES[Alignment]
    known = EXAMPLES[PairCorrespondences].model_copy(update={"server_epoch": server.epoch})
    with session._changed:  # the reader cannot go on meanwhile
        for key, message in (
            (KEYS.alignment("r1", "r2"), alignment),
            (KEYS.correspondences("r1", "r2"), known),
        ):
            # block: a busy machine would else drop the first one on its way
            publisher = server.link.latched(key, block=True, history=10)
            publisher.put(pack(message), encoding_of(type(message)))
            for k in range(5):
                publisher.put(bytes([k]) * 9, encoding_of(type(message)))
        end_s = time.monotonic() + 5
        while client.drops.total() < 9 and time.monotonic() < end_s:
            time.sleep(0.01)
    wait_for(lambda: client.drops.total() == 10)
    wait_for(lambda: client.session.alignments("r1").get(("r1", "r2")) is not None)
    wait_for(lambda: ("r1", "r2") in session.sets())


def test_watch_tells_the_drops_once_per_change():
    session = OperatorSession("anna", clock=lambda: 0.0)
    watcher = Watcher(session)
    session.drop("fleet/demo/pose/r1", CodecError("not msgpack: x"))
    (record,) = [r for r in watcher.news() if r["type"] == "drops"]
    assert record["total"] == 1 and "not msgpack 1" in sentence(record)
    assert not [r for r in watcher.news() if r["type"] == "drops"]
