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
from fleetpose.pose_server.registration.pair import OWN_NOISE, RATIO, Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.verdict.explained import (
    count_places,
    empty_parts,
    visible_in,
)

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

_POINTS, _MATCHES = 500, 400  # the strongest tell; matching takes time by their square
_ALIKE_PLACES, _ALIKE = 3, 0.9  # of each point, at most; cosine of two descriptors
_ELSEWHERE_PX = 24.0  # nearer points are the same corner, seen twice
_LEAST_AGREEING = 4  # twins, to look at a motion
_ROUGH_RADIUS, _RADIUS = 0.012, 0.006  # of the search around predicted places, share of the depth
# What a motion must find again, and how surfaces must agree at it. In corridors, colonnades and
# facades of equal parts the share is .11 to .48, .6 of the surfaces agree and more, and at most .09
# are seen through; the best motions of churches, a portal and a temple find .07 at most, and those
# of a house with equal windows fit the surfaces but once in twenty views.
_LEAST_PLACES, _LEAST_SHARE = 12, 0.1
_LEAST_AGREE, _MOST_THROUGH = 0.6, 0.1
_MOST, _NEARLY = 3, 0.5  # places of the best one: what finds fewer is a poor guess at it
_MEMO = "aliases"
_REPEATED_SHARE = 0.25  # of the points that a pose rests on: it may be shifted by the motion


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
        return again >= max(12, _REPEATED_SHARE * len(points))

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
    if len(twins) < _LEAST_AGREEING:
        return ()
    pair = Pair(view, view, RATIO)
    found: list[Alias] = []
    for T, agrees in poses_by_triangles(view.observed, view.observed, twins, pair.depth_m):
        if len(agrees) < _LEAST_AGREEING or not pair.gravely_apart(T, np.eye(4)):
            continue
        alias = _alias(pair, T)
        if alias is not None and all(pair.gravely_apart(alias.T, one.T) for one in found):
            found.append(alias)
    found.sort(key=lambda one: -one.places)
    return tuple(one for one in found[:_MOST] if one.places >= _NEARLY * found[0].places)


def _alias(pair: Pair, T: Floats) -> Alias | None:
    """A coarse motion, refined, if it is one."""
    view = pair.i
    around = _elsewhere(view, pair.guided(T, _ROUGH_RADIUS))
    if len(around) < _LEAST_PLACES:
        return None
    try:
        T = pair.refined(T, around, OWN_NOISE).T_i_j
    except DegenerateGeometryError:
        return None
    seen = pair.agreement(T)
    near = not pair.gravely_apart(T, np.eye(4))
    if near or seen.agree < _LEAST_AGREE or seen.through > _MOST_THROUGH:
        return None
    agreeing = pair.exact(T, _elsewhere(view, pair.guided(T, _RADIUS)))
    forth, back = (visible_in(view, view, motion, pair.sigma) for motion in (T, inverse(T)))
    places = count_places(view.observed.uv[agreeing[:, 1]])
    visible = count_places(view.observed.uv[forth.mask])
    if places < max(_LEAST_PLACES, _LEAST_SHARE * visible):
        return None
    repeated = np.zeros(len(forth.mask), bool)
    repeated[agreeing.ravel()] = True
    return Alias(T, places, repeated, forth.easily | back.easily)


def _twins(view: PreparedView) -> Indices:
    """Matches (M, 2) of points that look alike at different places, the most alike first."""
    points = view.observed.lifted[:_POINTS]
    if len(points) <= _ALIKE_PLACES:
        return NO_MATCHES
    cosines = view.descriptors[points] @ view.descriptors[points].T
    uv = view.observed.uv[points]
    for row, columns in enumerate(cKDTree(uv).query_ball_point(uv, _ELSEWHERE_PX)):
        cosines[row, columns] = -1.0
    best = np.argpartition(-cosines, _ALIKE_PLACES - 1, axis=1)[:, :_ALIKE_PLACES]
    alike = np.take_along_axis(cosines, best, axis=1)
    rows, columns = np.nonzero(alike > _ALIKE)
    order = np.argsort(-alike[rows, columns], kind="stable")[:_MATCHES]
    rows, columns = rows[order], columns[order]
    return np.column_stack((points[best[rows, columns]], points[rows]))


def _elsewhere(view: PreparedView, matches: Indices) -> Indices:
    """Of matches (M, 2) within a view those of two places."""
    uv = view.observed.uv
    apart = np.linalg.norm(uv[matches[:, 0]] - uv[matches[:, 1]], axis=1)
    return matches[apart > _ELSEWHERE_PX]
