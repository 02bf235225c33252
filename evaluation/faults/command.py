"""Runs the faults, prints what came of them and writes `summary.json`."""

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from evaluation.faults import crashes, frozen, late
from evaluation.report import output_folder, print_table, progress_bar, write_summary
from protocol.errors import FleetPoseError

Scenario = Callable[[Path, Path, Callable[[], None]], dict[str, Any]]


def run(kills: int, freeze_s: float, late_clicks: int, out: Path, seed: int = 0) -> dict[str, Any]:
    """Runs what is asked for, each in a fleet of its own; returns the summary.

    Raises:
        FleetPoseError: a fleet does not come up, or does not come back after a fault.
    """
    scenarios: dict[str, tuple[Scenario, int]] = {}
    if kills:
        scenarios["crashes"] = (partial(crashes.run, kills, seed), kills)
    if freeze_s:
        steps = round(freeze_s + frozen.BEFORE_S)
        scenarios["frozen"] = (partial(frozen.run, freeze_s), steps)
    if late_clicks:
        rounds = -(-late_clicks // (late.DESKS * late.CLICKS_PER_ROUND))
        steps = round(rounds * late.LATE_S)
        scenarios["late"] = (partial(late.run, late_clicks), steps)
    if not scenarios:
        raise FleetPoseError("nothing to do: give --kills, --freeze or --late-clicks")
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
    write_summary(out, summary)
    print_table("faults", ("what", "value"), summary.items())
    return summary
