"""What people click wrongly: the next window, the other side, all of it one step along a facade.

A question is answered by a few points in two views. The functions here take true answers, in the
order in which the points would be picked, and spoil what is clicked in the second view. They return
none where such a mistake cannot be made. All of them are without the noise of a hand.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.protocol.clouds import decode_salient, points_of
from fleetpose.protocol.messages import View

MistakeKind = Literal["alike", "one", "step", "mirrored"]

NEAR_PX = 4.0
"""A pixel shows a point of the cloud, or is a salient point, if that is so near."""
ELSEWHERE_SHARE = 0.06
"""Of the depth: two places are two, not one that is measured twice, if they are so far apart."""
_SAME_DEPTH = 0.05  # a step ends on a surface that is as far away as it should be, share
_ALIKE_SHARE = 0.75  # of the usual distance of two descriptors: more is not alike
_STEP_VOTES = 6  # pairs of alike places that are one and the same step apart
_STEP_SHARE = (0.1, 0.25)  # of the depth, where nothing repeats
_TRIES = 30  # of points for a mirror
_MARKS = 500  # salient points that are compared with each other


@dataclass(frozen=True)
class Sight:
    """A view as an operator sees it, with the depths behind it.

    Attributes:
        K: (3, 3) px.
        size: width and height.
        uv, xyz: (N, 2) pixels and (N, 3) points, camera frame, metres.
        marks_uv, marks_xyz: the same of (M,) places that catch the eye.
        looks: (M, D) what these look like, descriptors.
    """

    K: Floats
    size: tuple[int, int]
    uv: Floats
    xyz: Floats
    marks_uv: Floats
    marks_xyz: Floats
    looks: Floats

    def point(self, pixel: Floats) -> Floats | None:
        """(3,) the point at a pixel, as far away as the nearest known one; none where none is."""
        gap_px, nearest = self._tree.query(pixel, distance_upper_bound=NEAR_PX)
        if not np.isfinite(gap_px):
            return None
        return np.linalg.inv(self.K) @ (*pixel, 1.0) * self.xyz[int(nearest), 2]

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.uv)

    @cached_property
    def along(self) -> Floats:
        """(3,) unit vector along the longest level direction of what is seen."""
        level = self.xyz[:, (0, 2)] - np.median(self.xyz[:, (0, 2)], axis=0)
        x, z = np.linalg.eigh(level.T @ level)[1][:, 1]
        return np.array((x, 0.0, z))

    def pixel(self, point: Floats) -> Floats | None:
        """(2,) where a point of the camera frame is in the image; none outside."""
        if point[2] <= 0:
            return None
        pixel = (self.K @ point)[:2] / point[2]
        inside = ((pixel >= 0) & (pixel <= np.subtract(self.size, 1))).all()
        return pixel if inside else None


@dataclass(frozen=True)
class WrongAnswer:
    """A wrong answer: (N, 2) pixels of both views, and (N,) which of these clicks are wrong."""

    kind: MistakeKind
    pixels: tuple[Floats, Floats]
    wrong: npt.NDArray[np.bool_]


def sight_of(view: View) -> Sight:
    """What a robot's view shows, as the robot sent it."""
    cloud, salient, K = points_of(view), decode_salient(view.salient), view.camera.K
    with np.errstate(divide="ignore", invalid="ignore"):
        z = 1.0 / salient.inverse_depth.astype(np.float64)
    there = np.isfinite(z) & (z > 0)
    uv = salient.uv[there].astype(np.float64)
    rays = np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(K).T
    size = (view.camera.width, view.camera.height)
    looks = salient.descriptors[there].astype(np.float64)
    return Sight(K, size, cloud.uv, cloud.xyz, uv, rays * z[there, None], looks)


def alike(
    true: tuple[Floats, Floats], j: Sight, count: int, rng: np.random.Generator
) -> WrongAnswer | None:
    """Each point at another place of the second view that looks most like the right one: the next
    window, or any.
    """
    del rng
    places = [(uv_i, _most_alike(j, uv_j)) for uv_i, uv_j in _each(true)]
    pairs = [(uv_i, uv_j) for uv_i, uv_j in places if uv_j is not None]
    return _answer("alike", pairs[:count]) if len(pairs) >= count else None


def one(
    true: tuple[Floats, Floats], j: Sight, count: int, rng: np.random.Generator
) -> WrongAnswer | None:
    """All points are right but one, which is at another place that looks like the right one."""
    spoilt = alike(true, j, 1, rng)
    if spoilt is None:
        return None
    (uv_i,), (uv_j,) = spoilt.pixels
    others = [(a, b) for a, b in _each(true) if not np.array_equal(a, uv_i)][: count - 1]
    if len(others) < count - 1:
        return None
    at = int(rng.integers(count))
    answer = _answer("one", [*others[:at], (uv_i, uv_j), *others[at:]])
    return WrongAnswer("one", answer.pixels, np.arange(count) == at)


def step(
    true: tuple[Floats, Floats], j: Sight, count: int, rng: np.random.Generator
) -> WrongAnswer | None:
    """All points one and the same step aside in the world, on surfaces that are there: they fit
    each other as well as right ones do. The step is the one that the place repeats itself by.
    """
    offset = repeats_by(j)
    if offset is None:
        offset = rng.uniform(*_STEP_SHARE) * float(np.median(j.xyz[:, 2])) * j.along
    for sign in rng.permutation((-1.0, 1.0)):
        places = [(uv_i, _moved(j, uv_j, sign * offset)) for uv_i, uv_j in _each(true)]
        pairs = [(uv_i, uv_j) for uv_i, uv_j in places if uv_j is not None]
        if len(pairs) >= count:
            return _answer("step", pairs[:count])
    return None


def mirrored(
    true: tuple[Floats, Floats], j: Sight, count: int, rng: np.random.Generator
) -> WrongAnswer | None:
    """Left taken for right: the points are where an upright mirror in their middle shows them."""
    known = [(uv_i, uv_j) for uv_i, uv_j in _each(true) if j.point(uv_j) is not None]
    for _ in range(_TRIES if len(known) >= count > 1 else 0):
        picked = [known[k] for k in rng.choice(len(known), count, replace=False)]
        twins = _in_mirror(j, [uv_j for _, uv_j in picked])
        if twins is not None:
            answer = _answer("mirrored", [(a, b) for (a, _), b in zip(picked, twins, strict=True)])
            off_px = [np.linalg.norm(b - uv) for (_, uv), b in zip(picked, twins, strict=True)]
            wrong = np.array(off_px) > 2.0 * NEAR_PX  # more than a hand's noise
            if wrong.sum() > 1:
                return WrongAnswer("mirrored", answer.pixels, wrong)
    return None


MISTAKES: dict[
    MistakeKind,
    Callable[[tuple[Floats, Floats], Sight, int, np.random.Generator], WrongAnswer | None],
] = {"alike": alike, "one": one, "step": step, "mirrored": mirrored}


def mistaken(
    true: tuple[Floats, Floats], j: Sight, count: int, rng: np.random.Generator
) -> WrongAnswer | None:
    """Any of these mistakes by chance, of those that can be made here.

    Args:
        true: (N, 2) pixels of both views that show the same points, in the order of picking.
        j: the second view.
        count: how many are clicked.
        rng: of the choice.
    """
    if len(j.xyz) < 2:
        return None
    for kind in rng.permutation(list(MISTAKES)):
        answer = MISTAKES[kind](true, j, count, rng)
        if answer is not None:
            return answer
    return None


def repeats_by(view: Sight) -> Floats | None:
    """(3,) the step by which a view's surfaces repeat themselves: the difference that most pairs of
    places have in common which look alike. None where no step has several.
    """
    steps = _steps(view)
    if not len(steps):
        return None
    near_m = 0.5 * ELSEWHERE_SHARE * float(np.median(view.marks_xyz[:, 2]))
    fits = np.linalg.norm(steps[:, None] - steps[None], axis=2) < near_m
    most = int(fits.sum(axis=1).argmax())
    return steps[fits[most]].mean(axis=0) if fits[most].sum() >= _STEP_VOTES else None


def _steps(view: Sight) -> Floats:
    """(N, 3) from each mark to the one most like it elsewhere, all to the right."""
    some = slice(None, None, max(len(view.looks) // _MARKS, 1))
    xyz, looks = view.marks_xyz[some], view.looks[some]
    if len(looks) < 2:
        return np.zeros((0, 3))
    apart = np.linalg.norm(xyz[:, None] - xyz[None], axis=2) > ELSEWHERE_SHARE * xyz[:, 2:]
    distance = _distances(looks, looks)
    limit = _ALIKE_SHARE * float(np.median(distance))
    distance[~apart] = np.inf
    nearest = distance.argmin(axis=1)
    found = distance[np.arange(len(looks)), nearest] < limit
    steps = xyz[nearest[found]] - xyz[found]
    return steps * np.where(steps[:, :1] < 0, -1.0, 1.0)


def _most_alike(j: Sight, pixel: Floats) -> Floats | None:
    """The pixel of the place most like the one at a pixel; none where nothing is like it."""
    gaps = np.linalg.norm(j.marks_uv - pixel, axis=1)
    if not len(gaps) or gaps.min() > NEAR_PX:
        return None
    mark = int(gaps.argmin())
    distance = _distances(j.looks[mark : mark + 1], j.looks)[0]
    limit = _ALIKE_SHARE * float(np.median(distance))
    apart_m = np.linalg.norm(j.marks_xyz - j.marks_xyz[mark], axis=1)
    distance[apart_m < ELSEWHERE_SHARE * j.marks_xyz[mark, 2]] = np.inf
    best = int(distance.argmin())
    place = j.marks_uv[best] + pixel - j.marks_uv[mark]
    inside = ((place >= 0) & (place <= np.subtract(j.size, 1))).all()
    return place if distance[best] < limit and inside else None


def _moved(j: Sight, pixel: Floats, offset: Floats) -> Floats | None:
    """Where the place at a pixel is after a step; none where no surface is as far away as that."""
    p = j.point(pixel)
    there = None if p is None else j.pixel(p + offset)
    if p is None or there is None:
        return None
    surface = j.point(there)
    z = p[2] + offset[2]
    return there if surface is not None and abs(surface[2] / z - 1.0) < _SAME_DEPTH else None


def _in_mirror(j: Sight, pixels: list[Floats]) -> list[Floats] | None:
    """Where an upright mirror shows the places at some pixels; none if one is nowhere."""
    points = np.array([j.point(pixel) for pixel in pixels])
    offsets = (points - points.mean(axis=0)) @ j.along
    twins = [j.pixel(twin) for twin in points - 2.0 * np.outer(offsets, j.along)]
    found = [twin for twin in twins if twin is not None and j.point(twin) is not None]
    return found if len(found) == len(pixels) else None


def _distances(a: Floats, b: Floats) -> Floats:
    """(N, M) between descriptors (N, D) and (M, D)."""
    squared = (a**2).sum(1)[:, None] + (b**2).sum(1)[None] - 2.0 * a @ b.T
    return np.sqrt(np.maximum(squared, 0.0))


def _each(true: tuple[Floats, Floats]) -> list[tuple[Floats, Floats]]:
    return list(zip(*true, strict=True))


def _answer(kind: MistakeKind, pairs: list[tuple[Floats, Floats]]) -> WrongAnswer:
    pixels = np.array(pairs, np.float64).reshape(-1, 2, 2)
    return WrongAnswer(kind, (pixels[:, 0], pixels[:, 1]), np.ones(len(pixels), bool))
