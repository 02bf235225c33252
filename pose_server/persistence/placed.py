"""Where every followed view is: what an export is made of."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.frames import body_pose
from fleetpose.pose_server.frontend.trajectory import Followed
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True, eq=False)
class Placed:
    """A followed view, in the frame of its component: the fleet's own where it is the anchor's.

    Attributes:
        component: its name.
        followed: on which keyframe it hangs.
        T_fleet_camera, T_fleet_robot: (4, 4); of a view that is no longer kept, by the mounting
            that its keyframe tells.
    """

    component: str
    followed: Followed
    T_fleet_camera: Floats
    T_fleet_robot: Floats

    @property
    def view(self) -> ViewName:
        """Its name."""
        return self.followed.view

    @property
    def is_keyframe(self) -> bool:
        """Whether it hangs on itself."""
        return self.followed.keyframe == self.followed.view


def placed_views(site: Site) -> dict[ViewName, Placed]:
    """All followed views of a solved site, robot by robot, each robot's in order of its stamps."""
    found = sorted(_placed(site), key=lambda one: (one.view.robot, one.followed.stamp_ns))
    return {one.view: one for one in found}


def by_component(
    placed: dict[ViewName, Placed], keyframes_only: bool = False
) -> dict[str, dict[str, list[Placed]]]:
    """The same by component and robot."""
    found: dict[str, dict[str, list[Placed]]] = {}
    for one in placed.values():
        if one.is_keyframe or not keyframes_only:
            found.setdefault(one.component, {}).setdefault(one.view.robot, []).append(one)
    return found


def _placed(site: Site) -> Iterator[Placed]:
    if site.solution is None:
        return
    for followed in _followed(site).values():
        node = site.solution.nodes.get(followed.keyframe)
        if node is None:
            continue
        T_fleet_root = site.fleet_from_root(node.root)
        T_root_camera = node.T_root_camera @ followed.T_keyframe_view
        kept = site.views.get(followed.view) or site.views[followed.keyframe]
        T_fleet_robot = body_pose(T_fleet_root, T_root_camera, kept.camera.T_robot_camera)
        yield Placed(
            site.component_name(node.root), followed, T_fleet_root @ T_root_camera, T_fleet_robot
        )


def _followed(site: Site) -> dict[ViewName, Followed]:
    """What trajectories know, and what hangs now: older graphs know keyframes alone."""
    found: dict[ViewName, Followed] = {}
    for robot in site.robots.values():
        for view, here in robot.track.attached.items():
            if (kept := site.views.get(view)) is not None:
                way = (here.T_keyframe_view, here.covariance)
                found[view] = Followed(view, kept.stamp_ns, here.keyframe, *way, here.verdict)
        found |= robot.track.trajectory.views
    return found
