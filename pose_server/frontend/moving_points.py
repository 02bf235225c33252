"""Points that move against a robot's own views: people, other robots.

Two views of one robot, aligned, show where every matched point should be if it stood still. A match
that is far from there moved, or is wrong. Wrong matches point anywhere; what moves does so
together. So a match counts as moving only where most matches around it are off as well, by much
the same shift.
"""

from dataclasses import replace

import numpy as np

from fleetpose.pose_server.geometry.features.motion import Mask, moves_together
from fleetpose.pose_server.geometry.se3 import transform
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.verdict.evaluate import PairResult

MOST_MASKED = 0.4  # share of a view's points: more than that is no object before a still scene
_FAR_SIGMAS = 6.0  # of both points' noise, and
_LEAST_SHIFT_PX = 3.0  # in the image: what a slightly wrong pose does is no motion
_REACH_SHARE = 0.04  # of the image's width: how far around moving matches points are masked
_PIXEL_SIGMAS = 2.0  # matches of the same robot's views are off by more than features of one view


def moving_masks(pair: Pair, result: PairResult) -> tuple[Mask | None, Mask | None]:
    """Masks of both views of one robot, None where nothing moves or the alignment is not sure; what
    moves is seen through, and makes it `plausible` at best.
    """
    if result.verdict not in ("verified", "plausible") or result.T_i_j is None:
        return None, None
    i, j = pair.i.observed, pair.j.observed
    matches = pair.ratio
    moved = transform(result.T_i_j, j.points[matches[:, 1]])
    seen, z = i.project(moved)
    shift = i.uv[matches[:, 0]] - seen
    sigma_px = _PIXEL_SIGMAS * float(np.hypot(i.pixel_sigma_px, j.pixel_sigma_px))
    # what an error of the depth does in the image as the camera moves, to first order
    along = (
        j.points[matches[:, 1]]
        * (j.inverse_depth_sigma[matches[:, 1]] / j.inverse_depth[matches[:, 1]])[:, None]
    )
    nudged, _ = i.project(moved + along @ result.T_i_j[:3, :3].T)
    sigma = np.hypot(sigma_px, np.linalg.norm(nudged - seen, axis=1))
    length = np.linalg.norm(shift, axis=1)
    off = (z <= 0) | ((length > _FAR_SIGMAS * sigma) & (length > _LEAST_SHIFT_PX))
    moving = moves_together(i.uv[matches[:, 0]], shift, off)
    still = ~off
    if not moving.any() or not still.any():
        return None, None
    masks = (
        Mask(view.uv[matches[moving, k]], view.uv[matches[still, k]], _REACH_SHARE * view.size[0])
        for k, view in enumerate((i, j))
    )
    mask_i, mask_j = (
        mask if mask.hits(view.uv).mean() <= MOST_MASKED else None
        for mask, view in zip(masks, (i, j), strict=True)
    )
    return mask_i, mask_j


def without_moving(view: PreparedView, mask: Mask | None) -> PreparedView:
    """The view without its salient points, and without the sampled surface points, that move."""
    if mask is None or (gone := mask.hits(view.observed.uv)).mean() > MOST_MASKED:
        return view
    o, s = view.observed, view.surface
    kept = ~gone
    observed = replace(
        o,
        uv=o.uv[kept],
        inverse_depth=o.inverse_depth[kept],
        inverse_depth_sigma=o.inverse_depth_sigma[kept],
    )
    sampled = ~mask.hits(o.project(s.sample)[0])
    surface = replace(s, sample=s.sample[sampled] if sampled.any() else s.sample)
    return replace(view, observed=observed, descriptors=view.descriptors[kept], surface=surface)
