"""What restarts come to: covariances beside errors, a line for each set, the worst first."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.fleet_scoring import SampleRow
from fleetpose.evaluation.metrics.geometry import Floats, inverse, se3_log
from fleetpose.evaluation.metrics.intervals import DRAWS, LEVEL
from fleetpose.evaluation.metrics.scoring import CHI2_6_95, Limits, share, with_reference
from fleetpose.evaluation.report.output import plot, print_table, write_csv, write_summary


@dataclass(frozen=True)
class PoseRow:
    """One located robot at the end of one restart; the anchor has no error and is left out.

    Attributes:
        nees: squared error in units of the covariance, 6 degrees of freedom.
        nees_rotation, nees_translation: of three of them, whatever the others are.
    """

    restart: int
    robot: str
    position_error_m: float
    rotation_error_deg: float
    nees: float
    nees_rotation: float
    nees_translation: float
    verified: bool
    grave: bool


COLUMNS = ("set", *(field.name for field in fields(PoseRow)))


def scored(restart: int, row: SampleRow, rows: Sequence[SampleRow], limits: Limits) -> PoseRow:
    """A located robot's pose beside the truth, the anchor as gauge; the noise of the truth itself
    is added to the covariance.
    """
    gauge = next(other for other in rows if other.is_anchor)
    assert row.T_fleet_robot is not None and row.T_world_robot is not None
    assert gauge.T_fleet_robot is not None and gauge.T_world_robot is not None
    assert row.covariance is not None and row.nees is not None
    assert row.position_error_m is not None and row.rotation_error_deg is not None
    T_true = gauge.T_fleet_robot @ inverse(gauge.T_world_robot) @ row.T_world_robot
    xi = se3_log(T_true @ inverse(row.T_fleet_robot))
    C = with_reference(row.covariance, limits.reference_sigma_m)
    return PoseRow(
        restart,
        row.robot,
        row.position_error_m,
        row.rotation_error_deg,
        row.nees,
        float(xi[:3] @ np.linalg.solve(C[:3, :3], xi[:3])),
        float(xi[3:] @ np.linalg.solve(C[3:, 3:], xi[3:])),
        row.verified,
        limits.grave(row.position_error_m, row.rotation_error_deg),
    )


def worst_first(sets: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sets by the share of their poses within 95 % bounds, the smallest first: an error that its
    covariance denies is worse than one that it exaggerates.
    """
    return sorted(
        sets, key=lambda one: (one["coverage_95"] or 0.0, -(one["nees_per_dof_median"] or np.inf))
    )


def write_results(
    out: Path, found: Sequence[tuple[dict[str, Any], list[PoseRow]]]
) -> dict[str, Any]:
    """Writes poses.csv, summary.json and nees.png; prints a line for each set.

    Args:
        out: the folder.
        found: what is known of a set, among it its `set`, and its poses.

    Returns:
        The numbers of the worst set, and all `sets`, the worst first.
    """
    sets = worst_first([{**about, **summarize(rows)} for about, rows in found])
    summary = {**sets[0], "sets": sets}
    named = [(about["set"], rows) for about, rows in found]
    cells = ({"set": name, **asdict(row)} for name, rows in named for row in rows)
    write_csv(out / "poses.csv", COLUMNS, cells)
    write_summary(out, summary)
    plot_nees(out / "nees.png", named)
    shown = {"set": "", "split": "", "poses": "poses", "coverage_95": "in 95 %",
             "nees_per_dof_median": "NEES median", "nees_per_dof": "mean",
             "grave_located": "grave"}  # fmt: skip
    table = [[one[key] for key in shown] for one in sets]
    print_table("covariances over restarts, the worst set first", list(shown.values()), table)
    for one in sets:
        if one["reference_sigma_m"]:
            print(f"{one['set']}: judged against a truth with {one['reference_sigma_m']:g} m noise")
    return summary


def summarize(rows: Sequence[PoseRow], seed: int = 0) -> dict[str, Any]:
    """NEES per degree of freedom and coverage over all robots of all restarts, with what 95 % of
    redrawn restarts give: robots of one restart share their anchor's errors.
    """
    by_restart: dict[int, list[float]] = {}
    for row in rows:
        by_restart.setdefault(row.restart, []).append(row.nees)
    drawn = _redrawn([np.array(own) for own in by_restart.values()], seed)
    medians = [float(np.median(v) / 6) for v in drawn]
    coverages = [float(np.mean(v <= CHI2_6_95)) for v in drawn]
    low, high = (1 - LEVEL) / 2, (1 + LEVEL) / 2
    values = np.array([row.nees for row in rows])
    return {
        "poses": len(rows),
        "nees_per_dof_median": _median(values / 6),
        "nees_per_dof_median_low": _quantile(medians, low),
        "nees_per_dof_median_high": _quantile(medians, high),
        "nees_per_dof": float(values.mean() / 6) if len(values) else None,
        "nees_rotation_per_dof_median": _median([row.nees_rotation / 3 for row in rows]),
        "nees_translation_per_dof_median": _median([row.nees_translation / 3 for row in rows]),
        "coverage_95": share(value <= CHI2_6_95 for value in values),
        "coverage_95_low": _quantile(coverages, low),
        "coverage_95_high": _quantile(coverages, high),
        "grave_located": sum(row.grave for row in rows),
        "grave_acted": sum(row.grave and row.verified for row in rows),
    }


def _redrawn(groups: Sequence[Floats], seed: int) -> list[Floats]:
    rng = np.random.default_rng(seed)
    if not groups:
        return []
    draws = rng.integers(len(groups), size=(DRAWS, len(groups)))
    return [np.concatenate([groups[k] for k in draw]) for draw in draws]


def _median(values: Floats | Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _quantile(values: Sequence[float], q: float) -> float | None:
    return float(np.quantile(values, q)) if len(values) else None


def plot_nees(path: Path, sets: Sequence[tuple[str, Sequence[PoseRow]]]) -> None:
    """How often squared errors are below a value, beside how often they should be; a line a set."""
    from scipy.stats import chi2

    with plot(path, xlim=(0, 30), ylim=(0, 1)) as axes:
        for name, rows in sets:
            values = np.sort([row.nees for row in rows])
            shares = np.arange(1, len(values) + 1) / max(len(values), 1)
            axes.step(values, shares, where="post", label=name)
        x = np.linspace(0, 30, 200)
        axes.plot(x, chi2.cdf(x, 6), "--", label="if covariances were right")
        axes.set_xlabel("squared error / covariance (6 degrees of freedom)")
        axes.set_ylabel("share of the poses below")
