"""Which keyframes of other robots are worth aligning with a new one.

Where the fleet's poses are known they tell what two cameras see in common. Where they are not, two
views are promising as far as their strongest salient points match beyond chance: comparing takes a
third of a millisecond, aligning a hundred, and most pairs of a large fleet have nothing in common.
"""

from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import islice

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView, likeness
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]

ENOUGH_EDGES = 8  # between two joined robots; more keyframe pairs add little
BEST_OF_ROBOT = 2  # keyframes of another robot that are kept for one view
LEAST_OVERLAP = 0.15  # expected; less is not worth an alignment
_COMPARED = 6  # keyframes of a robot that is not joined: the newest, and some from before
_ALL_COMPARED = 80  # robots; comparing a view with six of each takes 0.2 s then
MOST_ALIKE = 60  # keyframes of a larger fleet
_GRID = 4  # by so many rays in each direction two views are laid on each other
_WIDE_COSINE = 0.35  # optical axes further apart than 70 deg are not worth trying


def candidate_views(site: Site, robot: Robot, view: ViewName) -> list[ViewName]:
    """The robot's keyframes that look most like a view, best first."""
    new = site.views[view]
    known = [keyframe for keyframe in robot.track.keyframes if keyframe in site.views]
    return sorted(known, key=lambda keyframe: -likeness(new, site.views[keyframe]))


def by_poses(site: Site, view: ViewName) -> dict[ViewName, float]:
    """Keyframes of other robots in the view's component that are expected to see the same, the
    best few of each robot, with their expected overlap (0 to 1).
    """
    assert site.solution is not None
    root = site.solution.nodes[view].root
    others = [
        other
        for other in site.solution.components[root]
        if other.robot != view.robot
        and other in site.views
        and site.edge_count(view.robot, other.robot) < ENOUGH_EDGES
    ]
    return _best_of_robots(others, expected_overlaps(site, view, others))


def to_compare(site: Site, view: ViewName) -> list[ViewName]:
    """Keyframes outside of the view's component whose looks are to be compared with its: some of
    each robot, or where there are many robots, those that the index finds most alike.
    """
    assert site.solution is not None
    component = set(site.solution.components[site.solution.nodes[view].root])
    nodes, index, signature = site.solution.nodes, site.view_index, site.views[view].signature
    index.forget_others(nodes, len(nodes))
    index.add(view, signature)
    if len(site.robots) > _ALL_COMPARED:
        alike = index.most_alike(signature)
        apart = (k for k in alike if k in nodes and k not in component and k in site.views)
        return list(islice(apart, MOST_ALIKE))[::-1]  # the last one is compared first
    found = []
    for robot in site.robots.values():
        apart = [k for k in robot.track.keyframes if k not in component and k in site.views]
        found += _some(apart, _COMPARED)
    return found


def expected_overlaps(site: Site, view: ViewName, others: Sequence[ViewName]) -> Floats:
    """(N,) share of what a view sees, at its median depth, that each of the others in its
    component sees as well and the other way round, the smaller of both.
    """
    assert site.solution is not None
    if not others:
        return np.zeros(0)
    here = site.views[view]
    T_root_view = site.solution.nodes[view].T_root_camera
    T_root_other = np.stack([site.solution.nodes[other].T_root_camera for other in others])
    T_view_other = inverse(T_root_view) @ T_root_other
    there = [site.views[other] for other in others]
    seen = np.minimum(
        _share_seen([here] * len(there), there, _inverses(T_view_other)),
        _share_seen(there, [here] * len(there), T_view_other),
    )
    return np.where(T_view_other[:, 2, 2] < _WIDE_COSINE, 0.0, seen)


def _share_seen(
    sources: Sequence[KeptView], targets: Sequence[KeptView], T_target_source: Floats
) -> Floats:
    """(N,) share of each source's rays, ended at its median depth, that its target sees."""
    steps = (np.arange(_GRID) + 0.5) / _GRID
    u, v = (axis.ravel() for axis in np.meshgrid(steps, steps))
    size = np.array([(s.camera.width, s.camera.height) for s in sources], float)
    K = np.stack([s.camera.K for s in sources])
    depth = np.array([s.median_depth_m for s in sources])[:, None]
    x = (u * size[:, :1] - K[:, :1, 2]) / K[:, :1, 0] * depth
    y = (v * size[:, 1:] - K[:, 1:2, 2]) / K[:, 1:2, 1] * depth
    points = np.stack((x, y, np.broadcast_to(depth, x.shape)), axis=1)
    moved = T_target_source[:, :3, :3] @ points + T_target_source[:, :3, 3:]
    K_target = np.stack([t.camera.K for t in targets])
    target_size = np.array([(t.camera.width, t.camera.height) for t in targets], float)
    z = np.maximum(moved[:, 2], 1e-9)
    u = K_target[:, :1, 0] * moved[:, 0] / z + K_target[:, :1, 2]
    v = K_target[:, 1:2, 1] * moved[:, 1] / z + K_target[:, 1:2, 2]
    inside = (moved[:, 2] > 0) & (u >= 0) & (v >= 0)
    inside &= (u < target_size[:, :1]) & (v < target_size[:, 1:])
    return inside.mean(axis=1)


def _inverses(T: Floats) -> Floats:
    back = np.zeros_like(T)
    back[:, :3, :3] = T[:, :3, :3].transpose(0, 2, 1)
    back[:, :3, 3] = -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])
    back[:, 3, 3] = 1.0
    return back


def _best_of_robots(others: Iterable[ViewName], overlaps: Floats) -> dict[ViewName, float]:
    by_robot: dict[str, list[tuple[float, ViewName]]] = defaultdict(list)
    for other, overlap in zip(others, overlaps, strict=True):
        if overlap >= LEAST_OVERLAP:
            by_robot[other.robot].append((float(overlap), other))
    return {
        other: overlap
        for found in by_robot.values()
        for overlap, other in sorted(found, key=lambda one: -one[0])[:BEST_OF_ROBOT]
    }


def _some(keyframes: Sequence[ViewName], count: int) -> list[ViewName]:
    """The newest half of so many, and the rest spread over those before."""
    newest = count // 2
    before = keyframes[:-newest]
    step = max(1, -(-len(before) // (count - newest)))
    return [*before[::step], *keyframes[-newest:]]
