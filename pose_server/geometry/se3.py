"""Rigid motions as (4, 4) float64 arrays; increments are (rotation, translation) and act from the
left.
"""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]


def hat(vectors: Floats) -> Floats:
    """Cross-product matrices (..., 3, 3) of vectors (..., 3)."""
    v = np.asarray(vectors, np.float64)
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp_so3(w: Floats) -> Floats:
    """Rotation (3, 3) by the vector w, radians (Rodrigues)."""
    angle = float(np.linalg.norm(w))
    if angle < 1e-12:
        return np.eye(3) + hat(w)
    k = hat(w / angle)
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def log_so3(R: Floats) -> Floats:
    """Rotation vector (3,) of a rotation, radians, also near pi."""
    q = quat_wxyz(R)
    sine = np.linalg.norm(q[1:])
    if sine < 1e-12:
        return 2 * q[1:] * np.sign(q[0])
    return 2 * np.arctan2(sine, q[0]) * q[1:] / sine


def quat_wxyz(R: Floats) -> Floats:
    """Unit quaternion (w, x, y, z), w >= 0, of a rotation: the largest eigenvector (Bar-Itzhack
    2000).
    """
    K = np.zeros((4, 4))
    K[0, 0] = np.trace(R)
    K[0, 1:] = K[1:, 0] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]
    K[1:, 1:] = R + R.T - np.trace(R) * np.eye(3)
    q = np.linalg.eigh(K)[1][:, -1]
    return q if q[0] >= 0 else -q


def make_pose(R: Floats, t: Floats) -> Floats:
    """(4, 4) pose of a rotation and a translation."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: Floats) -> Floats:
    """Inverse of a rigid motion."""
    return make_pose(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def transform(T: Floats, points: Floats) -> Floats:
    """Points (N, 3) of frame b in frame a, for T_a_b."""
    return points @ T[:3, :3].T + T[:3, 3]


def retract(T: Floats, increment: Floats) -> Floats:
    """`exp(xi) T` to first order in the translation: rotate about the origin of the left frame,
    then shift.
    """
    R = exp_so3(increment[:3])
    return make_pose(R @ T[:3, :3], R @ T[:3, 3] + increment[3:])


def weighted_mean(T_a: Floats, information_a: Floats, T_b: Floats, information_b: Floats) -> Floats:
    """The pose between two nearby ones, each pulling as hard as its information (6, 6) of left
    perturbations says; that of the first where neither knows.
    """
    way = log_so3(T_b[:3, :3] @ T_a[:3, :3].T)
    apart = np.concatenate((way, T_b[:3, 3] - exp_so3(way) @ T_a[:3, 3]))
    both = information_a + information_b
    return retract(T_a, np.linalg.lstsq(both, information_b @ apart)[0])


def adjoint(T: Floats) -> Floats:
    """(6, 6): `T exp(xi) = exp(Ad xi) T`, rotation first."""
    A = np.zeros((6, 6))
    A[:3, :3] = A[3:, 3:] = T[:3, :3]
    A[3:, :3] = hat(T[:3, 3]) @ T[:3, :3]
    return A


def nearest_rotation(M: Floats) -> Floats:
    """The rotation nearest to a (3, 3) matrix in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(M)
    return U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt


def rotation_angle(R: Floats) -> float:
    """Angle of a rotation, radians, by the chord: exact also for tiny angles."""
    chord = np.linalg.norm(R - np.eye(3)) / np.sqrt(8.0)
    return float(2 * np.arcsin(min(1.0, chord)))


def position_covariance(T: Floats, covariance: Floats) -> Floats:
    """(3, 3) covariance of the translation of T under left perturbations with the given (6, 6)
    covariance.
    """
    J = np.concatenate((-hat(T[:3, 3]), np.eye(3)), axis=1)
    return J @ covariance @ J.T


def compose_covariance(T_a_b: Floats, covariance_ab: Floats, covariance_bc: Floats) -> Floats:
    """Covariance of T_a_b @ T_b_c for independent errors, left perturbations."""
    A = adjoint(T_a_b)
    return covariance_ab + A @ covariance_bc @ A.T


def invert_covariance(T_a_b: Floats, covariance: Floats) -> Floats:
    """Covariance of T_b_a from that of T_a_b, left perturbations."""
    A = adjoint(inverse(T_a_b))
    return A @ covariance @ A.T
