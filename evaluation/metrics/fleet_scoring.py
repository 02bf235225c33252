"""From the poses that a fleet published to the numbers of `pose-eval fleet`: pure functions."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.metrics.scoring import (
    CHI2_6_95,
    Limits,
    aligned_errors_m,
    nees,
    percentile,
    pose_errors,
    share,
    with_reference,
)
from fleetpose.evaluation.metrics.trajectory_error import Positions, trajectory_error

LOCATED_SHARE = 0.9
"""A robot counts as located if it is so in this share of the samples."""


@dataclass(frozen=True)
class PoseNow:
    """A robot's newest published pose, and the truth at that pose's moment."""

    T_fleet_robot: Floats
    covariance: Floats
    component: str
    located: bool
    T_world_robot: Floats
    verified: bool = True


@dataclass(frozen=True)
class SampleRow:
    """One robot in one sample; errors are none where its pose does not compare to the anchor's."""

    time_s: float
    robot: str
    is_anchor: bool
    located: bool
    T_fleet_robot: Floats | None = None
    covariance: Floats | None = None
    T_world_robot: Floats | None = None
    position_error_m: float | None = None
    rotation_error_deg: float | None = None
    nees: float | None = None
    verified: bool = False


def score_sample(
    time_s: float,
    robots: Sequence[str],
    poses: Mapping[str, PoseNow],
    anchor: str | None,
    reference_sigma_m: float = 0.0,
) -> list[SampleRow]:
    """Compares the newest poses with the truth, the anchor as gauge.

    The anchor's own true pose places the fleet frame in the world; every other robot of its
    component is off by what remains. The truth's own noise is added to what covariances allow.
    """
    gauge = poses.get(anchor) if anchor else None
    rows = []
    for robot in robots:
        pose = poses.get(robot)
        row = SampleRow(time_s, robot, is_anchor=robot == anchor, located=False)
        if pose is not None:
            row = replace(
                row,
                T_fleet_robot=pose.T_fleet_robot,
                covariance=pose.covariance,
                T_world_robot=pose.T_world_robot,
                verified=pose.verified,
            )
            if gauge is not None and pose.component == gauge.component:
                row = _scored(row, pose, gauge, reference_sigma_m)
        rows.append(row)
    return rows


def _scored(row: SampleRow, pose: PoseNow, gauge: PoseNow, reference_sigma_m: float) -> SampleRow:
    allowed = with_reference(pose.covariance, reference_sigma_m)
    T_true = gauge.T_fleet_robot @ inverse(gauge.T_world_robot) @ pose.T_world_robot
    error_m, error_deg = pose_errors(T_true, pose.T_fleet_robot)
    return replace(
        row,
        located=pose.located,
        position_error_m=error_m,
        rotation_error_deg=error_deg,
        nees=None if row.is_anchor else nees(T_true, pose.T_fleet_robot, allowed),
    )


def summarize_poses(
    rows: Sequence[SampleRow], limits: Limits, together: Collection[str] = ()
) -> dict[str, Any]:
    """Located robots, errors and calibration over all samples.

    The anchor has no error by definition: it counts as located, but not in the mean of the errors.

    Args:
        rows: of all samples.
        limits: what is grave.
        together: the robots whose true views show something that another's shows as well.
    """
    by_robot: dict[str, list[SampleRow]] = {}
    for row in rows:
        by_robot.setdefault(row.robot, []).append(row)
    located = {
        robot: [row for row in own if row.located]
        for robot, own in by_robot.items()
        if (share(row.located for row in own) or 0.0) >= LOCATED_SHARE
    }
    ate = trajectory_error(_trajectories(located))
    errors = [own for own in (_errors(kept) for kept in located.values()) if own]
    surprises = [
        row.nees for row in rows if row.located and row.nees is not None and np.isfinite(row.nees)
    ]
    return {
        "robots": len(by_robot),
        "located": len(located),
        "position_error_mean_m": _mean([_mean(own) for own in errors]),
        "position_error_max_m": max((max(own) for own in errors), default=None),
        "position_error_aligned_m": _aligned(rows, set(located)),
        "ate_joint_m": ate.joint_m,
        "ate_robots_mean_m": ate.robots_mean_m,
        "grave_located": sum(is_grave(row, limits) for row in rows),
        "grave_acted": sum(is_grave(row, limits) for row in rows if row.verified),
        "robots_seen_together": len(together),
        "located_right": share(
            row.located and not is_grave(row, limits) for row in rows if row.robot in together
        ),
        "samples": len({row.time_s for row in rows}),
        "nees_per_dof": _mean([value / 6.0 for value in surprises]),
        "nees_per_dof_median": percentile(np.asarray(surprises) / 6.0, 50),
        "coverage_95": share(value <= CHI2_6_95 for value in surprises),
        "reference_sigma_m": limits.reference_sigma_m,
    }


def is_grave(row: SampleRow, limits: Limits) -> bool:
    """Whether a robot is located and gravely off."""
    if not row.located or row.position_error_m is None or row.rotation_error_deg is None:
        return False
    return limits.grave(row.position_error_m, row.rotation_error_deg)


def _aligned(rows: Sequence[SampleRow], located: set[str]) -> float | None:
    """Mean position error after one rigid fit per sample of all located robots, anchor included."""
    means = []
    for time_s in sorted({row.time_s for row in rows}):
        now = [row for row in rows if row.time_s == time_s and row.located and row.robot in located]
        if len(now) >= 2:
            true = positions(row.T_world_robot for row in now)
            found = positions(row.T_fleet_robot for row in now)
            means.append(float(aligned_errors_m(true, found).mean()))
    return _mean(means)


def _trajectories(located: Mapping[str, Sequence[SampleRow]]) -> dict[str, Positions]:
    """True and published positions of each robot, over all samples in which it was located."""
    return {
        robot: (positions(r.T_world_robot for r in own), positions(r.T_fleet_robot for r in own))
        for robot, own in located.items()
        if own
    }


def positions(poses: Iterable[Floats | None]) -> Floats:
    """(N, 3) translations of poses."""
    return np.array([T[:3, 3] for T in poses if T is not None])


def _errors(rows: Sequence[SampleRow]) -> list[float]:
    return [r.position_error_m for r in rows if r.position_error_m is not None and not r.is_anchor]


def _mean(values: Sequence[float | None]) -> float | None:
    return float(np.mean([v for v in values if v is not None])) if values else None
