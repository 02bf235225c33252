"""The operator's correspondences as the solver and the aligner use them: between keyframes.

A click belongs to the view it was made in. That view hangs on a keyframe, so that the click can be
carried there and goes on helping when the robot has moved on.
"""

from collections import Counter

import numpy as np
import numpy.typing as npt

from pose_server.correspondences.book import Kept
from pose_server.fleet.types import ClickFactor
from pose_server.geometry.consensus import OUTLIER_CHI2
from pose_server.geometry.point_pairs import PointPairs
from pose_server.geometry.se3 import transform
from pose_server.pairs.starts import Clicks
from pose_server.pairs.tracking import Attached
from pose_server.site import RobotPair, Site
from protocol.messages import CorrespondenceStatus, ViewName

Floats = npt.NDArray[np.floating]
Judgement = tuple[CorrespondenceStatus, float | None, float | None]


def click_factors(site: Site) -> list[ClickFactor]:
    """All live correspondences whose views hang on keyframes of the graph."""
    nodes = set(site.keyframes())
    factors = []
    for kept in site.book.all():
        i, j = site.attached(kept.item.view_i), site.attached(kept.item.view_j)
        if i is None or j is None or i.keyframe not in nodes or j.keyframe not in nodes:
            continue
        p_a, C_a = _carried(i, kept.p_i, kept.C_i)
        p_b, C_b = _carried(j, kept.p_j, kept.C_j)
        factors.append(ClickFactor(i.keyframe, j.keyframe, p_a, p_b, C_a, C_b, kept.item.id))
    return factors


def clicks_between(site: Site, a: str, b: str) -> tuple[tuple[ViewName, ViewName], Clicks] | None:
    """The keyframes that most of a pair's correspondences hang on, and these as seen from there."""
    placed: list[tuple[tuple[ViewName, ViewName], Kept, Attached, Attached]] = []
    for kept in site.book.of(a, b):
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
    rows_i, rows_j = [], []
    for keyframes, kept, i, j in placed:
        if keyframes == views:
            rows_i.append(_seen(site, i, kept.p_i, kept.C_i))
            rows_j.append(_seen(site, j, kept.p_j, kept.C_j))
    at_i, at_j = np.array(rows_i), np.array(rows_j)
    return views, Clicks(at_i[:, :2], at_j[:, :2], at_i[:, 2], at_j[:, 2], at_i[:, 3], at_j[:, 3])


def judge(site: Site) -> list[RobotPair]:
    """Tells the book how each correspondence fits the solution; the pairs whose judgement
    changed.
    """
    changed = []
    for pair in site.book.pairs():
        verdicts = {kept.item.id: _judged(site, kept) for kept in site.book.of(*pair)}
        if site.book.set_status(pair, verdicts):
            changed.append(pair)
    return changed


def _judged(site: Site, kept: Kept) -> Judgement:
    T_i_j = site.relative(kept.item.view_i, kept.item.view_j)
    if T_i_j is None:
        return "unused", None, None
    p = transform(T_i_j, kept.p_j[None])[0]
    u, v, w = site.views[kept.item.view_i].camera.K @ p
    residual_px = (
        float(np.hypot(u / w - kept.item.pixel_i[0], v / w - kept.item.pixel_i[1]))
        if w > 0
        else 1e6
    )
    wrong = contradicts(T_i_j, (kept.p_i, kept.C_i), (kept.p_j, kept.C_j))
    status = "outlier" if wrong else "accepted"
    return status, float(np.linalg.norm(kept.p_i - p)), residual_px


def contradicts(T_i_j: Floats, at_i: tuple[Floats, Floats], at_j: tuple[Floats, Floats]) -> bool:
    """Whether a clicked point, lifted in both views to ((3,) place, (3, 3) covariance), is too far
    from itself under a relative pose.
    """
    (p_i, C_i), (p_j, C_j) = at_i, at_j
    clicked = PointPairs(p_i[None], p_j[None], C_i[None], C_j[None])
    return float(clicked.distance2(T_i_j)[0]) > OUTLIER_CHI2


def _carried(here: Attached, p: Floats, C: Floats) -> tuple[Floats, Floats]:
    R = here.T_keyframe_view[:3, :3]
    return transform(here.T_keyframe_view, p[None])[0], R @ C @ R.T


def _seen(site: Site, here: Attached, p: Floats, C: Floats) -> tuple[float, float, float, float]:
    """(u, v, z, sigma z) of a clicked point in its keyframe."""
    point, covariance = _carried(here, p, C)
    u, v, w = site.views[here.keyframe].camera.K @ point
    return u / w, v / w, float(point[2]), float(np.sqrt(covariance[2, 2]))
