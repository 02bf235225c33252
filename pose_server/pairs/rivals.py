"""Where a place repeats itself: a view aligned with itself shows its own aliases, and each is a
rival of every pose of that view.

In a corridor of equal doors everything is explained a door further on as well, and descriptors that
repeat never become matches, so that no rival is found among what a pose leaves over. It is looked
for where it must be: if a view looks the same after a motion A (a period, a turn by a symmetry),
then T A, or A T, puts as much in place as T does. What breaks the tie are the points that only one
of both finds again.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.matching import NO_MATCHES
from pose_server.geometry.refine import NoiseScale
from pose_server.geometry.se3 import inverse
from pose_server.geometry.triangles import MOST_MATCHES, poses_by_triangles
from pose_server.pairs.explained import count_places, visible_in
from pose_server.pairs.pair import RATIO, Pair
from pose_server.pairs.views import PreparedView

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]

_ELSEWHERE_PX = 12.0  # nearer points are the same corner, seen twice
_LIKE = 0.8  # cosine of what looks alike: below it, matches of a view with itself are chance
_CONSIDERED = 1000  # salient points, the strongest first
_NEIGHBOURS = 2  # alike places of each point: a period has one on either side
_LEAST_PLACES, _LEAST_SHARE = 12, 0.15  # that a motion must explain of its own view
_MOST_ALIASES = 6
_RADIUS = 0.012  # share of the depth: an alias is known as well as a pose by triangles
_WORTH = 0.3  # of the winner's places: with fewer a rival is not looked at
EXACT_SIGMAS = 2.5  # across the epipolar line: a wider one is found by chance around any place
_NOISE = NoiseScale(1.0, 1.5)
_COMMON = 12  # places that both poses expect: with fewer only what each explains is compared


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pose of a pair, and how it stands to the winner.

    Attributes:
        T_i_j: (4, 4).
        own: places that only it finds again, of those that both poses expect.
        lost: places that only the winner finds again, of the same.
        share: what it explains, over what the winner explains; both of what each expects.
    """

    T_i_j: Floats
    own: int
    lost: int
    share: float

    @property
    def lead(self) -> float:
        """By how many sigmas the winner finds more (McNemar's test); negative where it finds
        less.
        """
        return (self.lost - self.own) / float(np.sqrt(max(self.lost + self.own, 1)))


def aliases_of(view: PreparedView) -> tuple[Floats, ...]:
    """Motions (4, 4), not identity, after which a view looks like itself; the best known first.
    Worked out once a view.
    """
    if not view.aliases:
        view.aliases.append(_aliases(view))
    return view.aliases[0]


def _aliases(view: PreparedView) -> tuple[Floats, ...]:
    itself = Pair(view, view, RATIO)
    matches = _alike(view)
    found: list[tuple[float, Floats]] = []
    for A, agrees in poses_by_triangles(view.observed, view.observed, matches, itself.depth_m):
        if itself.same_pose(A, np.eye(4)) or len(agrees) < 6:
            continue
        share, places = _explained_by(itself, A)
        if share >= _LEAST_SHARE and places >= _LEAST_PLACES:
            found.append((share, A))
    found.sort(key=lambda one: -one[0])
    return tuple(A for _, A in found[:_MOST_ALIASES])


def rivals_of(pair: Pair, T: Floats) -> list[Rival]:
    """How the poses that the views' own aliases offer stand to a pose."""
    poses = [A @ T for A in aliases_of(pair.i)] + [T @ A for A in aliases_of(pair.j)]
    if not poses:
        return []
    winner = _Claim.of(pair, T)
    rivals: list[Rival] = []
    for pose in poses:
        if not pair.gravely_apart(pose, T) or any(pair.same_pose(pose, r.T_i_j) for r in rivals):
            continue
        if (rival := _rival(pair, winner, pose)) is not None:
            rivals.append(rival)
    return rivals


def _rival(pair: Pair, winner: "_Claim", pose: Floats) -> Rival | None:
    matches = np.unique(np.concatenate((pair.guided(pose, _RADIUS), pair.ratio)), axis=0)
    if len(matches) < 6:
        return None
    try:
        pose = pair.refined(pose, matches, _NOISE, 6).T_i_j
    except DegenerateGeometryError:
        return None
    if not pair.gravely_apart(pose, winner.T_i_j):
        return None
    claim = _Claim.of(pair, pose)
    if claim.places < _WORTH * winner.places:
        return None
    own, lost = claim.beside(winner)
    return Rival(pose, own, lost, claim.share / max(winner.share, 1e-6))


@dataclass(frozen=True, eq=False)
class _Claim:
    """What a pose says of both views' points, and what comes true.

    Attributes:
        expected, found: of i's points and of j's, which should be seen in the other view, and which
            are found again to the pixel.
        places: distinct places found.
        share: of the places expected.
    """

    T_i_j: Floats
    pair: Pair
    expected: tuple[Bools, Bools]
    found: tuple[Bools, Bools]
    places: int
    share: float

    @classmethod
    def of(cls, pair: Pair, T: Floats) -> "_Claim":
        expected = (
            visible_in(pair.i, pair.j, inverse(T), pair.sigma).mask,
            visible_in(pair.j, pair.i, T, pair.sigma).mask,
        )
        matches = np.unique(np.concatenate((pair.guided(T, 0.006), pair.ratio)), axis=0)
        agreeing = exact_matches(pair, T, matches)
        found = tuple(np.zeros(len(mask), bool) for mask in expected)
        for column in (0, 1):
            found[column][agreeing[:, column]] = True
        views = pair.i.observed, pair.j.observed
        seen = min(count_places(v.uv[mask]) for v, mask in zip(views, expected, strict=True))
        places = min(count_places(v.uv[mask]) for v, mask in zip(views, found, strict=True))
        return cls(T, pair, expected, (found[0], found[1]), places, places / max(seen, 1))

    def beside(self, other: "_Claim") -> tuple[int, int]:
        """Of the places that both poses expect in the view where more of them are: how many only
        this one finds, and how many only the other.
        """
        counts = []
        for column, view in ((0, self.pair.i.observed), (1, self.pair.j.observed)):
            both = self.expected[column] & other.expected[column]
            mine, theirs = self.found[column], other.found[column]
            counts.append(
                (
                    count_places(view.uv[both]),
                    count_places(view.uv[both & mine & ~theirs]),
                    count_places(view.uv[both & theirs & ~mine]),
                )
            )
        common, own, lost = max(counts)
        return (own, lost) if common >= _COMMON else (self.places, other.places)


def exact_matches(pair: Pair, T: Floats, matches: Indices) -> Indices:
    """The matches (M, 2) that agree with a pose at the cameras' own noise, to the pixel across the
    epipolar lines.
    """
    if len(matches) < 3:
        return NO_MATCHES
    try:
        scored = pair.scored(T, matches, _NOISE)
    except DegenerateGeometryError:
        return NO_MATCHES
    sigma_px = np.hypot(pair.i.observed.pixel_sigma_px, pair.j.observed.pixel_sigma_px)
    return matches[scored.inliers & (np.abs(scored.across_px) < EXACT_SIGMAS * sigma_px)]


def _explained_by(itself: Pair, A: Floats) -> tuple[float, int]:
    claim = _Claim.of(itself, A)
    return claim.share, claim.places


def _alike(view: PreparedView) -> Indices:
    """Matches (M, 2) of a view's lifted points with the most alike ones elsewhere in it."""
    lifted = view.observed.lifted[:_CONSIDERED]
    descriptors, uv = view.descriptors[lifted], view.observed.uv[lifted]
    cosines = descriptors @ descriptors.T
    near = np.square(uv[:, None] - uv[None]).sum(axis=2) < _ELSEWHERE_PX**2
    cosines[near] = -1.0
    count = min(_NEIGHBOURS, len(lifted) - 1)
    best = np.argpartition(-cosines, count - 1, axis=1)[:, :count]
    rows = np.repeat(np.arange(len(lifted)), count)
    found = np.column_stack((rows, best.ravel()))
    like = cosines[found[:, 0], found[:, 1]]
    order = np.argsort(-like, kind="stable")
    order = order[like[order] > _LIKE][:MOST_MATCHES]
    return lifted[found[order]]
