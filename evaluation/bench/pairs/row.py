"""One pair of `pose-eval pairs`: what was answered, and how right it is."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.intervals import SharedPairs, share_over_views
from fleetpose.evaluation.metrics.scoring import nees
from fleetpose.evaluation.report.output import pose_cells

ENOUGH_SHARED = 30
VERDICTS = ("verified", "plausible", "ambiguous", "rejected")


@dataclass
class PairRow:
    """One pair: what was answered and how right it is. `T_i_j` is camera j in camera i.
    `mirrored`: one of both cameras flips its images; `named_mirrored`: that was said.
    """

    i: int
    j: int
    verdict: str
    align_ms: float
    T_i_j: Floats | None
    covariance: Floats | None
    T_i_j_true: Floats
    angle_deg: float
    position_error_m: float | None
    rotation_error_deg: float | None
    ok: bool
    grave: bool
    start: str
    inliers: int
    reasons: str
    shared: int | None = None
    overlap: float | None = None
    wide: bool = False
    p_grave: float = 1.0
    mirrored: bool = False
    named_mirrored: bool = False
    evidence: dict[str, float] = field(default_factory=dict)

    @property
    def enough_shared(self) -> bool:
        """Whether the truth knows enough points in common for the pair to be expected to work."""
        return self.shared is None or self.shared >= ENOUGH_SHARED

    def cells(self) -> dict[str, Any]:
        """One row of the CSV files."""
        fields = {name: value for name, value in vars(self).items() if value is not None}
        return {**pose_cells(self.T_i_j, self.covariance), **fields}

    def nees(self) -> float | None:
        """Squared error in units of the stated covariance; none without an answer."""
        if self.T_i_j is None or self.covariance is None:
            return None
        return nees(self.T_i_j_true, self.T_i_j, self.covariance)


def verified_nees(rows: Sequence[PairRow]) -> list[float]:
    """NEES of the verified pairs, nan where a covariance is singular."""
    values = [row.nees() for row in rows if row.verdict == "verified"]
    return [value for value in values if value is not None]


def share_of(rows: Sequence[PairRow], flags: Sequence[bool]) -> SharedPairs:
    """A share of pairs, with a bootstrap over their views."""
    return share_over_views([(row.i, row.j) for row in rows], flags)
