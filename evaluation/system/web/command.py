"""`pose-eval web`: the operator's page in a browser, each bar with its figure and its limit."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

from fleetpose.evaluation.options.building import numbers
from fleetpose.evaluation.options.web import WebOptions
from fleetpose.evaluation.report.output import cell, output_folder, progress_bar, write_summary
from fleetpose.evaluation.system.web.bars import BARS, SITES
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.browser import Browser, NoBrowserError, chromium
from fleetpose.evaluation.system.web.rows import Row, all_met, unmeasured
from fleetpose.evaluation.system.web.site import WebSite
from fleetpose.protocol.errors import FleetPoseError

_HEAD = ("bar", "figure", "limit", "met")


def run_web(options: WebOptions, out: Path) -> int:
    """Measures, prints, writes `summary.json` and `report.md`.

    Returns:
        0 where all bars that were asked for are met, 1 where one is not, 2 without a browser.

    Raises:
        FleetPoseError: an unknown bar is asked for, or the folder cannot be made.
    """
    asked = asked_bars(options.bars)
    try:
        chromium()
    except NoBrowserError as error:
        print(error)
        return 2
    output_folder(out)
    rows: list[Row] = []
    with progress_bar() as progress:
        task = progress.add_task("bars", total=len(asked))
        for bar in asked:
            shown = lambda what, bar=bar: progress.update(  # noqa: E731
                task, description=f"bar {bar}: {what}"
            )
            rows += measured(bar, options, out, shown)
            progress.advance(task)
    write_summary(out, {"all_met": all_met(rows), "rows": [vars(row) for row in rows]})
    table = table_of(rows)
    (out / "report.md").write_text(_report(options, table))
    print(table)
    return 0 if all_met(rows) else 1


def asked_bars(text: str) -> list[int]:
    """The bars of an option; all of them where it is empty.

    Raises:
        FleetPoseError: one of them is not known.
    """
    asked = numbers("--bars", text) or tuple(BARS)
    if unknown := sorted(set(asked) - set(BARS)):
        known = ",".join(map(str, sorted(BARS)))
        raise FleetPoseError(f"--bars {unknown[0]}: there is no such bar; there are {known}")
    return sorted(set(asked))


def measured(
    bar: int, options: WebOptions, out: Path, said: Callable[[str], None] = lambda _: None
) -> list[Row]:
    """The rows of one bar, on a site and in a browser of its own; where that fails, one that says
    why.
    """
    from playwright.sync_api import Error

    folder = out / f"bar{bar}"
    folder.mkdir(parents=True, exist_ok=True)
    try:
        said("starting")
        site_of = WebSite(options.robots, out=folder / "site", **SITES.get(bar, {}))
        with site_of as site, Browser() as browser:
            return BARS[bar](Bench(site, browser, folder, options, said))
    except (FleetPoseError, Error) as error:
        why = str(error).partition("\n")[0]
        return [unmeasured(bar, BARS[bar].__name__.replace("_", " "), why)]


def table_of(rows: Sequence[Row]) -> str:
    """Rows as a table of Markdown."""
    cells = [
        (f"{row.bar}. {row.name}", cell(row.value), row.limit.replace("|", "/"), row.said)
        for row in rows
    ]
    widths = [max(len(line[k]) for line in [_HEAD, *cells]) for k in range(len(_HEAD))]
    lines = [_HEAD, tuple("-" * width for width in widths), *cells]
    return "\n".join(
        "| " + " | ".join(text.ljust(w) for text, w in zip(line, widths, strict=True)) + " |"
        for line in lines
    )


def _report(options: WebOptions, table: str) -> str:
    asked = ", ".join(f"{name} {value}" for name, value in dataclasses.asdict(options).items())
    return f"# The operator's page beside its bars\n\n`pose-eval web`: {asked}.\n\n{table}\n"
