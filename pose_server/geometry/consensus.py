"""Which correspondences agree with each other, and the pose that those determine.

A person may click a wrong point. Every explanation "these are right, the others wrong" is tried:
the pose of the right ones is refined with their covariances, and its cost is the sum of their
squared Mahalanobis distances and a price for each one called wrong, as in MSAC (Torr and Zisserman
2000) but over all sets where they are few instead of a random sample.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
import numpy.typing as npt
from scipy.stats import chi2

from pose_server.geometry.dlt import rigid_unchecked, scale_between
from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.point_pairs import PointPairs
from pose_server.geometry.spread import check_points, dimension, need_dimension

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]

OUTLIER_CHI2 = 16.3  # 3 dof, 99.9 %
_CONTRADICTION = 1e-4  # share of right sets that are more at odds with themselves
_ALL_SETS_UP_TO = 130  # explanations; beyond, they grow from drawn triples
_DRAWN_TRIPLES = 100


@dataclass(frozen=True, eq=False)
class Consensus:
    """The pose of those correspondences that agree.

    Attributes:
        T_a_b: (4, 4).
        covariance: (6, 6), left, rotation first.
        inliers: (N,) which agree.
        distance2: (N,) squared Mahalanobis distances at the pose, 3 dof; for the outliers, the
            pose's own covariance is allowed for.
        runner_up: cost of the best explanation with other outliers, less the cost of this one; inf
            where there is none.
        contradiction: empty, or how the inliers contradict each other: no pose suits them.
    """

    T_a_b: Floats
    covariance: Floats
    inliers: Bools
    distance2: Floats
    runner_up: float
    contradiction: str = ""


def consensus(pairs: PointPairs, price: float = OUTLIER_CHI2) -> Consensus:
    """The explanation with the lowest cost; more than half, and three at least, must be right.

    Raises:
        DegenerateGeometryError: not finite; no three correspondences that span a triangle; one
            frame is the mirror image of the other or in other units.
    """
    check_points(pairs.p_a, pairs.p_b)
    scale_between(pairs.p_a, pairs.p_b)
    explained, why = _explained(pairs, price)
    if not explained:
        raise DegenerateGeometryError(why)
    cost, T, covariance, right = explained[0]
    distance2 = np.where(right, pairs.distance2(T), pairs.distance2(T, covariance))
    contradiction = _contradiction(distance2[right])
    if contradiction or not right.all():
        _refuse_mirror_image(pairs)
    margin = explained[1][0] - cost if len(explained) > 1 else np.inf
    return Consensus(T, covariance, right, distance2, margin, contradiction)


def pose_of(pairs: PointPairs) -> tuple[Floats, Floats]:
    """T_a_b (4, 4) and its covariance (6, 6) from three correspondences or more, all right.

    Raises:
        DegenerateGeometryError: fewer than three, or all on one line.
    """
    need_dimension(2, pairs.p_a, pairs.p_b)
    return pairs.refined(rigid_unchecked(pairs.p_a, pairs.p_b))


def _explained(
    pairs: PointPairs, price: float
) -> tuple[list[tuple[float, Floats, Floats, Bools]], str]:
    """Cost, pose, covariance and mask of all explanations, cheapest first; why others have none."""
    found: dict[bytes, tuple[float, Floats, Floats, Bools]] = {}
    why = ""
    for right in _explanations(pairs):
        if right.tobytes() in found:
            continue
        try:
            T, covariance = pose_of(pairs[right])
        except DegenerateGeometryError as error:
            why = why or str(error)  # the first one takes all of them as right
            continue
        cost = float(pairs[right].distance2(T).sum()) + price * int((~right).sum())
        found[right.tobytes()] = (cost, T, covariance, right)
    return sorted(found.values(), key=lambda one: one[0]), (
        why or f"{len(pairs)} correspondences, need 3"
    )


def _contradiction(distance2: Floats) -> str:
    """Whether the residuals of the pose's own points are too large by chance."""
    dof, total = 3 * len(distance2) - 6, float(distance2.sum())
    limit = float(chi2.isf(_CONTRADICTION, dof))
    if total <= limit:
        return ""
    return (
        f"{len(distance2)} correspondences contradict each other: chi-square {total:.0f}, "
        f"at most {limit:.0f}"
    )


def _refuse_mirror_image(pairs: PointPairs) -> None:
    """Where no rotation suits all correspondences, a reflection must not suit them."""
    if min(dimension(pairs.p_a), dimension(pairs.p_b)) < 3:
        return  # flat sets are their own mirror images
    flip = np.diag([-1.0, 1.0, 1.0])
    mirrored = PointPairs(pairs.p_a, pairs.p_b @ flip, pairs.C_a, flip @ pairs.C_b @ flip)
    T, _ = pose_of(mirrored)
    if not _contradiction(mirrored.distance2(T)):
        raise DegenerateGeometryError(
            f"one frame is the mirror image of the other: a reflection suits all {len(pairs)} "
            "correspondences, no rotation does"
        )


def _explanations(pairs: PointPairs) -> Iterator[Bools]:
    """(N,) masks of correspondences that may be the right ones."""
    n = len(pairs)
    most_wrong = min((n - 1) // 2, n - 3)
    if n < 3:
        return
    if sum(comb(n, k) for k in range(most_wrong + 1)) <= _ALL_SETS_UP_TO:
        for wrong in range(most_wrong + 1):
            for chosen in combinations(range(n), wrong):
                right = np.ones(n, bool)
                right[list(chosen)] = False
                yield right
        return
    yield np.ones(n, bool)
    rng = np.random.default_rng(0)  # by chance, but the same every time
    for _ in range(_DRAWN_TRIPLES):
        right = _grown(pairs, rng.choice(n, 3, replace=False))
        if right is not None and 2 * right.sum() > n:
            yield right


def _grown(pairs: PointPairs, triple: npt.NDArray[np.int64]) -> Bools | None:
    """What agrees with three, then with all of these."""
    index: npt.NDArray[np.int64] | Bools = triple
    for _ in range(3):
        try:
            T, covariance = pose_of(pairs[index])
        except DegenerateGeometryError:
            return None
        index = pairs.distance2(T, covariance) < OUTLIER_CHI2
        if index.sum() < 3:
            return None
    return np.asarray(index, bool)
