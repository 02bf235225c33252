"""`pose-eval restarts`: whether published covariances are right, over fleets that begin anew.

Within one run a fleet makes the same errors in every sample, so that its samples tell one thing
many times. Each restart is another draw: other noise and another synthetic world, or other views of
a recording; every robot counts once in it.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deploy.local_fleet import LocalFleet, wait_running
from evaluation.datasets import CloudKind, open_recording
from evaluation.fleet import (
    FleetOptions,
    open_link,
    plan_fleet,
    poses_now,
    start,
    wait_started,
)
from evaluation.fleet_scoring import SampleRow, score_sample
from evaluation.geometry import Floats, inverse, se3_log
from evaluation.intervals import DRAWS, LEVEL
from evaluation.observer import Observer
from evaluation.parts import parts_of
from evaluation.report import (
    new_figure,
    output_folder,
    print_table,
    progress_bar,
    write_csv,
    write_summary,
)
from evaluation.scoring import CHI2_6_95, Limits, share
from protocol.errors import DataFolderError
from protocol.keys import Keys

COLUMNS = (
    "restart",
    "robot",
    "position_error_m",
    "rotation_error_deg",
    "nees",
    "nees_rotation",
    "nees_translation",
    "verified",
    "grave",
)


@dataclass(frozen=True)
class RestartsOptions:
    """What `pose-eval restarts` is asked for: so many fleets, each for so many seconds."""

    restarts: int = 30
    robots: int = 8
    seconds: float = 12.0
    data: Path | None = None
    clouds: CloudKind | None = None
    workers: int = 2
    seed: int = 0


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


def run(options: RestartsOptions, out: Path) -> dict[str, Any]:
    """Restarts fleets, scores their poses once each, writes the results; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or a process ended.
    """
    output_folder(out)
    rows: list[PoseRow] = []
    located: list[int] = []
    with progress_bar() as progress:
        task = progress.add_task("restarts", total=options.restarts)
        for number, first in enumerate(_firsts(options)):
            found = _restart(options, number, first, out / "logs")
            rows += found
            located.append(len(found) + bool(found))
            progress.advance(task)
    summary = {"restarts": options.restarts, "robots": options.robots, **summarize(rows)}
    summary["located"] = float(np.mean(located)) if located else None
    write_csv(out / "poses.csv", COLUMNS, map(asdict, rows))
    write_summary(out, summary)
    _plot(out / "nees.png", rows)
    print_table("covariances over restarts", ("", "value"), summary.items())
    return summary


def _firsts(options: RestartsOptions) -> Sequence[int]:
    """The first view of each restart, spread over the recording.

    Raises:
        DataFolderError: there are not as many places to begin at.
    """
    if options.data is None:
        return range(options.restarts)
    recording = open_recording(options.data, options.clouds)
    if recording.is_rgbd:
        raise DataFolderError(f"{options.data}: stretches of a walk are the same in every restart")
    firsts = []
    for first in range(len(recording.usable)):
        try:
            parts_of(recording, options.robots, first)
        except DataFolderError:
            break
        firsts.append(first)
    if len(firsts) < options.restarts:
        raise DataFolderError(
            f"{options.data}: {options.robots} consecutive views begin at {len(firsts)} places: "
            f"give --restarts {len(firsts)}, or fewer --robots"
        )
    chosen = np.linspace(0, len(firsts) - 1, options.restarts).round().astype(int)
    return [firsts[k] for k in chosen]


def _restart(options: RestartsOptions, number: int, first: int, logs: Path) -> list[PoseRow]:
    """One fleet, from nothing to its poses."""
    fleet_options = FleetOptions(
        robots=options.robots,
        seconds=options.seconds,
        data=options.data,
        clouds=options.clouds,
        first=first if options.data is not None else 0,
        workers=options.workers,
        seed=options.seed + number,
    )
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
        plan = plan_fleet(fleet_options, Path(scratch))
        with LocalFleet(logs) as fleet:
            start(fleet, plan, options.workers, Path(scratch) / "state")
            link = open_link(fleet)
            observer = Observer(link, Keys(fleet.site))
            try:
                wait_started(fleet, observer, len(plan.robots))
                wait_running(fleet, lambda: False, options.seconds)
                anchor = None if observer.state is None else observer.state.anchor
                now = poses_now(observer, plan.truth)
                depth_m = plan.truth.median_depth_m(observer.newest_views())
            finally:
                observer.close()
                link.close()
    limits = Limits.of(depth_m, plan.truth.rgbd)
    rows = score_sample(options.seconds, plan.names, now, anchor)
    return [scored(number, row, rows, limits) for row in rows if row.located and not row.is_anchor]


def scored(restart: int, row: SampleRow, rows: Sequence[SampleRow], limits: Limits) -> PoseRow:
    """A located robot's pose beside the truth, the anchor as gauge."""
    gauge = next(other for other in rows if other.is_anchor)
    assert row.T_fleet_robot is not None and row.T_world_robot is not None
    assert gauge.T_fleet_robot is not None and gauge.T_world_robot is not None
    assert row.covariance is not None and row.nees is not None
    assert row.position_error_m is not None and row.rotation_error_deg is not None
    T_true = gauge.T_fleet_robot @ inverse(gauge.T_world_robot) @ row.T_world_robot
    xi, C = se3_log(T_true @ inverse(row.T_fleet_robot)), row.covariance
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
    summary: dict[str, Any] = {
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
    return summary


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


def _plot(path: Path, rows: Sequence[PoseRow]) -> None:
    """How often squared errors are below a value, beside how often they should be."""
    from scipy.stats import chi2

    figure, axes = new_figure()
    values = np.sort([row.nees for row in rows])
    axes.step(
        values,
        np.arange(1, len(values) + 1) / max(len(values), 1),
        where="post",
        label="published poses",
    )
    x = np.linspace(0, 30, 200)
    axes.plot(x, chi2.cdf(x, 6), "--", label="if covariances were right")
    axes.set(
        xlim=(0, 30),
        ylim=(0, 1),
        xlabel="squared error / covariance (6 degrees of freedom)",
        ylabel="share of the poses below",
    )
    axes.legend()
    figure.savefig(path)
