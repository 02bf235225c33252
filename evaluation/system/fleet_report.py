"""The results of `pose-eval fleet`: summary, samples, map and table."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.fleet_scoring import SampleRow, positions, summarize_poses
from fleetpose.evaluation.metrics.geometry import Floats, align_points, transform
from fleetpose.evaluation.metrics.scoring import Limits, percentile
from fleetpose.evaluation.report import output
from fleetpose.evaluation.simulate.operator import SimulatedOperator
from fleetpose.evaluation.system.memory import Memory
from fleetpose.evaluation.system.observer import Observer, first_time_located

LATE_S = 30.0  # a click that takes longer
NEWEST_WINS = ("newer_view",)
"""Reasons of drops that are meant: an older view gave way to a newer one."""
SAMPLE_COLUMNS = ("time_s", "place", "robot", "anchor", "located", "position_error_m")
SAMPLE_COLUMNS += ("rotation_error_deg", "nees", *output.POSE_COLUMNS, *output.COVARIANCE_COLUMNS)


@dataclass(frozen=True)
class FleetResult:
    """Everything that was noted of a run."""

    robots: tuple[str, ...]
    rows: Sequence[SampleRow]
    observer: Observer
    operator: SimulatedOperator | None
    unanswered_s: Sequence[float]
    memory: Memory
    started_s: float
    median_depth_m: float
    rgbd: bool
    together: Collection[str]
    leftover_processes: int


def write_results(out: Path, result: FleetResult) -> dict[str, Any]:
    """Writes summary.json, poses.csv and map.png; prints a table. Returns the summary."""
    summary = summarize(result)
    output.write_summary(out, summary)
    places = {robot: f"r{number + 1}" for number, robot in enumerate(result.robots)}
    output.write_csv(
        out / "poses.csv", SAMPLE_COLUMNS, (_cells(row, places) for row in result.rows)
    )
    plot_map(out / "map.png", result.rows, places)
    output.print_table("fleet", ("", ""), output.scalars(summary))
    return summary


def summarize(result: FleetResult) -> dict[str, Any]:
    """The numbers of summary.json; null where there was nothing to measure.

    `first_solution_s` and `all_located_s` are null if that never came to pass, the errors if no
    robot was located; for latencies see `latencies`.
    """
    observer, operator, memory = result.observer, result.operator, result.memory
    robots, counts, since_s = len(result.robots), observer.located_counts, result.started_s
    limits = Limits.of(result.median_depth_m, result.rgbd)
    poses = summarize_poses(result.rows, limits, result.together)
    return {
        **poses,
        "median_depth_m": result.median_depth_m,
        "first_solution_s": first_time_located(counts, min(2, robots), since_s),
        "all_located_s": first_time_located(counts, robots, since_s),
        "clicks": 0 if operator is None else operator.clicks,
        "clicks_wrong": 0 if operator is None else operator.wrong_clicks,
        "clicks_rejected": 0 if operator is None else len(operator.rejected),
        **latencies(
            [] if operator is None else operator.click_to_pose_s,
            result.unanswered_s,
            observer.view_to_pose_s,
            observer.moving_view_to_pose_s,
        ),
        "views_overtaken": observer.views_overtaken,
        "views_unanswered": observer.views_unanswered(),
        **_of_the_server(observer),
        "bytes_per_view": float(np.mean(observer.view_sizes)) if observer.view_sizes else None,
        "agent_rss_mb": memory.agent_peak_mb(),
        "server_rss_mb": memory.server_peak_mb(),
        "server_rss_slope_mb_per_min": memory.server_slope_mb_per_min(),
        "leftover_processes": result.leftover_processes,
        "undecodable": observer.undecodable,
    }


def latencies(
    clicks_s: Sequence[float],
    unanswered_s: Sequence[float],
    views_s: Sequence[float],
    moving_views_s: Sequence[float],
) -> dict[str, Any]:
    """Percentiles in ms: null without clicks or views, and where they are infinite.

    All clicks count, however late; one that led to no pose has taken for ever. Views of robots that
    move are told apart as well: where nothing has changed there is nothing to do.
    """
    clicks_ms = 1e3 * np.array([*clicks_s, *(np.inf for _ in unanswered_s)])
    views_ms, moving_ms = 1e3 * np.array(views_s), 1e3 * np.array(moving_views_s)
    return {
        "click_to_pose_ms_p50": _percentile_of_waits(clicks_ms, 50),
        "click_to_pose_ms_p95": _percentile_of_waits(clicks_ms, 95),
        "clicks_late": int(np.sum(np.array([*clicks_s, *unanswered_s]) > LATE_S)),
        "clicks_unanswered_s": list(unanswered_s),
        "view_to_pose_ms_p50": percentile(views_ms, 50),
        "view_to_pose_ms_p95": percentile(views_ms, 95),
        "moving_view_to_pose_ms_p50": percentile(moving_ms, 50),
        "moving_view_to_pose_ms_p95": percentile(moving_ms, 95),
        "moving_views": len(moving_ms),
    }


def _percentile_of_waits(values: Floats, q: float) -> float | None:
    """A percentile of numbers of which some may be infinite; none for none."""
    return float(np.percentile(values, q, method="higher")) if len(values) else None


def _of_the_server(observer: Observer) -> dict[str, Any]:
    if not observer.statuses:
        keys = ("pairs_per_s", "other_cpu_ms_per_view", "max_pair_wait_s", "dropped_other")
        return dict.fromkeys(keys)
    first_s, first = observer.statuses[0]
    last_s, last = observer.statuses[-1]
    elapsed_s = last_s - first_s
    pairs = last.alignments - first.alignments
    return {
        "pairs_per_s": pairs / elapsed_s if elapsed_s > 0 else None,
        "other_cpu_ms_per_view": last.other_cpu_ms_per_view,
        "max_pair_wait_s": last.max_pair_wait_s,
        "dropped_other": sum(n for why, n in last.drops.items() if why not in NEWEST_WINS),
        "drops": last.drops,
        "stage_ms": last.stage_ms,
        "pair_wait_share_of_bound": last.wait_share,
    }


def plot_map(path: Path, rows: Sequence[SampleRow], places: dict[str, str]) -> None:
    """True and estimated positions of the last sample, seen from where they spread most."""
    last = [row for row in rows if row.time_s == rows[-1].time_s] if rows else []
    last = [row for row in last if row.position_error_m is not None]
    with output.plot(path, (7.0, 7.0), grid=True, xlabel="m", ylabel="m", aspect="equal") as axes:
        axes.set(title="robots in the last sample")
        if last:
            true = positions(row.T_world_robot for row in last)
            found = positions(row.T_fleet_robot for row in last)
            found = transform(align_points(true, found), found)
            centre = true.mean(0)
            plane = np.linalg.svd(true - centre, full_matrices=True)[2][:2]
            xy_true, xy_found = (true - centre) @ plane.T, (found - centre) @ plane.T
            axes.plot(*xy_true.T, "o", mfc="none", color="black", label="truth")
            axes.plot(*xy_found.T, "x", color="tab:red", label="estimated, after one rigid fit")
            for row, (x, y) in zip(last, xy_true, strict=True):
                star = "*" if row.is_anchor else ""
                axes.annotate(f" {places[row.robot]}{star}", (x, y), fontsize=8)


def _cells(row: SampleRow, places: dict[str, str]) -> dict[str, Any]:
    flags = {"anchor": int(row.is_anchor), "located": int(row.located)}
    pose = output.pose_cells(row.T_fleet_robot, row.covariance)
    return {**vars(row), **pose, **flags, "place": places[row.robot]}
