"""Runs the faults, prints what came of them and writes `summary.json`."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.faults import crashes
from evaluation.report import output_folder, print_table, progress_bar, write_summary
from protocol.errors import FleetPoseError


def run(kills: int, out: Path, seed: int = 0) -> dict[str, Any]:
    """Runs everything; returns the summary.

    Raises:
        FleetPoseError: a fleet does not come up, or does not come back after a fault.
    """
    if kills < 1:
        raise FleetPoseError(f"--kills {kills}: give 1 or more")
    logs = output_folder(out) / "logs"
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch, progress_bar() as progress:
        task = progress.add_task("kills", total=kills)
        summary = crashes.run(
            kills, Path(scratch), logs / "crashes", lambda: progress.advance(task), seed
        )
    summary["recovery_s_p95"] = _p95(summary.pop("recovery_s"))
    write_summary(out, summary)
    print_table("faults", ("what", "value"), summary.items())
    return summary


def _p95(seconds: list[float]) -> float | None:
    return float(np.percentile(seconds, 95)) if seconds else None
