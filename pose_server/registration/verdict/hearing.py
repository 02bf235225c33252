"""Clicks are evidence, and the images are asked about it: what do they say of a clicked pose?

At a pose it is known which salient points of either view the other one should show. At the right
one many of them are found there, at a wrong one those that chance puts there; and the surfaces of
one view are not seen through by the other.

The limits were set on 3 to 6 clicks, right ones and such as were all 11 % of the depth along the
surface off, in views of church_herzjesu and ring_temple from 40 to 95 deg apart (two draws each of
30 pairs): of right clicks that place a robot to 5 % of the depth 100 of 107 are supported and 1 is
refused; of wrong ones none of 102 is supported and 93 are refused.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.refine import NoiseScale
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.registration.verdict.explained import EXPLAINED, seen_from_both
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]

Says = Literal["for", "blank", "nothing", "against"]
"""`blank`: there is nothing that images could say; `nothing`: they could, and are not for it."""


@dataclass(frozen=True)
class HearingSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    # of the search around predicted places, share of the depth: clicks are so good
    radius: float = 0.02
    noise: NoiseScale = NoiseScale(1.0, 1.2)  # the same for all poses
    supports: float = 0.09  # found share of what is expected from which on images are for clicks
    refutes: float = 0.04  # and below which they are against them
    chance: float = 0.015  # share of the visible points that is found by chance
    few: int = 8  # and so many more
    telling: int = 80  # expected points: fewer may all be missed by a right pose
    blank: int = 40  # visible points: with fewer it is as if there were no images
    max_seen_through: float = 0.25  # share of a cloud that may be seen through, as in the verdict
    min_agree: float = 0.25  # share of it that must agree
    compared: int = 20  # points compared, to say so
    # position sigma, share of the depth, from which on surfaces may differ by the pose's own
    # error
    unsure: float = 0.05
    mostly: float = 0.5  # share that may be seen through then
    tilted_rad: float = np.radians(30.0)  # no robot knows gravity worse


HEARING = in_use("hearing", HearingSettings())


@dataclass(frozen=True)
class Hearing:
    """What became of clicks when their pair was asked.

    Attributes:
        accepted: of each click, whether it is believed.
        p_grave: probability that the pose of those that are believed is gravely off; 1 where none
            is or they determine no pose.
        told: empty, or what the operator should know.
    """

    accepted: tuple[bool, ...]
    p_grave: float = 1.0
    told: str = ""


@dataclass(frozen=True, eq=False)
class ByClicks:
    """The pose that clicks give by themselves: the paper's H*, as T_i_j.

    Attributes:
        T_i_j: (4, 4) the rigid motion nearest to the model.
        model: what they determine: translation, upright, rigid, affine, projective.
        ids: of the correspondences that it grew from.
    """

    T_i_j: Floats
    model: str
    ids: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Heard:
    """What the images say of a pose.

    Attributes:
        share: points found where they should be, of those that may be expected, 1 at most; less
            where the cloud is seen through.
        why: what speaks against it, in words.
    """

    T_i_j: Floats
    says: Says
    share: float
    why: str = ""


def hear(pair: Pair, T: Floats, sigma: float = 0.0) -> Heard:
    """Asks the images about a pose T_i_j, known to `sigma`, share of the depth.

    One that is known so badly that nobody is located by it is seen through by its own error: that
    alone speaks against it only where most is.
    """
    tilt = _tilt_rad(pair, T)
    if tilt > HEARING.tilted_rad:
        how = "upside down" if tilt > np.pi / 2 else f"tilted by {np.degrees(tilt):.0f} deg"
        return Heard(T, "against", 0.0, f"only with {pair.j.name.robot} {how}: another order?")
    seen = pair.agreement(T)
    most = HEARING.max_seen_through if sigma < HEARING.unsure else HEARING.mostly
    if seen.compared >= HEARING.compared and seen.through > most:
        why = f"{seen.through:.0%} of {pair.j.name.robot}'s cloud would be seen through"
        return Heard(T, "against", 0.0, why)
    if (
        seen.compared >= HEARING.compared
        and seen.agree < HEARING.min_agree
        and sigma < HEARING.unsure
    ):
        return Heard(T, "against", 0.0, f"only {seen.agree:.0%} of the surfaces would agree")
    if not pair.looks:  # a wall agrees wherever along it one clicks: that is no word for a pose
        return Heard(T, "nothing" if pair.i.shaped and pair.j.shaped else "blank", 0.0)
    visible, parallax_rad = _visible(pair, T)
    found = found_again(pair, T)
    expected = visible * max(
        float(np.exp(-((parallax_rad / EXPLAINED.parallax_rad) ** 2))), EXPLAINED.least_expected
    )
    share = min(found / max(expected, 1.0), 1.0) * max(0.0, 1.0 - 2.0 * seen.through)
    if share >= HEARING.supports and found >= HEARING.few + HEARING.chance * visible:
        return Heard(T, "for", share)
    if share < HEARING.refutes and expected >= HEARING.telling:
        why = f"of {visible} points that both images should show then, {found} are found"
        return Heard(T, "against", share, why)
    return Heard(T, "blank" if visible < HEARING.blank else "nothing", share)


def found_again(pair: Pair, T: Floats) -> int:
    """Matches around predicted places that agree with a pose."""
    matches = pair.guided(T, HEARING.radius)
    if len(matches) < 6:
        return 0
    try:
        return int(pair.scored(T, matches, HEARING.noise).inliers.sum())
    except DegenerateGeometryError:
        return 0


def _visible(pair: Pair, T: Floats) -> tuple[int, float]:
    """Salient points of the poorer view that the other one should show, and the median angle
    between both cameras' rays to them, rad.
    """
    i, j = pair.i.observed, pair.j.observed
    in_i, in_j = j.predict_in(i, T, 0.0).index, i.predict_in(j, inverse(T), 0.0).index
    if not len(in_i) or not len(in_j):
        return 0, 0.0
    parallax_rad, _ = seen_from_both(j.points[in_i], T)
    return min(len(in_i), len(in_j)), float(np.median(parallax_rad))


def _tilt_rad(pair: Pair, T: Floats) -> float:
    """Angle between both views' gravity at a pose; 0 where one of them does not know it."""
    if pair.i.up is None or pair.j.up is None:
        return 0.0
    return float(np.arccos(np.clip(pair.i.up @ T[:3, :3] @ pair.j.up, -1.0, 1.0)))
