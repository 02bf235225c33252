"""What raises the weight of a pair that waits."""

from dataclasses import dataclass
from typing import Literal

Line = Literal["joining", "unlikely", "sharpening"]


@dataclass(frozen=True)
class Weights:
    """What raises a pair's weight, and how long one rests that failed. None of it was fitted.

    Attributes:
        clicks: what the pair's live correspondences add, as a share of its own weight, once there
            are three; fewer add in proportion, more add no more. The paper has operators make at
            most three per pair: they make a pose.
        error: the most that the error of its last alignment adds, as a share of its own weight. An
            error of 1 % of the depth adds it once. Some bound is needed: a pair that is hopelessly
            off must not keep all others waiting.
        retry_s: rest of a pair after an alignment failed, seconds; each failure in a row doubles
            it. 10 s is what doubles the weight of a pair that waits (`weighted_round_robin.AGE_S`).
    """

    clicks: float = 1.0
    error: float = 2.0
    retry_s: float = 10.0
