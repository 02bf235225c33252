"""What clicks in two images tell by themselves, before a server has said anything: whether they
are enough, far enough apart, not on one line, and whether the distances between them agree.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.assist.picking import projected
from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.model.records import Entry, Pick, PixelUV
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.float64]
NEEDED = 3  # points that say where a robot is
NEAR_PX = 12.0  # points nearer to each other say hardly more than one
_ON_A_LINE = 0.06  # second extent over the first
_SHARE = 0.1  # of a distance that may differ for reasons nobody models
_CLICK_PX = 3.0
_SIGMAS = 3.0
_MOST = 4096


@dataclass(frozen=True)
class Lifted:
    """The point (3,) under a click in its camera's frame and its sigma, m; K of the camera."""

    point: Floats
    sigma_m: float
    K: Floats


@dataclass(frozen=True)
class Misfit:
    """Two entries of a list, by their numbers, which are so far apart in i and in j; metres."""

    a: int
    b: int
    in_i_m: float
    in_j_m: float


@dataclass(frozen=True)
class Wrong:
    """A point that the others contradict.

    Attributes:
        id: the server's; `number` in the list.
        side: the image that `clicked` and `fits` are in.
        clicked: where it was clicked.
        fits: where its other half is by the others; none where that is not known.
        off_m, off_px: how far it is from there, as far as that is known.
    """

    id: int
    number: int
    side: int
    clicked: PixelUV
    fits: PixelUV | None
    off_m: float | None
    off_px: float | None


class ClickedPoints:
    """Lifts clicks while depths of their views are known, and remembers them."""

    def __init__(self, session: OperatorSession) -> None:
        self._session = session
        self._lifted: dict[tuple[ViewName, PixelUV], Lifted] = {}

    def learn(self) -> None:
        """Lifts what the selected pair's list holds in views whose depths are known now."""
        for entry in self._session.entries():
            self.lifted(entry.pick)

    def lifted(self, pick: Pick) -> tuple[Lifted | None, Lifted | None]:
        """Both halves of a pick, as far as they are known."""
        return self.at(pick.view_i, pick.pixel_i), self.at(pick.view_j, pick.pixel_j)

    def at(self, view: ViewName, pixel: PixelUV) -> Lifted | None:
        """The point under a pixel; none where it has no depth, or that is not known."""
        known = self._lifted.get((view, pixel))
        depths = self._session.depths(view.robot)
        if known is not None or depths is None or depths.view != view:
            return known
        point = depths.lift(pixel)
        if point is None:
            return None
        if len(self._lifted) > _MOST:
            self._lifted.clear()
        found = Lifted(point, _sigma_m(depths, float(point[2])), depths.camera.K)
        self._lifted[view, pixel] = found
        return found

    # ---- what is wrong with them -----------------------------------------------------------------

    def misfits(self, entries: Sequence[Entry]) -> list[Misfit]:
        """Which of them are not as far apart in one image as in the other: of those in the same
        two views.
        """
        by_views: defaultdict[object, list[tuple[int, Lifted, Lifted]]] = defaultdict(list)
        for n, entry in enumerate(entries, start=1):
            in_i, in_j = self.lifted(entry.pick)
            if is_live(entry) and in_i and in_j:
                by_views[entry.pick.view_i, entry.pick.view_j].append((n, in_i, in_j))
        found = [misfit for points in by_views.values() for misfit in _misfits(points)]
        return sorted(found, key=lambda misfit: (misfit.a, misfit.b))

    def misfit(self, a: Pick, b: Pick) -> Misfit | None:
        """Whether two picks contradict each other; none where they agree, or nothing is known."""
        (a_i, a_j), (b_i, b_j) = self.lifted(a), self.lifted(b)
        if (a.view_i, a.view_j) != (b.view_i, b.view_j) or not (a_i and a_j and b_i and b_j):
            return None
        return next(iter(_misfits([(0, a_i, a_j), (1, b_i, b_j)])), None)

    def near(self, entries: Sequence[Entry]) -> tuple[int, int] | None:
        """The numbers of two points that are too near to each other in an image."""
        live = [(n, e) for n, e in enumerate(entries, start=1) if is_live(e)]
        pixels = np.array([(e.pick.pixel_i, e.pick.pixel_j) for _, e in live]).reshape(-1, 2, 2)
        for k in range(len(live) - 1):
            apart = np.linalg.norm(pixels[k + 1 :] - pixels[k], axis=2).min(axis=1)
            if (apart < NEAR_PX).any():
                return live[k][0], live[k + 1 + int(np.argmax(apart < NEAR_PX))][0]
        return None

    def on_one_line(self, entries: Sequence[Entry]) -> bool:
        """Whether three points or more lie nearly on one line: in space, or as far as depths are
        not known in both images.
        """
        picks = [entry.pick for entry in entries if is_live(entry)]
        if len(picks) < NEEDED:
            return False
        lifted = [self.lifted(pick)[0] for pick in picks]
        space = [one.point for one in lifted if one is not None]
        if len(space) == len(picks):
            return _is_line(np.array(space))
        return _is_line(np.array([p.pixel_i for p in picks])) and _is_line(
            np.array([p.pixel_j for p in picks])
        )

    def wrong(self, entries: Sequence[Entry], side: int) -> Wrong | None:
        """The point that the others contradict: by the server's word, else by the distances.

        Args:
            entries: the list of the selected pair.
            side: the image to tell it in.
        """
        outliers = [e for e in entries if e.status == "outlier" and e.id is not None]
        worst = max(outliers, key=lambda e: e.residual_m or 0.0, default=None)
        entry = worst or self._odd_one(entries)
        if entry is None or entry.id is None:
            return None
        number = list(entries).index(entry) + 1
        clicked = entry.pick.pixel_j if side else entry.pick.pixel_i
        fits, off_m = self._where(entry, entries, side)
        off_px = None if fits is None else math.dist(clicked, fits)
        off_m = entry.residual_m if entry.status == "outlier" and entry.residual_m else off_m
        return Wrong(entry.id, number, side, clicked, fits, off_m, off_px)

    # ---- inside ----------------------------------------------------------------------------------

    def _odd_one(self, entries: Sequence[Entry]) -> Entry | None:
        """The one that contradicts two others, which agree."""
        misfits = self.misfits(entries)
        counts = {n: sum(n in (m.a, m.b) for m in misfits) for n in range(1, len(entries) + 1)}
        most = max(counts.values(), default=0)
        odd = [n for n, count in counts.items() if count == most]
        return entries[odd[0] - 1] if most >= 2 and len(odd) == 1 else None

    def _where(
        self, entry: Entry, entries: Sequence[Entry], side: int
    ) -> tuple[PixelUV | None, float | None]:
        """Where the others put an entry in the image of a side, and how far off it is, metres."""
        here, there = self.lifted(entry.pick)[:: -1 if side else 1]
        T_here_there = self._T_here_there(entry, entries, side)
        if T_here_there is None or there is None:
            return None, None
        point = T_here_there[:3, :3] @ there.point + T_here_there[:3, 3]
        off_m = None if here is None else float(np.linalg.norm(point - here.point))
        K = there.K if here is None else here.K
        return projected(point, K), off_m

    def _T_here_there(self, entry: Entry, entries: Sequence[Entry], side: int) -> Floats | None:
        """Of both cameras: by the other points, else by the pair's alignment."""
        others = [e for e in entries if is_live(e) and e is not entry and e.status != "outlier"]
        same = [
            self.lifted(e.pick)
            for e in others
            if (e.pick.view_i, e.pick.view_j) == (entry.pick.view_i, entry.pick.view_j)
        ]
        both = [(i.point, j.point) for i, j in same if i is not None and j is not None]
        if len(both) >= NEEDED and not _is_line(np.array([i for i, _ in both])):
            T_i_j = rigid(np.array([i for i, _ in both]), np.array([j for _, j in both]))
        else:
            known = self._session.alignment
            if known is None or known.T_i_j is None or known.verdict == "rejected":
                return None
            T_i_j = known.T_i_j
        return np.asarray(np.linalg.inv(T_i_j) if side else T_i_j, np.float64)


def is_live(entry: Entry) -> bool:
    """Whether an entry counts: it is neither rejected nor being erased."""
    return entry.status not in ("rejected", "erasing")


def _misfits(points: Sequence[tuple[int, Lifted, Lifted]]) -> list[Misfit]:
    """Of points in the same two views, each with its number: each beside all that follow."""
    p_i = np.array([i.point for _, i, _ in points])
    p_j = np.array([j.point for _, _, j in points])
    variance = np.array([i.sigma_m**2 + j.sigma_m**2 for _, i, j in points])
    found: list[Misfit] = []
    for k in range(len(points) - 1):
        in_i, in_j = (np.linalg.norm(p[k + 1 :] - p[k], axis=1) for p in (p_i, p_j))
        sigma = np.sqrt(variance[k + 1 :] + variance[k])
        allowed = _SIGMAS * sigma + _SHARE * np.maximum(in_i, in_j)
        for m in map(int, np.flatnonzero(np.abs(in_i - in_j) > allowed)):
            numbers = points[k][0], points[k + 1 + m][0]
            found.append(Misfit(*numbers, float(in_i[m]), float(in_j[m])))
    return found


def rigid(p_i: Floats, p_j: Floats) -> Floats:
    """(4, 4) T_i_j that brings points (N, 3) of frame j nearest to those of frame i (Kabsch)."""
    middle_i, middle_j = p_i.mean(axis=0), p_j.mean(axis=0)
    U, _, Vt = np.linalg.svd((p_i - middle_i).T @ (p_j - middle_j))
    R = U @ np.diag((1.0, 1.0, np.sign(np.linalg.det(U @ Vt)))) @ Vt
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, middle_i - R @ middle_j
    return T


def _is_line(points: Floats) -> bool:
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extents[1] <= _ON_A_LINE * extents[0])


def _sigma_m(depths: Depths, z: float) -> float:
    """How well a click is lifted: by the camera's noise, and by a hand."""
    c0, c1, c2 = depths.camera.noise.depth_sigma_m
    across = _CLICK_PX * z / float(depths.camera.K[0, 0])
    return math.hypot(c0 + c1 * z + c2 * z * z, across)
