"""What was worked out of the operator's correspondences at the last solve, and from what."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.pose_graph.types import ClickFactor
from fleetpose.pose_server.state.pairs import ViewPair

Floats = npt.NDArray[np.floating]
MadeOf = tuple[object, ...]
JudgedAt = tuple[list[Floats], Floats, tuple[bool, ...]]


@dataclass
class ClickCaches:
    """Nothing is worked out again whose ingredients are the same.

    Attributes:
        factors: of the last solve, by id of the correspondence, and what they were made of.
        judged: points clicked in two views, the relative pose that they were judged at last, and
            which of them their pair had refused then.
    """

    factors: Mapping[int, tuple[MadeOf, ClickFactor]] = field(default_factory=dict)
    judged: Mapping[ViewPair, JudgedAt] = field(default_factory=dict)

    def keep_factors(self, factors: Mapping[int, tuple[MadeOf, ClickFactor]]) -> None:
        """Of this solve."""
        self.factors = factors

    def keep_judged(self, judged: Mapping[ViewPair, JudgedAt]) -> None:
        """By this solution."""
        self.judged = judged
