"""Every message survives the wire, and no bytes do harm."""

from contextlib import suppress

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from protocol import clouds, codec
from protocol import messages as m
from protocol.errors import CodecError

EPOCH = "0123456789ab"
T = np.eye(4)
T[:3, 3] = (1.0, -2.0, 0.5)
COVARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2])
PIXEL = np.array([12.5, 8.25])
V1 = m.ViewName(robot="r1", epoch=EPOCH, seq=12)
V2 = m.ViewName(robot="r2", epoch=EPOCH, seq=2**62)
NOISE = m.NoiseModel.stereo(500.0, 0.1, 0.5, 0.7)
CAMERA = m.Camera(
    width=64,
    height=48,
    K=np.array([[60.0, 0.0, 32.0], [0.0, 60.0, 24.0], [0.0, 0.0, 1.0]]),
    T_robot_camera=m.ROBOT_FROM_CAMERA,
    noise=NOISE,
    kind="stereo",
)
DEPTH = clouds.encode_depth(np.ones((48, 64)))
SCATTERED = clouds.encode_scattered(np.ones((3, 2)), np.ones(3), 0.01)
SALIENT = m.Salient(extractor="rootsift", count=0, descriptor_bytes=128, data=codec.compress(b""))
VIEW = m.View(
    name=V1,
    stamp_ns=1,
    camera=CAMERA,
    cloud=SCATTERED,
    salient=SALIENT,
    up_camera=np.array([0.0, -1.0, 0.0]),
    up_sigma_rad=0.01,
)
HEADER = m.ImageHeader(view=V1, stamp_ns=1, scale=2)
POSE = m.RobotPose(
    robot="r1",
    view=V1,
    stamp_ns=1,
    T_fleet_robot=T,
    covariance=COVARIANCE,
    component="r1",
    located=True,
    verdict="verified",
    gauge_revision=3,
    jumped=False,
    age_s=0.2,
    valid_until_ns=5_000_000_000,
    errors=(m.PairError(other="r2", rmse_m=0.02, verdict="plausible"),),
    server_epoch=EPOCH,
    n=7,
)
CORRESPONDENCE = m.Correspondence(
    id=4,
    operator="op",
    view_i=V1,
    view_j=V2,
    pixel_i=PIXEL,
    pixel_j=PIXEL,
    status="accepted",
    residual_m=0.01,
    residual_px=0.8,
    revision=2,
)
CELL = m.PairCell(i="r1", j="r2", state="tried", verdict="rejected", rmse_m=0.5)
QUESTION = m.Question(i="r1", j="r2", view_i=V1, view_j=V2, reason="joins two parts", gain=0.4)
ROBOT_STATE = m.RobotState(
    robot="r1", alive=True, newest_view=V1, views_kept=3, pose=POSE, why_not=""
)

EXAMPLES = {
    type(message): message
    for message in (
        V1,
        NOISE,
        CAMERA,
        m.CameraAnnouncement(
            robot="r1", epoch=EPOCH, camera=CAMERA, rate_hz=1.0, capabilities=("image",)
        ),
        DEPTH,
        SCATTERED,
        SALIENT,
        VIEW,
        HEADER,
        m.KeptView(view=VIEW, jpeg=b"\xff\xd8", image=HEADER),
        m.Odometry(robot="r1", epoch=EPOCH, stamp_ns=1, T_odom_robot=T, covariance=COVARIANCE),
        m.PairError(other="r2", rmse_m=0.1, verdict="ambiguous"),
        POSE,
        m.Alignment(
            view_i=V1,
            view_j=V2,
            T_i_j=T,
            covariance=COVARIANCE,
            information=np.linalg.inv(COVARIANCE),
            verdict="verified",
            reasons=("many",),
            regression_error_m2=0.3,
            regression_count=40,
            rmse_m=0.02,
            overlap=0.6,
            inliers=50,
            start="features",
            timings_ms={"match": 3.5},
            server_epoch=EPOCH,
            n=1,
        ),
        CORRESPONDENCE,
        m.PairCorrespondences(
            i="r1", j="r2", revision=3, items=(CORRESPONDENCE,), server_epoch=EPOCH
        ),
        m.OperatorUpdate(
            operator="op",
            session=EPOCH,
            n=1,
            action="add",
            i="r1",
            j="r2",
            base_revision=0,
            view_i=V1,
            view_j=V2,
            pixel_i=PIXEL,
            pixel_j=PIXEL,
        ),
        m.Rejection(n=3, reason="no depth there"),
        m.Receipts(
            operator="op",
            session=EPOCH,
            n=3,
            rejections=(m.Rejection(n=3, reason="no depth there"),),
            server_epoch=EPOCH,
        ),
        m.Selection(operator="op", session=EPOCH, i="r1", j="r2", view_i=V1, view_j=V2),
        CELL,
        QUESTION,
        ROBOT_STATE,
        m.FleetState(
            server_epoch=EPOCH,
            n=9,
            stamp_ns=1,
            anchor="r1",
            gauge_revision=1,
            up_assumed=True,
            robots=(ROBOT_STATE,),
            pairs=(CELL,),
            questions=(QUESTION,),
            events=("r1 joined",),
        ),
        m.ServerStatus(
            server_epoch=EPOCH,
            uptime_s=1.0,
            views=1,
            alignments=2,
            solves=3,
            pending_jobs=0,
            workers=2,
            pairs_per_s=4.0,
            other_cpu_ms_per_view=8.0,
            max_pair_wait_s=2.0,
            drops={"codec": 1},
            version="0.1.0",
        ),
        m.RelativePose(a="r1", b="r2", T_a_b=T, covariance=COVARIANCE, age_s=0.1, through=("r3",)),
    )
}
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
