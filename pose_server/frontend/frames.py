"""From views to keyframes, from cameras to bodies, from a component's root to the fleet's frame."""

import math
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose
from fleetpose.pose_server.geometry.se3 import (
    adjoint,
    compose_covariance,
    exp_so3,
    inverse,
    invert_covariance,
    make_pose,
    position_covariance,
)
from fleetpose.pose_server.registration.pair import PAIR
from fleetpose.pose_server.registration.verdict.evaluate import PairResult

Floats = npt.NDArray[np.floating]
_STRAY_RAD_S, _STRAY_SHARE_S = 0.02, 0.02  # of a robot unseen: turn, and way as a share of depth


def on_keyframes(
    result: PairResult, i: KeyframeRelativePose, j: KeyframeRelativePose
) -> tuple[Floats, Floats]:
    """An alignment of two views as one of the keyframes they hang on: T_keyframe_i_keyframe_j and
    its covariance.
    """
    assert result.T_i_j is not None and result.covariance is not None
    T, C = (
        i.T_keyframe_view @ result.T_i_j,
        compose_covariance(i.T_keyframe_view, i.covariance, result.covariance),
    )
    back = inverse(j.T_keyframe_view)
    return T @ back, compose_covariance(T, C, invert_covariance(j.T_keyframe_view, j.covariance))


def body_pose(T_fleet_root: Floats, T_root_camera: Floats, T_robot_camera: Floats) -> Floats:
    """T_fleet_robot."""
    return T_fleet_root @ T_root_camera @ inverse(T_robot_camera)


def in_fleet(T_fleet_root: Floats, covariance: Floats) -> Floats:
    """A covariance of left perturbations in the root's frame, in the fleet's."""
    A = adjoint(T_fleet_root)
    return A @ covariance @ A.T


def strayed(T: Floats, covariance: Floats, age_s: float, depth_m: float) -> Floats:
    """A covariance (6, 6) of a pose of so long ago as one of now: nobody knows where its robot went
    since, at a pace that a robot is likely to have in a scene of that depth.
    """
    sigmas = age_s * np.repeat((_STRAY_RAD_S, _STRAY_SHARE_S * depth_m), 3)
    A = adjoint(T)
    return covariance + A @ np.diag(sigmas**2) @ A.T


def position_sigma(T: Floats, covariance: Floats) -> float:
    """Sigma of the weakest position direction, metres."""
    return float(np.sqrt(max(np.linalg.eigvalsh(position_covariance(T, covariance))[-1], 0.0)))


def grave_by_noise(sigma: float) -> float:
    """Probability that a position known to sigma, share of the median depth, is gravely off though
    all that it rests on is right.
    """
    return math.erfc(PAIR.grave_position / (math.sqrt(2.0) * max(sigma, 1e-9)))


def sigma_by_grave(p_grave: float) -> float:
    """The sigma, share of the median depth, at which `grave_by_noise` is so much."""
    return PAIR.grave_position / NormalDist().inv_cdf(1.0 - p_grave / 2)


def upright(up: Floats) -> Floats:
    """The smallest turn that brings a direction of the body frame to its z axis."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine, cosine = float(np.linalg.norm(axis)), float(up[2])
    angle = np.arctan2(sine, cosine)
    return make_pose(exp_so3(axis / sine * angle) if sine > 1e-9 else np.eye(3), np.zeros(3))
