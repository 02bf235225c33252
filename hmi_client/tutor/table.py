"""The table at the end of a lesson."""

from typing import Any

from rich.console import Console
from rich.table import Table

from fleetpose.hmi_client.tutor.advice import advice, is_bad, metres

_COLUMNS = (
    "point",
    "pair",
    "off, px",
    "off",
    "server",
    "located",
    "pair off",
    "fleet off",
    "sigma",
)
_TAKEN = {"waiting": "no answer"}


def show(report: dict[str, Any], console: Console) -> None:
    """Prints how far each point was off and what it did, what to do better, and how it ended."""
    if report["points"]:
        table = Table(title=f"Against {report['against']}", title_justify="left")
        for number, column in enumerate(_COLUMNS):
            table.add_column(column, justify="left" if number in (1, 4) else "right")
        for point in report["points"]:
            table.add_row(*row(point), style="bold red" if is_bad(point) else "")
        console.print(table)
        console.print("located, pair off, fleet off, sigma: before the point > after it\n")
    for line in (*advices(report), ending(report)):
        console.print(line, highlight=False)


def row(point: dict[str, Any]) -> tuple[str, ...]:
    """The cells of a point."""
    before, after = point["before"], point["after"]

    def change(name: str) -> str:
        return f"{metres(before[name])} > {metres(after[name])}"

    return (
        str(point["n"]),
        f"{point['i']} {point['j']}",
        "-" if point["off_px"] is None else f"{point['off_px']:.1f}",
        metres(point["off_m"]),
        _TAKEN.get(point["taken"]) or point["taken"],
        f"{before['located']} > {after['located']}",
        change("pair_error_m"),
        change("fleet_error_m"),
        change("sigma_m"),
    )


def advices(report: dict[str, Any]) -> list[str]:
    """A line for each point that something is to be said about."""
    lines = []
    for point in report["points"]:
        said = (f"refused: {point['reason']}" if point["reason"] else "", advice(point))
        if text := " ".join(filter(None, said)):
            lines.append(f"{point['n']}: {text}")
    return lines


def ending(report: dict[str, Any]) -> str:
    """How it ended, in a sentence or two."""
    points, robots = report["points"], len(report["robots"])
    before, after = report["before"], report["after"]
    located = f"{after['located']} of {robots} robots are located"
    if not points:
        alone = "; the machine needed no help: try --apart ROBOTS" if _all(report) else ""
        return f"No point was clicked; {located}{alone}."
    bad = sum(map(is_bad, points))
    error = after["fleet_error_m"]
    off = "" if error is None else f", {metres(error)} off in the mean"
    return (
        f"{len(points) - bad} of {len(points)} points were good. {located}{off}; they were "
        f"{before['located']} before."
    )


def _all(report: dict[str, Any]) -> bool:
    return report["after"]["located"] == len(report["robots"])
