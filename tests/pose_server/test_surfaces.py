"""Views without images: aligned by shape, and believed only as far as shapes tell."""

from dataclasses import replace

import numpy as np
import pytest

from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose, transform
from fleetpose.pose_server.registration.align import align_from, align_pair, is_settled
from fleetpose.pose_server.registration.clicked import with_clicks
from fleetpose.pose_server.registration.operator_starts import Clicks, operator_starts
from fleetpose.pose_server.registration.prepared_view import PreparedView, prepare_view
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.protocol.clouds import SalientPoints, encode_salient, encode_scattered
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Camera, NoiseModel, View, ViewName

K = np.array([[300.0, 0.0, 320.0], [0.0, 300.0, 240.0], [0.0, 0.0, 1.0]])
SIGMA_M = 0.004


def corner(rng, count=40_000):
    """Points (N, 3) of a room's corner with boxes in it, 3 m ahead."""
    u, v = rng.uniform(-1, 1, (2, count))
    parts = [
        np.column_stack((3 * u, 2 * v, np.full(count, 4.5))),
        np.column_stack((np.full(count, -2.2), 2 * v, 3 + 1.5 * u)),
        np.column_stack((3 * u, np.full(count, 1.2), 3.0 + 1.5 * v)),
    ]
    for x, z, size, height in ((0.5, 3.4, 0.4, 0.9), (-1.0, 3.8, 0.3, 1.6), (1.4, 2.9, 0.25, 0.6)):
        front, side = rng.uniform(-size, size, (2, count // 4)), rng.uniform(0, height, count // 4)
        parts.append(np.column_stack((x + front[0], 1.2 - side, np.full(len(side), z - size))))
        parts.append(np.column_stack((np.full(len(side), x - size), 1.2 - side, z + front[1])))
        parts.append(
            np.column_stack((x + front[0], np.full(len(side), 1.2 - height), z + front[1]))
        )
    return np.concatenate(parts)


def view(points, robot, rng, sigma_m=SIGMA_M) -> PreparedView:
    """What a sensor without a camera sees of points in its frame."""
    uv = (points @ K.T)[:, :2] / points[:, 2:]
    seen = (points[:, 2] > 0.1) & (uv >= 0).all(1) & (uv < (640, 480)).all(1)
    uv, z = uv[seen], points[seen, 2]
    # of what lies behind each other only the nearest is seen
    cell = (uv // 4).astype(int) @ (1, 1000)
    order = np.lexsort((z, cell))
    _, first = np.unique(cell[order], return_index=True)
    nearest = np.full(cell.max() + 1, np.inf)
    nearest[cell[order[first]]] = z[order[first]]
    front = z < nearest[cell] + 0.05
    uv, z = uv[front], z[front]
    return prepared(uv, z + rng.normal(0, sigma_m, len(z)), robot, sigma_m)


def prepared(uv, z, robot, sigma_m=SIGMA_M) -> PreparedView:
    camera = Camera(
        width=640, height=480, K=K, T_robot_camera=ROBOT_FROM_CAMERA, kind="cloud",
        noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(sigma_m, 0, 0)),
    )  # fmt: skip
    nothing = np.zeros(0, np.float32)
    none = SalientPoints(
        np.zeros((0, 2), np.float32), nothing, nothing, np.zeros((0, 128), np.uint8)
    )
    message = View(
        name=ViewName(robot=robot, epoch="0" * 12, seq=0),
        stamp_ns=1,
        camera=camera,
        cloud=encode_scattered(uv, z, 0.0005),
        salient=encode_salient(none),
        has_image=False,
    )
    return prepare_view(message)


def walked(yaw_deg, x_m=0.0):
    R = exp_so3(np.array([0.0, np.radians(yaw_deg), 0.0]))
    centre = np.array([0.0, 0.0, 3.0])
    return make_pose(R, centre - R @ centre + (x_m, 0, 0))


@pytest.fixture(scope="module")
def pair():
    T = walked(20, 0.3)
    rng = np.random.default_rng(0)
    i = view(corner(rng), "r1", rng)
    j = view(transform(inverse(T), corner(np.random.default_rng(1))), "r2", rng)
    return i, j, T


def off(T, other):
    return np.linalg.norm(T[:3, 3] - other[:3, 3]), np.linalg.norm(T[:3, :3] - other[:3, :3])


def test_two_clouds_without_images_find_each_other(pair):
    i, j, T = pair
    result = align_pair(i, j)
    assert result.T_i_j is not None
    shift, turn = off(result.T_i_j, T)
    assert shift < 0.03
    assert turn < 0.02
    assert result.verdict == "verified", result.reasons
    assert result.p_grave < 0.03
    assert is_settled(result)  # there is no wide set that could be asked for
    assert result.icp is not None
    assert result.icp.method == "gicp"
    assert result.regression_count > 0


def test_a_pose_that_clouds_contradict_is_not_believed(pair):
    i, j, T = pair
    wrong = walked(20, 1.3)
    result = align_pair(i, j, [Start("previous", wrong, 0.01)], features=False)
    assert result.verdict == "rejected" or off(result.T_i_j, T)[0] < 0.05


def test_clicks_on_clouds_alone_make_a_pose(pair):
    i, j, T = pair
    p_j = np.array([[0.1, -0.3, 3.0], [-0.8, 0.6, 3.5], [0.9, 0.5, 2.9], [0.2, 0.9, 3.4]])
    p_i = transform(T, p_j)
    uv_i, uv_j = ((p @ K.T)[:, :2] / p[:, 2:] for p in (p_i, p_j))
    sigma = np.full(4, 0.01)
    clicks = Clicks(uv_i, uv_j, p_i[:, 2], p_j[:, 2], sigma, sigma)
    sets = operator_starts(i, j, clicks, ())
    starts = [start for one in sets for start in one.starts]
    result = with_clicks(align_pair(i, j, starts, False), sets, clicks, i, j)
    assert result.T_i_j is not None
    assert off(result.T_i_j, T)[0] < 0.05
    assert result.verdict in ("verified", "plausible")
    assert result.confirmed
    again = align_from(i, j, starts, align_pair(i, j))
    assert again.verdict == "verified"


def test_a_bare_wall_does_not_say_where_along_it(pair):
    rng = np.random.default_rng(0)
    wall = np.column_stack((rng.uniform(-4, 4, (60_000, 2)), np.full(60_000, 3.0)))
    i, j = view(wall, "r1", rng), view(wall - (0.7, 0.4, 0), "r2", rng)
    result = align_pair(i, j)
    assert result.verdict != "verified", result.reasons


def test_an_image_beside_a_cloud_is_aligned_by_the_clouds(pair):
    i, j, T = pair
    looks = np.random.default_rng(0).normal(size=(len(i.observed.uv), 128)).astype(np.float32)
    with_image = replace(i, looks=True, descriptors=looks)
    result = align_pair(with_image, j)
    assert result.T_i_j is not None
    assert off(result.T_i_j, T)[0] < 0.03


@pytest.mark.parametrize("count", [10, 11, 299, 301, 2000])
@pytest.mark.parametrize("shape", ["blob", "line", "plane", "spot", "far"])
def test_poor_clouds_are_refused_and_never_crash(count, shape):
    rng = np.random.default_rng(count)
    uv = rng.uniform(5, 470, (count, 2))
    z = {
        "blob": rng.uniform(1, 5, count),
        "line": np.full(count, 2.0),
        "plane": np.full(count, 2.0),
        "spot": np.full(count, 2.0),
        "far": np.full(count, 9e4),
    }[shape]
    if shape == "line":
        uv[:, 1] = 240.0
    if shape == "spot":
        uv[:] = 100.0
    try:
        i, j = prepared(uv, z, "r1"), prepared(uv[::-1], z[::-1], "r2")
        result = align_pair(i, j)
    except CodecError:
        return
    if result.T_i_j is not None:
        assert np.isfinite(result.T_i_j).all()
    if count < 300 or shape in ("line", "spot"):
        assert result.verdict != "verified", result.reasons


def test_wrong_clicks_along_a_wall_are_not_supported_by_the_wall():
    rng = np.random.default_rng(0)
    wall = np.column_stack((rng.uniform(-4, 4, (60_000, 2)), np.full(60_000, 3.0)))
    i, j = view(wall, "r1", rng), view(wall - (0.7, 0.4, 0), "r2", rng)
    p_j = np.array([[-0.8, -0.6, 3.0], [0.9, -0.5, 3.0], [0.2, 0.7, 3.0]])
    p_i = p_j + np.array((1.5, -0.3, 0.0))  # 0.8 and 0.7 m off
    uv_i, uv_j = ((p @ K.T)[:, :2] / p[:, 2:] for p in (p_i, p_j))
    sigma = np.full(3, 0.01)
    clicks = Clicks(uv_i, uv_j, p_i[:, 2], p_j[:, 2], sigma, sigma)
    sets = operator_starts(i, j, clicks, ())
    result = with_clicks(align_pair(i, j), sets, clicks, i, j)
    assert result.hearing is not None
    assert result.hearing.p_grave > 0.05  # nobody is located by them
