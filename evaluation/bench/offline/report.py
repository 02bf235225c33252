"""What the fleets come to: a line for each folder, the worst first, and all of them together."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.offline.fleet import Fleet, Placed
from fleetpose.evaluation.data.splits import split_of
from fleetpose.evaluation.metrics.scoring import share
from fleetpose.evaluation.report.output import write_csv, write_summary

COLUMNS = ("data", *(field.name for field in fields(Placed)))


def summarize(fleets: Sequence[Fleet]) -> dict[str, Any]:
    """The numbers of one folder, or of all; null where there was nothing to count.

    An anchor counts like every other robot: it is located as soon as anything is joined to it.
    """
    robots = [robot for fleet in fleets for robot in fleet.robots]
    together = [robot for robot in robots if robot.together]
    errors = [
        robot.position_error_m
        for robot in robots
        if robot.located and not robot.anchor and robot.position_error_m is not None
    ]
    reached = [robot for robot in robots if robot.in_reach]
    explained = [one for fleet in fleets for one in fleet.explained]
    return {
        "fleets": len(fleets),
        "robots": len(robots),
        "grave_located": sum(robot.grave for robot in robots),
        "located": share(robot.located for robot in robots),
        "robots_seen_together": len(together),
        "located_right": share(robot.located and not robot.grave for robot in together),
        "robots_in_reach": len(reached),
        "located_right_in_reach": share(robot.located and not robot.grave for robot in reached),
        "explained": float(np.median(explained)) if explained else None,
        "position_error_mean_m": float(np.mean(errors)) if errors else None,
        "position_error_max_m": max(errors, default=None),
        "unfinished": sum(not fleet.finished for fleet in fleets),
    }


def worst_first(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Folders with grave robots first, then those of which the fewest robots are located right."""
    return sorted(
        lines,
        key=lambda line: (
            -line["grave_located"],
            1.0 if line["located_right"] is None else line["located_right"],
        ),
    )


def line_of(name: str, line: Mapping[str, Any]) -> str:
    """A summary as one line."""
    return (
        f"{name}: {line['grave_located']} located and gravely off; "
        f"of {line['robots_seen_together']} seen together {_percent(line['located_right'])} "
        f"located right, {_percent(line['located_right_in_reach'])} of {line['robots_in_reach']} "
        f"joined to the anchor by sight; {_percent(line['located'])} of {line['robots']} robots in "
        f"{line['fleets']} fleets located, {line['unfinished']} fleets unfinished"
    )


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"


def write_results(out: Path, found: Sequence[tuple[Path, list[Fleet]]]) -> dict[str, Any]:
    """Writes summary.json and robots.csv; prints a line for each folder. Returns the summary."""
    rows = [
        {"data": str(data), **vars(robot)}
        for data, fleets in found
        for fleet in fleets
        for robot in fleet.robots
    ]
    lines = [
        {"data": str(data), "split": split_of(data), **summarize(fleets)} for data, fleets in found
    ]
    summary = {
        **summarize([fleet for _, fleets in found for fleet in fleets]),
        "folders": worst_first(lines),
        "grave": [_grave_one(row) for row in rows if row["grave"]],
    }
    write_summary(out, summary)
    write_csv(out / "robots.csv", COLUMNS, rows)
    for line in summary["folders"]:
        print(line_of(f"{Path(line['data']).name} ({line['split']})", line))
    if len(lines) > 1:
        print(line_of("all", summary))
    for one in summary["grave"]:
        place = f"{Path(one['data']).name}, seed {one['seed']}, view {one['view']}"
        off = f"{one['position_error_m']:.4g} m and {one['rotation_error_deg']:.3g} deg off"
        print(f"  located and gravely off: {place}: {off}, {one['verdict']}")
    return summary


def _grave_one(row: dict[str, Any]) -> dict[str, Any]:
    told = ("data", "seed", "view", "position_error_m", "rotation_error_deg", "verdict")
    return {key: row[key] for key in told}
