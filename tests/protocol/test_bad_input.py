"""Whatever arrives costs little, is counted once, and makes one log line."""

import logging
import threading

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from fleetpose.protocol import codec
from fleetpose.protocol import messages as m
from fleetpose.protocol.clouds import MAX_CLOUD_PIXELS, SalientPoints, decode_depth, encode_salient
from fleetpose.protocol.clouds import decode_salient as decoded
from fleetpose.protocol.drops import MAX_REASONS, MAX_REASONS_OF_ONE, MAX_SENDERS, OTHER, Drops
from fleetpose.protocol.errors import CodecError, NameRefusedError
from fleetpose.protocol.keys import NAME_PATTERN, Keys
from fleetpose.protocol.slots import Sample, Slots
from fleetpose.protocol.text import one_line
from fleetpose.protocol.transport import parameters_of
from tests.protocol.message_examples import CAMERA, EPOCH, EXAMPLES, T

few = settings(max_examples=80, deadline=None)


def unpacked(kind, **changes):
    content = {**EXAMPLES[kind].model_dump(), **changes}
    return codec.unpack(kind, msgpack.packb(content, default=codec._pack_array))


# ---- sizes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("item", [[], {}, [[]] * 3])
def test_lists_in_lists_are_refused_before_they_fill_the_memory(item):
    payload = msgpack.packb({"view": [[item] * 60_000] * 60})
    with pytest.raises(CodecError, match="items"):
        codec.unpack(m.KeptView, payload)


def test_a_million_wrong_items_are_refused_at_the_first():
    with pytest.raises(CodecError, match=r"Receipts\.rejections") as refused:
        unpacked(m.Receipts, rejections=[0] * 1_000_000)
    assert len(str(refused.value)) < 300


def test_a_map_of_many_keys_is_refused():
    with pytest.raises(CodecError):
        unpacked(m.ServerStatus, drops={f"k{k}": k for k in range(5000)})


@pytest.mark.parametrize("kind", [m.OperatorUpdate, m.Selection, m.RobotPose, m.ServerStatus])
def test_small_messages_have_a_small_limit(kind):
    assert kind.at_most <= 2**20
    with pytest.raises(CodecError, match="at most"):
        codec.unpack(kind, bytes(kind.at_most + 1))


def test_a_depth_image_of_too_many_pixels_is_refused_however_well_it_packs():
    width, height = 4096, MAX_CLOUD_PIXELS // 4096 + 1
    data = codec.compress(bytes(2 * width * height))
    assert len(data) < 2000
    with pytest.raises(CodecError, match="pixels of depth"):
        decode_depth(
            m.DepthCloud(width=width, height=height, coding="depth", step=0.001, data=data)
        )


# ---- numbers -------------------------------------------------------------------------------------


@pytest.mark.parametrize("stamp_ns", [2**62, -(2**62), 2**63, 2**64 - 1])
def test_a_stamp_whose_sums_leave_64_bits_is_refused(stamp_ns):
    with pytest.raises(CodecError, match="stamp_ns"):
        unpacked(m.Odometry, stamp_ns=stamp_ns)


@pytest.mark.parametrize(
    "K",
    [
        np.diag([1e-300, 60.0, 1.0]),
        np.diag([60.0, 1e300, 1.0]),
        np.array([[60.0, 0, 1e9], [0, 60.0, 24], [0, 0, 1]]),
        np.array([[60.0, 1e5, 32], [0, 60.0, 24], [0, 0, 1]]),
        np.diag([0.5, 0.5, 1.0]),
    ],
)
def test_a_camera_that_cannot_be_is_refused(K):
    with pytest.raises(CodecError, match="Camera"):
        unpacked(m.Camera, K=K)


@pytest.mark.parametrize("sigmas", [(0, 0, 0), (1e300, 0, 0), (0, 0, 1e-300)])
def test_a_noise_model_that_cannot_be_is_refused(sigmas):
    with pytest.raises(CodecError, match="NoiseModel"):
        unpacked(m.NoiseModel, depth_sigma_m=sigmas)


def test_a_pose_beyond_the_planet_and_up_that_is_no_direction_are_refused():
    far = T.copy()
    far[0, 3] = 1e9
    with pytest.raises(CodecError, match="farther"):
        unpacked(m.Odometry, T_odom_robot=far)
    for up in (np.zeros(3), np.full(3, 1e300)):
        with pytest.raises(CodecError, match="unit vector"):
            unpacked(m.View, up_camera=up)


@pytest.mark.parametrize("bad", [1e-38, 1e38, np.inf, -1.0, 1e-45])
def test_a_salient_depth_that_cannot_be_is_no_depth(bad):
    one = np.array([bad], np.float32)
    points = SalientPoints(np.ones((1, 2), np.float32), one, one, np.zeros((1, 8), np.uint8))
    assert np.isnan(decoded(encode_salient(points)).inverse_depth).all()


# ---- texts and keys ------------------------------------------------------------------------------


@few
@given(st.text(max_size=60) | st.text("\n\r\x1b\x07\u2028\u202e[2JERROR", max_size=60))
def test_a_text_becomes_one_printable_line_and_stays_it(text):
    line = one_line(text)
    assert line.isprintable() and len(line) == len(text) and one_line(line) == line
    assert m.Rejection(n=1, reason=text).reason == line


def test_a_long_text_is_cut_not_refused():
    assert len(m.Rejection(n=1, reason="x" * 5000).reason) == 2000


@few
@given(st.text(max_size=40) | st.from_regex(r"fleet/demo/[a-z0-9_/@*-]{0,30}", fullmatch=True))
def test_a_key_comes_apart_into_names_or_is_refused(key):
    try:
        chunks = Keys("demo").chunks(key)
    except NameRefusedError:
        return
    assert "fleet/demo/" + "/".join(chunks) == key
    assert all(m.ViewName(robot=chunk, epoch=EPOCH, seq=0) for chunk in chunks), NAME_PATTERN


@few
@given(st.text(max_size=60))
def test_any_selector_has_parameters(text):
    for name, value in parameters_of(text).items():
        assert ";" not in name + value and "=" not in name


# ---- counting ------------------------------------------------------------------------------------


def test_a_drop_is_one_log_line_whatever_its_text(caplog):
    drops = Drops()
    with caplog.at_level(logging.WARNING):
        for n in range(3):
            drops.note("fleet/x\nFORGED", CodecError(f"encoding 'a\nb\x1b[2J{n}', expected 'c'"))
    assert drops.total() == 3 and len(drops) == 1
    (record,) = caplog.records
    assert record.getMessage().isprintable() and "told once" in record.getMessage()


@few
@given(st.lists(st.tuples(st.text(max_size=5), st.text(max_size=80)), max_size=200))
def test_every_drop_is_counted_once_and_reasons_are_bounded(noted):
    drops = Drops()
    for key, sentence in noted:
        drops.note(key, sentence)
    assert drops.total() == len(noted) and len(drops) <= MAX_REASONS + 1


def test_the_log_ends_where_keys_are_invented_and_the_count_goes_on(caplog):
    drops = Drops()
    with caplog.at_level(logging.WARNING):
        for k in range(MAX_SENDERS + 50):
            drops.note(f"fleet/demo/robot/x{k}/cloud", "not msgpack")
    assert drops == {"not msgpack": MAX_SENDERS + 50}
    assert len(caplog.records) == MAX_SENDERS


def test_a_sender_fills_its_own_room_and_no_other(caplog):
    drops = Drops()
    words = [chr(97 + k % 26) + chr(97 + k // 26) for k in range(200)]
    with caplog.at_level(logging.WARNING):
        for k, word in enumerate(words):
            drops.note(f"fleet/demo/robot/r2/alive/{k:012x}", word)
        assert len(caplog.records) == MAX_REASONS_OF_ONE + 1
        assert "drops of robot/r2 were told" in caplog.records[-1].getMessage()
        drops.note("fleet/demo/robot/r1/cloud", "not msgpack")
    assert "not msgpack" in caplog.records[-1].getMessage()
    assert drops.of("robot/r1") == {"not msgpack": 1}
    assert drops.of("robot/r2")[OTHER] == len(words) - MAX_REASONS_OF_ONE
    assert drops.of("robot/r9") == {}


def test_a_reason_is_told_once_for_each_kind_of_key(caplog):
    drops = Drops()
    with caplog.at_level(logging.WARNING):
        for kind in ("cloud", "odometry"):
            for _ in range(3):
                drops.note(f"fleet/demo/robot/r1/{kind}", "not msgpack")
    assert len(caplog.records) == 2 and drops == {"not msgpack": 6}


def test_drops_of_many_threads_are_all_counted():
    drops = Drops()

    def note():
        for n in range(2000):
            drops.note("key", f"{n} is wrong")

    threads = [threading.Thread(target=note) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert drops.snapshot() == {"_ is wrong": 8000}


def test_reasons_beyond_the_limit_are_counted_as_others():
    drops = Drops()
    words = [chr(97 + k % 26) + chr(97 + k // 26) for k in range(MAX_REASONS + 20)]
    for word in words:
        drops.note("key", word)
    assert drops[OTHER] == 20 and drops.total() == len(words)


def test_slots_hold_so_many_keys_and_bytes_and_count_what_finds_no_room():
    slots: Slots[Sample] = Slots(max_keys=3, max_bytes=100)
    for name, size in (("a", 40), ("b", 40), ("c", 40), ("a", 10), ("c", 40), ("d", 1), ("e", 1)):
        slots.store(Sample(name, bytes(size), ""))
    assert (slots.replaced, slots.overflowed, len(slots)) == (1, 3, 3)
    assert slots.take(0) == Sample("a", bytes(10), "")
    slots.store(Sample("e", bytes(9), ""))
    assert len(slots) == 3


def test_models_of_this_process_are_checked_as_well():
    with pytest.raises(ValidationError, match="focal"):
        m.Camera.model_validate({**CAMERA.model_dump(), "K": np.diag([1e-9, 1e-9, 1.0])})
