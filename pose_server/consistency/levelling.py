"""A level fleet frame: its z axis points up where any of the fleet's robots knows gravity.

The origin's component is turned about its origin by what all its keyframes say of up, and held so:
views to come turn it again only if it is off by more than `RELEVEL_RAD`. Relative poses, the origin
and the heading stay. Poses before and after a turn do not compare, so it raises the gauge revision.
"""

import json
from collections import Counter
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.frames import upright
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.float64]

RELEVEL_RAD = np.radians(0.5)  # less than robots' own words of up differ by
_SIGMA_RAD = 0.02  # of ups that are told without one
_LEAST_SIGMA_RAD = 1e-3
_ROUNDS, _LEAST = 30, 1e-6  # of the mean


def learns_up(site: Site, view: KeptView) -> bool:
    """Whether a view may tell up of a fleet's frame that is not known to be level."""
    return view.up_camera is not None and site.gauge is not None and not site.knows_up(site.gauge)


def level(site: Site) -> bool:
    """Turns the fleet's frame upright where its keyframes know up and it is not; whether it did."""
    root = site.gauge
    if root is None or site.solution is None or root not in site.solution.nodes:
        return False
    R_fleet_root = site.fleet_from_root(root)[:3, :3]
    told = _told(site, root)
    if not told:
        return False
    ups, weights = _votes(told)
    up_fleet = robust_mean(ups @ R_fleet_root.T, weights)
    off_rad = float(np.arccos(np.clip(up_fleet[2], -1.0, 1.0)))
    if site.knows_up(root) and off_rad <= RELEVEL_RAD:
        return False
    R_robot_root = site.views[root].camera.T_robot_camera[:3, :3]
    R_fleet_robot = upright(up_fleet)[:3, :3] @ R_fleet_root @ R_robot_root.T
    site.anchoring.set_level(root, R_fleet_robot)
    site.raise_revision()
    site.say(
        f"the fleet's frame was turned by {np.degrees(off_rad):.1f} deg: its z axis points up, as "
        f"{', '.join(sorted({view.robot for view in told}))} say"
    )
    return True


def robust_mean(ups: Floats, weights: Floats) -> Floats:
    """The unit vector (3,) from which unit vectors (N, 3) are nearest by the weighted sum of their
    distances (Weiszfeld's geometric median): less than half of the weight cannot pull it away.
    """
    mean = _unit(np.median(ups, axis=0), ups[int(np.argmax(weights))])
    for _ in range(_ROUNDS):
        share = weights / np.maximum(np.linalg.norm(ups - mean, axis=1), _LEAST)
        before, mean = mean, _unit(share @ ups, mean)
        if np.linalg.norm(mean - before) < _LEAST:
            break
    return mean


def levels_text(site: Site) -> str:
    """What a server that begins again must know, so that its frame is the same: for the journal."""
    rows = [
        [view.robot, view.epoch, view.seq, R.reshape(-1).tolist()]
        for view, R in site.anchoring.levels.items()
    ]
    return json.dumps(rows)


def recall_levels(site: Site, text: str) -> None:
    """The frames are as an earlier life of the server noted them; of keyframes that are gone no
    frame is left.
    """
    for robot, epoch, seq, numbers in json.loads(text):
        view = ViewName(robot=robot, epoch=epoch, seq=seq)
        if view in site.views:
            site.anchoring.set_level(view, np.array(numbers, np.float64).reshape(3, 3))


def _told(site: Site, root: ViewName) -> dict[ViewName, tuple[Floats, float]]:
    """Up (3,) in the root camera's frame, and its sigma, rad, of what knows it in a component:
    keyframes, and newest views, as who learns it late, standing still, tells it by no keyframe.
    """
    assert site.solution is not None
    newest = (robot.track.newest.view for robot in site.robots.values() if robot.track.newest)
    found = {}
    for name in dict.fromkeys((*site.solution.components[root], *newest)):
        kept, R = site.views.get(name), _R_root(site, name, root)
        if kept is not None and kept.up_camera is not None and R is not None:
            found[name] = R @ kept.up_camera, kept.up_sigma_rad or _SIGMA_RAD
    return found


def _R_root(site: Site, name: ViewName, root: ViewName) -> Floats | None:
    """R_root_view (3, 3) of a view, None where it hangs elsewhere."""
    here = site.attached(name)
    assert site.solution is not None
    node = None if here is None else site.solution.nodes.get(here.keyframe)
    if here is None or node is None or node.root != root:
        return None
    return node.T_root_camera[:3, :3] @ here.T_keyframe_view[:3, :3]


def _votes(told: Mapping[ViewName, tuple[Floats, float]]) -> tuple[Floats, Floats]:
    """Ups (N, 3) and their weights (N,): a robot's views have one vote together, as they share its
    sensor, and a surer sensor has more.
    """
    count = Counter(view.robot for view in told)
    ups = np.array([up for up, _ in told.values()])
    sigmas = np.maximum([sigma for _, sigma in told.values()], _LEAST_SIGMA_RAD)
    shares = np.array([count[view.robot] for view in told], np.float64)
    return ups / np.linalg.norm(ups, axis=1, keepdims=True), 1.0 / (shares * sigmas)


def _unit(vector: Floats, otherwise: Floats) -> Floats:
    """Of length one; the other one where it has none: ups that contradict each other cancel."""
    length = float(np.linalg.norm(vector))
    return vector / length if length > _LEAST else otherwise
