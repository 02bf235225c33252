"""Is a found pose right? Every test is a small function with its reason; a false `verified` is the
worst failure.
"""

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["verified", "plausible", "ambiguous", "rejected"]

# What is verified is not gravely wrong: three sigma of its weakest direction, what a refit on all
# matches moves it, and what surfaces have moved it, lie within 5 % of the median depth together;
# three sigma of its rotation lie within 5 deg
_VERIFIED_POSITION = 0.05
_VERIFIED_ROTATION_RAD = 0.087


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against a pose. Shares are of the median depth.

    Attributes:
        inliers: guided and ratio matches at distinct places that agree with the pose.
        ratio_inliers: of these, the ones found by descriptor alone.
        ratio_matches: matches found by descriptor alone.
        rival: ratio matches that agree with the best other pose.
        position_sigma: calibrated sigma of the weakest direction of the position, share.
        rotation_sigma_rad: calibrated sigma of the weakest rotation.
        across_px: sigma of the residuals across the epipolar lines.
        pixel_sigma_px: what it should be by the cameras' noise.
        shift: how far a refit on the matches moves the position that they led to, share.
        turn_rad: how far it turns.
        pulled: how far surfaces have moved that position, share.
        compared: points compared with the other surface.
        agree: share of these that agree in depth.
        through: share of these that the other view sees through.
        spread: smaller extent of the matches in the images, share of the image height.
        depth_noise: depth noise found over depth noise stated.
    """

    inliers: int
    ratio_inliers: int
    ratio_matches: int
    rival: int
    position_sigma: float
    rotation_sigma_rad: float
    across_px: float
    pixel_sigma_px: float
    shift: float
    turn_rad: float
    pulled: float
    compared: int
    agree: float
    through: float
    spread: float
    depth_noise: float


def judge(e: Evidence) -> tuple[Verdict, tuple[str, ...]]:
    """The verdict on a pose, and the reasons for it."""
    if reasons := _against(e):
        return "rejected", reasons
    if e.rival > 0.6 * e.ratio_inliers and e.rival >= 5:
        return "ambiguous", (f"another pose has {e.rival} matches, this one {e.ratio_inliers}",)
    if reasons := _doubts(e):
        return "plausible", reasons
    return "verified", (f"{e.inliers} matches agree to {e.across_px:.2f} px",)


def needed_matches(ratio_matches: int) -> int:
    """How many unguided matches must agree: of more wrong ones more agree with some pose by
    chance.
    """
    return 10 + ratio_matches // 100


def _against(e: Evidence) -> tuple[str, ...]:
    """Signs that the pose is wrong, or that nothing supports it."""
    return _said(
        (e.inliers < 8, f"only {e.inliers} matches agree, need 8"),
        (e.through > 0.25, f"{e.through:.0%} of the moved cloud is seen through"),
        (e.compared >= 20 and e.agree < 0.25, f"only {e.agree:.0%} of the surfaces agree in depth"),
        (e.position_sigma > 0.09, f"position sigma {e.position_sigma:.1%} of the depth"),
    )


def _doubts(e: Evidence) -> tuple[str, ...]:
    """What keeps a pose from being verified."""
    allowed_px = 1.5 * e.pixel_sigma_px
    needed = needed_matches(e.ratio_matches)
    off = 3 * e.position_sigma + e.shift + e.pulled
    return _said(
        (e.inliers < 14, f"{e.inliers} matches agree, need 14"),
        (e.ratio_inliers < needed, f"{e.ratio_inliers} unguided matches agree, need {needed}"),
        (
            off > _VERIFIED_POSITION,
            f"three sigma of the position, and what a refit and surfaces move it, are {off:.1%} "
            f"of the depth, need {_VERIFIED_POSITION:.0%}",
        ),
        (
            3 * e.rotation_sigma_rad > _VERIFIED_ROTATION_RAD,
            f"three sigma of the rotation are {3 * e.rotation_sigma_rad:.3f} rad, need "
            f"{_VERIFIED_ROTATION_RAD:.3f}",
        ),
        (
            e.across_px > allowed_px,
            f"residuals {e.across_px:.2f} px across epipolar lines, need {allowed_px:.2f}",
        ),
        (e.shift > 0.015, f"a refit moves the pose by {e.shift:.1%} of the depth"),
        (e.compared < 20, f"{e.compared} surface points compared, need 20"),
        (e.agree < 0.45, f"{e.agree:.0%} of the surfaces agree in depth, need 45 %"),
        (e.through > 0.10, f"{e.through:.0%} of the moved cloud is seen through, at most 10 %"),
    )


def _said(*tests: tuple[bool, str]) -> tuple[str, ...]:
    return tuple(reason for holds, reason in tests if holds)
