"""The rows of `pose-eval cameras`, printed with their limits."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

from fleetpose.evaluation.bench.cameras import calibrations, cases, layouts, rigs, robots
from fleetpose.evaluation.bench.cameras.bars import Bar
from fleetpose.evaluation.report.output import output_folder, print_table, write_csv, write_summary

_COLUMNS = ("bar", "name", "met", "says")


def run(faults: Path | None, data: Path | None, out: Path | None) -> bool:
    """Tries everything, prints each row and what failed of it; whether all are met.

    Args:
        faults: folder of cases that are not to be misread, a folder each; None leaves them out.
        data: folder of recordings of good rigs; None leaves these out.
        out: where attempts.csv and summary.json go; None: nowhere.
    """
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
        bars = list(bars_of(Path(scratch), faults, data))
    if out is not None:
        _write(output_folder(out), bars)
    for bar in bars:
        for attempt in bar.failed:
            print(f"{bar.name}: {attempt.name}: {attempt.says}")
    rows = [(b.name, b.unit, b.count, b.limit, "yes" if b.is_met else "NO") for b in bars]
    print_table("cameras", ("row", "what", "figure", "limit", "met"), rows)
    return all(bar.is_met for bar in bars)


def bars_of(scratch: Path, faults: Path | None, data: Path | None) -> Iterator[Bar]:
    """The rows, each as soon as it is measured."""
    yield cases.bar(scratch / "cases", faults)
    yield rigs.bar(data)
    yield calibrations.bar(scratch / "calibrations")
    yield layouts.bar(scratch / "layouts")
    yield robots.bar()


def _write(out: Path, bars: list[Bar]) -> None:
    rows = [
        {"bar": bar.name, "name": one.name, "met": one.met, "says": one.says}
        for bar in bars
        for one in bar.attempts
    ]
    write_csv(out / "attempts.csv", _COLUMNS, rows)
    write_summary(
        out, {b.name: {"figure": b.count, "limit": b.limit, "met": b.is_met} for b in bars}
    )
