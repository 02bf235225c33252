"""`pose-eval fleet --offline`: many fleets of recorded views, without network and clicks."""

import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.offline.fleet import Fleet, Task, draw_views, play
from fleetpose.evaluation.bench.offline.report import write_results
from fleetpose.evaluation.bench.working import as_done, on_the_wire, worker_pool
from fleetpose.evaluation.data.opening import median_depth_m, open_recordings
from fleetpose.evaluation.data.parts import checked_views
from fleetpose.evaluation.data.recording import CloudKind, Recording
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.report.output import output_folder, progress_bar
from fleetpose.protocol.errors import DataFolderError


@dataclass(frozen=True)
class OfflineOptions:
    """What `pose-eval fleet --offline` is asked for: so many drawn fleets of each folder.

    Attributes:
        robots: in each fleet; by chance if not told.
        views: the robots stand at these views; there is nothing to draw then.
    """

    data: tuple[Path, ...]
    clouds: CloudKind | None = None
    seeds: int = 20
    robots: int | None = None
    views: tuple[int, ...] = ()
    workers: int = 2


def run(options: OfflineOptions, out: Path) -> dict[str, Any]:
    """Lets a server put all fleets together, writes the results; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used.
    """
    if not options.data:
        raise DataFolderError("--offline needs recorded views: give --data DIR, again for more")
    recordings = open_recordings(options.data, options.clouds)
    draws = [_draws(options, recording) for recording in recordings]
    output_folder(out)
    found: list[tuple[Path, list[Fleet]]] = []
    with worker_pool(options.workers) as pool, progress_bar() as progress:
        for recording, drawn in zip(recordings, draws, strict=True):
            fleets = _played(recording, drawn, pool, options.workers, progress)
            found.append((recording.directory, fleets))
    return write_results(out, found)


def _draws(options: OfflineOptions, recording: Recording) -> dict[int, tuple[int, ...]]:
    """The views of each fleet, by seed."""
    if options.views:
        return {0: tuple(view.index for view in checked_views(recording, options.views))}
    return {seed: draw_views(recording, options.robots, seed) for seed in range(options.seeds)}


def _played(
    recording: Recording,
    draws: dict[int, tuple[int, ...]],
    pool: ProcessPoolExecutor,
    workers: int,
    progress: Any,
) -> list[Fleet]:
    """The fleets of one recording, in order of their seeds."""
    limits = Limits.of(median_depth_m(recording), recording.is_rgbd)
    stood_at = {index for views in draws.values() for index in views}
    views = [view for view in recording.usable if view.index in stood_at]
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as folder:
        wires, _ = on_the_wire(recording, views, Path(folder), pool, progress, seed=0)
        bar = progress.add_task(f"fleets of {recording.directory.name}", total=len(draws))
        jobs = (
            (seed, (play, Task(recording, wires, seed, views, limits)))
            for seed, views in draws.items()
        )
        found: dict[int, Fleet] = {}
        for seed, fleet in as_done(pool, jobs, in_flight=workers):
            found[seed] = fleet
            progress.advance(bar)
    return [found[seed] for seed in sorted(found)]
