"""Where one robot is, seen from another, and whether that may be acted on."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.frames import in_fleet, strayed
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.messages.builders import unknown, why_not_located
from fleetpose.pose_server.pose_graph.types import FleetSolution
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import RelativePose, Verdict, ViewName

Floats = npt.NDArray[np.floating]
_WEAKEST_FIRST: tuple[Verdict, ...] = ("rejected", "ambiguous", "plausible", "verified")


def relative_pose(
    site: Site, a: str, b: str, settings: ServerSettings, now_s: float
) -> RelativePose | str:
    """T_a_b of two robots' bodies now, or why there is none.

    Where a robot was not seen for a while, it may be elsewhere: the covariance says so as that of
    its pose in the fleet does, and why it is not located is told.
    """
    for name in (a, b):
        if name not in site.robots:
            return unknown(site, name)
    at_a, at_b = site.robots[a].track.newest, site.robots[b].track.newest
    if at_a is None or at_b is None or site.solution is None:
        return f"'{a if at_a is None else b}' has no aligned view yet"
    relative = site.solution.relative(at_a.keyframe, at_b.keyframe)
    if relative is None or relative.covariance is None:
        return f"nothing joins '{a}' and '{b}': they are in different components of the fleet"
    body_a, body_b = (site.views[at.view].camera.T_robot_camera for at in (at_a, at_b))
    T_body_a = body_a @ inverse(at_a.T_keyframe_view)
    T = T_body_a @ relative.T_a_b @ at_b.T_keyframe_view @ inverse(body_b)
    age_a, age_b = (max(0.0, now_s - site.views[at.view].received_s) for at in (at_a, at_b))
    covariance = in_fleet(T_body_a, relative.covariance)
    if age_a > settings.fresh_s:
        covariance = strayed(np.eye(4), covariance, age_a, site.depth_m)
    if age_b > settings.fresh_s:
        covariance = strayed(T, covariance, age_b, site.depth_m)
    reasons = {name: why_not_located(site, site.robots[name], settings, now_s) for name in (a, b)}
    return RelativePose(
        a=a,
        b=b,
        T_a_b=T,
        covariance=covariance,
        age_s=max(age_a, age_b),
        through=tuple(dict.fromkeys(v.robot for v in relative.path if v.robot not in (a, b))),
        verdict=_weakest(site.solution, at_a.keyframe, at_b.keyframe),
        located=not any(reasons.values()),
        p_grave=p_grave_of(site, relative.path),
        why_not="; ".join(f"{name}: {reason}" for name, reason in reasons.items() if reason),
    )


def _weakest(solution: FleetSolution, *nodes: ViewName) -> Verdict:
    found = {solution.nodes[node].verdict for node in nodes}
    return next(verdict for verdict in _WEAKEST_FIRST if verdict in found)


def p_grave_of(site: Site, path: tuple[ViewName, ...]) -> float | None:
    """The probability that one of the links between robots on a way is gravely off, as if each
    erred for itself; of several between two robots the surest counts. None where nothing is known
    of one of them.
    """
    assert site.solution is not None
    surest: dict[tuple[str, str], float] = {}
    for key, edge in site.edges.items():
        judged = site.solution.edges.get(key)
        if judged is not None and judged.weight > 0:
            robots = ordered_pair(edge.a.robot, edge.b.robot)
            surest[robots] = min(surest.get(robots, 1.0), edge.p_grave)
    steps = {ordered_pair(v.robot, w.robot) for v, w in pairwise(path) if v.robot != w.robot}
    if not steps <= surest.keys():
        return None
    right = np.prod([1.0 - surest[step] for step in steps])
    return float(np.clip(1.0 - right, 0.0, 1.0))
