"""The operator's correspondences as the solver and the aligner use them: between keyframes.

A click belongs to the view it was made in. That view hangs on a keyframe, so that the click can be
carried there and goes on helping when the robot has moved on.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.correspondences.store import Kept
from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose
from fleetpose.pose_server.geometry.consensus import OUTLIER_CHI2
from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import transform
from fleetpose.pose_server.pose_graph.types import ClickFactor
from fleetpose.pose_server.registration.operator_starts import FULL_POSE, Clicks
from fleetpose.pose_server.registration.verdict.hearing import Hearing
from fleetpose.pose_server.state.click_caches import JudgedAt
from fleetpose.pose_server.state.pairs import ViewPair
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import RobotPair
from fleetpose.protocol.messages import CorrespondenceStatus, ViewName

Floats = npt.NDArray[np.floating]
Judgement = tuple[CorrespondenceStatus, float | None, float | None]
_ALIKE = 1e-4
BEHIND_PX = 1e6  # told of a point that ends up behind the camera


def click_factors(site: Site) -> list[ClickFactor]:
    """The live correspondences whose views hang on keyframes of the graph. What their pair refuses
    is left out, and so is what it is still to be asked about.
    """
    nodes, before = set(site.keyframes()), site.clicks.factors
    factors: dict[int, tuple[tuple[object, ...], ClickFactor]] = {}
    for kept in site.correspondences.all():
        i, j = site.attached(kept.item.view_i), site.attached(kept.item.view_j)
        if i is None or j is None or i.keyframe not in nodes or j.keyframe not in nodes:
            continue
        p_grave = _heard_as(site, kept)
        if p_grave is None:
            continue
        number, made_of = kept.item.id, (i, j, kept.p_i, kept.p_j)
        known = before.get(number)
        if known is None or not _same(known[0], made_of):
            p_a, C_a = _carried(i, kept.p_i, kept.C_i)
            p_b, C_b = _carried(j, kept.p_j, kept.C_j)
            factor = ClickFactor(i.keyframe, j.keyframe, p_a, p_b, C_a, C_b, number)
            known = made_of, factor
        if known[1].p_grave != p_grave:
            known = known[0], replace(known[1], p_grave=p_grave)
        factors[number] = known
    site.clicks.keep_factors(factors)
    return [factor for _, factor in factors.values()]


def _heard_as(site: Site, kept: Kept) -> float | None:
    """How likely what a correspondence says is gravely off; None where it does not count.

    One that its pair was not asked about, because it hangs where nothing is known of the others,
    pulls at what is joined, and joins nothing.
    """
    record = site.pair(kept.item.view_i.robot, kept.item.view_j.robot)
    believed = record.heard.get((kept.item.id, kept.item.revision))
    if believed is None:
        return None if record.clicks_due or record.running else 1.0
    return record.clicks_grave if believed else None


def is_refused(site: Site, kept: Kept) -> bool:
    """Whether the images contradict a correspondence."""
    record = site.pair(kept.item.view_i.robot, kept.item.view_j.robot)
    return record.heard.get((kept.item.id, kept.item.revision)) is False


def note_heard(site: Site, pair: RobotPair, clicks: Clicks | None, hearing: Hearing | None) -> None:
    """Files what became of a pair's correspondences when the images were asked about them."""
    record = site.pair(*pair)
    if clicks is None or hearing is None:
        record.hear({}, 1.0, "")
        return
    heard = dict(zip(clicks.ids, hearing.accepted, strict=True)) if clicks.ids else {}
    if record.hear(heard, hearing.p_grave, hearing.told):
        site.say(hearing.told)
    site.want_solution()


def clicks_between(site: Site, a: str, b: str) -> tuple[tuple[ViewName, ViewName], Clicks] | None:
    """The keyframes that most of a pair's correspondences hang on, and all of these as seen from
    there, as far as the solution knows how other keyframes of the two robots stand to these.
    """
    placed: list[
        tuple[tuple[ViewName, ViewName], Kept, KeyframeRelativePose, KeyframeRelativePose]
    ] = []
    for kept in site.correspondences.of(a, b):
        i, j = site.attached(kept.item.view_i), site.attached(kept.item.view_j)
        if (
            i is not None
            and j is not None
            and i.keyframe in site.views
            and j.keyframe in site.views
        ):
            placed.append(((i.keyframe, j.keyframe), kept, i, j))
    if not placed:
        return None
    views = Counter(entry[0] for entry in placed).most_common(1)[0][0]
    rows, ids = [], []
    for _, kept, i, j in placed:
        seen_i = _seen(site, views[0], i, kept.p_i, kept.C_i)
        seen_j = _seen(site, views[1], j, kept.p_j, kept.C_j)
        if seen_i is not None and seen_j is not None:
            rows.append((*seen_i, *seen_j))
            ids.append((kept.item.id, kept.item.revision))
    u_i, v_i, z_i, sigma_i, u_j, v_j, z_j, sigma_j = np.array(rows).reshape(-1, 8).T
    uv_i, uv_j = np.column_stack((u_i, v_i)), np.column_stack((u_j, v_j))
    return views, Clicks(uv_i, uv_j, z_i, z_j, sigma_i, sigma_j, tuple(ids))


def judge(site: Site) -> list[RobotPair]:
    """Tells the book how each correspondence fits the solution; the pairs whose judgement
    changed.
    """
    changed = []
    before = site.clicks.judged
    now: dict[ViewPair, JudgedAt] = {}
    for pair in site.correspondences.pairs():
        by_views: dict[tuple[ViewName, ViewName], list[Kept]] = defaultdict(list)
        for kept in site.correspondences.of(*pair):
            by_views[kept.item.view_i, kept.item.view_j].append(kept)
        verdicts: dict[int, Judgement] = {}
        for views, clicked in by_views.items():
            points, T_i_j = [kept.p_i for kept in clicked], site.relative(*views)
            refused = tuple(is_refused(site, kept) for kept in clicked)
            known = before.get(views)
            if T_i_j is None:
                verdicts |= {
                    kept.item.id: ("outlier" if wrong else "unused", None, None)
                    for kept, wrong in zip(clicked, refused, strict=True)
                }
            elif (
                known
                and _same(known[0], points)
                and _alike(known[1], T_i_j, site.depth_m)
                and known[2] == refused
            ):
                now[views] = known
            else:
                now[views] = points, T_i_j, refused
                verdicts |= _judged(site, views, clicked, T_i_j, refused)
        if site.correspondences.set_status(pair, verdicts):
            changed.append(pair)
        _note_contradicted(site, pair)
    site.clicks.keep_judged(now)
    return changed


def _note_contradicted(site: Site, pair: RobotPair) -> None:
    """Operators are told where the fleet contradicts points that their own pair believes."""
    record = site.pair(*pair)
    believed = [
        kept
        for kept in site.correspondences.of(*pair)
        if record.heard.get((kept.item.id, kept.item.revision)) and record.clicks_grave < 1.0
    ]
    wrong = sum(kept.item.status == "outlier" for kept in believed)
    told = ""
    if wrong >= FULL_POSE and 2 * wrong > len(believed):
        told = (
            f"{wrong} points in {pair[0]} and {pair[1]} fit each other, but the rest of the fleet "
            "contradicts them: are these the same places in both images?"
        )
    if record.contradict(told):
        site.say(told)


def _same(before: Sequence[object], now: Sequence[object]) -> bool:
    """Whether these are the very same objects."""
    return len(before) == len(now) and all(a is b for a, b in zip(before, now, strict=True))


def _alike(T: Floats, other: Floats, depth_m: float) -> bool:
    """Whether two relative poses say the same of clicks, to a small share of a pixel."""
    off = np.abs(T - other)
    return bool(off[:3, :3].max() < _ALIKE and off[:3, 3].max() < _ALIKE * depth_m)


def _judged(
    site: Site,
    views: tuple[ViewName, ViewName],
    clicked: Sequence[Kept],
    T_i_j: Floats,
    refused: tuple[bool, ...],
) -> dict[int, Judgement]:
    """How the correspondences of two views fit a relative pose, by id."""
    pairs = point_pairs(clicked)
    p = transform(T_i_j, pairs.p_b)
    seen = p @ site.views[views[0]].camera.K.T
    pixels = np.array([kept.item.pixel_i for kept in clicked])
    with np.errstate(divide="ignore", invalid="ignore"):
        off_px = np.linalg.norm(seen[:, :2] / seen[:, 2:] - pixels, axis=1)
    off_px = np.where(seen[:, 2] > 0, off_px, BEHIND_PX)
    off_m = np.linalg.norm(pairs.p_a - p, axis=1)
    wrong = contradicts(T_i_j, pairs) | np.array(refused)
    return {
        kept.item.id: ("outlier" if wrong[k] else "accepted", float(off_m[k]), float(off_px[k]))
        for k, kept in enumerate(clicked)
    }


def point_pairs(clicked: Sequence[Kept]) -> PointPairs:
    """The points of correspondences in the views that they were clicked in."""
    columns = zip(*((k.p_i, k.p_j, k.C_i, k.C_j) for k in clicked), strict=True)
    return PointPairs(*(np.array(column) for column in columns))


def contradicts(T_i_j: Floats, clicked: PointPairs) -> npt.NDArray[np.bool_]:
    """(N,) whether clicked points, lifted in both views, are too far from themselves under a
    relative pose.
    """
    return clicked.distance2(T_i_j) > OUTLIER_CHI2


def _carried(here: KeyframeRelativePose, p: Floats, C: Floats) -> tuple[Floats, Floats]:
    R = here.T_keyframe_view[:3, :3]
    return transform(here.T_keyframe_view, p[None])[0], R @ C @ R.T


def _seen(
    site: Site, view: ViewName, here: KeyframeRelativePose, p: Floats, C: Floats
) -> tuple[float, float, float, float] | None:
    """(u, v, z, sigma z) of a clicked point in a keyframe of its robot, its own or another one;
    None where that does not have it before its camera, or is not known.
    """
    point, covariance = _carried(here, p, C)
    if here.keyframe != view:
        T = site.relative(view, here.keyframe)
        if T is None:
            return None
        point, covariance = transform(T, point[None])[0], T[:3, :3] @ covariance @ T[:3, :3].T
    if point[2] <= 0:
        return None
    u, v, w = site.views[view].camera.K @ point
    return u / w, v / w, float(point[2]), float(np.sqrt(covariance[2, 2]))
