"""How likely a found pose is gravely off, by all evidence together.

Every sign is taken in contrast to what a right pose shows at that parallax, scale and depth noise,
then all are added up (a logistic regression with the sign of each weight given). Both were fitted
by `pose-eval trust`, which prints them and judges them on places they were not fitted on.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.registration.verdict.evidence import Evidence
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class GraveProbabilitySettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    nothing: float = 0.003  # share of places that is as good as none: its logarithm stays finite
    few: float = 0.003  # share of what is seen through that is as good as none
    most_chi2: float = 25.0  # chi-square of a lack beyond which it says no more
    most_off: float = 0.5  # uncertainty beyond which it says no more, share of the depth
    # nine in ten right poses have no more holes than this at no parallax: .013 below .2 rad, .04
    # at .5, .05 at .9, .09 at 1.15, .13 at 1.5
    few_holes: float = 0.02
    few_per_rad: float = 0.06  # and so many more per radian
    most_holes: float = 0.15  # holes beyond these that say no more
    verified_p_grave: float = 0.03  # probability of a grave error below which a pose is verified
    rejected_p_grave: float = 0.9  # and from which on it is refused
    # A lead of so many sigmas is chance. In repeating facades and corridors no wrong pose led the
    # right one by four, where things that stand about only once gave right poses five to nine
    clear_lead: float = 1.0
    # A right pose is rarely likelier than this to be wrong by its own evidence: what is, is no
    # rival
    rival_p_grave: float = 0.2
    elsewhere_p_grave: float = 0.5  # What one of two alike things is taken for may be the other
    # sigmas that both explained shares together lack in right poses; a facade taken for its
    # mirror image lacks 4 to 6
    both_poor: float = 3.5
    most_poor: float = 4.0  # sigmas beyond these that say no more
    # log odds per sigma; set so that most mirror images of church_herzjesu are told
    per_sigma: float = 1.5


GRAVE_PROBABILITY = in_use("grave_probability", GraveProbabilitySettings())

_LEAST, _MOST = 1e-4, 1 - 1e-4  # derived: by the number of pairs that the model was fitted on


@dataclass(frozen=True)
class TrustModel:
    """Fitted numbers; see `pose-eval trust`.

    Attributes:
        expected: (4, 6) weights of `circumstances`, for the `shares` of a right pose.
        scatter: (4,) sigmas of right poses around these.
        weights: (S,) of `signs`, and `bias`: the log odds of a grave error.
    """

    expected: tuple[tuple[float, ...], ...]
    scatter: tuple[float, ...]
    weights: tuple[float, ...]
    bias: float


def circumstances(e: Evidence) -> Floats:
    """(6,) what a share depends on, though the pose is right."""
    parallax = e.explained.parallax_rad
    return np.array(
        (
            1.0,
            parallax,
            min(parallax, 1.5) ** 2,
            min(e.explained.scale, 1.5),
            np.log(max(e.explained.visible, 1) / 500),
            np.log(max(e.depth_sigma, 1e-3) / 0.01),
        )
    )


def shares(e: Evidence) -> Floats:
    """(4,) what a right pose has much of: log of the explained share and of the unguided share,
    logit of the agreement, and less the log of what is seen through.
    """
    agree = np.clip(e.agree, 0.02, 0.98)
    return np.array(
        (
            np.log(e.explained.share + GRAVE_PROBABILITY.nothing),
            np.log(e.explained.unguided_share + GRAVE_PROBABILITY.nothing),
            np.log(agree / (1 - agree)),
            -np.log(e.through + GRAVE_PROBABILITY.few),
        )
    )


def holes_beyond_few(e: Evidence) -> float:
    """By how much the share of points that are missing exceeds what right poses have."""
    few = GRAVE_PROBABILITY.few_holes + GRAVE_PROBABILITY.few_per_rad * e.explained.parallax_rad
    return max(e.explained.holes - few, 0.0)


def signs(e: Evidence, contrast: Floats) -> Floats:
    """(S,) signs of a grave error, each the larger the more likely one is.

    Args:
        e: the evidence.
        contrast: (4,) of its shares with what right poses have, sigmas; negative is poor.
    """
    lacking = np.maximum(-contrast, 0.0)
    return np.array(
        (
            *np.minimum(np.square(lacking), GRAVE_PROBABILITY.most_chi2),
            -np.log(max(e.exact, 1)),
            -np.log(max(e.ratio_inliers, 1)),
            -np.log(max(2 * e.exact - e.inliers, 1)),
            np.log(np.clip(e.depth_noise, 0.8, 4.0)),
            1 - e.explained.front if e.explained.sides >= 10 else 0.0,
            np.log(
                np.clip(
                    3 * e.position_sigma + e.shift + e.pulled, 0.003, GRAVE_PROBABILITY.most_off
                )
            ),
            min((e.rival + 1) / (e.rivalled + 1), 1.0),
            min(holes_beyond_few(e), GRAVE_PROBABILITY.most_holes),
        )
    )


CHI2_SIGNS = (
    "unexplained",
    "found_by_guidance_alone",
    "surfaces_disagree",
    "seen_through",
)
SIGNS = (
    *CHI2_SIGNS,
    "few_exact",
    "few_unguided",
    "hazy",
    "loose_depths",
    "from_behind",
    "undetermined",
    "rival",
    "holes",
)


def contrast(model: TrustModel, e: Evidence) -> Floats:
    """(4,) of the shares with what right poses have in these circumstances, sigmas."""
    expected = np.asarray(model.expected) @ circumstances(e)
    return (shares(e) - expected) / np.asarray(model.scatter)


def p_grave(e: Evidence, model: TrustModel) -> float:
    """Probability (0..1) that a pose with this evidence is gravely off."""
    lacking = contrast(model, e)
    log_odds = model.bias + float(np.dot(model.weights, signs(e, lacking)))
    poor = -float(lacking[0] + lacking[1]) - GRAVE_PROBABILITY.both_poor
    log_odds += GRAVE_PROBABILITY.per_sigma * float(np.clip(poor, 0.0, GRAVE_PROBABILITY.most_poor))
    return float(np.clip(1 / (1 + np.exp(-np.clip(log_odds, -30, 30))), _LEAST, _MOST))


def with_rivals(chance: float, leads: Sequence[float]) -> float:
    """The probability (0..1) of a grave error where other poses look right as well and one of all
    is: where none leads clearly each may be.

    Args:
        chance: that the winner is gravely off, on its own evidence.
        leads: by how many sigmas the winner leads each rival where both contradict each other.
    """
    others = sum(np.exp(-max(lead - GRAVE_PROBABILITY.clear_lead, 0.0)) for lead in leads)
    return float(np.clip(1 - (1 - chance) / (1 + others), _LEAST, _MOST))


def stands(lead: float) -> bool:
    """Whether a rival is likelier than a verified pose's chance to be wrong allows."""
    return lead < GRAVE_PROBABILITY.clear_lead - float(np.log(GRAVE_PROBABILITY.verified_p_grave))
