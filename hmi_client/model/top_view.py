"""A pose seen from above: position on the ground, heading and uncertainty.

Metres, radians, fleet frame (z up).
"""

import math

import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.model.records import natural
from fleetpose.protocol.messages import RobotPose

Floats = npt.NDArray[np.float64]


def position(pose: RobotPose) -> Floats:
    """(3,) position of the robot in the fleet frame."""
    return pose.T_fleet_robot[:3, 3]


def heading_rad(pose: RobotPose) -> float:
    """Direction of the robot's x axis on the ground, counter-clockwise from the fleet's x axis."""
    return math.atan2(pose.T_fleet_robot[1, 0], pose.T_fleet_robot[0, 0])


def position_covariance(pose: RobotPose) -> Floats:
    """(3, 3) covariance of the position: a left perturbation (w, v) moves p by w x p + v."""
    x, y, z = position(pose)
    J = np.hstack((np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]), np.eye(3)))
    return J @ pose.covariance @ J.T


def position_sigma_m(pose: RobotPose) -> float:
    """Sigma of the position along its weakest direction."""
    return math.sqrt(max(float(np.linalg.eigvalsh(position_covariance(pose))[-1]), 0.0))


def ground_ellipse(pose: RobotPose, sigmas: float = 2.0, points: int = 48) -> Floats:
    """(points, 2) outline of the uncertainty of the position on the ground."""
    values, axes = np.linalg.eigh(position_covariance(pose)[:2, :2])
    angles = np.linspace(0.0, 2.0 * math.pi, points, endpoint=False)
    circle = np.stack((np.cos(angles), np.sin(angles)))
    radii = sigmas * np.sqrt(np.maximum(values, 0.0))
    return position(pose)[:2] + (axes @ (radii[:, None] * circle)).T


def layout(poses: dict[str, RobotPose], anchor: str | None) -> dict[str, Floats]:
    """Where to draw each robot, (2,) metres.

    Poses compare only within a component. That of the anchor stands where it is; the others are put
    below it, one beneath the other, with their own origins.
    """
    parts: dict[str, list[str]] = {}
    for robot in sorted(poses, key=natural):
        parts.setdefault(poses[robot].component, []).append(robot)
    places: dict[str, Floats] = {}
    bottom = None
    for component in sorted(parts, key=lambda c: (c != anchor, natural(c))):
        here = np.array([position(poses[robot])[:2] for robot in parts[component]])
        if bottom is not None:
            gap = 0.4 * max(float(np.abs(np.array(list(places.values()))).max()), 1.0)
            here = here - (here.mean(0)[0], here[:, 1].max() - bottom + gap)
        places.update(zip(parts[component], here, strict=True))
        bottom = min(float(here[:, 1].min()), 0.0 if bottom is None else bottom)
    return places
