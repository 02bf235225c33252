"""The tree of tf that the fleet's poses make: one root, every frame on one parent, and relative
poses by tf that are the fleet's.
"""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import RobotPose, ViewName
from fleetpose.ros_bridge.fleet_tree import FLEET, SETTLED_S, Hung, RobotTree
from fleetpose.ros_bridge.outgoing import Outgoing, quaternion, ros_covariance
from fleetpose.rosmsg.dialects import rmw_zenoh
from fleetpose.rosmsg.motion.odometry import left_covariance
from fleetpose.rosmsg.transforms import Tf, inverse

MADE = Outgoing(rmw_zenoh.types().types.__getitem__)
EPOCH = "0" * 12
SMALL = np.diag([0.01, 0.02, 0.03, 0.1, 0.2, 0.3]) ** 2


def pose(x=0.0, y=0.0, yaw=0.0) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:2, 3] = x, y
    return T


def told(robot: str, T: np.ndarray, stamp_ns: int, located=True, valid_s=10.0) -> RobotPose:
    return RobotPose(
        robot=robot,
        view=ViewName(robot=robot, epoch=EPOCH, seq=1),
        stamp_ns=stamp_ns,
        T_fleet_robot=T,
        covariance=SMALL,
        component="r1",
        located=located,
        verdict="verified",
        gauge_revision=0,
        jumped=False,
        age_s=0.0,
        valid_until_ns=stamp_ns + int(valid_s * 1e9),
        server_epoch=EPOCH,
        n=1,
    )


def transforms(*joints: tuple[str, str, np.ndarray, int]):
    return MADE.transforms([MADE.transform(*joint) for joint in joints])


def odometry(parent: str, child: str, T: np.ndarray, stamp_ns: int):
    return MADE.odometry(parent, child, T, SMALL, stamp_ns)


def join(tree: RobotTree, message: RobotPose, now_s: float = 0.0) -> bool:
    """Poses for as long as a tree needs to settle; the last one counts."""
    tree.take_pose(message, now_s - SETTLED_S)
    return tree.take_pose(message, now_s)


def tree_of(hung: list[Hung]) -> Tf:
    """As tf2 would build it; a frame has one parent."""
    parents: dict[str, str] = {}
    for one in hung:
        assert parents.setdefault(one.child, one.parent) == one.parent, "two parents"
    roots = set(parents.values()) - parents.keys()
    assert roots <= {FLEET}, roots
    tf = Tf()
    tf.add(transforms(*hung), static=False)
    return tf


def test_frames_of_all_kinds_of_robots_make_one_tree_whose_relative_poses_are_the_fleets():
    mapping, driving, bare = RobotTree("r1"), RobotTree("r2"), RobotTree("r3")
    at = {"r1": pose(1, 2, 0.3), "r2": pose(-2, 0, 1.2), "r3": pose(4, 4, -2)}
    for tree in (mapping, driving, bare):
        assert not tree.joins(0.0)
    lens = ("base_link", "lens", pose(0.1), 0)
    assert not mapping.take_tf(transforms(lens), static=True)
    moving = ("map", "odom", pose(5), 10**9), ("odom", "base_link", pose(0, 3, 1), 10**9)
    assert not mapping.take_tf(transforms(*moving), static=False), "it hangs nowhere yet"
    assert not driving.take_odometry(odometry("odom", "base_link", pose(7, 7, 2), 10**9))
    trees = {"r1": mapping, "r2": driving, "r3": bare}
    assert all(join(tree, told(name, at[name], 10**9)) for name, tree in trees.items())

    hung = [
        *mapping.take_tf(transforms(*moving), static=False),
        *mapping.standing,
        *driving.take_odometry(odometry("odom", "base_link", pose(7, 7, 2), 10**9)),
        *(joint for tree in trees.values() for joint in tree.joins(1.0)),
    ]
    tf = tree_of(hung)
    assert tf.parents["r1/map"] == tf.parents["r2/odom"] == tf.parents["r3/base_link"] == FLEET
    assert tf.parents["r1/lens"] == "r1/base_link"
    for a in trees:
        for b in trees:
            relative = tf.lookup(f"{a}/base_link", f"{b}/base_link")
            assert np.abs(relative - inverse(at[a]) @ at[b]).max() < 1e-9


def test_a_robot_that_is_not_located_or_not_heard_of_any_more_hangs_nowhere():
    tree = RobotTree("r1")
    tree.take_odometry(odometry("odom", "base_link", pose(), 10**9))
    assert not join(tree, told("r1", pose(), 10**9, located=False))
    assert tree.take_pose(told("r1", pose(), 10**9, valid_s=5.0), 0.0)
    assert tree.joins(4.9)
    assert not tree.joins(5.1)
    assert not tree.take_odometry(odometry("odom", "base_link", pose(), 2 * 10**9))
    assert tree.take_pose(told("r1", pose(), 10**9), 6.0), "it begins to hang again"
    assert not tree.take_pose(told("r1", pose(), 10**9, located=False), 7.0)
    assert not tree.joins(7.0)


def test_a_joint_between_odometry_messages_is_that_of_the_views_moment():
    tree = RobotTree("r1")
    for second in (1, 2):
        stamp_ns = 10**9 + second * 10**8
        tree.take_odometry(odometry("odom", "base_link", pose(second), stamp_ns))
    join(tree, told("r1", pose(10), 10**9 + 15 * 10**7))
    (joint,) = tree.joins(0.0)
    assert np.allclose(joint.T_parent_child, pose(8.5), atol=1e-9)
    assert joint.stamp_ns == 10**9 + 2 * 10**8, "told with the newest odometry's stamp"


def test_odometry_of_another_clock_is_named():
    tree = RobotTree("r1")
    tree.take_odometry(odometry("odom", "base_link", pose(), 10**9))
    assert not join(tree, told("r1", pose(), 10**12))
    assert any("clock" in fault for fault in tree.faults) and not tree.joins(0.0)


def test_what_tf_says_of_a_frame_goes_before_odometry_messages_and_prefixes_stand_once():
    tree = RobotTree("r1")
    tree.take_tf(transforms(("r1/odom", "r1/base_link", pose(1), 10**9)), static=False)
    join(tree, told("r1", pose(), 10**9))
    assert not tree.take_odometry(odometry("r1/odom", "r1/base_link", pose(2), 2 * 10**9))
    (joint,) = tree.joins(0.0)
    assert (joint.parent, joint.child) == (FLEET, "r1/odom")


def test_frames_that_hang_on_nothing_of_the_robot_are_left_out():
    tree = RobotTree("r1")
    tree.take_tf(transforms(("arm", "hand", pose(1), 0)), static=True)
    tree.take_tf(transforms(("odom", "base_link", pose(1), 10**9)), static=False)
    join(tree, told("r1", pose(), 10**9))
    assert not tree.standing
    assert not tree.take_tf(transforms(("world", "ghost", pose(1), 10**9)), static=False)
    tree.take_tf(transforms(("base_link", "arm", pose(1), 0)), static=True)
    assert {one.child for one in tree.standing} == {"r1/arm", "r1/hand"}


def test_a_map_that_appears_later_is_the_new_root():
    tree = RobotTree("r1")
    odom = ("odom", "base_link", pose(1), 10**9)
    tree.take_tf(transforms(odom), static=False)
    join(tree, told("r1", pose(9), 10**9))
    tree.take_tf(transforms(("map", "odom", pose(3), 10**9), odom), static=False)
    assert not tree.joins(0.0), "where it hung is no more"
    assert not tree.take_pose(told("r1", pose(9), 10**9), 0.0), "there may be more to come"
    assert tree.take_pose(told("r1", pose(9), 10**9), SETTLED_S)
    (joint,) = tree.joins(0.0)
    assert joint.child == "r1/map" and np.allclose(joint.T_parent_child, pose(5))


def test_odometry_that_is_no_pose_is_refused():
    message = odometry("odom", "base_link", pose(), 0)
    message.pose.pose.position.x = np.nan
    with pytest.raises(CodecError):
        RobotTree("r1").take_odometry(message)


@given(st.integers(0, 2**32 - 1))
def test_a_covariance_there_and_back_is_the_same(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(6, 6))
    T = pose(*rng.uniform(-20, 20, 2), rng.uniform(-3, 3))
    C = A @ A.T + np.eye(6)
    assert np.allclose(left_covariance(ros_covariance(C, T), T), C, rtol=1e-12, atol=1e-9)


def test_the_covariance_is_that_of_many_draws():
    rng = np.random.default_rng(1)
    T = pose(10, 4, 0.7)
    draws = rng.multivariate_normal(np.zeros(6), SMALL * 1e-2, 100_000)
    # to first order, of exp(xi) T: the body turns by phi about fixed axes, and is moved
    moved = draws[:, 3:] + np.cross(draws[:, :3], T[:3, 3])
    sampled = np.cov(np.hstack((moved, draws[:, :3])).T)
    ours = ros_covariance(SMALL * 1e-2, T).reshape(6, 6)
    assert np.abs(np.sqrt(np.diag(sampled)) / np.sqrt(np.diag(ours)) - 1).max() < 0.02


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
def test_a_quaternion_is_its_rotation(turn):
    R = cv2.Rodrigues(np.array(turn))[0]
    message = MADE.transform("a", "b", np.block([[R, np.zeros((3, 1))], [np.eye(4)[3:]]]), 5)
    tf = Tf()
    tf.add(MADE.transforms([message]), static=True)
    assert np.abs(tf.lookup("a", "b")[:3, :3] - R).max() < 1e-12
    assert abs(np.linalg.norm(quaternion(R)) - 1) < 1e-12
