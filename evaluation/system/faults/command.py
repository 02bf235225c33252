"""Runs the faults, prints what came of them and writes `summary.json`."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from fleetpose.evaluation.options.fleets import FaultOptions
from fleetpose.evaluation.report.output import output_folder, progress_bar, write_summary
from fleetpose.evaluation.system.faults import crashes, frozen, inject, late
from fleetpose.protocol.errors import FleetPoseError

Scenario = Callable[[Path, Path, Callable[[], None]], dict[str, Any]]


def run(options: FaultOptions, out: Path) -> dict[str, Any]:
    """Runs what is asked for, each in a fleet of its own; returns the summary.

    Raises:
        FleetPoseError: a fleet does not come up, or does not come back after a fault.
    """
    scenarios = _scenarios(options)
    logs = output_folder(out) / "logs"
    for old in (*logs.glob("*/*.log"), *logs.glob("*/*.jsonl")):
        old.unlink()
    summary: dict[str, Any] = {}
    with progress_bar() as progress:
        for name, (scenario, steps) in scenarios.items():
            task = progress.add_task(name, total=steps)
            with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
                step = partial(progress.advance, task)
                summary |= scenario(Path(scratch), logs / name, step)
    write_summary(out, summary, "faults")
    return summary


def _scenarios(options: FaultOptions) -> dict[str, tuple[Scenario, int]]:
    """By name, what is to be run and of how many steps."""
    scenarios: dict[str, tuple[Scenario, int]] = {}
    if options.kills:
        crash = partial(crashes.run, options.kills, options.seed)
        scenarios["crashes"] = (crash, options.kills)
    if options.freeze_s:
        steps = round(options.freeze_s + frozen.BEFORE_S)
        scenarios["frozen client"] = (partial(frozen.run, options.freeze_s), steps)
    if options.late_clicks:
        rounds = -(-options.late_clicks // (late.DESKS * late.CLICKS_PER_ROUND))
        steps = round(rounds * late.LATE_S)
        scenarios["late"] = (partial(late.run, options.late_clicks), steps)
    for name in options.inject:
        if name not in inject.FAULTS:
            raise FleetPoseError(f"--inject: no '{name}'; there are {', '.join(inject.FAULTS)}")
        steps = round(options.inject_s)
        injected = partial(inject.run, name, options.inject_s, robots=options.inject_robots)
        scenarios[name] = (injected, steps)
    if not scenarios:
        raise FleetPoseError("nothing to do: give --kills, --freeze, --late-clicks or --inject")
    return scenarios
