"""What messages mean: images, depths, clouds, transforms, odometry, by arrays made here."""

import itertools
import struct
from contextlib import suppress
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from fleetpose.protocol.errors import CalibrationError, CodecError
from fleetpose.rosmsg import rvl
from fleetpose.rosmsg.bag import Topic
from fleetpose.rosmsg.camera_infos import camera_info
from fleetpose.rosmsg.clouds import xyz_of
from fleetpose.rosmsg.depths import depth_m
from fleetpose.rosmsg.images import bgr, raw_image
from fleetpose.rosmsg.motion.odometry import NEAR_NS, OdometryReading, Track, left_covariance
from fleetpose.rosmsg.roles import Wanted, choose
from fleetpose.rosmsg.stamps import Pairing
from fleetpose.rosmsg.transforms import Tf
from fleetpose.rosmsg.typestore import Kind, Types
from tests.rosmsg import bag_makers as makers

BGR = makers.source(1).colours[0]


class Messages(makers.Maker):
    """Messages without a bag."""

    def __init__(self):
        self.ros = 2
        self.store = get_typestore(Stores.ROS2_HUMBLE)


MAKE = Messages()
DEFINED = MAKE.store.generate_msgdef("sensor_msgs/msg/Image", ros_version=2)[0]
KIND = Kind("sensor_msgs/msg/Image", MessageDefinition(MessageDefinitionFormat.MSG, DEFINED), "cdr")
TYPES = Types()


def image(array, encoding, **options):
    return MAKE.image(array, encoding, 0, "camera", **options)


@pytest.mark.parametrize("padding", [0, 5])
def test_colours_come_out_as_bgr_whatever_their_order(padding):
    alpha = np.full((*BGR.shape[:2], 1), 255, np.uint8)
    coded = {
        "bgr8": BGR,
        "rgb8": BGR[..., ::-1],
        "bgra8": np.dstack((BGR, alpha)),
        "rgba8": np.dstack((BGR[..., ::-1], alpha)),
    }
    for encoding, array in coded.items():
        assert np.array_equal(bgr(image(array, encoding, padding=padding)), BGR), encoding


def test_grey_of_eight_and_sixteen_bits_and_of_either_order_of_bytes():
    grey = BGR[..., 0]
    assert np.array_equal(bgr(image(grey, "mono8"))[..., 1], grey)
    wide = grey.astype(np.uint16) << 8
    for big in (False, True):
        assert np.array_equal(bgr(image(wide, "mono16", big=big))[..., 2], grey)


@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_a_colour_filter_gives_its_colours_back(order):
    colour = dict(zip("bgr", (40, 120, 200), strict=True))
    tile = np.array([[colour[order[0]], colour[order[1]]], [colour[order[2]], colour[order[3]]]])
    mosaic = np.tile(tile, (20, 20)).astype(np.uint8)
    inner = bgr(image(mosaic, f"bayer_{order}8"))[4:-4, 4:-4]
    assert np.array_equal(np.unique(inner.reshape(-1, 3), axis=0), [[40, 120, 200]])


@pytest.mark.parametrize(
    "broken",
    [
        {"step": 10},
        {"height": 1000},
        {"width": 0},
        {"encoding": "nonsense"},
        {"data": np.zeros(3, np.uint8)},
    ],
)
def test_an_image_that_cannot_be_is_refused(broken):
    message = SimpleNamespace(**{**vars(image(BGR, "bgr8")), **broken})
    with pytest.raises(CodecError):
        raw_image(message)


def test_depths_are_metres_and_nan_where_there_are_none():
    mm = np.array([[0, 1, 1500], [65535, 6000, 2]], np.uint16)
    expected = np.array([[np.nan, 0.001, 1.5], [np.nan, 6.0, 0.002]], np.float32)
    metres = np.array([[0, 0.001, 1.5], [np.inf, 6.0, 0.002]], np.float32)
    for message in (image(mm, "16UC1"), image(mm, "16UC1", big=True), image(metres, "32FC1")):
        assert np.allclose(depth_m(message), expected, equal_nan=True, atol=1e-7)


def test_inverse_depths_come_back_within_their_quantum():
    mm = makers.source(1).depths[0]
    data = makers.compressed_depth(
        makers.inverse_quantised(mm), "png", (0, makers.QUANT_A, makers.QUANT_B)
    )
    found = depth_m(MAKE.compressed(data, "32FC1; compressedDepth png", 0, "camera"))
    true = np.where((mm == 0) | (mm == 65535), np.nan, mm / 1000)
    assert np.array_equal(np.isnan(found), np.isnan(true))
    assert np.nanmax(np.abs(found - true) / true**2) < 1.01 / makers.QUANT_A


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.floats(0, 1), st.sampled_from([(1, 1), (3, 5), (16, 24)]))
def test_rvl_gives_back_every_pixel(seed, empty, shape):
    rng = np.random.default_rng(seed)
    raw = rng.integers(0, 65536, shape).astype(np.uint16)
    raw[rng.random(shape) < empty] = 0
    code = makers.rvl(raw)
    width, height = struct.unpack_from("<II", code)
    assert np.array_equal(rvl.decoded(code[8:], width, height), raw)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=80), st.integers(-1, 20), st.integers(-1, 20))
def test_damaged_rvl_is_refused_or_an_image(data, width, height):
    with suppress(CodecError):
        assert rvl.decoded(data, width, height).shape == (height, width)


@settings(max_examples=100, deadline=None)
@given(st.data())
def test_damaged_messages_are_refused_and_end_nothing(data):
    raw = bytearray(MAKE.store.serialize_cdr(image(BGR[:4, :6], "bgr8"), KIND.name))
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    del raw[data.draw(st.integers(0, len(raw))) :]
    with suppress(CodecError):
        bgr(TYPES.read(KIND, bytes(raw)))


def test_points_of_a_cloud_are_where_they_were_put():
    xyz = np.random.default_rng(0).normal(size=(6, 8, 3))
    xyz[0, 0] = np.nan
    assert np.allclose(xyz_of(MAKE.cloud(xyz, 0, "camera")), xyz, atol=1e-6, equal_nan=True)
    broken = MAKE.cloud(xyz, 0, "camera")
    broken.row_step = 10**6
    with pytest.raises(CodecError):
        xyz_of(broken)


def test_infos_of_a_camera_that_was_never_calibrated_are_refused():
    with pytest.raises(CalibrationError, match="not calibrated"):
        camera_info(MAKE.info(0, "camera", K=np.zeros((3, 3))))
    plain = MAKE.info(0, "/camera", R=np.zeros((3, 3)), P=np.zeros((3, 4)))
    found = camera_info(plain)
    assert found.is_undistorted and found.frame_id == "camera"
    assert np.array_equal(found.K_rectified, makers.K)


def pose(vector, t):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(vector).as_matrix()
    T[:3, 3] = t
    return T


def test_the_tree_gives_the_way_between_any_two_frames():
    rng = np.random.default_rng(1)
    T_world = {
        name: pose(rng.normal(size=3), rng.normal(size=3)) for name in ("odom", "base", "a", "b")
    }
    tf = Tf()
    edges = (("odom", "base", False), ("base", "a", True), ("base", "b", True))
    for parent, child, static in edges:
        T = np.linalg.inv(T_world[parent]) @ T_world[child]
        tf.add(MAKE.transforms(0, (f"/{parent}", child, T)), static)
    for one, other in itertools.product(T_world, T_world):
        expected = np.linalg.inv(T_world[one]) @ T_world[other]
        assert np.allclose(tf.lookup(one, other), expected, atol=1e-9)
    assert tf.chain("a", "b") == ["a", "base", "b"] and not tf.moves("a", "b")
    assert tf.moves("odom", "a") and tf.lookup("a", "elsewhere") is None


def test_a_tree_that_is_a_circle_ends_nothing():
    tf = Tf()
    for parent, child in (("a", "b"), ("b", "c"), ("c", "a")):
        tf.add(MAKE.transforms(0, (parent, child, np.eye(4))), static=True)
    assert tf.lookup("a", "elsewhere") is None


def test_the_covariance_is_that_of_samples_drawn_as_ros_means_it():
    rng = np.random.default_rng(2)
    T = pose((0.3, -0.2, 1.0), (10.0, -4.0, 1.0))
    sigmas = np.array((0.02, 0.03, 0.01, 0.004, 0.003, 0.006))
    drawn = rng.normal(size=(20_000, 6)) * sigmas
    rotations = Rotation.from_rotvec(drawn[:, 3:])
    moved = T[:3, 3] + drawn[:, :3] - rotations.apply(T[:3, 3])  # exp(xi) T, first order
    sampled = np.cov(np.hstack((drawn[:, 3:], moved)).T)
    found = left_covariance(np.diag(sigmas**2).reshape(-1), T)
    assert found is not None
    assert np.abs(found - sampled).max() < 0.03 * np.abs(found).max()
    for unknown in (np.zeros(36), -np.ones(36), np.eye(6).reshape(-1) * 1e6):
        assert left_covariance(unknown, T) is None


def test_odometry_between_two_readings_lies_between_them():
    track = Track()
    for k in range(3):
        track.add(OdometryReading(k * 10**8, pose((0, 0, 0.2 * k), (0.1 * k, 0, 0)), None))
    found = track.at(15 * 10**7)
    assert found is not None
    assert np.allclose(found.T_odom_child, pose((0, 0, 0.3), (0.15, 0, 0)), atol=1e-9)
    assert track.at(2 * 10**8 + NEAR_NS + 1) is None and Track().at(0) is None


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 40), st.integers(0, 10**6), st.randoms())
def test_pairing_loses_none_of_what_belongs_together(count, seed, order):
    rng = np.random.default_rng(seed)
    first = [(k * 100, ("first", k)) for k in range(count)]
    second = [(k * 100 + int(rng.integers(-40, 41)), ("second", k)) for k in range(count)]
    sent = [(0, *item) for item in first] + [(1, *item) for item in second]
    jitter = [item[1] + order.randint(0, 250) for item in sent]
    arrived = [item for _, item in sorted(zip(jitter, sent, strict=True), key=lambda x: x[0])]
    for stream in (0, 1):  # each stream itself is in order
        ordered = iter(sorted(item for item in arrived if item[0] == stream))
        arrived = [next(ordered) if item[0] == stream else item for item in arrived]
    pairing = Pairing(2, 45)
    found = [m for item in arrived for m in pairing.add(*item)] + list(pairing.rest())
    assert [m.items for m in found] == [(("first", k), ("second", k)) for k in range(count)]
    assert pairing.dropped == 0 and max(pairing.skews_ns) <= 40


def test_what_has_no_partner_is_dropped_and_counted():
    pairing = Pairing(2, 10)
    found = [m for at in (0, 100, 200) for m in pairing.add(0, at, at)]
    for at in (1, 150, 199):
        found += pairing.add(1, at, at)
    found += pairing.rest()
    assert [m.items for m in found] == [(0, 1), (200, 199)] and pairing.dropped == 1


IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"


def chosen(*topics, **options):
    return choose([Topic(name, kind, 9) for name, kind in topics], **options)


def test_depth_that_is_registered_and_unpacked_topics_are_preferred():
    roles = chosen(
        ("/cam/color/image_raw", IMAGE),
        ("/cam/color/image_raw/compressed", COMPRESSED),
        ("/cam/depth/image_rect_raw", IMAGE),
        ("/cam/aligned_depth_to_color/image_raw", IMAGE),
        ("/cam/infra1/image_rect_raw", IMAGE),
        ("/cam/infra2/image_rect_raw", IMAGE),
        ("/cam/color/camera_info", INFO),
    )
    assert (roles.form, roles.image) == ("rgbd", "/cam/color/image_raw")
    assert roles.ranges == "/cam/aligned_depth_to_color/image_raw"
    assert roles.infos == ("/cam/color/camera_info", None)


def test_depth_goes_with_the_image_of_its_frame():
    frames = {"/color/image": "color", "/infra1/image": "infra", "/depth/image": "infra"}
    topics = [(name, IMAGE) for name in frames]
    assert chosen(*topics, frame_of=frames.__getitem__).image == "/infra1/image"


def test_two_eyes_are_found_by_their_names_and_others_can_be_named():
    eyes = [(f"/stereo/{side}/image_rect", IMAGE) for side in ("left", "right")]
    roles = chosen(*eyes, ("/other/color", IMAGE))
    assert (roles.image, roles.ranges) == ("/stereo/left/image_rect", "/stereo/right/image_rect")
    named = chosen(
        *eyes, ("/other/color", IMAGE), wanted=Wanted(left="/other/color", right=eyes[1][0])
    )
    assert named.image == "/other/color"


def test_ground_truth_is_never_taken_for_odometry():
    topics = [("/color/image", IMAGE), ("/depth/image", IMAGE)]
    truth = ("/ground_truth/odom", "nav_msgs/msg/Odometry")
    assert chosen(*topics, truth).odometry is None
    assert chosen(*topics, truth, ("/vio", "nav_msgs/msg/Odometry")).odometry == "/vio"


def test_topics_of_one_robot_are_taken_where_it_is_named():
    topics = [(f"/r{k}/{kind}/image", IMAGE) for k in (1, 11) for kind in ("color", "depth")]
    roles = chosen(*topics, namespace="/r1")
    assert (roles.image, roles.ranges) == ("/r1/color/image", "/r1/depth/image")


def test_colours_decode_from_jpeg_with_a_filter_left_to_do():
    grey = np.full((16, 16), 90, np.uint8)
    data = cv2.imencode(".png", grey)[1].tobytes()
    message = MAKE.compressed(data, "bayer_rggb8; png compressed", 0, "camera")
    assert np.array_equal(np.unique(bgr(message)), [90])
    with pytest.raises(CodecError, match="cannot be decoded"):
        bgr(MAKE.compressed(b"nothing", "rgb8; jpeg compressed bgr8", 0, "camera"))
