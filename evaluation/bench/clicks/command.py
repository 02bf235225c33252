"""`pose-eval clicks`: all pairs of views within a range of angles, clicked in by chance."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.clicks.rows import ClickRow, click_row, named, write_rows
from fleetpose.evaluation.bench.clicks.truth import true_pixels
from fleetpose.evaluation.bench.clicks.worker import ClickedAnswer, Plan, Task, run_task
from fleetpose.evaluation.bench.pairs.command import limited, pairs_of
from fleetpose.evaluation.bench.ring.solving import solve_ring
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.recording import Recording, TrueView, shared_tracks
from fleetpose.evaluation.metrics.scoring import Limits, optical_angle_deg, share
from fleetpose.evaluation.options.recorded import ClicksOptions
from fleetpose.evaluation.report.output import output_folder, write_summary
from fleetpose.protocol.errors import DataFolderError

_RESAMPLED = 1000


def run(options: ClicksOptions, out: Path) -> dict[str, Any]:
    """Clicks and aligns; writes poses.csv, pairs.csv, summary.json; returns the summary.

    Raises:
        DataFolderError: the data cannot be used, or no pair is in the range.
    """
    count, _ = options.clicks
    recording = options.recording()
    pairs = {(i.index, j.index): (i, j) for i, j in pairs_in_range(recording, options)}
    output_folder(out)
    depth_m = median_depth_m(recording)
    limits = Limits.of(depth_m, recording.is_rgbd)
    rows: list[ClickRow] = []
    with bench_of(options.workers) as bench:
        wires, _ = bench.on_the_wire(recording, [view for pair in pairs.values() for view in pair])
        plans = (Plan(count, options.wrong),)
        jobs = []
        for (i, j), pair in pairs.items():
            true = true_pixels(recording, *pair)
            for draw in range(options.draws if count else 1):
                seed = (options.seed, i, j, draw)
                task = Task(wires[i], wires[j], true, plans, "full", seed)
                jobs.append(((pair, draw), (_aligned_and_judged, task, pair, depth_m)))
        for (pair, draw), (clicked, is_named) in bench.as_done("draws", jobs):
            shared = shared_tracks(recording, *pair)
            row = click_row(pair, count, draw, clicked, limits, shared)
            row.named = is_named
            rows.append(row)
    rows.sort(key=lambda row: (row.i, row.j, row.draw))
    write_rows(out, rows)
    summary = {"median_depth_m": depth_m, **summarize(rows, options.seed)}
    write_summary(out, summary, "clicks")
    return summary


def pairs_in_range(recording: Recording, options: ClicksOptions) -> list[tuple[TrueView, TrueView]]:
    """Pairs of views, no stereo partners, within the range of angles, that share enough.

    Raises:
        DataFolderError: there is none.
    """
    low, high = options.angles_deg
    found = [
        (i, j)
        for i, j in pairs_of(recording)
        if low <= optical_angle_deg(i.T_world_camera, j.T_world_camera) < high
        and _shares(recording, i, j, options.min_shared)
    ]
    if not found:
        raise DataFolderError(
            f"{recording.directory}: no pair of views {low:g} to {high:g} deg apart shares "
            f"{options.min_shared} points; give other --angles or a smaller --min-shared"
        )
    return limited(found, options.limit)


def _shares(recording: Recording, i: TrueView, j: TrueView, least: int) -> bool:
    """Whether both see so many tracks; where there are none, so many depths."""
    shared = shared_tracks(recording, i, j)
    return (len(true_pixels(recording, i, j)[0]) if shared is None else shared) >= least


def _aligned_and_judged(
    task: Task, pair: tuple[TrueView, TrueView], depth_m: float
) -> tuple[ClickedAnswer, bool | None]:
    """Runs in a worker: the pair's answer, and whether the server, for which these two robots are a
    fleet, names exactly the wrong clicks.
    """
    (clicked,) = run_task(task)
    indices = (pair[0].index, pair[1].index)
    views = {view.index: view for view in pair}
    solved = solve_ring(views, {indices: clicked}, depth_m)
    return clicked, named(clicked, solved.marked[indices])


def summarize(rows: Sequence[ClickRow], seed: int = 0) -> dict[str, Any]:
    """Shares over all draws of all pairs, each with a 95 % interval by resampling the views."""
    wrong = [row for row in rows if row.wrong]
    answered = [row.position_error_m for row in rows if row.position_error_m is not None]
    summary: dict[str, Any] = {
        "pairs": len({(row.i, row.j) for row in rows}),
        "alignments": len(rows),
        "fewer_clicks": share(row.made < row.clicks for row in rows),
        "success": share(row.ok for row in rows),
        "success_95": interval(rows, [row.ok for row in rows], seed),
        "grave": share(row.grave for row in rows),
        "grave_verified": sum(row.grave and row.verdict == "verified" for row in rows),
        "position_error_median_m": float(np.median(answered)) if answered else None,
        "align_ms_median": float(np.median([row.align_ms for row in rows])),
    }
    if wrong:
        right_only = [bool(row.ok_right_only) for row in wrong]
        marks = [bool(row.named) for row in wrong]
        summary |= {
            "with_wrong": len(wrong),
            "named": share(marks),
            "named_95": interval(wrong, marks, seed),
            "success_with_wrong": share(row.ok for row in wrong),
            "success_right_clicks": share(right_only),
            "success_right_clicks_95": interval(wrong, right_only, seed),
        }
    return summary


def interval(
    rows: Sequence[ClickRow], flags: Sequence[bool], seed: int = 0
) -> tuple[float, float] | None:
    """95 % interval of a share of rows, by drawing the views anew: pairs that have a view in common
    are no independent evidence. None where no draw leaves a pair.
    """
    views, ends = np.unique([(row.i, row.j) for row in rows], return_inverse=True)
    ends = ends.reshape(-1, 2)
    rng = np.random.default_rng(seed)
    shares = []
    for _ in range(_RESAMPLED):
        times = np.bincount(rng.integers(len(views), size=len(views)), minlength=len(views))
        weight = times[ends[:, 0]] * times[ends[:, 1]]
        if weight.any():
            shares.append(float(weight @ np.asarray(flags, float) / weight.sum()))
    if not shares:
        return None
    low, high = np.percentile(shares, (2.5, 97.5))
    return float(low), float(high)
