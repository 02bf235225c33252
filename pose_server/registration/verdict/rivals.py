"""Where a place repeats itself, other poses explain as much: they are rivals.

In a corridor of equal doors everything is explained a door further on as well, and descriptors that
repeat never become matches, so that no rival is found among what a pose leaves over. It is looked
for where it must be: what looks like a point that the pose finds again, at another place of the
other view, is where a rival would put that point. What breaks the tie are the points that only one
of both poses finds again.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features import robust
from fleetpose.pose_server.geometry.features.matching import NO_MATCHES, union
from fleetpose.pose_server.geometry.features.refine import NoiseScale
from fleetpose.pose_server.geometry.features.triangles import TRIANGLES, poses_by_triangles
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.verdict.aliases import Alias, aliases_of
from fleetpose.pose_server.registration.verdict.explained import (
    EXPLAINED,
    count_places,
    empty_parts,
    visible_at,
)
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class RivalsSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    elsewhere_px: float = 12.0  # nearer points are the same corner, seen twice
    alike_places: int = 3  # of each point, at most: a period has one on either side
    as_alike: float = 1.5  # squared distance of descriptors, over that of the pose's own match
    exactly_alike: float = 0.04  # which is at least this: twins in a rendered or very sharp image
    least_left_over: int = 6  # matches, to look for another pose among them
    least_twins: int = 4  # that agree on a pose, to look at it
    enough_matches: int = 120  # whose twins are looked for
    least_alike: int = 8  # points with a twin elsewhere: fewer are chance
    radius: float = 0.012  # share of the depth: an alias is known as well as a pose by triangles
    least_places: int = 12  # places that a rival finds again
    worth: float = 0.25  # the same, over those of the winner
    most_through: float = 0.25  # of a cloud: nobody sees through walls
    # Of what may be expected a rival finds so much of what the winner finds. In corridors,
    # facades and colonnades of equal parts nineteen in twenty do, of the rivals in a church that
    # does not repeat fewer than half
    as_much: float = 0.5
    common: int = 12  # places that one pose finds and the other expects: fewer tell nothing
    most_rivals: int = 3  # poses that are compared with the winner
    unique_points: int = 24  # points lost by an alias that single out a pose
    unique_share: float = 0.05  # the same, share by both views: .06 and more for right ones
    # by one view alone, where the other does not repeat: .3 and more for right ones
    unique_share_by_one: float = 0.2
    # share of a view that its own alias explains, to ask what is lost by it
    telling_rate: float = 0.15


RIVALS = in_use("rivals", RivalsSettings())


@dataclass(frozen=True, eq=False)
class Rival:
    """Another pose of a pair, and where both contradict each other.

    Attributes:
        T_i_j: (4, 4).
        places: that it finds again.
        own: places in parts of a view where it finds much of what should be seen, and the winner
            nothing.
        lost: places where it is the other way round.
        by_itself: it is offered by how a view repeats, and need not find anything again by itself:
            of who sees a door from the side the next one may be too oblique to be matched.
    """

    T_i_j: Floats
    places: int
    own: int
    lost: int
    by_itself: bool = False

    @property
    def lead(self) -> float:
        """By how many sigmas the winner finds more; negative where it finds less (a sign test)."""
        return _lead(self.lost, self.own)


def rivals_of(pair: Pair, T: Floats, exact: Indices) -> list[Rival]:
    """How the poses that the place's repetitions offer stand to a pose.

    Args:
        pair: the views.
        T: T_i_j.
        exact: (M, 2) matches that agree with it to the pixel.
    """
    shifted = _shifted(pair, T, exact)
    poses = [rival.T_i_j for rival in shifted]
    other = left_over(pair, np.isin(pair.ratio[:, 1], exact[:, 1]), PAIR.own_noise)
    if other is not None and pair.gravely_apart(T, other):
        poses.append(other)
    some = exact[:: 1 + len(exact) // RIVALS.enough_matches]
    elsewhere = _elsewhere(pair, some)[: TRIANGLES.most_matches]
    if len(elsewhere) >= RIVALS.least_alike:
        found = poses_by_triangles(pair.i.observed, pair.j.observed, elsewhere, pair.depth_m)
        poses += [pose for pose, agrees in found if len(agrees) >= RIVALS.least_twins]
    if not poses:
        return []
    winner = _Claim.of(pair, T)
    worth = max(RIVALS.least_places, RIVALS.worth * winner.places)
    rivals: list[Rival] = []
    looked_at: list[Floats] = []
    for pose in poses:
        rival = _rival(pair, winner, pose, worth, looked_at)
        if rival is not None:
            rivals.append(rival)
    rivals = sorted(rivals, key=lambda one: -one.places)[: RIVALS.most_rivals]
    return _joined(pair, rivals, shifted)


def unique_points(pair: Pair, exact: Indices) -> int | None:
    """How many of the points (M, 2) that a pose rests on are there only once, though much of what
    the views show repeats; 0 where that may be chance, None where neither view repeats.

    The same things are in both views, so that both must say so: one alone says it also of what
    repeats, but is seen at a grazing angle one step further.
    """
    found = [
        alias.unexplained(view, np.unique(exact[:, column]))
        for column, view in enumerate((pair.i, pair.j))
        for alias in aliases_of(view)[:1]
        if alias.rate >= RIVALS.telling_rate
    ]
    if not found:
        return None
    lost, of = min(found)
    least_share = RIVALS.unique_share if len(found) == 2 else RIVALS.unique_share_by_one
    return lost if lost >= max(RIVALS.unique_points, least_share * of) else 0


def one_step_on(pair: Pair, T: Floats) -> list[Floats]:
    """The poses (4, 4) that a pose becomes if either view shows what is one step on or back."""
    poses: list[Floats] = []
    for column, view in enumerate((pair.i, pair.j)):
        for alias in aliases_of(view)[:1]:
            for pose in _either_way(T, alias, column):
                if all(pair.gravely_apart(pose, other) for other in poses):
                    poses.append(pose)
    return poses[: RIVALS.most_rivals]


def _either_way(T: Floats, alias: Alias, column: int) -> list[Floats]:
    """A pose shifted by a motion of view i (0) or j (1), and by its inverse."""
    return [A @ T if column == 0 else T @ A for A in (alias.T, inverse(alias.T))]


def _lead(lost: int, own: int) -> float:
    """Sigmas of a sign test."""
    return (lost - own) / float(np.sqrt(max(lost + own, 1)))


def _joined(pair: Pair, rivals: list[Rival], shifted: list[Rival]) -> list[Rival]:
    """All rivals, each once: who beats it in one way has beaten it."""
    joined, others = [], shifted
    for rival in rivals:
        same = [one for one in others if pair.same_pose(rival.T_i_j, one.T_i_j)]
        others = [one for one in others if one not in same]
        best = max((rival, *same), key=lambda one: one.lead)
        joined.append(replace(rival, own=best.own, lost=best.lost))
    return joined + others


def _shifted(pair: Pair, T: Floats, exact: Indices) -> list[Rival]:
    """The pose shifted by the motions that map either view onto itself, as far as what it rests on
    repeats.
    """
    rivals: list[Rival] = []
    lost = unique_points(pair, exact) or 0
    for column, view in enumerate((pair.i, pair.j)):
        points = np.unique(exact[:, column])
        for alias in aliases_of(view):
            if not alias.explains(points):
                continue
            places = int(alias.repeated[points].sum())
            for pose in _either_way(T, alias, column):
                if pair.agreement(pose).through < RIVALS.most_through:
                    rivals.append(Rival(pose, places, 0, lost, by_itself=True))
    return rivals


def left_over(pair: Pair, agreeing: Bools, noise: NoiseScale) -> Floats | None:
    """The best pose of the matches by descriptor that do not agree with a known one.

    Args:
        pair: the views.
        agreeing: (R,) which of `pair.ratio` do.
        noise: of the pair.
    """
    rest = pair.ratio[~agreeing]
    if len(rest) < RIVALS.least_left_over:
        return None
    p_i, p_j = pair.points(rest)
    found = robust.solve(p_i / pair.depth_m, p_j / pair.depth_m, 0.01)
    if found is None:
        return None
    other = found[0].copy()
    other[:3, 3] *= pair.depth_m
    try:
        return pair.refined(other, rest[found[1]], noise, 4).T_i_j
    except DegenerateGeometryError:
        return None


def _elsewhere(pair: Pair, matches: Indices) -> Indices:
    """Matches (M', 2) of both views' points with what looks as much like them at other places than
    where `matches` (M, 2) put them.
    """
    turned = _elsewhere_in(pair.j, pair.i, matches[:, ::-1])
    return np.concatenate((_elsewhere_in(pair.i, pair.j, matches), turned[:, ::-1]))


def _elsewhere_in(i: PreparedView, j: PreparedView, matches: Indices) -> Indices:
    """Matches (M', 2) of j's points with what looks as much like them at other places of i than
    where `matches` (M, 2) put them; the most alike first.
    """
    lifted = i.observed.lifted
    matches = matches[np.isfinite(j.observed.inverse_depth[matches[:, 1]])]
    if len(lifted) <= RIVALS.alike_places or len(matches) == 0:
        return NO_MATCHES
    cosines = j.descriptors[matches[:, 1]] @ i.descriptors[lifted].T
    own = np.einsum("md,md->m", j.descriptors[matches[:, 1]], i.descriptors[matches[:, 0]])
    uv = i.observed.uv
    near = cKDTree(uv[lifted]).query_ball_point(uv[matches[:, 0]], RIVALS.elsewhere_px)
    for row, columns in enumerate(near):
        cosines[row, columns] = -1.0
    best = np.argpartition(-cosines, RIVALS.alike_places - 1, axis=1)[:, : RIVALS.alike_places]
    distance = 1 - np.take_along_axis(cosines, best, axis=1)
    rows, columns = np.nonzero(
        distance < RIVALS.as_alike * np.maximum(1 - own, RIVALS.exactly_alike)[:, None]
    )
    order = np.argsort(distance[rows, columns], kind="stable")
    rows, columns = rows[order], columns[order]
    return np.column_stack((lifted[best[rows, columns]], matches[rows, 1]))


def _rival(
    pair: Pair, winner: "_Claim", pose: Floats, worth: float, looked_at: list[Floats]
) -> Rival | None:
    """A coarse pose as a rival, if it is one: refined, it finds so many places again, and is none
    of those that were looked at, to which it is added.
    """
    around = pair.guided(pose, RIVALS.radius)
    if len(around) < worth:
        return None
    try:
        pose = pair.refined(pose, around, PAIR.own_noise, 6).T_i_j
    except DegenerateGeometryError:
        return None
    if not pair.gravely_apart(pose, winner.T_i_j):
        return None
    if any(pair.same_pose(pose, other) for other in looked_at):
        return None
    looked_at.append(pose)
    agreeing = pair.exact(pose, around)
    if len(agreeing) < worth:
        return None
    claim = _Claim.of(pair, pose)
    if claim.places < worth or claim.share < RIVALS.as_much * winner.share:
        return None
    return Rival(pose, claim.places, _holes(winner, claim), _holes(claim, winner))


def _holes(of: "_Claim", beside: "_Claim") -> int:
    """Places that another pose finds in parts of a view where a pose accounts for nothing, though
    elsewhere it accounts for enough for that to be no chance.

    A pose accounts for a place that it finds again too, and for one that it puts out of sight if
    something like it is elsewhere in the other view: repetition explains that it was found. A
    right pose seen at a wide angle finds less than an alias seen at a narrow one, but everywhere;
    an alias accounts for nothing of what stands about only once. Such a thing was matched, so that
    it is missing in both views. What is missing in one alone is a part that the pose sees there at
    a grazing angle: by that even aliases led the right pose by six sigmas.
    """
    return min(_holes_in(of, beside, column) for column in (0, 1))


def _holes_in(of: "_Claim", beside: "_Claim", column: int) -> int:
    view = (of.pair.i, of.pair.j)[column].observed
    known = beside.found[column]
    if known.sum() < RIVALS.common:
        return 0
    unseen = known & ~of.found[column] & ~of.expected[column]
    accounted = of.found[column] | beside.repeated(unseen, column)
    # a partner that is found elsewhere explains as well why the two look alike
    explained = beside.agreeing[of.found[1 - column][beside.agreeing[:, 1 - column]], column]
    accounted[explained] |= unseen[explained]
    return empty_parts(view, view.uv[known], accounted[known])


@dataclass(frozen=True, eq=False)
class _Claim:
    """What a pose says of both views' points, and what comes true.

    Attributes:
        expected, found: of i's points and of j's, which should be found in the other view, and
            which are, to the pixel.
        agreeing: (M, 2) the matches that say so.
        places: distinct places found.
        share: these over all that should be seen, and over what is found at such an angle.
    """

    T_i_j: Floats
    pair: Pair
    expected: tuple[Bools, Bools]
    agreeing: Indices
    found: tuple[Bools, Bools]
    places: int
    share: float

    @classmethod
    def of(cls, pair: Pair, T: Floats) -> "_Claim":
        seen = visible_at(pair, T)
        matches = union(pair.guided(T, 0.006), pair.ratio)
        agreeing = pair.exact(T, matches)
        found = _masks(pair, agreeing)
        views = pair.i.observed, pair.j.observed
        places = min(count_places(v.uv[mask]) for v, mask in zip(views, found, strict=True))
        visible = min(count_places(v.uv[one.mask]) for v, one in zip(views, seen, strict=True))
        angles = np.concatenate((seen[0].parallax_rad, seen[1].parallax_rad))
        angle = float(np.median(angles)) if len(angles) else 0.0
        usual = max(
            float(np.exp(-((angle / EXPLAINED.parallax_rad) ** 2))), EXPLAINED.least_expected
        )
        share = places / max(visible * usual, 1.0)
        return cls(T, pair, (seen[0].easily, seen[1].easily), agreeing, found, places, share)

    def repeated(self, points: Bools, column: int) -> Bools:
        """Which of these points (N,) of a view, found, have something like them elsewhere in the
        other view.
        """
        i, j = self.pair.i, self.pair.j
        asked = self.agreeing[points[self.agreeing[:, column]]]
        out = np.zeros(len(points), bool)
        if column == 0:
            out[_elsewhere_in(j, i, asked[:, ::-1])[:, 1]] = True
        else:
            out[_elsewhere_in(i, j, asked)[:, 1]] = True
        return out


def _masks(pair: Pair, matches: Indices) -> tuple[Bools, Bools]:
    """Which of i's points and of j's are in matches (M, 2)."""
    masks = np.zeros(len(pair.i.observed.uv), bool), np.zeros(len(pair.j.observed.uv), bool)
    for column in (0, 1):
        masks[column][matches[:, column]] = True
    return masks
