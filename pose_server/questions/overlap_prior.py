"""How likely an operator finds the same points in two images of robots that nothing joins.

Of two parts of a fleet the alignments of their pairs of views give hypotheses: each found pose,
trusted or not, says where one whole part stands to the other. A hypothesis gains odds by how well
its own matches fit and by others that agree with it; it loses them by pairs of views that it puts
side by side though they did not align, and by pairs in which an operator found nothing. The chance
of a pair is then the share of what remains under which its views look at the same place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import inverse, rotation_angle
from fleetpose.pose_server.registration.verdict.evidence import Evidence
from fleetpose.pose_server.registration.verdict.words import needed_matches

Floats = npt.NDArray[np.floating]

# Log odds that a pose which is not verified is right, fitted to other recordings than those by
# which questions are judged: residuals across the epipolar lines over the pixel noise, sigma of the
# position over a usual one, matches that agree over those that chance brings together.
_ACROSS, _SIGMA, _MATCHES = -1.6, -0.5, 2.1
_USUAL_SIGMA = 0.03
_CLEAR_ACROSS = 0.7  # better residuals than this prove no more
_MOST_HYPOTHESES = 16
_AGREE_SHARE, _AGREE_RAD = 0.15, 0.17  # of the depth; wider than for joining: it is only asked
_BY_CHANCE = 0.04  # of wrong poses that agree with a given one
_MOST_SUPPORT = 3.0  # log odds by agreement: aliases of one structure agree with each other
_SEEN_DEG, _SEEN_WIDTH_DEG = 85.0, 9.0  # half of the pairs so far apart share points to click
_ALIGNS_DEG, _ALIGNS_WIDTH_DEG = 52.0, 6.0  # half of the pairs so far apart are verified
_MISSED_IF_ALIGNED, _IF_NOT_ALIGNED = 0.3, 0.7  # what the pair's own alignment adds to that
_SURE = 0.95  # that what should be seen or align, is or does
_GRID = 3  # pixels per side at which overlap is looked up


@dataclass(frozen=True, eq=False)
class Look:
    """How a robot looks at the scene: T_part_camera (4, 4) in the frame of its part, intrinsics
    (3, 3), image size in pixels, median depth in metres.
    """

    T_part_camera: Floats
    K: Floats
    size: tuple[int, int]
    depth_m: float

    @cached_property
    def sight(self) -> Floats:
        """(G, 3) places it looks at, in its own frame: a grid of pixels at the median depth."""
        width, height = self.size
        u, v = np.meshgrid(
            (np.arange(_GRID) + 0.5) * width / _GRID, (np.arange(_GRID) + 0.5) * height / _GRID
        )
        rays = np.column_stack((u.ravel(), v.ravel(), np.ones(u.size))) @ np.linalg.inv(self.K).T
        return rays * self.depth_m

    @cached_property
    def T_camera_part(self) -> Floats:
        """(4, 4), the other way round."""
        return inverse(self.T_part_camera)


@dataclass(frozen=True, eq=False)
class Attempt:
    """What is known of one pair of views of two parts: indices of the views in either part, the
    pose that was found with the log odds that it is right, how often an operator looked at the pair
    in vain, and the chance that it shares enough if no found pose is right.
    """

    a: int
    b: int
    T_a_b: Floats | None
    log_odds: float
    in_vain: int = 0
    otherwise: float = 0.1


def log_odds(evidence: Evidence | None) -> float:
    """That a pose which is not verified is right all the same."""
    if evidence is None or evidence.ratio_inliers == 0:
        return -6.0
    across = max(evidence.across_px / evidence.pixel_sigma_px, _CLEAR_ACROSS)
    matches = evidence.ratio_inliers / needed_matches(evidence.ratio_matches)
    return float(
        _ACROSS * np.log(across)
        + _SIGMA * np.log(max(evidence.position_sigma, 1e-3) / _USUAL_SIGMA)
        + _MATCHES * np.log(matches)
    )


def overlap_probabilities(
    part_a: Sequence[Look], part_b: Sequence[Look], tries: Sequence[Attempt]
) -> Floats:
    """(A, B) how likely the views of two parts share enough to click, what an operator saw in other
    pairs included, what they saw in the pair itself left out.
    """
    found = sorted((t for t in tries if t.T_a_b is not None), key=lambda t: -t.log_odds)
    found = found[:_MOST_HYPOTHESES]
    vain, otherwise = (np.zeros((len(part_a), len(part_b))) for _ in range(2))
    for one in tries:
        vain[one.a, one.b], otherwise[one.a, one.b] = one.in_vain, one.otherwise
    if not found:
        return otherwise
    weights = [float(np.exp((vain * np.log1p(-otherwise)).sum()))]
    seen: list[Floats] = [otherwise]
    poses = [_between(part_a, part_b, one) for one in found]
    depth_m = float(np.median([look.depth_m for look in (*part_a, *part_b)]))
    for one, T in zip(found, poses, strict=True):
        share, angle_deg = apart(part_a, part_b, T)
        likely = overlap_probability(share, angle_deg)
        aligns = _SURE * share * _falls(angle_deg, _ALIGNS_DEG, _ALIGNS_WIDTH_DEG)
        agree = [
            other is one or alike(T, T_other, depth_m)
            for other, T_other in zip(found, poses, strict=True)
        ]
        support = 0.0
        for other, agrees in zip(found, agree, strict=True):
            if agrees:
                aligns[other.a, other.b] = 0.0  # it did
            if agrees and other is not one:
                right = 1 / (1 + np.exp(-other.log_odds))
                support += np.log(1 - right + right / _BY_CHANCE)
        doubt = np.log1p(-aligns).sum() + (vain * np.log1p(-likely)).sum()
        weights.append(float(np.exp(one.log_odds + min(support, _MOST_SUPPORT) + doubt)))
        seen.append(likely)
    return np.tensordot(np.array(weights) / sum(weights), np.array(seen), 1)


def apart(part_a: Sequence[Look], part_b: Sequence[Look], T_a_b: Floats) -> tuple[Floats, Floats]:
    """If one part stands so to the other: (A, B) share of either view that falls into the other
    one, and the angle in degrees at which both look at it.
    """
    forward, angle_a = _towards(part_a, part_b, inverse(T_a_b))
    backward, angle_b = _towards(part_b, part_a, T_a_b)
    return 0.5 * (forward + backward.T), 0.5 * (angle_a + angle_b.T)


def overlap_probability(share: Floats, angle_deg: Floats) -> Floats:
    """How likely views that stand so share enough to click."""
    return _SURE * share * _falls(angle_deg, _SEEN_DEG, _SEEN_WIDTH_DEG)


def if_aligned(chance: Floats, aligned: npt.NDArray[np.bool_]) -> Floats:
    """The same for views of which it is known how they stand, given whether aligning them found
    just that.
    """
    return np.where(aligned, 1 - _MISSED_IF_ALIGNED * (1 - chance), _IF_NOT_ALIGNED * chance)


def alike(T_a_b: Floats, other: Floats, depth_m: float) -> bool:
    """Whether two poses are roughly the same."""
    shift = float(np.linalg.norm(T_a_b[:3, 3] - other[:3, 3])) / depth_m
    return shift < _AGREE_SHARE and rotation_angle(T_a_b[:3, :3].T @ other[:3, :3]) < _AGREE_RAD


def _towards(
    here: Sequence[Look], there: Sequence[Look], T_there_here: Floats
) -> tuple[Floats, Floats]:
    """(H, T) share of what each view here looks at that falls into each view there, and the angle
    in degrees between both at its middle.
    """
    T = T_there_here @ np.stack([look.T_part_camera for look in here])  # (H, 4, 4)
    sights = np.stack([look.sight for look in here])
    places = sights @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]  # (H, G, 3)
    into = np.stack([look.T_camera_part for look in there])
    seen = np.einsum("tij,hgj->htgi", into[:, :3, :3], places) + into[:, None, :3, 3]
    z = np.where(seen[..., 2] > 1e-6, seen[..., 2], np.inf)
    uv = np.einsum("tij,htgj->htgi", np.stack([o.K for o in there]), seen)[..., :2] / z[..., None]
    size = np.array([o.size for o in there], float)[:, None]
    inside = (uv >= 0).all(-1) & (uv < size).all(-1) & np.isfinite(z)
    middle = places[:, _GRID * _GRID // 2]
    to_here = T[:, :3, 3] - middle
    to_there = np.stack([look.T_part_camera[:3, 3] for look in there]) - middle[:, None]
    lengths = np.linalg.norm(to_here, axis=1)[:, None] * np.linalg.norm(to_there, axis=2)
    cosine = np.einsum("hi,hti->ht", to_here, to_there) / np.maximum(lengths, 1e-12)
    return inside.mean(-1), np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _between(part_a: Sequence[Look], part_b: Sequence[Look], one: Attempt) -> Floats:
    """T_a_b of the two parts by one alignment."""
    assert one.T_a_b is not None
    here, there = part_a[one.a].T_part_camera, part_b[one.b].T_part_camera
    return here @ one.T_a_b @ inverse(there)


def _falls(angle_deg: Floats, half_deg: float, width_deg: float) -> Floats:
    return 1.0 / (1.0 + np.exp((angle_deg - half_deg) / width_deg))
