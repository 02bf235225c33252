"""The server's knowledge as messages: poses, alignments, the fleet's state."""

from dataclasses import asdict, dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.consistency.anchoring import why_apart
from fleetpose.pose_server.consistency.doubts import why_doubted
from fleetpose.pose_server.frontend.frames import (
    body_pose,
    grave_by_noise,
    in_fleet,
    position_sigma,
    strayed,
)
from fleetpose.pose_server.geometry.se3 import inverse, rotation_angle
from fleetpose.pose_server.messages.error_matrix import CellCache, error_of, pair_cells
from fleetpose.pose_server.pose_graph.types import NodePose
from fleetpose.pose_server.questions.facts import questions
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.robots import PublishedAt, Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Alignment,
    FleetState,
    IcpFit,
    OperatorFit,
    PairError,
    RobotPose,
    RobotState,
    ViewName,
    WhyNot,
)

Floats = npt.NDArray[np.floating]

_JUMP_SIGMAS = 3.0
_JUMP_SHARE = 0.01  # of the median depth: smaller moves are never called jumps
_WORTH_TELLING = 0.1  # sigmas that a solve must move a robot by
_SURER = 1.1  # ratio of sigmas


@dataclass(frozen=True)
class Stamp:
    """What every message of the server carries."""

    epoch: str
    now_s: float
    now_ns: int


def robot_pose(
    site: Site,
    robot: Robot,
    settings: ServerSettings,
    stamp: Stamp,
    errors: tuple[PairError, ...] = (),
) -> tuple[RobotPose, PublishedAt] | None:
    """The newest pose of a robot and where that hangs, or None while nothing is known but itself.

    Args:
        errors: of its pairs.
    """
    newest = robot.track.newest
    if newest is None or site.solution is None:
        return None
    placed = site.camera_pose(newest.view)
    if placed is None:
        return None
    root, T_root_camera, covariance_root = placed
    if covariance_root is None:
        return None
    kept = site.views[newest.view]
    T_fleet_root = site.fleet_from_root(root)
    T = body_pose(T_fleet_root, T_root_camera, kept.camera.T_robot_camera)
    covariance = in_fleet(T_fleet_root, covariance_root)
    if not (np.isfinite(T).all() and np.isfinite(covariance).all()):
        return None
    component = site.component_name(root)
    age_s = max(0.0, stamp.now_s - kept.received_s)
    node = site.solution.nodes[newest.keyframe]
    why_not = (
        _absent(robot)
        or why_doubted(site, robot)
        or _why_not(site, settings, node, age_s, T, covariance, kept.median_depth_m)
    )
    at = PublishedAt(newest.keyframe, node, T_fleet_root @ node.T_root_camera)
    if age_s > settings.fresh_s:
        covariance = strayed(T, covariance, age_s, site.depth_m)
    pose = RobotPose(
        robot=robot.name,
        view=newest.view,
        stamp_ns=kept.stamp_ns,
        T_fleet_robot=T,
        covariance=covariance,
        component=component,
        located=not why_not,
        verdict=node.verdict,
        gauge_revision=site.gauge_revision,
        jumped=_jumped(site, robot, at, component),
        age_s=age_s,
        valid_until_ns=kept.stamp_ns + int(1e9 * settings.fresh_s),
        errors=errors,
        server_epoch=stamp.epoch,
        n=robot.poses_sent + 1,
        why_not=why_not,
    )
    return pose, at


def why_not_located(site: Site, robot: Robot, settings: ServerSettings, now_s: float) -> str:
    """Why a robot is not located; empty if it is."""
    count, reason = robot.refused
    if robot.newest is None:
        if not robot.alive:
            return "not there"
        if count:
            return f"alive, but its views are refused, {count} so far: {reason}"
        if denied := _denied(site, settings, robot):
            return f"alive, but {denied}"
        return "alive, but no view arrived: is its camera running, may it publish?"
    if absent := _absent(robot) or why_doubted(site, robot):
        return absent
    pose = robot.published
    if pose is None:
        return "its views are not aligned yet"
    if now_s - site.views[robot.newest].received_s > settings.fresh_s:
        old = f"its newest view is {now_s - site.views[robot.newest].received_s:.0f} s old"
        why = f"{count} since were refused: {reason}" if count else _denied(site, settings, robot)
        return f"{old}: {why}" if why else old
    placed = site.camera_pose(pose.view) if pose.view in site.views else None
    if placed is None or placed[2] is None:
        return "its newest view does not hang on the fleet's graph"
    if site.gauge is None or placed[0] != site.gauge:
        return _with_clicks_told(site, robot, why_apart(site, robot))
    kept, here = site.views[pose.view], site.attached(pose.view)
    assert here is not None and site.solution is not None  # it is placed
    node = site.solution.nodes[here.keyframe]
    age_s = now_s - kept.received_s
    T, covariance = pose.T_fleet_robot, pose.covariance
    why = _why_not(site, settings, node, age_s, T, covariance, kept.median_depth_m)
    return _with_clicks_told(site, robot, why)


def _denied(site: Site, settings: ServerSettings, robot: Robot) -> str:
    """That routers let none of its views pass; empty if nothing is known of that."""
    key = Keys(settings.site).cloud(robot.name)
    count = site.denials.of(f"robot/{robot.name}", key)
    return f"its router's rules deny its views, {count} so far" if count else ""


def _with_clicks_told(site: Site, robot: Robot, why_not: str) -> str:
    """A reason, and what was told of the points clicked for the robot, if that is still so."""
    records = [site.pair(robot.name, other) for other in site.partners[robot.name]]
    told = [record.told or record.contradicted for record in records]
    return "; ".join([why_not, *filter(None, told)]) if why_not else ""


def _absent(robot: Robot) -> str:
    """That nobody knows where it is now, whatever was known; empty if its views still come."""
    if not robot.alive:
        return "its token is gone: the agent ended or lost the network"
    if robot.newest is not None and robot.newest.epoch != robot.epoch:
        return "it was started anew, and no view of this life of it has come yet"
    return ""


def _why_not(
    site: Site,
    settings: ServerSettings,
    node: NodePose,
    age_s: float,
    T: Floats,
    covariance: Floats,
    depth_m: float,
) -> str:
    if age_s > settings.fresh_s and site.gauge is not None and node.root == site.gauge:
        return (
            f"its last pose is {age_s:.0f} s old: its newer views align with none of its keyframes"
        )
    return why_misplaced(site, settings, node, T, covariance, depth_m)


def why_misplaced(
    site: Site,
    settings: ServerSettings,
    node: NodePose,
    T: Floats,
    covariance: Floats,
    depth_m: float,
) -> str:
    """Why a robot that stands at a keyframe is not located there, however fresh its view is; empty
    if it is.

    Args:
        T, covariance: its pose (4, 4) in the fleet frame by that keyframe, and its covariance.
        depth_m: median depth of the keyframe.
    """
    if site.gauge is None or node.root != site.gauge:
        return "no verified alignment joins it to the fleet's origin, directly or through others"
    if node.verdict == "ambiguous":
        return "the links to it contradict each other"
    if node.p_grave > settings.located_grave:
        limit = settings.located_grave
        return (
            f"its pose is gravely wrong with a probability of {node.p_grave:.1%}, need "
            f"{limit:.0%}: no independent link to the origin confirms the doubtful one it hangs by"
        )
    share = position_sigma(T, covariance) / depth_m
    if share > settings.located_sigma:
        limit = settings.located_sigma
        return f"its position is known to {share:.1%} of the depth, need {limit:.0%}"
    grave = 1.0 - (1.0 - node.p_grave) * (1.0 - grave_by_noise(share))
    if grave > settings.located_grave:
        return (
            f"its position is known to {share:.1%} of the depth: gravely off with a probability of "
            f"{grave:.1%}, need {settings.located_grave:.0%}"
        )
    return ""


def _jumped(site: Site, robot: Robot, at: PublishedAt, component: str) -> bool:
    """Whether the same keyframe stands elsewhere than when it was published last, or in another
    component.
    """
    before, node = robot.published_at, at.node
    if robot.published is None or before is None:
        return False
    if robot.published.component != component:
        return True
    if before.keyframe != at.keyframe:
        return False
    shift = float(np.linalg.norm(at.T_fleet_keyframe[:3, 3] - before.T_fleet_keyframe[:3, 3]))
    depth = site.views[at.keyframe].median_depth_m
    sigma = 0.0 if node.covariance is None else position_sigma(node.T_root_camera, node.covariance)
    return shift > max(_JUMP_SHARE * depth, _JUMP_SIGMAS * sigma)


def pair_errors(site: Site, robot: Robot) -> tuple[PairError, ...]:
    """Of a robot's pairs, each its last."""
    return tuple(
        PairError(other=other, rmse_m=error_of(last), verdict=last.verdict)
        for other in site.partners[robot.name]
        if (last := site.pair(robot.name, other).last) is not None
    )


def has_moved(site: Site, robot: Robot) -> bool:
    """Whether the solution puts a robot, since it was told last, elsewhere by more than is worth
    telling between two views, or into another component, or is less or more sure.
    """
    newest, solution, pose = robot.track.newest, site.solution, robot.published
    if newest is None or solution is None or (node := solution.nodes.get(newest.keyframe)) is None:
        return False
    at = robot.published_at
    if at is None or pose is None or pose.gauge_revision != site.gauge_revision:
        return True
    before = at.node
    if before is node:
        return False
    if (before.root, before.verdict) != (node.root, node.verdict):
        return True
    if before.covariance is None or node.covariance is None:
        return before.covariance is not node.covariance
    sigma = position_sigma(before.T_root_camera, before.covariance)
    ratio = position_sigma(node.T_root_camera, node.covariance) / max(sigma, 1e-12)
    shift = np.linalg.norm(node.T_root_camera[:3, 3] - before.T_root_camera[:3, 3])
    turn = rotation_angle(node.T_root_camera[:3, :3].T @ before.T_root_camera[:3, :3])
    turn_sigma = float(np.sqrt(np.trace(before.covariance[:3, :3])))
    moved = shift > _WORTH_TELLING * sigma or turn > _WORTH_TELLING * turn_sigma
    return bool(moved or not 1 / _SURER < ratio < _SURER)


def alignment(i: ViewName, j: ViewName, result: PairResult, stamp: Stamp, n: int) -> Alignment:
    """An alignment's message."""
    information = None if result.covariance is None else np.linalg.inv(result.covariance)
    return Alignment(
        view_i=i,
        view_j=j,
        T_i_j=result.T_i_j,
        covariance=result.covariance,
        information=information,
        verdict=result.verdict,
        reasons=result.reasons,
        regression_error_m2=result.regression_error_m2,
        regression_count=result.regression_count,
        rmse_m=result.rmse_m,
        overlap=result.overlap,
        inliers=result.inliers,
        start=result.start,
        timings_ms=result.timings_ms,
        p_grave=result.p_grave,
        rivals=result.rivals,
        operator=_operator_fit(result),
        icp=_icp_fit(result),
        server_epoch=stamp.epoch,
        n=n,
    )


def _operator_fit(result: PairResult) -> OperatorFit | None:
    told = result.by_clicks
    if told is None:
        return None
    T_j_i = None if result.T_i_j is None else inverse(result.T_i_j)
    return OperatorFit(
        T_j_i_operator=inverse(told.T_i_j),
        T_j_i_refine=None if T_j_i is None else T_j_i @ told.T_i_j,
        model=told.model,
        correspondences=told.ids,
    )


def _icp_fit(result: PairResult) -> IcpFit | None:
    return None if result.icp is None else IcpFit(**asdict(result.icp))


def fleet_state(
    site: Site, settings: ServerSettings, stamp: Stamp, n: int, cells: CellCache | None = None
) -> FleetState:
    """Everything a late client needs. `cells`: of the states told before."""
    robots = tuple(
        _robot_state(site, robot, settings, stamp.now_s) for _, robot in sorted(site.robots.items())
    )
    return FleetState(
        server_epoch=stamp.epoch,
        n=n,
        stamp_ns=stamp.now_ns,
        anchor=site.anchor,
        gauge_revision=site.gauge_revision,
        up_assumed=site.gauge is None or not site.knows_up(site.gauge),
        robots=robots,
        pairs=pair_cells(site, stamp.now_s, {} if cells is None else cells),
        questions=questions(site, stamp.now_s),
        events=tuple(site.events),
        pinned=site.pinned(),
        alarms=monitor.standing(site),
        answered=site.feedback.answers,
        depth_m=None if site.solution is None else site.depth_m,
    )


def _robot_state(site: Site, robot: Robot, settings: ServerSettings, now_s: float) -> RobotState:
    """A robot now: its last pose ages, and one that is gone is no longer located."""
    why_not = why_not_located(site, robot, settings, now_s)
    pose = robot.published
    if pose is not None:
        kept = site.views.get(pose.view)
        age_s = pose.age_s if kept is None else max(0.0, now_s - kept.received_s)
        now = {"age_s": age_s, "located": not why_not, "why_not": why_not}
        if age_s > settings.fresh_s:
            counted_s = pose.age_s if pose.age_s > settings.fresh_s else 0.0
            unseen_s = max(age_s**2 - counted_s**2, 0.0) ** 0.5
            now["covariance"] = strayed(pose.T_fleet_robot, pose.covariance, unseen_s, site.depth_m)
        pose = pose.model_copy(update=now)
    return RobotState(
        robot=robot.name,
        alive=robot.alive,
        newest_view=robot.newest,
        views_kept=site.views.count(robot.name),
        pose=pose,
        why_not=why_not,
    )


def why_not(site: Site, name: str, settings: ServerSettings, now_s: float) -> WhyNot | str:
    """What operators are told of a robot, or why nothing is known of it."""
    robot = site.robots.get(name)
    if robot is None:
        return unknown(site, name)
    reason = why_not_located(site, robot, settings, now_s)
    told = tuple(alarm.text for alarm in monitor.standing(site) if alarm.robot == name)
    return WhyNot(robot=name, located=not reason, why_not=reason, alarms=told)


def unknown(site: Site, name: str) -> str:
    """That a robot is not known, and which are."""
    known = ", ".join(sorted(site.robots)) or "none"
    return f"no robot '{name[:32]}' is known; known are: {known}"
