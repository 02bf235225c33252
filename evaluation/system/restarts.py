"""`pose-eval restarts`: whether published covariances are right, over fleets that begin anew.

Within one run a fleet makes the same errors in every sample, so that its samples tell one thing
many times. Each restart is another draw: other noise and another synthetic world, or other views of
a recording; every robot counts once in it.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.bench.offline.fleet import Task, put_together
from fleetpose.evaluation.bench.offline.fleet import scored as scored_offline
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.recording import Recording, TrueView, are_partners, in_ring_order
from fleetpose.evaluation.data.splits import split_of
from fleetpose.evaluation.metrics.fleet_scoring import SampleRow, score_sample
from fleetpose.evaluation.metrics.scoring import RGBD_REFERENCE_SIGMA_M, Limits
from fleetpose.evaluation.options.fleets import FleetOptions, RestartsOptions
from fleetpose.evaluation.report.output import output_folder, progress_bar
from fleetpose.evaluation.system.fleet import observed, plan_fleet, poses_now, start, wait_started
from fleetpose.evaluation.system.restarts_report import PoseRow, scored, write_results
from fleetpose.protocol.errors import DataFolderError

WORLD = "synthetic world"


def run(options: RestartsOptions, out: Path) -> dict[str, Any]:
    """Restarts fleets, scores their poses once each, writes the results; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or a process ended.
    """
    recordings = options.recordings()
    if options.offline and not recordings:
        raise DataFolderError("--offline needs recorded views: give --data DIR, again for more")
    stands = [views_of(recording, options) for recording in recordings]
    output_folder(out)
    found = []
    for recording, views in zip(recordings, stands, strict=True):
        by = _offline if options.offline else _live
        found.append((_about(recording, options), by(options, recording, views, out)))
    if not recordings:
        none: list[tuple[int, ...]] = [()] * options.restarts
        found.append((_about(None, options), _live(options, None, none, out)))
    for about, rows in found:
        by_restart = [sum(row.restart == k for row in rows) for k in range(options.restarts)]
        about["located"] = float(np.mean([number + bool(number) for number in by_restart]))
    return write_results(out, found)


def views_of(recording: Recording, options: RestartsOptions) -> list[tuple[int, ...]]:
    """Indices of the views of each restart: consecutive ones, from places spread over the
    recording, without stereo partners: these share their errors.

    Raises:
        DataFolderError: there are not as many places to begin at.
    """
    views = in_ring_order(recording.usable)
    ring = any(view.ring_angle_deg is not None for view in views)
    onward = [[*views[first:], *(views[:first] if ring else ())] for first in range(len(views))]
    places = [_first_ones(some, options.robots) for some in onward]
    places = [place for place in places if len(place) == options.robots]
    if len(places) < options.restarts:
        raise DataFolderError(
            f"{recording.directory}: {options.robots} consecutive views begin at {len(places)} "
            "places: give fewer --restarts, or fewer --robots"
        )
    chosen = np.linspace(0, len(places) - 1, options.restarts).round().astype(int)
    return [places[k] for k in chosen]


def _first_ones(views: Sequence[TrueView], count: int) -> tuple[int, ...]:
    chosen: list[TrueView] = []
    for view in views:
        if len(chosen) < count and not any(are_partners(view, other) for other in chosen):
            chosen.append(view)
    return tuple(view.index for view in chosen)


def _about(recording: Recording | None, options: RestartsOptions) -> dict[str, Any]:
    """What is known of a set before its fleets are started."""
    rgbd = recording is not None and recording.is_rgbd
    return {
        "set": WORLD if recording is None else recording.directory.name,
        "split": "held out" if recording is None else split_of(recording.directory),
        "clouds": None if recording is None else recording.clouds,
        "restarts": options.restarts,
        "robots": options.robots,
        "reference_sigma_m": RGBD_REFERENCE_SIGMA_M if rgbd else 0.0,
    }


def _live(
    options: RestartsOptions,
    recording: Recording | None,
    stands: Sequence[tuple[int, ...]],
    out: Path,
) -> list[PoseRow]:
    """The poses of live fleets, one after the other."""
    name = WORLD if recording is None else recording.directory.name
    rows: list[PoseRow] = []
    with progress_bar() as progress:
        for number, views in enumerate(progress.track(stands, description=f"restarts: {name}")):
            rows += _restart(options, recording, number, views, out / "logs")
    return rows


def _offline(
    options: RestartsOptions,
    recording: Recording,
    stands: Sequence[tuple[int, ...]],
    out: Path,
) -> list[PoseRow]:
    """The poses of fleets without network, by several workers."""
    del out
    limits = Limits.of(median_depth_m(recording), recording.is_rgbd)
    needed = {index for views in stands for index in views}
    with bench_of(options.workers) as bench:
        views = [view for view in recording.usable if view.index in needed]
        wires, _ = bench.on_the_wire(recording, views, seed=0)
        jobs = [
            (number, (_put_together, Task(recording, wires, number, chosen, limits)))
            for number, chosen in enumerate(stands)
        ]
        found = bench.by_label(f"restarts: {recording.directory.name}", jobs)
    return [row for number in found for row in _located(number, found[number], limits)]


def _put_together(task: Task) -> list[SampleRow]:
    """What a worker does for one restart."""
    server, _ = put_together(task)
    return scored_offline(server, task.views_of(server), task.limits)


def _restart(
    options: RestartsOptions,
    recording: Recording | None,
    number: int,
    views: tuple[int, ...],
    logs: Path,
) -> list[PoseRow]:
    """One fleet, from nothing to its poses."""
    fleet_options = FleetOptions(
        robots=options.robots,
        seconds=options.seconds,
        data=() if recording is None else (recording.directory,),
        clouds=None if recording is None else recording.clouds,
        workers=options.workers,
        seed=options.seed + number,
        views=views,
    )
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
        plan = plan_fleet(fleet_options, Path(scratch))
        with LocalFleet(logs) as fleet:
            start(fleet, plan, options.workers, Path(scratch) / "state")
            with observed(fleet) as observer:
                wait_started(fleet, observer, len(plan.robots))
                wait_running(fleet, lambda: False, options.seconds)
                anchor = None if observer.state is None else observer.state.anchor
                now = poses_now(observer, plan.truth)
                depth_m = plan.truth.median_depth_m(observer.newest_views())
    limits = Limits.of(depth_m, plan.truth.rgbd)
    rows = score_sample(options.seconds, plan.names, now, anchor, limits.reference_sigma_m)
    return _located(number, rows, limits)


def _located(number: int, rows: Sequence[SampleRow], limits: Limits) -> list[PoseRow]:
    """The rows of the robots that are located; the anchor has no error and is left out."""
    return [scored(number, row, rows, limits) for row in rows if row.located and not row.is_anchor]
