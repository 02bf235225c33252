"""Which pairs of `pose-eval pairs` deserve a look: closest calls, and what was not solved."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from fleetpose.evaluation.bench.pairs.row import PairRow
from fleetpose.evaluation.metrics.scoring import Limits

CLOSEST = 8
UNSOLVED, UNSOLVED_PER_VIEW = 24, 4
UNSOLVED_BELOW_DEG = 60.0
MIN_SHARED, MIN_OVERLAP = 30, 0.2
_TOLD = ("i", "j", "verdict", "angle_deg", "shared", "overlap", "position_error_m")
_TOLD += ("rotation_error_deg", "ok", "grave", "inliers", "start")


def closest_calls(rows: Sequence[PairRow], limits: Limits) -> dict[str, list[dict[str, Any]]]:
    """The verified answers with the largest errors, and the grave ones with the most support."""
    verified = [row for row in rows if row.verdict == "verified"]
    grave = [row for row in rows if row.grave]
    verified.sort(key=lambda row: -badness(row, limits))
    grave.sort(key=lambda row: -row.inliers)
    return {
        "verified_largest_error": [_call(row, limits) for row in verified[:CLOSEST]],
        "grave_most_support": [_call(row, limits) for row in grave[:CLOSEST]],
    }


def badness(row: PairRow, limits: Limits) -> float:
    """How far the error goes into what is grave, 1 being the limit; inf without an answer."""
    if row.position_error_m is None or row.rotation_error_deg is None:
        return float("inf")
    return max(row.position_error_m / limits.grave_m, row.rotation_error_deg / limits.grave_deg)


def unsolved(rows: Sequence[PairRow], rgbd: bool) -> list[PairRow]:
    """Pairs below 60 deg that see enough of the same and are not right, the worst first.

    False verdicts come first, then what should have been easiest. No view is shown often, so that
    one bad view does not hide the others. RGB-D: not right is gravely wrong or without an answer,
    as their reference is no better.
    """
    failed = [
        row
        for row in rows
        if row.angle_deg < UNSOLVED_BELOW_DEG
        and (row.grave or row.T_i_j is None if rgbd else not row.ok)
        and ((row.overlap or 0) >= MIN_OVERLAP if rgbd else (row.shared or 0) >= MIN_SHARED)
    ]
    failed.sort(
        key=lambda row: (
            not (row.grave and row.verdict == "verified"),
            -(row.overlap or 0.0 if rgbd else row.shared or 0),
        )
    )
    shown: list[PairRow] = []
    often: Counter[int] = Counter()
    for row in failed:
        if len(shown) < UNSOLVED and max(often[row.i], often[row.j]) < UNSOLVED_PER_VIEW:
            shown.append(row)
            often.update((row.i, row.j))
    return shown


def _call(row: PairRow, limits: Limits) -> dict[str, Any]:
    return {
        **{field: getattr(row, field) for field in _TOLD},
        "share_of_grave": badness(row, limits),
        "nees_per_dof": None if (nees := row.nees()) is None else nees / 6,
    }
