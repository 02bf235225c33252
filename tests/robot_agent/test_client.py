"""A robot of the fleet, over a real router: views go out, poses come back, names are unique."""

import itertools
import threading
import time

import cv2
import numpy as np
import pytest

from fleetpose.protocol.clouds import decode_depth, decode_salient
from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.errors import (
    CalibrationError,
    NameRefusedError,
    NameTakenError,
    UnreachableError,
)
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    ROBOT_FROM_CAMERA,
    Camera,
    CameraAnnouncement,
    ImageHeader,
    KeptView,
    NoiseModel,
    Odometry,
    RelativePose,
    RobotPose,
    View,
    ViewName,
)
from fleetpose.protocol.transport import (
    ENCODING_JPEG,
    Answer,
    Sample,
    SessionSettings,
    Slots,
    free_port,
    wait_until,
)
from fleetpose.robot_agent.agent import paced
from fleetpose.robot_agent.cameras.base import DepthImage, Frame
from fleetpose.robot_agent.cameras.frozen import LEAST_S
from fleetpose.robot_agent.client import FleetRobot
from fleetpose.robot_agent.sender import SenderSettings

KEYS = Keys("demo")
MODEL = Camera(
    width=160,
    height=120,
    K=np.array([[150.0, 0.0, 80.0], [0.0, 150.0, 60.0], [0.0, 0.0, 1.0]]),
    T_robot_camera=ROBOT_FROM_CAMERA,
    noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.001)),
    kind="rgbd",
)
IMAGE = cv2.GaussianBlur(
    np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8), (0, 0), 1.5
)
DEPTH = np.round(np.random.default_rng(1).uniform(1.0, 3.0, (120, 160)), 3).astype(np.float32)
DEPTH[:20] = np.nan


def settings_for(router):
    return SessionSettings(connect=(router,), timeout_s=5)


@pytest.fixture
def robot(router):
    with FleetRobot(
        "r1", settings_for(router), camera=MODEL, settings=SenderSettings(keep_views=3)
    ) as opened:
        yield opened


def pose_publisher(link, robot="r1", epoch="0" * 12):
    """A server's, whose token is there."""
    link.token(KEYS.server_alive(epoch))
    return link.latched(KEYS.pose(robot))


def publish(publisher, pose):
    publisher.put(pack(pose), encoding_of(RobotPose))


def next_view(slots):
    sample = slots.take(30)
    assert sample is not None
    return unpack(View, sample.payload, sample.encoding)


def pose_message(n=0, server_epoch="0" * 12, valid_for_s=5.0, robot="r1", x_m=1.0):
    T = np.eye(4)
    T[0, 3] = x_m
    return RobotPose(
        robot=robot,
        view=ViewName(robot=robot, epoch="a" * 12, seq=0),
        stamp_ns=time.time_ns(),
        T_fleet_robot=T,
        covariance=np.eye(6),
        component="r1",
        located=True,
        verdict="verified",
        gauge_revision=0,
        jumped=False,
        age_s=0.5,
        valid_until_ns=time.time_ns() + int(valid_for_s * 1e9),
        server_epoch=server_epoch,
        n=n,
    )


def test_a_pushed_view_arrives_with_the_pushed_depth(robot, link):
    clouds = link.on_bulk(KEYS.cloud("*"))
    assert wait_until(lambda: robot._sender._cloud.wanted, 30)
    name = robot.push(IMAGE, DEPTH, stamp_ns=123)
    view = next_view(clouds)
    assert view.name == name == ViewName(robot="r1", epoch=robot.epoch, seq=0)
    assert view.stamp_ns == 123
    assert np.allclose(decode_depth(view.cloud), DEPTH, atol=1e-6, equal_nan=True)
    salient = decode_salient(view.salient)
    assert len(salient.uv) > 20
    assert np.array_equal(view.camera.K, MODEL.K)
    assert robot.push(IMAGE, DEPTH).seq == 1
    assert next_view(clouds).name.seq == 1


def test_a_frame_in_which_nothing_changed_is_sent_again_as_a_view_of_its_own(robot, link):
    slots = link.on_bulk(KEYS.cloud("*"))
    ranges, views = DepthImage(DEPTH), []
    for stamp_ns in (5, 6):
        robot.push_frame(Frame(stamp_ns=stamp_ns, image=IMAGE, ranges=ranges, model=MODEL))
        views.append(next_view(slots))
    first, again = views
    assert (first.stamp_ns, again.stamp_ns) == (5, 6)
    assert again.name.seq == first.name.seq + 1
    assert (again.cloud, again.salient) == (first.cloud, first.salient)
    reply = link.query(f"{KEYS.view('r1')}?seq={again.name.seq}")
    kept = unpack(KeptView, reply.payload, reply.encoding)
    assert kept.view.name == kept.image.view == again.name and kept.image.stamp_ns == 6
    other = Frame(stamp_ns=7, image=IMAGE, ranges=DepthImage(DEPTH + 1), model=MODEL)
    robot.push_frame(other)
    assert next_view(slots).cloud != first.cloud


def test_a_device_that_repeats_itself_is_told_with_its_views(robot, link):
    slots, said = link.on_bulk(KEYS.cloud("*")), [0.0]
    end_s = time.monotonic() + 10 * LEAST_S
    for _ in paced(itertools.count(), 3.0, threading.Event()):
        robot.push(IMAGE, DEPTH, live=True)
        said.append(next_view(slots).frozen_s)
        if said[-1] or time.monotonic() > end_s:
            break
    assert said[:3] == [0.0] * 3 and said[-1] >= LEAST_S
    robot.push(IMAGE ^ 1, DEPTH, live=True)
    assert next_view(slots).frozen_s == 0.0
    robot.push(IMAGE, DEPTH)
    assert next_view(slots).frozen_s == 0.0, "a program that does not say so may show a recording"


def test_the_caller_may_reuse_its_buffers(robot, link):
    clouds = link.on_bulk(KEYS.cloud("r1"))
    assert wait_until(lambda: robot._sender._cloud.wanted, 30)
    image, depth = IMAGE.copy(), DEPTH.copy()
    robot.push(image, depth)
    image[:], depth[:] = 0, 9.0
    assert np.allclose(decode_depth(next_view(clouds).cloud), DEPTH, atol=1e-6, equal_nan=True)


def test_the_image_is_sent_only_while_somebody_wants_it(robot, link):
    clouds = link.on_bulk(KEYS.cloud("r1"))
    assert wait_until(lambda: robot._sender._cloud.wanted, 30)
    robot.push(IMAGE, DEPTH)
    next_view(clouds)
    assert robot.flush()  # the cloud leaves before the image: past both, the first has no taker
    images = Slots()
    subscriber = link.subscribe_bulk(KEYS.image("r1"), images.store)
    assert wait_until(lambda: robot._sender._image.wanted, 30)
    name = robot.push(IMAGE, DEPTH)
    sample = images.take(30)
    assert sample is not None
    assert sample.encoding == ENCODING_JPEG
    assert unpack(ImageHeader, sample.attachment).view == name  # the first view's was not sent
    decoded = cv2.imdecode(np.frombuffer(sample.payload, np.uint8), cv2.IMREAD_COLOR)
    assert np.abs(decoded.astype(int) - IMAGE).mean() < 12
    subscriber.undeclare()
    assert wait_until(lambda: not robot._sender._image.wanted, 30)
    robot.push(IMAGE, DEPTH)
    assert robot.flush()
    assert images.take(0) is None


def test_the_last_views_can_be_asked_for(robot, link):
    for _ in range(5):
        robot.push(IMAGE, DEPTH)
        assert robot.flush()
    view_key = KEYS.view("r1")
    answer = link.query(f"{view_key}?seq=3;epoch={robot.epoch}")
    kept = unpack(KeptView, answer.payload, answer.encoding)
    assert kept.view.name.seq == 3
    assert kept.image is not None
    assert kept.image.view == kept.view.name
    assert cv2.imdecode(np.frombuffer(kept.jpeg, np.uint8), cv2.IMREAD_COLOR).shape == IMAGE.shape
    newest = link.query(view_key)
    assert unpack(KeptView, newest.payload, newest.encoding).view.name.seq == 4
    for asked, reason in (
        ("seq=1", "not kept: 3 views from 2 to 4"),
        ("seq=x", "not kept"),
        ("seq=3;epoch=" + "0" * 12, "is over"),
    ):
        with pytest.raises(UnreachableError, match=reason):
            link.query(f"{view_key}?{asked}")


def test_a_view_before_the_first_push_is_refused(robot, link):
    with pytest.raises(UnreachableError, match="no view yet"):
        link.query(KEYS.view("r1"))


def test_the_camera_is_latched_and_follows_its_model(robot, link):
    got: list[Sample] = []
    link.on_latched(KEYS.camera("*"), got.append)
    assert wait_until(lambda: got, 30)
    announced = unpack(CameraAnnouncement, got[0].payload, got[0].encoding)
    assert (announced.robot, announced.epoch) == ("r1", robot.epoch)
    assert np.array_equal(announced.camera.K, MODEL.K)
    K = np.array([[151.0, 0.0, 80.0], [0.0, 150.0, 60.0], [0.0, 0.0, 1.0]])
    model = MODEL.model_copy(update={"K": K})
    robot.push_frame(Frame(stamp_ns=1, image=IMAGE, ranges=DepthImage(DEPTH), model=model))
    assert wait_until(lambda: len(got) > 1, 30)
    assert unpack(CameraAnnouncement, got[1].payload, got[1].encoding).camera.K[0, 0] == 151.0


def test_odometry_is_latched(robot, link):
    T_odom_robot = np.eye(4)
    T_odom_robot[0, 3] = 2.5
    robot.push(IMAGE, DEPTH, stamp_ns=77, T_odom_robot=T_odom_robot)
    got: list[Sample] = []
    link.on_latched(KEYS.odometry("r1"), got.append)
    assert wait_until(lambda: got, 30)
    odometry = unpack(Odometry, got[0].payload, got[0].encoding)
    assert odometry.stamp_ns == 77
    assert np.array_equal(odometry.T_odom_robot, T_odom_robot)


def test_the_newest_pose_comes_back_and_goes_stale(robot, link):
    assert robot.pose() is None
    assert robot.age_s("r1") is None
    publisher = pose_publisher(link)
    assert wait_until(lambda: robot.server_alive, 30)
    publisher.put(pack(pose_message(n=5)), encoding_of(RobotPose))
    assert wait_until(lambda: robot.pose() is not None, 30)
    assert robot.pose().n == 5
    assert not robot.is_stale(robot.pose())
    assert 0.5 <= robot.age_s("r1") < 6
    publisher.put(pack(pose_message(n=4)), encoding_of(RobotPose))  # older: no effect
    publisher.put(b"damaged", encoding_of(RobotPose))
    assert wait_until(lambda: robot.poses() and robot.drops == {"not msgpack": 1}, 30)
    assert robot.pose().n == 5
    expired = pose_message(n=0, server_epoch="1" * 12, valid_for_s=-0.1)
    link.token(KEYS.server_alive("1" * 12))
    publisher.put(pack(expired), encoding_of(RobotPose))  # a new server counts from 0
    assert wait_until(lambda: robot.pose().server_epoch == "1" * 12, 30)
    assert robot.is_stale(robot.pose())


def test_poses_of_the_others_come_as_well(robot, link):
    publisher = pose_publisher(link, "r2")
    publisher.put(pack(pose_message(robot="r2", x_m=3.0)), encoding_of(RobotPose))
    assert wait_until(lambda: "r2" in robot.poses(), 30)
    assert robot.poses()["r2"].T_fleet_robot[0, 3] == 3.0
    assert robot.pose() is None


def test_a_relative_pose_is_asked_of_the_server(robot, link):
    def answer(asked):
        if asked["to"] != "r2":
            return Answer(error=f"{asked['to']} is not joined to {asked['from']}")
        pose = RelativePose(
            a=asked["from"], b="r2", T_a_b=np.eye(4), covariance=np.eye(6), age_s=0.1, through=()
        )
        return Answer(pack(pose), encoding_of(RelativePose))

    with pytest.raises(UnreachableError, match="nobody answered"):
        robot.relative_pose("r2", timeout_s=1)
    link.queryable(KEYS.relative, answer)
    assert wait_until(lambda: _reachable(robot), 30)
    assert (robot.relative_pose("r2").a, robot.relative_pose("r2").b) == ("r1", "r2")
    with pytest.raises(UnreachableError, match="r3 is not joined to r1"):
        robot.relative_pose("r3")
    with pytest.raises(NameRefusedError):
        robot.relative_pose("r2;x=1")


def _reachable(robot):
    try:
        return robot.relative_pose("r2")
    except UnreachableError:
        return None


def test_a_name_that_is_alive_is_refused_unless_taken_over(robot, router, link):
    started = time.monotonic()
    with pytest.raises(NameTakenError, match=f"alive/{robot.epoch}.*--takeover"):
        FleetRobot("r1", settings_for(router), camera=MODEL)
    assert time.monotonic() - started > 1.9
    with FleetRobot("r1", settings_for(router), camera=MODEL, takeover=True) as second:
        tokens = link.alive(KEYS.robot_alive("r1", "*"))
        assert tokens == sorted(KEYS.robot_alive("r1", e) for e in (robot.epoch, second.epoch))
        assert wait_until(lambda: _push_refusal(robot) is not None, 30)
        assert second.epoch in _push_refusal(robot)
        assert _push_refusal(second) is None


def _push_refusal(robot):
    try:
        robot.push(IMAGE, DEPTH)
    except NameTakenError as error:
        return str(error)
    return None


def test_a_name_becomes_free_within_the_lease(router):
    first = FleetRobot("r1", settings_for(router), camera=MODEL)
    closer = threading.Timer(0.5, first.close)
    closer.start()
    with FleetRobot("r1", settings_for(router), camera=MODEL) as second:
        assert second.epoch != first.epoch
    closer.join()


def test_push_does_not_wait_and_drops_all_but_the_newest(robot, link):
    release = threading.Event()
    make_ready = robot._sender._make_ready
    published = []

    def slow(name, frame):
        release.wait(10)
        published.append(name.seq)
        return make_ready(name, frame)

    robot._sender._make_ready = slow
    started = time.monotonic()
    for _ in range(20):
        robot.push(IMAGE, DEPTH)
    assert time.monotonic() - started < 10, "no push waits"
    release.set()
    assert robot.flush()
    assert published[-1] == 19
    assert len(published) <= 2
    assert robot._sender.dropped == 20 - len(published)


def test_a_bug_in_the_sender_comes_to_light_at_the_next_push(robot):
    def broken(name, frame):
        raise ZeroDivisionError("bug")

    robot._sender._make_ready = broken
    robot.push(IMAGE, DEPTH)
    with pytest.raises(ZeroDivisionError):
        robot.flush()
    with pytest.raises(ZeroDivisionError):
        robot.push(IMAGE, DEPTH)


def test_frames_that_do_not_fit_the_camera_are_refused(robot):
    with pytest.raises(CalibrationError, match="80x60"):
        robot.push(IMAGE[::2, ::2], DEPTH)
    with pytest.raises(CalibrationError, match="no whole fraction"):
        robot.push(IMAGE, DEPTH[:, :100])


def test_a_robot_without_a_camera_model_cannot_push(router):
    with (
        FleetRobot("r9", settings_for(router)) as robot,
        pytest.raises(CalibrationError, match="give FleetRobot a camera"),
    ):
        robot.push(IMAGE, DEPTH)


def test_a_bad_name_and_a_missing_router_are_refused():
    nowhere = SessionSettings(connect=(f"tcp/127.0.0.1:{free_port()}",), timeout_s=0.3)
    with pytest.raises(NameRefusedError):
        FleetRobot("R 1", nowhere)
    with pytest.raises(UnreachableError):
        FleetRobot("r1", nowhere)
