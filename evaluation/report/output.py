"""What the commands show and leave: summary.json, CSV files, progress, tables, plots."""

import csv
import json
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats, quat_wxyz
from fleetpose.protocol.errors import FleetPoseError

POSE_COLUMNS = ("qw", "qx", "qy", "qz", "tx", "ty", "tz")
COVARIANCE_COLUMNS = tuple(f"c{row}{column}" for row in range(6) for column in range(row, 6))
"""Upper triangle, row by row: rotation then translation, left perturbation."""


class OutputFolderError(FleetPoseError):
    """The folder for the results cannot be made."""


def output_folder(path: Path) -> Path:
    """Makes the folder for the results.

    Raises:
        OutputFolderError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputFolderError(f"--out {path}: {error.strerror}; name a folder to make") from error
    return path


def pose_cells(T_a_b: Floats | None, covariance: Floats | None) -> dict[str, float | str]:
    """The cells of a pose and its covariance in a CSV row; empty where there is none."""
    row: dict[str, float | str] = dict.fromkeys((*POSE_COLUMNS, *COVARIANCE_COLUMNS), "")
    if T_a_b is not None:
        values = (*quat_wxyz(T_a_b[:3, :3]), *T_a_b[:3, 3])
        row.update(zip(POSE_COLUMNS, (float(value) for value in values), strict=True))
    if T_a_b is not None and covariance is not None:
        upper = covariance[np.triu_indices(6)]
        row.update(zip(COVARIANCE_COLUMNS, (float(value) for value in upper), strict=True))
    return row


def write_csv(path: Path, columns: Sequence[str] | type, rows: Iterable[Any]) -> None:
    """Writes rows, mappings or dataclasses, with exactly these columns, or with the fields of a
    dataclass; None becomes an empty cell.
    """
    names = [one.name for one in fields(columns)] if isinstance(columns, type) else columns
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(row if isinstance(row, Mapping) else vars(row) for row in rows)


def write_summary(folder: Path, summary: Mapping[str, Any], title: str = "") -> None:
    """Writes `summary.json`; numbers that are not finite become null. With a title it is printed
    as well.
    """
    text = json.dumps(finite(summary), indent=1, allow_nan=False)
    (folder / "summary.json").write_text(text + "\n")
    if title:
        print_table(title, ("", ""), summary.items())


def scalars(summary: Mapping[str, Any]) -> list[tuple[str, Any]]:
    """What of a summary fits into a table's cell."""
    return [(key, value) for key, value in summary.items() if not isinstance(value, list | dict)]


def finite(value: Any) -> Any:
    """A value as JSON takes it: arrays' numbers plain, and null in place of what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def progress_bar() -> Any:
    """A `rich` progress bar on standard error, so that output can be piped."""
    from rich import progress
    from rich.console import Console

    return progress.Progress(
        progress.TextColumn("{task.description}"),
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        console=Console(file=sys.stderr),
    )


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> None:
    """Prints a table; numbers are shown with four significant digits, None as a dash."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for number, column in enumerate(columns):
        first = number == 0  # a name that is cut short names nothing
        justify = "left" if first else "right"
        table.add_column(column, justify=justify, no_wrap=first, overflow="fold")
    for row in rows:
        table.add_row(*(cell(value) for value in row))
    Console().print(table)


def cell(value: Any) -> str:
    """A value as tables show it."""
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def new_figure(width: float = 6.0, height: float = 5.0) -> tuple[Any, Any]:
    """A matplotlib figure and its axes that need no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


@contextmanager
def plot(
    path: Path,
    size: tuple[float, float] = (6.0, 5.0),
    legend: str = "best",
    grid: bool = False,
    **about: Any,
) -> Iterator[Any]:
    """Axes to draw on, a PNG file afterwards.

    Args:
        path: the file.
        size: inches.
        legend: where it goes, if anything that is drawn has a label.
        grid: whether there are faint lines.
        about: what `Axes.set` takes: labels, limits, scales.
    """
    figure, axes = new_figure(*size)
    yield axes
    axes.set(**about)
    if grid:
        axes.grid(alpha=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc=legend)
    figure.savefig(path)
