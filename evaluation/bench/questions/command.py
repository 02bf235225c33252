"""`pose-eval questions`: clicks until the fleet is located and right, by who chooses the pairs."""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.questions.play import Played, Task, play
from fleetpose.evaluation.bench.questions.policies import POLICIES
from fleetpose.evaluation.bench.questions.report import write_results
from fleetpose.evaluation.bench.working import as_done, on_the_wire, worker_pool
from fleetpose.evaluation.data.opening import median_depth_m, open_recording
from fleetpose.evaluation.data.recording import CloudKind
from fleetpose.evaluation.data.splits import split_of
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.report.output import output_folder, progress_bar
from fleetpose.protocol.errors import DataFolderError


@dataclass(frozen=True)
class QuestionsOptions:
    """What `pose-eval questions` is asked for: so many drawn fleets, from the first seed on."""

    data: Path
    clouds: CloudKind | None = None
    seeds: int = 20
    first: int = 0
    workers: int = 2
    mistakes: float = 0.0


def run(options: QuestionsOptions, out: Path) -> dict[str, Any]:
    """Draws fleets, has every policy ask in each, writes the results; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or no drawn fleet needs an operator.
    """
    recording = open_recording(options.data, options.clouds)
    limits = Limits.of(median_depth_m(recording), recording.is_rgbd)
    output_folder(out)
    with (
        tempfile.TemporaryDirectory(prefix="fleetpose-") as folder,
        worker_pool(options.workers) as pool,
        progress_bar() as progress,
    ):
        wires, _ = on_the_wire(recording, recording.usable, Path(folder), pool, progress, seed=0)
        task = progress.add_task("fleets", total=options.seeds)
        seeds = range(options.first, options.first + options.seeds)
        jobs = (
            (seed, (play, Task(recording, wires, seed, limits, options.mistakes))) for seed in seeds
        )
        found: dict[int, Played] = {}
        for seed, played in as_done(pool, jobs, in_flight=options.workers):
            if played is not None:
                found[seed] = played
            progress.advance(task)
    if not found:
        raise DataFolderError(
            f"{recording.directory}: no draw of its views is a fleet that needs an operator and "
            "can be joined by one"
        )
    played = [found[seed] for seed in sorted(found)]
    return write_results(out, played, list(POLICIES), split_of(recording.directory))
