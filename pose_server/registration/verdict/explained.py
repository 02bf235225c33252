"""What should be seen from there, and is found again?

At a claimed pose it is known which salient points of either view should appear in the other. A
right pose finds most of them again, an alias only the parts that repeat.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.geometry.features.free_space import hides
from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.features.patches import sides_seen
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class ExplainedSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    parts: int = 8  # across a view's width
    # places expected to be found in a part: none is found by chance in one of twenty
    no_chance: float = 3.0
    # what is found again falls off with the parallax p as exp(-(p / this)^2)
    parallax_rad: float = np.radians(70.0)
    least_expected: float = 0.2  # down to this share
    # places seen from directions nearer than this, radians
    easy_parallax_rad: float = np.radians(40.0)
    # and at scales nearer than this, logarithm, are easy to find again
    easy_scale: float = np.log(1.6)
    # probability that none of the points around a place is found though it is there
    chance: float = 0.001
    most_likely: float = 0.95  # highest probability that one is found
    least_around: int = 20  # points around a place that tell of a hole
    most_around: int = 60  # the same, at most
    asked_points: int = 300  # points of a view that are asked about
    least_told: int = 10  # of these, enough to tell a share
    strongest: int = 700  # visible places: weaker ones of a wide set are found now here, now there
    tilt: float = np.log(3.0)  # descriptors hardly stand a tilt of more than this, logarithm
    tilted_together: int = 9  # points by which a tilt is measured
    cell_px: float = 4.0  # copies of one spot in several tilted images are one place


EXPLAINED = in_use("explained", ExplainedSettings())

_LEAST_SPREAD_PX2, _LEAST_STRETCH = 1e-3, 1e-6  # numerical: no division by nothing


@dataclass(frozen=True)
class Explained:
    """How much of what both views should see in common is found in common.

    Attributes:
        visible: places of the poorer view that the other one should see.
        share: places that agree, over these.
        unguided_share: of the matches by descriptor alone between places that both should see, the
            ones that agree.
        holes: share of the visible points around which none is found, though that is no chance by
            what is found elsewhere; of the better view. A right pose finds less at a wide angle,
            but everywhere; an alias finds nothing of what stands about only once, in either view.
        parallax_rad: median angle between both cameras' rays to these places.
        scale: median of |log| of the ratio of both cameras' distances to them.
        front: share of the surfaces that are seen from their front, of the worse direction.
        sides: surfaces of which the side can be told, in that direction.
    """

    visible: int
    share: float
    unguided_share: float
    holes: float
    parallax_rad: float
    scale: float
    front: float
    sides: int


@dataclass(frozen=True)
class Visible:
    """One view's salient points that another should see.

    Attributes:
        mask: (N,) of all salient points.
        parallax_rad, scale: (M,) of those, see `Explained`.
        uv: (M, 2) pixels at which the other one should see them.
    """

    mask: Bools
    parallax_rad: Floats
    scale: Floats
    uv: Floats

    @property
    def easily(self) -> Bools:
        """(N,) which of them look much the same from there, so that they are hardly missed."""
        out = self.mask.copy()
        out[self.mask] = (self.parallax_rad < EXPLAINED.easy_parallax_rad) & (
            self.scale < EXPLAINED.easy_scale
        )
        return out


def explained(pair: Pair, T: Floats, agreeing: Indices, unguided: Bools) -> Explained:
    """What a pose explains.

    Args:
        pair: the views.
        T: T_i_j.
        agreeing: (M, 2) matches that agree with it.
        unguided: (R,) which of `pair.ratio` do.
    """
    of_i, of_j = visible_at(pair, T)
    places_i = count_places(pair.i.observed.uv[of_i.mask])
    places_j = count_places(pair.j.observed.uv[of_j.mask])
    found_i = count_places(pair.i.observed.uv[agreeing[:, 0]])
    found_j = count_places(pair.j.observed.uv[agreeing[:, 1]])
    expected = of_i.mask[pair.ratio[:, 0]] & of_j.mask[pair.ratio[:, 1]]
    front, sides = _sides(pair, T)
    return Explained(
        visible=min(places_i, places_j),
        share=min(found_i, found_j) / max(min(places_i, places_j), 1),
        holes=_holes_of_both(pair, of_i, of_j, agreeing),
        unguided_share=float((unguided & expected).sum() / max(expected.sum(), 1)),
        parallax_rad=_median(np.concatenate((of_i.parallax_rad, of_j.parallax_rad))),
        scale=_median(np.concatenate((of_i.scale, of_j.scale))),
        front=front,
        sides=sides,
    )


def visible_at(pair: Pair, T: Floats) -> tuple[Visible, Visible]:
    """What i's points and j's should be seen of in the other view at a pose T_i_j; several steps
    ask about one pose.
    """
    key = T.tobytes()
    if key not in pair.memo:
        pair.memo[key] = (
            visible_in(pair.i, pair.j, inverse(T), pair.sigma),
            visible_in(pair.j, pair.i, T, pair.sigma),
        )
    return pair.memo[key]


def _holes_of_both(pair: Pair, of_i: Visible, of_j: Visible, agreeing: Indices) -> float:
    """The smaller share of both views; the second is not asked where the first has none."""
    first = holes(pair.i.observed.uv, of_i, agreeing[:, 0])
    return min(first, holes(pair.j.observed.uv, of_j, agreeing[:, 1])) if first > 0.0 else 0.0


def visible_in(
    source: PreparedView, target: PreparedView, T_target_source: Floats, sigma: float
) -> Visible:
    """Which salient points of a view should be seen in another: they fall into its image, and
    nothing that it sees there hides them.
    """
    predicted = source.observed.predict_in(target.observed, T_target_source, 0.0)
    seen = ~hides(target.surface, predicted.uv, 1.0 / predicted.inverse_depth, sigma)
    mask = np.zeros(len(source.observed.uv), bool)
    mask[predicted.index[seen]] = True
    here = source.observed.points[predicted.index[seen]]
    return Visible(mask, *seen_from_both(here, T_target_source), predicted.uv[seen])


def holes(uv: Floats, visible: Visible, found: Indices) -> float:
    """Share of the visible points of a view around which none is found, though that is no chance.

    How likely a point is found is told by its angle and distance to both cameras, by how much its
    surroundings are tilted from one to the other, and by the share of all that are. Around it so
    many of the nearest ones are looked at that one of a thousand times none would be found; points
    around which too little may be expected do not count. Copies of one spot are one point.

    Args:
        uv: (N, 2) pixels of all salient points of the view.
        visible: those that the other one should see.
        found: numbers of those that are found again.
    """
    again = np.zeros(len(visible.mask), bool)
    again[found] = True
    index = np.flatnonzero(visible.mask)
    cells, place = np.unique(_cells(uv[index]), return_inverse=True)
    if len(cells) < EXPLAINED.least_around:
        return 0.0
    first = np.full(len(cells), len(index))
    np.minimum.at(first, place, np.arange(len(index)))  # the strongest copy of each place
    found_there = np.zeros(len(cells), bool)
    np.logical_or.at(found_there, place, again[index])
    some = np.sort(first)[: EXPLAINED.strongest]
    uv, there = uv[index[some]], visible.uv[some]
    parallax_rad, scale = visible.parallax_rad[some], visible.scale[some]
    again = found_there[place[some]]
    tree = cKDTree(uv)
    tilt = _log_tilt(uv, there, tree.query(uv, k=EXPLAINED.tilted_together)[1]) / EXPLAINED.tilt
    likely = np.exp(-((parallax_rad / EXPLAINED.parallax_rad) ** 2) - scale**2 - tilt**2)
    likely = np.clip(likely * again.sum() / max(likely.sum(), 1e-9), 0.0, EXPLAINED.most_likely)
    asked = slice(None, None, 1 + len(uv) // EXPLAINED.asked_points)
    _, nearest = tree.query(uv[asked], k=min(EXPLAINED.most_around, len(uv)))
    no_chance = np.cumsum(np.log1p(-likely)[nearest], axis=1) < np.log(EXPLAINED.chance)
    told = no_chance[:, -1]
    if told.sum() < EXPLAINED.least_told:
        return 0.0
    none = np.cumsum(again[nearest], axis=1)[np.arange(len(told)), no_chance.argmax(axis=1)] == 0
    return float((told & none).sum() / told.sum())


def _log_tilt(here: Floats, there: Floats, around: Indices) -> Floats:
    """(M,) log of how much more the surroundings of points are stretched one way than across it
    from one image to the other, their transition tilt (Morel and Yu 2009): by the affine map of
    pixels (M, 2) around each, given by number (M, K).
    """
    a, b = (uv[around] - uv[around].mean(axis=1, keepdims=True) for uv in (here, there))
    spread = np.einsum("nki,nkj->nij", a, a) + _LEAST_SPREAD_PX2 * np.eye(2)
    A = np.einsum("nki,nkj->nij", b, a) @ np.linalg.inv(spread)
    half = 0.5 * np.einsum("nij,nij->n", A, A)  # of the sum of the squared stretches
    apart = np.sqrt(np.maximum(half**2 - np.linalg.det(A) ** 2, 0.0))
    return 0.5 * np.log((half + apart) / np.maximum(half - apart, _LEAST_STRETCH))


def empty_parts(view: Observed, uv: Floats, again: Bools, rate: float | None = None) -> int:
    """How many pixels (N, 2) lie in parts of an image in which none of them is found `again` (N,),
    though by the share of all some should be, or by another one that is known.
    """
    rate = float(again.mean()) if rate is None else rate
    cells = np.floor(uv / (view.size[0] / EXPLAINED.parts)).astype(np.int64)
    part = cells[:, 1] * EXPLAINED.parts + cells[:, 0]
    places = np.bincount(part)
    found = np.bincount(part, weights=again)
    return int(places[(found == 0) & (rate * places >= EXPLAINED.no_chance)].sum())


def count_places(uv: Floats) -> int:
    """Distinct places among pixels (N, 2)."""
    return len(np.unique(_cells(uv)))


def _cells(uv: Floats) -> Indices:
    """(N,) a number for the place of each pixel (N, 2): copies have the same."""
    cells = np.rint(uv / EXPLAINED.cell_px).astype(np.int64)
    return cells[:, 0] << 32 | cells[:, 1]


def seen_from_both(points: Floats, T_target_source: Floats) -> tuple[Floats, Floats]:
    """Angle between both cameras' rays to points (M, 3), and |log| of the ratio of distances."""
    there = transform(T_target_source, points)
    turned = points @ T_target_source[:3, :3].T
    far_here, far_there = np.linalg.norm(points, axis=1), np.linalg.norm(there, axis=1)
    cosine = (turned * there).sum(axis=1) / np.maximum(far_here * far_there, 1e-12)
    ratio = np.maximum(far_there, 1e-12) / np.maximum(far_here, 1e-12)
    return np.arccos(np.clip(cosine, -1, 1)), np.abs(np.log(ratio))


def _sides(pair: Pair, T: Floats) -> tuple[float, int]:
    """The share of surfaces seen from their front, of the worse direction, and of how many."""
    both = (
        sides_seen(pair.j.surface.patches, T, pair.i.surface.K, pair.i.surface.size),
        sides_seen(pair.i.surface.patches, inverse(T), pair.j.surface.K, pair.j.surface.size),
    )
    told = [one for one in both if one.told] or both
    worse = min(told, key=lambda one: one.front)
    return worse.front, worse.told


def _median(values: Floats) -> float:
    return float(np.median(values)) if len(values) else 0.0
