"""`pose-eval fleet --offline`: many fleets of recorded views, without network and clicks."""

from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.offline.fleet import Fleet, Task, draw_views, play
from fleetpose.evaluation.bench.offline.report import write_results
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.parts import checked_views
from fleetpose.evaluation.data.recording import Recording
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.options.fleets import FleetOptions
from fleetpose.evaluation.report.output import output_folder
from fleetpose.protocol.errors import DataFolderError


def run(options: FleetOptions, out: Path) -> dict[str, Any]:
    """Lets a server put all fleets together, writes the results; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used.
    """
    if not options.data:
        raise DataFolderError("--offline needs recorded views: give --data DIR, again for more")
    recordings = options.recordings()
    draws = [_draws(options, recording) for recording in recordings]
    output_folder(out)
    found = [
        (recording.directory, _played(recording, drawn, options.workers))
        for recording, drawn in zip(recordings, draws, strict=True)
    ]
    return write_results(out, found)


def _draws(options: FleetOptions, recording: Recording) -> dict[int, tuple[int, ...]]:
    """The views of each fleet, by seed."""
    if options.views:
        return {0: tuple(view.index for view in checked_views(recording, options.views))}
    return {seed: draw_views(recording, options.robots, seed) for seed in range(options.seeds)}


def _played(recording: Recording, draws: dict[int, tuple[int, ...]], workers: int) -> list[Fleet]:
    """The fleets of one recording, in order of their seeds."""
    limits = Limits.of(median_depth_m(recording), recording.is_rgbd)
    stood_at = {index for views in draws.values() for index in views}
    views = [view for view in recording.usable if view.index in stood_at]
    with bench_of(workers) as bench:
        wires, _ = bench.on_the_wire(recording, views, seed=0)
        jobs = [
            (seed, (play, Task(recording, wires, seed, views, limits)))
            for seed, views in draws.items()
        ]
        name = f"fleets of {recording.directory.name}"
        return list(bench.by_label(name, jobs).values())
