"""The operator's starts: poses from the correspondences alone, with their uncertainty.

Direct Linear Transformation gives a first pose H* of the largest model that the points determine;
refined with the points' covariances it is a second one. Both compete: depths that are worse than
stated bend the one, a wide set of points the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry import dlt
from fleetpose.pose_server.geometry.consensus import OUTLIER_CHI2, Consensus, consistent_sets
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.features.refine import NoiseScale, Refinement, refine
from fleetpose.pose_server.geometry.gravity import Gravity, pose_by_gravity
from fleetpose.pose_server.geometry.lift import LIFT
from fleetpose.pose_server.geometry.noise import covariances
from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import position_covariance
from fleetpose.pose_server.geometry.spread import check_points, dimension
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.hearing import ByClicks
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]

OPERATOR, LINEAR = "operator", "dlt"  # kinds of starts
BY_CLICKS = frozenset((OPERATOR, LINEAR))
FULL_POSE = 3  # derived: correspondences that determine a pose


@dataclass(frozen=True)
class OperatorStartsSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    most_starts: int = 5  # each costs a refinement, and somebody waits
    translation_sigma: float = 0.03  # of a start whose rotation comes from elsewhere, at least
    unturned_sigma: float = 0.1  # of one whose rotation nobody knows


OPERATOR_STARTS = in_use("operator_starts", OperatorStartsSettings())


@dataclass(frozen=True)
class Clicks:
    """Correspondences between two views: (N, 2) pixels, (N,) depths along the optical axis and
    their sigmas, metres; and where they are the book's, their ids and revisions.
    """

    uv_i: Floats
    uv_j: Floats
    z_i: Floats
    z_j: Floats
    sigma_i: Floats
    sigma_j: Floats
    ids: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True, eq=False)
class OperatorStart:
    """Starts from clicks.

    Attributes:
        start: the refined pose, and how far it may be off.
        linear: (4, 4) T_i_j by DLT, the rigid motion nearest to the model: the paper's H*,
            inverted.
        covariance: (6, 6), only where the clicks determine a full pose.
        inliers: (N,) which clicks the pose grew from; the others contradict it.
        model: the largest model that the inliers determine, or `upright` by two and gravity.
        note: empty, or why it is not a larger one, or how the clicks contradict each other.
        pairs: the clicked points.
        alone: whether the clicks alone may stand for the pose where features say nothing.
    """

    start: Start
    linear: Floats
    covariance: Floats | None
    inliers: npt.NDArray[np.bool_]
    model: str
    pairs: PointPairs
    note: str = ""
    alone: bool = False

    @property
    def starts(self) -> tuple[Start, ...]:
        """Both poses, one where they are the same."""
        if self.linear is self.start.T_i_j:
            return (self.start,)
        return self.start, Start(LINEAR, self.linear, self.start.sigma)

    def suits(self, T_i_j: Floats) -> bool:
        """Whether a pose found otherwise explains all clicks that agree with each other."""
        return bool((self.pairs[self.inliers].distance2(T_i_j) < OUTLIER_CHI2).all())


def operator_starts(
    i: PreparedView,
    j: PreparedView,
    clicks: Clicks,
    others: Sequence[Start],
    gravity: Gravity | None = None,
) -> list[OperatorStart]:
    """`starts_from_clicks`, none where the clicks determine none."""
    try:
        return starts_from_clicks(i, j, clicks, others, gravity)
    except DegenerateGeometryError:
        return []


def starts_from_clicks(
    i: PreparedView,
    j: PreparedView,
    clicks: Clicks,
    others: Sequence[Start],
    gravity: Gravity | None = None,
) -> list[OperatorStart]:
    """The poses on which clicks agree, refined anisotropically: one where most of them agree, else
    one for every set of them that does, the largest first.

    Three clicks that span a triangle give a full pose; so do two if gravity is known in both views.
    Fewer, or clicks on one line, give a translation only: the rotation comes from the best other
    start, else from gravity, or there is none, as in the paper.

    Raises:
        DegenerateGeometryError: they determine nothing, or are mirrored or in other units; the text
            says so.
    """
    pairs = point_pairs(i, j, clicks)
    check_points(pairs.p_a, pairs.p_b)
    try:
        agreed = consistent_sets(pairs)
    except DegenerateGeometryError as error:
        return [_smaller_start(i, j, pairs, others, gravity, error)]
    return [_full_start(i, j, clicks, pairs, one) for one in agreed[: OPERATOR_STARTS.most_starts]]


def _full_start(
    i: PreparedView, j: PreparedView, clicks: Clicks, pairs: PointPairs, agreed: Consensus
) -> OperatorStart:
    index = np.nonzero(agreed.inliers)[0]
    refined = refine(
        _observed(i, clicks.uv_i, clicks.z_i, clicks.sigma_i),
        _observed(j, clicks.uv_j, clicks.z_j, clicks.sigma_j),
        np.column_stack((index, index)),
        agreed.T_a_b,
        NoiseScale(),
        estimate_noise=False,
    )
    T, covariance = refined.T_i_j, _covariance(refined)
    if covariance is None:  # it gave up on one that it needs
        T, covariance = agreed.T_a_b, agreed.covariance
    fit = dlt.fit(pairs.p_a[index], pairs.p_b[index], largest="projective")
    start = Start(OPERATOR, T, _sigma(i, j, T, covariance))
    note = agreed.contradiction or fit.note
    return OperatorStart(
        start,
        fit.T_a_b,
        covariance,
        agreed.inliers,
        fit.model,
        pairs,
        note,
        not agreed.contradiction,
    )


def _smaller_start(
    i: PreparedView,
    j: PreparedView,
    pairs: PointPairs,
    others: Sequence[Start],
    gravity: Gravity | None,
    why: DegenerateGeometryError,
) -> OperatorStart:
    """What clicks give that do not span a triangle."""
    if max(dimension(pairs.p_a), dimension(pairs.p_b)) >= 2 and len(pairs) >= FULL_POSE:
        raise why
    everyone = np.ones(len(pairs), bool)
    if gravity is not None and len(pairs) >= 2:
        try:
            linear = pose_by_gravity(pairs.p_a, pairs.p_b, gravity)
            T, covariance = pairs.refined(linear, gravity)
        except DegenerateGeometryError as error:  # they stand above each other: a smaller model
            why = error
        else:
            start = Start(OPERATOR, T, _sigma(i, j, T, covariance))
            return OperatorStart(start, linear, covariance, everyone, "upright", pairs, str(why))
    known = min(others, key=lambda start: start.sigma, default=None)
    if known is not None:
        R, sigma = known.T_i_j[:3, :3], max(known.sigma, OPERATOR_STARTS.translation_sigma)
    else:
        R, sigma = np.eye(3) if gravity is None else gravity.level(), OPERATOR_STARTS.unturned_sigma
    T = dlt.translation(pairs.p_a, pairs.p_b, R)
    return OperatorStart(
        Start(OPERATOR, T, sigma), T, None, everyone, "translation", pairs, str(why)
    )


def gravity_between(i: PreparedView, j: PreparedView) -> Gravity | None:
    """What both views know of gravity; none where one does not."""
    if i.up is None or j.up is None:
        return None
    ups = (up / np.linalg.norm(up) for up in (i.up, j.up))
    return Gravity(*ups, sigma_rad=float(np.hypot(i.up_sigma_rad, j.up_sigma_rad)))


def by_clicks(sets: Sequence[OperatorStart], clicks: Clicks, T_i_j: Floats | None) -> ByClicks:
    """What is told of the clicks' own pose: of the set that fits the found pose best, if any does.

    Args:
        sets: that agree, not empty; the largest first.
        clicks: all of them.
        T_i_j: (4, 4) what the alignment ended with.
    """

    def agreeing(one: OperatorStart) -> int:
        assert T_i_j is not None
        return int((one.inliers & (one.pairs.distance2(T_i_j) < OUTLIER_CHI2)).sum())

    one = sets[0] if T_i_j is None else max(sets, key=agreeing)
    index = np.flatnonzero(one.inliers).tolist()
    ids = tuple(clicks.ids[k][0] for k in index) if clicks.ids else tuple(index)
    return ByClicks(one.linear, one.model, ids)


def point_pairs(i: PreparedView, j: PreparedView, clicks: Clicks) -> PointPairs:
    """The clicked points of view i (a) and view j (b) with their covariances."""
    sides = []
    for view, uv, z, sigma in (
        (i, clicks.uv_i, clicks.z_i, clicks.sigma_i),
        (j, clicks.uv_j, clicks.z_j, clicks.sigma_j),
    ):
        p = _observed(view, uv, z, sigma).points
        sides.append((p, covariances(p, view.observed.focal_px, LIFT.click_sigma_px, sigma)))
    (p_i, C_i), (p_j, C_j) = sides
    return PointPairs(p_i, p_j, C_i, C_j)


def _observed(view: PreparedView, uv: Floats, z: Floats, sigma: Floats) -> Observed:
    return Observed(
        view.observed.K, view.observed.size, uv, 1.0 / z, sigma / z**2, LIFT.click_sigma_px
    )


def _sigma(i: PreparedView, j: PreparedView, T: Floats, covariance: Floats) -> float:
    """How far a start may be off: of its weakest direction, as a share of the depth."""
    weakest = float(np.sqrt(np.linalg.eigvalsh(position_covariance(T, covariance))[-1]))
    return float(np.clip(weakest / (0.5 * (i.median_depth_m + j.median_depth_m)), 0.005, 0.1))


def _covariance(refined: Refinement) -> Floats | None:
    values = np.linalg.eigvalsh(refined.information)
    if values[0] <= 1e-12 * values[-1]:
        return None
    return np.linalg.inv(refined.information)
