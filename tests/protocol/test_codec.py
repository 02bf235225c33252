"""Every message survives the wire, and no bytes do harm."""

from contextlib import suppress

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from fleetpose.protocol import codec
from fleetpose.protocol import messages as m
from fleetpose.protocol.errors import CodecError
from tests.protocol.message_examples import COVARIANCE, EPOCH, EXAMPLES, T

classes = pytest.mark.parametrize("message_class", m.MESSAGES, ids=lambda c: c.__name__)
few = settings(max_examples=40, deadline=None)


def test_every_message_has_its_example_and_its_own_schema_name():
    assert set(EXAMPLES) == set(m.MESSAGES)
    names = [message_class.schema_name for message_class in m.MESSAGES]
    assert len(set(names)) == len(names)


@classes
def test_a_message_comes_back_the_same(message_class):
    message = EXAMPLES[message_class]
    packed = codec.pack(message)
    again = codec.unpack(message_class, packed, codec.encoding_of(message_class))
    assert type(again) is message_class
    assert codec.pack(again) == packed
    for field in message_class.model_fields:
        original, decoded = getattr(message, field), getattr(again, field)
        if isinstance(original, np.ndarray):
            assert decoded.dtype == original.dtype
            assert np.array_equal(decoded, original)


@classes
def test_the_encoding_of_another_message_or_version_is_refused_by_name(message_class):
    packed = codec.pack(EXAMPLES[message_class])
    with pytest.raises(CodecError, match=r"fleet\.other\.v9"):
        codec.unpack(message_class, packed, "application/msgpack;fleet.other.v9")


@classes
def test_a_truncated_message_is_refused(message_class):
    packed = codec.pack(EXAMPLES[message_class])
    for length in {0, 1, len(packed) // 3, len(packed) // 2, len(packed) - 1}:
        with pytest.raises(CodecError):
            codec.unpack(message_class, packed[:length])


@classes
def test_an_unknown_field_is_refused(message_class):
    content = msgpack.unpackb(codec.pack(EXAMPLES[message_class]), strict_map_key=False)
    with pytest.raises(CodecError):
        codec.unpack(message_class, msgpack.packb({**content, "more": 1}))


@classes
def test_flipped_bits_give_a_codec_error_or_a_valid_message(message_class):
    packed = codec.pack(EXAMPLES[message_class])
    rng = np.random.default_rng(5)
    for _ in range(150):
        damaged = bytearray(packed)
        for place in rng.integers(0, len(damaged), 2):
            damaged[place] ^= 1 << int(rng.integers(8))
        with suppress(CodecError):
            assert type(codec.unpack(message_class, bytes(damaged))) is message_class


@few
@given(st.binary(max_size=300), st.sampled_from(m.MESSAGES))
def test_random_bytes_are_refused(payload, message_class):
    with pytest.raises(CodecError):
        codec.unpack(message_class, payload)


values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=20)
    | st.binary(max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=8) | st.integers(0, 5), inner, max_size=4)
    ),
    max_leaves=8,
)


@few
@given(values, st.sampled_from(m.MESSAGES), st.randoms(use_true_random=False))
def test_a_wrong_value_in_any_field_gives_a_codec_error_or_a_valid_message(
    value, message_class, random
):
    content = EXAMPLES[message_class].model_dump()
    content[random.choice(sorted(content))] = value
    payload = msgpack.packb(content, default=codec._pack_array)
    with suppress(CodecError):
        assert type(codec.unpack(message_class, payload)) is message_class


@pytest.mark.parametrize(
    "header",
    [
        ("|O", [1]),
        ("<f8", [2]),
        ("<f8", [-1]),
        ("<f8", [2**40, 2**40]),
        ("<f8", "xx"),
        ("<f8", [1.5]),
        ("no dtype", [1]),
        (["<f8"], [1]),
        ({}, [1]),
        "no header",
        [],
        7,
    ],
)
def test_an_array_with_an_odd_header_is_refused(header):
    array = msgpack.ExtType(1, msgpack.packb(header) + bytes(8))
    content = {**EXAMPLES[m.Odometry].model_dump(), "T_odom_robot": array}
    with pytest.raises(CodecError):
        codec.unpack(m.Odometry, msgpack.packb(content, default=codec._pack_array))


def test_an_empty_array_header_is_refused():
    content = {**EXAMPLES[m.Odometry].model_dump(), "T_odom_robot": msgpack.ExtType(1, b"")}
    with pytest.raises(CodecError):
        codec.unpack(m.Odometry, msgpack.packb(content, default=codec._pack_array))


@pytest.mark.parametrize("payload", [b"\xc1", b"\x90", b"\xa3abc", b"\x80", b"\x91" * 100_000])
def test_msgpack_that_is_no_message_is_refused(payload):
    with pytest.raises(CodecError):
        codec.unpack(m.Rejection, payload)


def test_an_oversize_message_is_refused_unread():
    with pytest.raises(CodecError, match="at most"):
        codec.unpack(m.Rejection, bytes(codec.MAX_MESSAGE_BYTES + 1))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_pose_that_is_not_finite_is_refused(bad):
    broken = T.copy()
    broken[0, 3] = bad
    content = {**EXAMPLES[m.Odometry].model_dump(), "T_odom_robot": broken}
    with pytest.raises(CodecError, match="T_odom_robot"):
        codec.unpack(m.Odometry, msgpack.packb(content, default=codec._pack_array))


def test_a_pose_that_is_no_rigid_motion_is_refused():
    for broken in (2 * np.eye(4), np.diag([1.0, 1.0, -1.0, 1.0])):
        with pytest.raises(ValidationError):
            m.Odometry(
                robot="r1", epoch=EPOCH, stamp_ns=1, T_odom_robot=broken, covariance=COVARIANCE
            )


def test_objects_do_not_go_on_the_wire():
    with pytest.raises(ValidationError, match="dtype"):
        m.Odometry(
            robot="r1",
            epoch=EPOCH,
            stamp_ns=1,
            T_odom_robot=np.full((4, 4), None),
            covariance=COVARIANCE,
        )


def test_received_arrays_cannot_be_changed():
    again = codec.unpack(m.Odometry, codec.pack(EXAMPLES[m.Odometry]))
    with pytest.raises(ValueError, match="read-only"):
        again.T_odom_robot[0, 0] = 5.0
