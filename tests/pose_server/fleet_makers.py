"""Small fleets with known truth for the tests of the fleet solve."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.noise import covariances
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, log_so3, make_pose, transform
from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.pose_graph.types import ClickFactor, Edge, EdgeKind
from fleetpose.protocol.messages import Verdict, ViewName

Floats = npt.NDArray[np.floating]
EPOCH = "0123456789ab"
SIGMAS = np.array([0.004] * 3 + [0.02] * 3)


def view(robot: str, seq: int = 0) -> ViewName:
    return ViewName(robot=robot, epoch=EPOCH, seq=seq)


def exp_se3(xi: Floats) -> Floats:
    """The exact exponential, independent of the code under test."""
    w, v = xi[:3], xi[3:]
    angle = np.linalg.norm(w)
    K = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    if angle < 1e-9:
        return make_pose(exp_so3(w), v)
    V = np.eye(3) + (1 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * K @ K
    return make_pose(exp_so3(w), V @ v)


def left_error(T: Floats, T_true: Floats) -> Floats:
    """xi with T = exp(xi) T_true, to first order in the rotation."""
    E = T @ inverse(T_true)
    w = log_so3(E[:3, :3])
    V_inverse = np.eye(3) - 0.5 * np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    return np.concatenate((w, V_inverse @ E[:3, 3]))


def ring(n: int, radius: float = 3.0) -> list[Floats]:
    """T_world_camera (4, 4) of n cameras on a ring that look at its centre."""
    poses = []
    for angle in 2 * np.pi * np.arange(n) / n:
        forward = -np.array([np.cos(angle), 0.0, np.sin(angle)])
        down = np.array([0.0, 1.0, 0.0])
        R = np.column_stack((np.cross(down, forward), down, forward))
        poses.append(make_pose(R, -radius * forward))
    return poses


def edge(
    nodes: Sequence[ViewName],
    truth: Sequence[Floats],
    a: int,
    b: int,
    rng: np.random.Generator | None,
    sigmas: Floats = SIGMAS,
    verdict: Verdict = "verified",
    kind: EdgeKind = "pair",
    operator: bool = False,
    grown: bool = False,
    offset: Floats | None = None,
    p_grave: float = -1.0,
    rests_on: Floats | None = None,
) -> Edge:
    """A measured edge; `offset` (6,) makes it wrong. It rests on world points (N, 3)."""
    xi = np.zeros(6) if rng is None else rng.normal(size=6) * sigmas
    T = exp_se3(xi) @ inverse(truth[a]) @ truth[b]
    if offset is not None:
        T = T @ exp_se3(offset)
    rests = None if rests_on is None else Structure.of(transform(inverse(truth[a]), rests_on))
    return Edge(
        nodes[a],
        nodes[b],
        T,
        np.diag(sigmas**2),
        verdict,
        kind,
        operator,
        grown,
        p_grave,
        rests,
    )


def thing(x: float, y: float = 0.0, z: float = 0.0, size: float = 0.1) -> Floats:
    """Corners (8, 3) of a box in the world, something that matches rest on."""
    corners = np.array(np.meshgrid((-1, 1), (-1, 1), (-1, 1)), float).reshape(3, 8).T
    return np.array((x, y, z)) + size * corners


def click(
    nodes: Sequence[ViewName],
    truth: Sequence[Floats],
    a: int,
    b: int,
    point: Floats,
    rng: np.random.Generator | None,
    number: int,
    depth_sigma: float = 0.06,
    offset: Floats | None = None,
) -> ClickFactor:
    """A world point clicked in two views, noisy along and across each ray."""
    seen = []
    for k in (a, b):
        p = transform(inverse(truth[k]), point[None])
        C = covariances(p, 500.0, 1.0, np.array([depth_sigma]))[0]
        noise = np.zeros(3) if rng is None else rng.multivariate_normal(np.zeros(3), C)
        seen.append((p[0] + noise, C))
    (p_a, C_a), (p_b, C_b) = seen
    if offset is not None:
        p_b = p_b + offset
    return ClickFactor(nodes[a], nodes[b], p_a, p_b, C_a, C_b, number)


def position_errors(
    solution, nodes: Sequence[ViewName], truth: Sequence[Floats], root: int
) -> Floats:
    """|t - t_true| of every node relative to the root."""
    return np.array(
        [
            np.linalg.norm(
                solution.nodes[node].T_root_camera[:3, 3] - (inverse(truth[root]) @ T)[:3, 3]
            )
            for node, T in zip(nodes, truth, strict=True)
        ]
    )
