"""Rigid motions for scoring, written here so that nothing is judged by its own code."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


def rigid(R: Floats, t: Floats) -> Floats:
    """(4, 4) pose from a (3, 3) rotation and a (3,) translation in metres."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T_a_b: Floats) -> Floats:
    """T_b_a."""
    R = T_a_b[:3, :3]
    return rigid(R.T, -R.T @ T_a_b[:3, 3])


def transform(T_a_b: Floats, p_b: Floats) -> Floats:
    """Points (N, 3) of frame b in frame a."""
    return p_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def nearest_rotation(M: Floats) -> Floats:
    """The rotation nearest to a (3, 3) matrix; recorded poses are not exactly orthonormal."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt


def se3_log(T: Floats) -> Floats:
    """(6,) twist, rotation (rad) then translation, exp(twist) = T; for angles below 180 degrees."""
    R, t = T[:3, :3], T[:3, 3]
    skew = (R - R.T) / 2.0
    axis_sin = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    angle = np.arctan2(np.linalg.norm(axis_sin), (np.trace(R) - 1.0) / 2.0)
    if angle < 1e-7:
        return np.concatenate((axis_sin, t))
    w = axis_sin * (angle / np.sin(angle))
    W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    half = angle / 2.0
    V_inv = np.eye(3) - W / 2.0 + (1.0 - half / np.tan(half)) / angle**2 * (W @ W)
    return np.concatenate((w, V_inv @ t))


def quat_wxyz(R: Floats) -> Floats:
    """(4,) unit quaternion w, x, y, z of a rotation, w >= 0 (Bar-Itzhack's eigenvector)."""
    m = R
    N = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    q = np.linalg.eigh(N)[1][:, -1]
    return q if q[0] >= 0 else -q


def align_points(p_a: Floats, p_b: Floats) -> Floats:
    """T_a_b that brings points (N, 3) of b nearest to those of a (Umeyama, without scale)."""
    centre_a, centre_b = p_a.mean(0), p_b.mean(0)
    U, _, Vt = np.linalg.svd((p_a - centre_a).T @ (p_b - centre_b))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return rigid(R, centre_a - R @ centre_b)
