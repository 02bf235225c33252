"""Rotations as the formats write them; (w, x, y, z) here, and each format has its own order."""

import numpy as np

from fleetpose.formats.arrays import Floats


def pose_of(quat_wxyz: Floats, t: Floats) -> Floats:
    """(4, 4) the pose of a rotation, (4,) of any length, and a translation; a quaternion of zeros,
    which is no rotation, becomes a matrix of zeros, which is none either.
    """
    w, v = quat_wxyz[0], quat_wxyz[1:]
    turn = (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * np.cross(np.eye(3), v)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn / (quat_wxyz @ quat_wxyz or 1.0), t
    return T


def quat_wxyz(R: Floats) -> Floats:
    """(4,) unit quaternion of a rotation matrix, w >= 0: of the four columns of its outer product
    the longest (Shepperd 1978), which never divides by little.
    """
    (a, b, c), (d, e, f), (g, h, i) = R
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    q = products[np.argmax(np.diag(products))]
    q = q / np.linalg.norm(q)
    return -q if q[0] < 0 else q


def is_rotation(R: Floats, within: float = 1e-3) -> bool:
    """Whether a matrix (3, 3) turns without mirroring or scaling."""
    return bool(np.allclose(R @ R.T, np.eye(3), atol=within) and np.linalg.det(R) > 0)
