"""A view aligned with itself shows where its place repeats: a facade is the same one window on.

Each such motion is a rival of every pose by which the view is joined to another: what that one sees
may as well be what is one window on. What breaks the tie are the points that stand about only once.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.matching import NO_MATCHES
from fleetpose.pose_server.geometry.features.triangles import poses_by_triangles
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.verdict.explained import (
    count_places,
    empty_parts,
    visible_in,
)
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class AliasesSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    points: int = 500  # strongest points of a view that are compared with each other
    matches: int = 400  # of these, most alike pairs: matching takes time by their square
    alike_places: int = 3  # twins of a point, at most
    alike: float = 0.9  # cosine of two descriptors that are twins
    elsewhere_px: float = 24.0  # nearer points are the same corner, seen twice
    least_agreeing: int = 4  # twins, to look at a motion
    rough_radius: float = 0.012  # of the first search around predicted places, share of the depth
    radius: float = 0.006  # of the second one, share of the depth
    least_places: int = 12  # places that a motion of a view onto itself finds again
    # the same, share of the visible ones: the best motions of churches, a portal and a temple
    # find .07 at most
    least_share: float = 0.1
    least_agree: float = 0.6  # share of surfaces that agree with such a motion
    # share of them that is seen through: those of a house with equal windows fit but once in
    # twenty views
    most_through: float = 0.1
    most: int = 3  # motions of a view onto itself that are told
    nearly: float = 0.5  # places of the best one: what finds fewer is a poor guess at it
    # of the points that a pose rests on: it may be shifted by the motion
    repeated_share: float = 0.25


ALIASES = in_use("aliases", AliasesSettings())

_MEMO = "aliases"


@dataclass(frozen=True, eq=False)
class Alias:
    """A motion that maps what a view shows onto itself.

    Attributes:
        T: (4, 4) in the camera frame.
        places: that are found again.
        repeated: (N,) which points are found one step on or one step back.
        expected: (N,) which should be, as they look much the same there.
    """

    T: Floats
    places: int
    repeated: Bools
    expected: Bools

    @property
    def rate(self) -> float:
        """Share of the expected points that are found."""
        return float(self.repeated[self.expected].mean()) if self.expected.any() else 0.0

    def explains(self, points: Indices) -> bool:
        """Whether enough of these points repeat, so that a pose which rests on them may be shifted
        by the motion.
        """
        again = int(self.repeated[points].sum())
        return again >= max(12, ALIASES.repeated_share * len(points))

    def unexplained(self, view: PreparedView, points: Indices) -> tuple[int, int]:
        """How many of these points lie in parts of the view where none repeats though some should:
        they stand about only once. And how many should repeat.
        """
        accounted = self.repeated[points] | ~self.expected[points]
        lost = empty_parts(view.observed, view.observed.uv[points], accounted, self.rate)
        return lost, int(self.expected[points].sum())


def aliases_of(view: PreparedView) -> tuple[Alias, ...]:
    """The motions that map what a view shows onto itself, those that find most again first."""
    if _MEMO not in view.memo:
        view.memo[_MEMO] = _found_in(view)
    known: tuple[Alias, ...] = view.memo[_MEMO]
    return known


def _found_in(view: PreparedView) -> tuple[Alias, ...]:
    twins = _twins(view)
    if len(twins) < ALIASES.least_agreeing:
        return ()
    pair = Pair(view, view, PAIR.ratio)
    found: list[Alias] = []
    for T, agrees in poses_by_triangles(view.observed, view.observed, twins, pair.depth_m):
        if len(agrees) < ALIASES.least_agreeing or not pair.gravely_apart(T, np.eye(4)):
            continue
        alias = _alias(pair, T)
        if alias is not None and all(pair.gravely_apart(alias.T, one.T) for one in found):
            found.append(alias)
    found.sort(key=lambda one: -one.places)
    return tuple(
        one for one in found[: ALIASES.most] if one.places >= ALIASES.nearly * found[0].places
    )


def _alias(pair: Pair, T: Floats) -> Alias | None:
    """A coarse motion, refined, if it is one."""
    view = pair.i
    around = _elsewhere(view, pair.guided(T, ALIASES.rough_radius))
    if len(around) < ALIASES.least_places:
        return None
    try:
        T = pair.refined(T, around, PAIR.own_noise).T_i_j
    except DegenerateGeometryError:
        return None
    seen = pair.agreement(T)
    near = not pair.gravely_apart(T, np.eye(4))
    if near or seen.agree < ALIASES.least_agree or seen.through > ALIASES.most_through:
        return None
    agreeing = pair.exact(T, _elsewhere(view, pair.guided(T, ALIASES.radius)))
    forth, back = (visible_in(view, view, motion, pair.sigma) for motion in (T, inverse(T)))
    places = count_places(view.observed.uv[agreeing[:, 1]])
    visible = count_places(view.observed.uv[forth.mask])
    if places < max(ALIASES.least_places, ALIASES.least_share * visible):
        return None
    repeated = np.zeros(len(forth.mask), bool)
    repeated[agreeing.ravel()] = True
    return Alias(T, places, repeated, forth.easily | back.easily)


def _twins(view: PreparedView) -> Indices:
    """Matches (M, 2) of points that look alike at different places, the most alike first."""
    points = view.observed.lifted[: ALIASES.points]
    if len(points) <= ALIASES.alike_places:
        return NO_MATCHES
    cosines = view.descriptors[points] @ view.descriptors[points].T
    uv = view.observed.uv[points]
    for row, columns in enumerate(cKDTree(uv).query_ball_point(uv, ALIASES.elsewhere_px)):
        cosines[row, columns] = -1.0
    best = np.argpartition(-cosines, ALIASES.alike_places - 1, axis=1)[:, : ALIASES.alike_places]
    alike = np.take_along_axis(cosines, best, axis=1)
    rows, columns = np.nonzero(alike > ALIASES.alike)
    order = np.argsort(-alike[rows, columns], kind="stable")[: ALIASES.matches]
    rows, columns = rows[order], columns[order]
    return np.column_stack((points[best[rows, columns]], points[rows]))


def _elsewhere(view: PreparedView, matches: Indices) -> Indices:
    """Of matches (M, 2) within a view those of two places."""
    uv = view.observed.uv
    apart = np.linalg.norm(uv[matches[:, 0]] - uv[matches[:, 1]], axis=1)
    return matches[apart > ALIASES.elsewhere_px]
