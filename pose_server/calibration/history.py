"""What pairs of views said of the robots' depths, as much as is worth keeping."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration.clocks import Clocks
from fleetpose.pose_server.calibration.depth_comparison import DepthErrors
from fleetpose.pose_server.calibration.links import Links
from fleetpose.pose_server.calibration.mirrors import Mirrors
from fleetpose.pose_server.calibration.time_offset import TimeOffsets
from fleetpose.protocol.keys import RobotPair

Floats = npt.NDArray[np.floating]

KEPT_PER_PAIR = 6
MAX_PARTNERS = 24


@dataclass(frozen=True)
class DepthStatement:
    """One comparison: views i and j, and at what rate each robot went forward then, shares of the
    depth in a second (nan where it is not known).
    """

    errors: DepthErrors
    rate_i: float
    rate_j: float


@dataclass
class DepthHistory:
    """The newest comparisons of every two robots; the oldest partners of a robot make room.

    Attributes:
        moments: what robots' own views say of when their depths are measured.
        mirrors: which robots fit only if one of both is mirrored.
        clocks: what arrivals say of the robots' clocks.
        links: what robots tell of their links.
        changed: whether anything was said or forgotten since that was asked last.
        compared: the same of comparisons of two robots.
    """

    changed: bool = False
    compared: bool = False
    moments: TimeOffsets = field(default_factory=TimeOffsets)
    mirrors: Mirrors = field(default_factory=Mirrors)
    clocks: Clocks = field(default_factory=Clocks)
    links: Links = field(default_factory=Links)
    _pairs: dict[RobotPair, deque[DepthStatement]] = field(default_factory=dict)

    def note(self, i: str, j: str, said: DepthStatement) -> None:
        """Keeps a comparison of a view of robot i with one of robot j."""
        self.changed = self.compared = True
        if j < i:
            said = DepthStatement(said.errors.swapped(), said.rate_j, said.rate_i)
            i, j = j, i
        kept = self._pairs.pop((i, j), deque(maxlen=KEPT_PER_PAIR))
        kept.append(said)
        self._pairs[i, j] = kept
        for robot in (i, j):
            partners = [pair for pair in self._pairs if robot in pair]
            for pair in partners[:-MAX_PARTNERS]:
                del self._pairs[pair]

    def forget(self, robot: str) -> None:
        """Drops what was said of a robot: it has another calibration now."""
        self.changed = self.compared = True
        self.moments.forget(robot)
        self.mirrors.forget(robot)
        self._pairs = {pair: said for pair, said in self._pairs.items() if robot not in pair}

    def note_change(self) -> None:
        """Something was said of moments, mirrors, clocks or links."""
        self.changed = True

    def take_changes(self) -> tuple[bool, bool]:
        """Whether anything was said since this was asked last, and whether a comparison was."""
        changes = self.changed, self.compared
        self.changed = self.compared = False
        return changes

    @property
    def robots(self) -> list[str]:
        """Of which anything was said."""
        return sorted({robot for pair in self._pairs for robot in pair})

    def scales(self, without: set[str]) -> dict[RobotPair, tuple[float, float]]:
        """By pair of robots: log of the size that the first one sees over the second one's, and
        its sigma.
        """
        return {
            pair: (
                float(np.median([-one.errors.scale for one in said])),
                float(np.median([one.errors.scale_sigma for one in said])),
            )
            for pair, said in self._pairs.items()
            if not without & set(pair)
        }

    def bends(self, robot: str) -> dict[str, tuple[Floats, Floats]]:
        """By partner: how a robot's inverse depths are off (3,), 1/m, and its covariance (3, 3)."""
        return {
            partner: (
                np.median([e.bend_i for e in errors], axis=0),
                np.mean([e.covariance_i for e in errors], axis=0),
            )
            for partner, errors in (
                (partner, [one.errors for one in said]) for partner, said in self._of(robot)
            )
        }

    def inverse_depth(self, robot: str) -> float:
        """Median of a robot's views, 1/m."""
        return float(
            np.median([one.errors.inverse_depth[0] for _, said in self._of(robot) for one in said])
        )

    def paces(self, robot: str) -> tuple[Floats, Floats, Floats]:
        """Of comparisons in which a robot's pace is known: log of how much too long its depths
        were, the sigma, and the pace, shares of the depth in a second; (M,) each.
        """
        rows = [
            (-one.errors.scale, one.errors.scale_sigma, one.rate_i)
            for _, said in self._of(robot)
            for one in said
            if np.isfinite(one.rate_i)
        ]
        scales, sigmas, rates = np.array(rows, np.float64).reshape(-1, 3).T
        return scales, sigmas, rates

    def _of(self, robot: str) -> Iterator[tuple[str, list[DepthStatement]]]:
        """Partners of a robot and what was said, the robot being i."""
        for (a, b), said in self._pairs.items():
            if robot == a:
                yield b, list(said)
            elif robot == b:
                yield (
                    a,
                    [DepthStatement(one.errors.swapped(), one.rate_j, one.rate_i) for one in said],
                )
