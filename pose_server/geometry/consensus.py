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

from fleetpose.pose_server.geometry.dlt import rigid_unchecked, scale_between
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.spread import check_points, dimension, need_dimension
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]

OUTLIER_CHI2 = 16.3  # derived: chi-square of 3 dof, 99.9 %


@dataclass(frozen=True)
class ConsensusSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    contradiction: float = 0.0001  # share of right sets that are more at odds with themselves


CONSENSUS = in_use("consensus", ConsensusSettings())

_ALL_SETS_UP_TO = 130  # numerical: explanations; beyond, they grow from drawn triples
_DRAWN_TRIPLES = 40  # derived: a fifth of clicks wrong, half of all triples are right
_ALL_TRIPLES_UP_TO = 84  # derived: all triples of nine clicks
_MAY_BE_RIGHT = 2  # derived: left out, with one more by chance they may be right instead


@dataclass(frozen=True, eq=False)
class Consensus:
    """The pose of those correspondences that agree.

    Attributes:
        T_a_b: (4, 4).
        covariance: (6, 6), left, rotation first.
        inliers: (N,) which agree.
        distance2: (N,) squared Mahalanobis distances at the pose, 3 dof; for the outliers, the
            pose's own covariance is allowed for.
        contradiction: empty, or how the inliers contradict each other: no pose suits them.
    """

    T_a_b: Floats
    covariance: Floats
    inliers: Bools
    distance2: Floats
    contradiction: str = ""


def consensus(pairs: PointPairs, price: float = OUTLIER_CHI2) -> Consensus:
    """The explanation with the lowest cost; more than half, and three at least, must be right.

    Raises:
        DegenerateGeometryError: not finite; no three correspondences that span a triangle; one
            frame is the mirror image of the other or in other units.
    """
    check_points(pairs.p_a, pairs.p_b)
    scale_between(pairs.p_a, pairs.p_b)
    T, covariance, right = _best_explanation(pairs, price)
    distance2 = np.where(right, pairs.distance2(T), pairs.distance2(T, covariance))
    contradiction = _contradiction(distance2[right])
    if contradiction or not right.all():
        _refuse_mirror_image(pairs)
    return Consensus(T, covariance, right, distance2, contradiction)


def consistent_sets(pairs: PointPairs) -> list[Consensus]:
    """Every way to believe some of the correspondences: the explanation of `consensus`, and where
    that leaves so many out that these may be right instead, or contradicts itself, the other sets
    of three or more that agree with each other. The largest comes first, then what adds most.

    Three wrong ones that fit each other are outvoted by no majority of three right ones: what else
    is known must decide.

    Raises:
        DegenerateGeometryError: there is none; see `consensus`.
    """
    why: DegenerateGeometryError | None = None
    try:
        first = consensus(pairs)
        if not first.contradiction and (~first.inliers).sum() < _MAY_BE_RIGHT:
            return [first]
        found = [] if first.contradiction else [first]
    except DegenerateGeometryError as error:
        first, found, why = None, [], error
    alike = _as_far_apart(pairs)
    for triple in _triples(len(pairs)):
        known = any(one.inliers[triple].all() for one in found)
        if known or not alike[np.ix_(triple, triple)].all():
            continue
        inliers = _grown(pairs, triple)
        if inliers is None or any((inliers <= one.inliers).all() for one in found):
            continue
        one = _believing(pairs, inliers)
        if one is not None:
            found = [other for other in found if not (other.inliers <= inliers).all()]
            found.append(one)
    if not found:
        if first is None:
            assert why is not None
            raise why
        return [first]
    return _in_order_of_what_they_add(found)


def _in_order_of_what_they_add(sets: list[Consensus]) -> list[Consensus]:
    """First the largest, then the one with most that is in none before it."""
    left, ordered, covered = list(sets), [], np.zeros(len(sets[0].inliers), bool)
    while left:
        one = max(left, key=lambda s: (int((s.inliers & ~covered).sum()), int(s.inliers.sum())))
        left.remove(one)
        ordered.append(one)
        covered |= one.inliers
    return ordered


def _as_far_apart(pairs: PointPairs) -> Bools:
    """(N, N) whether two points are as far from each other in one frame as in the other, within
    their noise along the line between them: no pose suits two that are not.
    """
    lengths, variances = [], []
    for p, C in ((pairs.p_a, pairs.C_a), (pairs.p_b, pairs.C_b)):
        between = p[:, None] - p[None]
        length = np.linalg.norm(between, axis=2)
        along = between / np.maximum(length, 1e-12)[:, :, None]
        noise = np.einsum("kmi,kmij,kmj->km", along, C[:, None] + C[None], along)
        lengths.append(length)
        variances.append(noise)
    return (lengths[0] - lengths[1]) ** 2 <= OUTLIER_CHI2 * (variances[0] + variances[1]) + 1e-12


def _believing(pairs: PointPairs, inliers: Bools) -> Consensus | None:
    """The pose of those that agree with each other; none where they do not after all."""
    try:
        T, covariance = pose_of(pairs[inliers])
    except DegenerateGeometryError:
        return None
    distance2 = np.where(inliers, pairs.distance2(T), pairs.distance2(T, covariance))
    if _contradiction(distance2[inliers]):
        return None
    return Consensus(T, covariance, inliers, distance2)


def _triples(n: int) -> Iterator[npt.NDArray[np.int64]]:
    """All, or as many as are drawn by chance, but the same every time."""
    if comb(n, 3) <= _ALL_TRIPLES_UP_TO:
        yield from (np.array(chosen) for chosen in combinations(range(n), 3))
        return
    rng = np.random.default_rng(0)
    yield from (rng.choice(n, 3, replace=False) for _ in range(_ALL_TRIPLES_UP_TO))


def pose_of(pairs: PointPairs) -> tuple[Floats, Floats]:
    """T_a_b (4, 4) and its covariance (6, 6) from three correspondences or more, all right.

    Raises:
        DegenerateGeometryError: fewer than three, or all on one line.
    """
    need_dimension(2, pairs.p_a, pairs.p_b)
    return pairs.refined(rigid_unchecked(pairs.p_a, pairs.p_b))


def _best_explanation(pairs: PointPairs, price: float) -> tuple[Floats, Floats, Bools]:
    """Pose, covariance and mask of the cheapest explanation.

    Raises:
        DegenerateGeometryError: none has a pose; the text is that of the first, which takes all
            correspondences as right.
    """
    best, lowest, why = None, np.inf, f"{len(pairs)} correspondences, need 3"
    tried: set[bytes] = set()
    for right in _explanations(pairs):
        paid = price * int((~right).sum())
        if paid >= lowest or right.tobytes() in tried:
            continue  # its price alone is more than another's whole cost
        tried.add(right.tobytes())
        try:
            T, covariance = pose_of(pairs[right])
        except DegenerateGeometryError as error:
            why = str(error) if len(tried) == 1 else why
            continue
        cost = float(pairs[right].distance2(T).sum()) + paid
        if cost < lowest:
            best, lowest = (T, covariance, right), cost
    if best is None:
        raise DegenerateGeometryError(why)
    return best


def _contradiction(distance2: Floats) -> str:
    """Whether the residuals of the pose's own points are too large by chance."""
    dof, total = 3 * len(distance2) - 6, float(distance2.sum())
    limit = chi2_limit(CONSENSUS.contradiction, dof)
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
    everyone = np.ones(n, bool)
    yield everyone
    if _agree(pairs):
        return
    rng = np.random.default_rng(0)  # by chance, but the same every time
    for _ in range(_DRAWN_TRIPLES):
        right = _grown(pairs, rng.choice(n, 3, replace=False))
        if right is not None and 2 * right.sum() > n:
            yield right


def _agree(pairs: PointPairs) -> bool:
    """Whether all of many correspondences agree: none stands out."""
    try:
        T, _ = pose_of(pairs)
    except DegenerateGeometryError:
        return False
    return bool((pairs.distance2(T) < OUTLIER_CHI2).all())


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
