"""Points seen in two frames, each with its covariance, and the pose that fits them best.

A stereo point is long along its ray and thin across it. Two such points agree if their difference
is small in the covariance of both, S = C_a + R C_b R^T (squared Mahalanobis distance, chi-square
with three degrees of freedom); the best pose minimises the sum of these distances.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.gravity import Gravity
from fleetpose.pose_server.geometry.se3 import hat, retract, transform

Floats = npt.NDArray[np.floating]

_ITERATIONS = 10  # numerical: of one fit
_SETTLED_SIGMAS = 1e-3  # numerical: a step this small against the pose's sigma ends it
_LONGEST_TURN_RAD = 0.5  # numerical: of one step, the linearisation holds no further
_RANK = 1e-12  # numerical: of the normal matrix, in units of the points' distance


@dataclass(frozen=True, eq=False)
class PointPairs:
    """Points in two frames: p_a, p_b (N, 3) metres, and their covariances C_a, C_b (N, 3, 3)."""

    p_a: Floats
    p_b: Floats
    C_a: Floats
    C_b: Floats

    def __len__(self) -> int:
        return len(self.p_a)

    def __getitem__(self, index: npt.NDArray[np.int64] | npt.NDArray[np.bool_]) -> "PointPairs":
        return PointPairs(self.p_a[index], self.p_b[index], self.C_a[index], self.C_b[index])

    def fingerprint(self) -> int:
        """A number that changes with any of the points."""
        return hash((self.p_a.tobytes(), self.p_b.tobytes()))

    def distance2(self, T_a_b: Floats, covariance: Floats | None = None) -> Floats:
        """(N,) squared Mahalanobis distances of p_a and T_a_b p_b, 3 dof.

        With the (6, 6) covariance of a pose that was found without these points, what the pose
        leaves open is no fault of theirs.
        """
        e = self.p_a - transform(T_a_b, self.p_b)
        S = self._joint(T_a_b)
        if covariance is not None:
            J = self._jacobian(T_a_b)
            S = S + J @ covariance @ J.transpose(0, 2, 1)
        return np.einsum("ni,ni->n", e, np.linalg.solve(S, e[:, :, None])[:, :, 0])

    def refined(self, T_a_b: Floats, gravity: Gravity | None = None) -> tuple[Floats, Floats]:
        """Gauss-Newton from a start: T_a_b (4, 4) and its covariance (6, 6), left, rotation first.

        Raises:
            DegenerateGeometryError: the points (and gravity) do not determine a pose.
        """
        for _ in range(_ITERATIONS):
            H, g = self.normal_equations(T_a_b, gravity)
            step = self._inverse(H) @ g
            turn = float(np.linalg.norm(step[:3]))
            T_a_b = retract(T_a_b, step * min(1.0, _LONGEST_TURN_RAD / max(turn, 1e-12)))
            if float(step @ g) < _SETTLED_SIGMAS**2:
                break
        H, _ = self.normal_equations(T_a_b, gravity)
        return T_a_b, self._inverse(H)

    def normal_equations(
        self, T_a_b: Floats, gravity: Gravity | None = None, weights: Floats | None = None
    ) -> tuple[Floats, Floats]:
        """H (6, 6) and g (6,) of Gauss-Newton at a pose: its left increment is H^-1 g. The pairs
        may have weights (N,).
        """
        J = self._jacobian(T_a_b)
        WJ = np.linalg.solve(self._joint(T_a_b), J)
        if weights is not None:
            WJ *= weights[:, None, None]
        e = self.p_a - transform(T_a_b, self.p_b)
        H, g = np.einsum("nki,nkj->ij", J, WJ), np.einsum("nki,nk->i", WJ, e)
        if gravity is not None:
            up = T_a_b[:3, :3] @ gravity.up_b
            J_up = -hat(up) / gravity.sigma_rad
            H[:3, :3] += J_up.T @ J_up
            g[:3] += J_up.T @ (gravity.up_a - up) / gravity.sigma_rad
        return H, g

    def _jacobian(self, T_a_b: Floats) -> Floats:
        """(N, 3, 6) of T_a_b p_b by the left increment."""
        q = transform(T_a_b, self.p_b)
        eye = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        return np.concatenate((-hat(q), eye), axis=2)

    def _joint(self, T_a_b: Floats) -> Floats:
        R = T_a_b[:3, :3]
        return self.C_a + R @ self.C_b @ R.T

    def _inverse(self, H: Floats) -> Floats:
        """Inverse of a normal matrix, about the points' centre and in their size, where it is as
        well conditioned as the points allow.
        """
        centre = self.p_a.mean(axis=0)
        size = max(float(np.sqrt(((self.p_a - centre) ** 2).sum(axis=1).mean())), 1e-300)
        # an increment about the origin, from one about the centre and in the points' size
        B = np.eye(6)
        B[3:, :3] = hat(centre)
        B[3:, 3:] *= size
        values, vectors = np.linalg.eigh(B.T @ H @ B)
        if not np.isfinite(values).all() or values[0] <= _RANK * values[-1]:
            raise DegenerateGeometryError(
                f"{len(self.p_a)} correspondences do not determine a pose: smallest eigenvalue "
                f"{values[0]:.3g} of {values[-1]:.3g}"
            )
        half = B @ (vectors / np.sqrt(values))
        return half @ half.T
