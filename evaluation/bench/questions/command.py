"""`pose-eval questions`: clicks until the fleet is located and right, by who chooses the pairs."""

from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.questions.play import Task, play
from fleetpose.evaluation.bench.questions.policies import POLICIES
from fleetpose.evaluation.bench.questions.report import write_results
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.splits import split_of
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.options.recorded import QuestionsOptions
from fleetpose.evaluation.report.output import output_folder
from fleetpose.protocol.errors import DataFolderError


def run(options: QuestionsOptions, out: Path) -> dict[str, Any]:
    """Draws fleets, has every policy ask in each, writes the results; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or no drawn fleet needs an operator.
    """
    recording = options.recording()
    limits = Limits.of(median_depth_m(recording), recording.is_rgbd)
    output_folder(out)
    with bench_of(options.workers) as bench:
        wires, _ = bench.on_the_wire(recording, recording.usable, seed=0)
        seeds = range(options.first, options.first + options.seeds)
        jobs = [
            (seed, (play, Task(recording, wires, seed, limits, options.mistakes))) for seed in seeds
        ]
        all_played = bench.by_label("fleets", jobs).values()
    found = [played for played in all_played if played is not None]
    if not found:
        raise DataFolderError(
            f"{recording.directory}: no draw of its views is a fleet that needs an operator and "
            "can be joined by one"
        )
    return write_results(out, found, list(POLICIES), split_of(recording.directory))
