"""A relative pose from the operator's clicks alone, when three or more of them determine it."""

from dataclasses import dataclass
from itertools import combinations, islice

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from pose_server.geometry.dlt import rigid
from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.se3 import hat, retract, transform

Floats = npt.NDArray[np.floating]

_MAX_TRIPLES = 120
_MAX_ROTATION_SIGMA_RAD = 0.35  # beyond it a linearised covariance means nothing
_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class PointPairs:
    """Points in two frames: p_a, p_b (N, 3) metres, and their covariances C_a, C_b (N, 3, 3)."""

    p_a: Floats
    p_b: Floats
    C_a: Floats
    C_b: Floats

    def __getitem__(self, index: npt.NDArray[np.int64] | npt.NDArray[np.bool_]) -> "PointPairs":
        return PointPairs(self.p_a[index], self.p_b[index], self.C_a[index], self.C_b[index])

    def distance2(self, T_a_b: Floats) -> Floats:
        """(N,) squared Mahalanobis distances of p_a and T_a_b p_b, 3 dof."""
        e = self.p_a - transform(T_a_b, self.p_b)
        return np.einsum("ni,nij,nj->n", e, np.linalg.inv(self._joint(T_a_b)), e)

    def refined(self, T_a_b: Floats) -> tuple[Floats, Floats]:
        """Anisotropic Gauss-Newton from a start: T_a_b (4, 4) and its covariance (6, 6)."""
        for _ in range(_ITERATIONS):
            H, g = self._normal_equations(T_a_b)
            T_a_b = retract(T_a_b, np.linalg.solve(H, g).astype(np.float64))
        H, _ = self._normal_equations(T_a_b)
        return T_a_b, np.linalg.inv(H).astype(np.float64)

    def _normal_equations(self, T_a_b: Floats) -> tuple[Floats, Floats]:
        q = transform(T_a_b, self.p_b)
        J = np.concatenate((-hat(q), np.broadcast_to(np.eye(3), (len(q), 3, 3))), axis=2)
        W = np.linalg.inv(self._joint(T_a_b))
        H = np.einsum("nki,nkl,nlj->ij", J, W, J)
        return H, np.einsum("nki,nkl,nl->i", J, W, self.p_a - q)

    def _joint(self, T_a_b: Floats) -> Floats:
        R = T_a_b[:3, :3]
        return self.C_a + R @ self.C_b @ R.T


def pose_from_clicks(pairs: PointPairs, inlier_probability: float) -> tuple[Floats, Floats]:
    """T_a_b (4, 4) and its covariance (6, 6) from three or more point pairs, of which most agree.

    Raises:
        DegenerateGeometryError: fewer than three, on a line, contradictory, or too weak to give an
            orientation.
    """
    limit = float(chi2.ppf(inlier_probability, 3))
    n = len(pairs.p_a)
    best, best_count = None, 2
    for triple in islice(combinations(range(n), 3), _MAX_TRIPLES):
        index = np.array(triple)
        try:
            T = rigid(pairs.p_a[index], pairs.p_b[index])
        except DegenerateGeometryError:
            continue
        T, _ = _refined_or(T, pairs[index])
        agrees = pairs.distance2(T) < limit
        if agrees.sum() > best_count:
            best, best_count = (T, agrees), int(agrees.sum())
        if best_count == n:
            break
    if best is None or 2 * best_count <= n:
        raise DegenerateGeometryError(
            f"of {n} clicks no three that span a triangle agree with most of the rest"
        )
    T, agrees = best
    T, covariance = _refined_or(T, pairs[agrees])
    sigma = float(np.sqrt(max(np.linalg.eigvalsh(covariance[:3, :3])[-1], 0.0)))
    if not sigma < _MAX_ROTATION_SIGMA_RAD:
        raise DegenerateGeometryError(
            f"{best_count} clicks leave an orientation error of {np.degrees(sigma):.0f} deg, "
            f"need below {np.degrees(_MAX_ROTATION_SIGMA_RAD):.0f} deg"
        )
    return T, covariance


def _refined_or(T_start: Floats, pairs: PointPairs) -> tuple[Floats, Floats]:
    """The refined pose, or the start with infinite covariance where the clicks fix none."""
    try:
        T, covariance = pairs.refined(T_start)
    except np.linalg.LinAlgError:
        return T_start, np.full((6, 6), np.inf)
    if not (np.isfinite(T).all() and np.isfinite(covariance).all()):
        return T_start, np.diag(np.full(6, np.inf))
    return T, covariance
