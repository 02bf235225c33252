"""What counts as right and as gravely wrong: pure functions from poses to numbers."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats, align_points, inverse, se3_log, transform

if TYPE_CHECKING:
    from scipy.spatial import KDTree

CHI2_6_95 = 12.5916  # 95 % of a chi-square with 6 degrees of freedom lie below
OVERLAP_TOLERANCE_M = 0.05
OVERLAP_TOLERANCE_PER_Z = 0.02


RGBD_REFERENCE_SIGMA_M = 0.05
"""Of the poses that come with RGB-D recordings, in each direction: they were tracked by the depth
camera itself, and are 4 to 7 cm off where they can be checked."""


@dataclass(frozen=True)
class Limits:
    """Thresholds of one recording: metres and degrees; and what its own truth is worth."""

    ok_m: float
    ok_deg: float
    grave_m: float
    grave_deg: float
    reference_sigma_m: float = 0.0

    @classmethod
    def of(cls, median_depth_m: float, rgbd: bool) -> "Limits":
        """ok: 2 % of the median depth and 2 deg; grave: 5 % or 5 deg.

        For RGB-D, whose reference is no better, grave is 0.3 m or 15 deg.
        """
        grave_m, grave_deg = (0.3, 15.0) if rgbd else (0.05 * median_depth_m, 5.0)
        reference_sigma_m = RGBD_REFERENCE_SIGMA_M if rgbd else 0.0
        return cls(0.02 * median_depth_m, 2.0, grave_m, grave_deg, reference_sigma_m)

    def ok(self, position_error_m: float, rotation_error_deg: float) -> bool:
        return position_error_m < self.ok_m and rotation_error_deg < self.ok_deg

    def grave(self, position_error_m: float, rotation_error_deg: float) -> bool:
        return position_error_m > self.grave_m or rotation_error_deg > self.grave_deg


def position_error_m(T_true: Floats, T_estimated: Floats) -> float:
    """Distance of the two translations."""
    return float(np.linalg.norm(T_estimated[:3, 3] - T_true[:3, 3]))


def rotation_error_deg(T_true: Floats, T_estimated: Floats) -> float:
    """Angle between two rotations by their chord, |R_a - R_b| = 2 sqrt(2) sin(angle / 2).

    Unlike the arc cosine of the trace it is exact for tiny angles.
    """
    chord = np.linalg.norm(T_true[:3, :3] - T_estimated[:3, :3])
    return float(np.degrees(2.0 * np.arcsin(min(chord / (2.0 * np.sqrt(2.0)), 1.0))))


def pose_errors(T_true: Floats, T_estimated: Floats) -> tuple[float, float]:
    """Metres and degrees."""
    return position_error_m(T_true, T_estimated), rotation_error_deg(T_true, T_estimated)


def optical_angle_deg(T_world_i: Floats, T_world_j: Floats) -> float:
    """Angle between the optical axes (z) of two cameras."""
    z_i, z_j = T_world_i[:3, 2], T_world_j[:3, 2]
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(z_i, z_j)), z_i @ z_j)))


@dataclass(frozen=True)
class OverlapCloud:
    """A cloud made ready to ask for its overlap with others; thinned out far below the tolerance.

    Attributes:
        asked: (N, 3) points that look for company in other clouds, camera frame, metres.
        tree: of the points that give company.
    """

    asked: Floats
    tree: "KDTree"

    @classmethod
    def of(cls, points: Floats) -> "OverlapCloud":
        """From the (N, 3) points of a view in row order."""
        from scipy.spatial import KDTree

        step = max(len(points) // 60_000, 1)
        return cls(points[:: 4 * step], KDTree(points[::step]))


def overlap(i: OverlapCloud, j: OverlapCloud, T_i_j: Floats) -> float:
    """Mean over both directions of the share of points that come near the other's points.

    Near is 5 cm + 2 % of the point's own z. 0 where one of them has no points.
    """

    def share(source: OverlapCloud, target: OverlapCloud, T_target_source: Floats) -> float:
        moved = transform(T_target_source, source.asked)
        tolerance = OVERLAP_TOLERANCE_M + OVERLAP_TOLERANCE_PER_Z * source.asked[:, 2]
        distance, _ = target.tree.query(moved, distance_upper_bound=float(tolerance.max()))
        return float(np.mean(distance <= tolerance))

    if not len(i.asked) or not len(j.asked):
        return 0.0
    return (share(j, i, T_i_j) + share(i, j, inverse(T_i_j))) / 2.0


def nees(T_true: Floats, T_estimated: Floats, covariance: Floats) -> float:
    """Squared error in units of its own covariance; its mean is 6 if the covariance is right.

    The error is the left perturbation exp(xi) T_estimated = T_true, rotation first. A singular
    covariance gives nan.
    """
    xi = se3_log(T_true @ inverse(T_estimated))
    try:
        return float(xi @ np.linalg.solve(covariance, xi))
    except np.linalg.LinAlgError:
        return float("nan")


def with_reference(covariance: Floats, sigma_m: float) -> Floats:
    """A pose's (6, 6) covariance as seen from a truth whose position has a sigma of its own."""
    return covariance + np.diag([0.0] * 3 + [sigma_m**2] * 3)


def trimmed_nees_per_dof(values: Sequence[float]) -> float | None:
    """Mean of the smallest 95 % of NEES values, 1 if the covariances are right; none for none.

    Without trimming, one gross error hides how the rest is. What the trimming takes from right
    values is given back: a chi-square of k degrees of freedom has below q the mean
    k P(chi2_{k+2} < q) / P(chi2_k < q).
    """
    if not len(values):
        return None
    from scipy.stats import chi2

    kept = np.sort(values)[: max(int(np.ceil(0.95 * len(values))), 1)]
    if not np.isfinite(kept).all():
        return None
    return float(kept.mean() / (6 * chi2.cdf(CHI2_6_95, 8) / 0.95))


def aligned_errors_m(true_positions: Floats, positions: Floats) -> Floats:
    """(N,) distances after the rigid motion that fits all (N, 3) positions best."""
    T_true_estimated = align_points(true_positions, positions)
    return np.linalg.norm(transform(T_true_estimated, positions) - true_positions, axis=1)


def weakest_sigma_m(covariance: Floats | None) -> float:
    """Sigma of the weakest position direction of a (6, 6) covariance; inf without one."""
    if covariance is None:
        return float("inf")
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance[3:, 3:])[-1], 0.0)))


def precision_recall(
    certainty: Sequence[tuple[float, ...]], correct: Sequence[bool]
) -> tuple[Floats, Floats]:
    """Precision and recall when answers are accepted from the surest down.

    Args:
        certainty: one sortable key per answer, larger is surer; equal keys are accepted together.
        correct: whether each answer is right.

    Returns:
        Recall (of all right answers) and precision, one entry per distinct key.
    """
    order = sorted(range(len(certainty)), key=lambda k: certainty[k], reverse=True)
    right = np.cumsum([bool(correct[k]) for k in order])
    keys = [certainty[k] for k in order]
    last = [n for n in range(len(keys)) if n + 1 == len(keys) or keys[n + 1] != keys[n]]
    total = max(int(right[-1]) if len(right) else 0, 1)
    return right[last] / total, right[last] / (np.asarray(last) + 1.0)


def share(flags: Iterable[bool]) -> float | None:
    """Share of true flags; none for no flags at all."""
    flags = list(flags)
    return sum(flags) / len(flags) if flags else None


def percentile(values: Sequence[float] | npt.NDArray[np.float64], q: float) -> float | None:
    """A percentile of finite numbers; none for none."""
    return float(np.percentile(values, q)) if len(values) else None
