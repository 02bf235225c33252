"""Is a found pose right? Four words, which are limits on the probability of a grave error and on
what determines the pose; each test has its reason. A false `verified` is the worst failure.
"""

from dataclasses import dataclass
from typing import Literal

from fleetpose.pose_server.registration.pair import PAIR
from fleetpose.pose_server.registration.verdict.evidence import Evidence
from fleetpose.pose_server.registration.verdict.grave_probability import GRAVE_PROBABILITY, stands
from fleetpose.pose_server.tuned import in_use

Verdict = Literal["verified", "plausible", "ambiguous", "rejected"]


@dataclass(frozen=True)
class WordsSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    least_inliers: int = 8  # matches that agree, of any pose
    most_through: float = 0.25  # share of the cloud that is seen through
    least_agree: float = 0.25  # share of the surfaces that agree in depth
    compared: int = 20  # points of surfaces, to tell that
    most_sigma: float = 0.09  # of the position, share of the depth, of any pose
    least_front: float = 0.4  # share of the surfaces that are seen from their front
    told_sides: int = 20  # of so many that tell
    least_exact: int = 14  # matches that agree to the pixel, of a verified pose
    most_shift: float = 0.015  # by a refit of it, share of the depth
    needed_matches: int = 10  # unguided ones that agree
    needed_share: float = 0.01  # and so many of all: of more wrong ones more agree by chance


WORDS = in_use("words", WordsSettings())

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
    return WORDS.needed_matches + int(WORDS.needed_share * ratio_matches)


def _against(e: Evidence, p_grave: float) -> tuple[str, ...]:
    """Signs that the pose is wrong, or that nothing supports it."""
    return _said(
        (
            e.inliers < WORDS.least_inliers,
            f"only {e.inliers} matches agree, need {WORDS.least_inliers}",
        ),
        (e.through > WORDS.most_through, f"{e.through:.0%} of the moved cloud is seen through"),
        (
            e.compared >= WORDS.compared and e.agree < WORDS.least_agree,
            f"only {e.agree:.0%} of the surfaces agree in depth",
        ),
        (
            e.position_sigma > WORDS.most_sigma,
            f"position sigma {e.position_sigma:.1%} of the depth",
        ),
        (
            e.explained.sides >= WORDS.told_sides and e.explained.front < WORDS.least_front,
            f"{1 - e.explained.front:.0%} of the surfaces would be seen from behind",
        ),
        (
            p_grave > GRAVE_PROBABILITY.rejected_p_grave,
            f"of {e.explained.visible} points that both should see {e.explained.share:.0%} are "
            "found again",
        ),
    )


def _doubts(e: Evidence, p_grave: float) -> tuple[str, ...]:
    """What keeps a pose from being verified."""
    off = 3 * e.position_sigma + e.shift + e.pulled
    return _said(
        (
            e.exact < WORDS.least_exact,
            f"{e.exact} matches agree to the pixel, need {WORDS.least_exact}",
        ),
        (
            off > PAIR.grave_position,
            f"three sigma of the position, and what a refit and surfaces move it, are {off:.1%} "
            f"of the depth, need {PAIR.grave_position:.0%}",
        ),
        (
            3 * e.rotation_sigma_rad > PAIR.grave_rotation_rad,
            f"three sigma of the rotation are {3 * e.rotation_sigma_rad:.3f} rad, need "
            f"{PAIR.grave_rotation_rad:.3f}",
        ),
        (e.shift > WORDS.most_shift, f"a refit moves the pose by {e.shift:.1%} of the depth"),
        (
            e.compared < WORDS.compared,
            f"{e.compared} surface points compared, need {WORDS.compared}",
        ),
        (
            p_grave > GRAVE_PROBABILITY.verified_p_grave,
            f"gravely off with a probability of {p_grave:.1%}, at most "
            f"{GRAVE_PROBABILITY.verified_p_grave:.0%}: "
            f"{e.explained.share:.0%} of {e.explained.visible} points that both should see are "
            f"found again, {e.explained.unguided_share:.0%} by looks alone, and "
            f"{e.explained.holes:.0%} lie where none is found; {e.agree:.0%} of the surfaces "
            f"agree, {e.through:.0%} are seen through",
        ),
    )


def _said(*tests: tuple[bool, str]) -> tuple[str, ...]:
    return tuple(reason for holds, reason in tests if holds)
