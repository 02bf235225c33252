"""Is a found pose right? Four words, which are limits on the probability of a grave error and on
what determines the pose; each test has its reason. A false `verified` is the worst failure.
"""

from typing import Literal

from fleetpose.pose_server.registration.pair import GRAVE_POSITION, GRAVE_ROTATION_RAD
from fleetpose.pose_server.registration.verdict.evidence import Evidence
from fleetpose.pose_server.registration.verdict.grave_probability import (
    REJECTED_P_GRAVE,
    VERIFIED_P_GRAVE,
    stands,
)

Verdict = Literal["verified", "plausible", "ambiguous", "rejected"]

# What is verified is not gravely wrong: three sigma of its weakest direction, what a refit on all
# matches moves it, and what surfaces have moved it, lie within 5 % of the median depth together;
# three sigma of its rotation lie within 5 deg
_LEAST_FRONT, _TOLD_SIDES = 0.4, 20  # of the surfaces, from their front; of so many that tell
ELSEWHERE = (
    "a view shows the same more than once, and nothing that is there only once tells which this is"
)
_ALIAS = "the place repeats itself: another pose finds as much again"


def judge(e: Evidence, p_grave: float) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict on a pose that is gravely off with this probability, and the reasons for it."""
    if reasons := _against(e, p_grave):
        return "rejected", reasons
    if stands(e.lead):
        return "ambiguous", (_ALIAS,)
    if reasons := _doubts(e, p_grave):
        return "plausible", reasons
    return "verified", (f"{e.inliers} matches agree to {e.across_px:.2f} px",)


def needed_matches(ratio_matches: int) -> int:
    """How many unguided matches must agree: of more wrong ones more agree with some pose by
    chance.
    """
    return 10 + ratio_matches // 100


def _against(e: Evidence, p_grave: float) -> tuple[str, ...]:
    """Signs that the pose is wrong, or that nothing supports it."""
    return _said(
        (e.inliers < 8, f"only {e.inliers} matches agree, need 8"),
        (e.through > 0.25, f"{e.through:.0%} of the moved cloud is seen through"),
        (e.compared >= 20 and e.agree < 0.25, f"only {e.agree:.0%} of the surfaces agree in depth"),
        (e.position_sigma > 0.09, f"position sigma {e.position_sigma:.1%} of the depth"),
        (
            e.explained.sides >= _TOLD_SIDES and e.explained.front < _LEAST_FRONT,
            f"{1 - e.explained.front:.0%} of the surfaces would be seen from behind",
        ),
        (
            p_grave > REJECTED_P_GRAVE,
            f"of {e.explained.visible} points that both should see {e.explained.share:.0%} are "
            "found again",
        ),
    )


def _doubts(e: Evidence, p_grave: float) -> tuple[str, ...]:
    """What keeps a pose from being verified."""
    off = 3 * e.position_sigma + e.shift + e.pulled
    return _said(
        (e.exact < 14, f"{e.exact} matches agree to the pixel, need 14"),
        (
            off > GRAVE_POSITION,
            f"three sigma of the position, and what a refit and surfaces move it, are {off:.1%} "
            f"of the depth, need {GRAVE_POSITION:.0%}",
        ),
        (
            3 * e.rotation_sigma_rad > GRAVE_ROTATION_RAD,
            f"three sigma of the rotation are {3 * e.rotation_sigma_rad:.3f} rad, need "
            f"{GRAVE_ROTATION_RAD:.3f}",
        ),
        (e.shift > 0.015, f"a refit moves the pose by {e.shift:.1%} of the depth"),
        (e.compared < 20, f"{e.compared} surface points compared, need 20"),
        (
            p_grave > VERIFIED_P_GRAVE,
            f"gravely off with a probability of {p_grave:.1%}, at most {VERIFIED_P_GRAVE:.0%}: "
            f"{e.explained.share:.0%} of {e.explained.visible} points that both should see are "
            f"found again, {e.explained.unguided_share:.0%} by looks alone, and "
            f"{e.explained.holes:.0%} lie where none is found; {e.agree:.0%} of the surfaces "
            f"agree, {e.through:.0%} are seen through",
        ),
    )


def _said(*tests: tuple[bool, str]) -> tuple[str, ...]:
    return tuple(reason for holds, reason in tests if holds)
