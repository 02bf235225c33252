"""The pictures of `pose-eval ring`: the paper's Figs. 9 and 10, a row per recipe, with the paper's
statements below.
"""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.ring.statements import statements
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.report.output import new_figure

RECIPES = ("full", "paper")
"""Recipes that are drawn, from top to bottom."""
_MOST_TICKS = 12  # more numbers of robots do not fit below an axis
_WIDTH, _HEIGHT = 4.6, 3.4  # of one panel, inches
_LINE = 0.17  # of text, inches
_AROUND = 1.0  # legend above and labels below, inches
_BRIGHTEST = 0.9  # of the colours; the yellow beyond it is too pale on white


def plot_error_and_success(path: Path, summaries: Mapping[str, dict[str, Any]]) -> None:
    """Fig. 9: mean and median position error and success over separation, a curve per number of
    clicks.
    """
    panels = {
        "position_error_m": "mean error of all robots, m",
        "position_error_median_m": "median error of all robots, m",
        "success": "share of pairs that are ok",
    }
    figure, axes = _panels(panels, summaries)
    _logarithmic(axes[:, :2].ravel())
    low, high = zip(*(one.get_ylim() for one in axes[0, :2]), strict=True)
    for one in axes[0, :2]:  # the rows below follow
        one.set(ylim=(min(low), max(high)))
    axes[0, 2].set(ylim=(0, 1.03))
    figure.savefig(path)


def plot_times(path: Path, summaries: Mapping[str, dict[str, Any]]) -> None:
    """Fig. 10: milliseconds of ICP, and of the whole alignment, over separation."""
    panels = {"icp_ms": "ICP, ms per pair", "align_ms": "whole alignment, ms per pair"}
    figure, axes = _panels(panels, summaries)
    _logarithmic(axes.ravel())
    figure.savefig(path)


def _panels(panels: Mapping[str, str], summaries: Mapping[str, dict[str, Any]]) -> tuple[Any, Any]:
    """A figure with a row of panels per recipe, a panel per column of the table, one legend for
    all, and what the rings say of the paper's statements below; and its axes (recipes, columns).
    """
    drawn = [recipe for recipe in RECIPES if recipe in summaries]
    said = _said(summaries, drawn, panels)
    height = _HEIGHT * len(drawn) + _LINE * len(said) + _AROUND
    figure, only = new_figure(_WIDTH * len(panels), height)
    only.remove()
    axes = figure.subplots(len(drawn), len(panels), sharex=True, sharey="col", squeeze=False)
    rings = [ring for recipe in drawn for ring in summaries[recipe]["rings"]]
    colours = _colours(sorted({ring["clicks"] for ring in rings}))
    for row, recipe in zip(axes, drawn, strict=True):
        for one, (column, label) in zip(row, panels.items(), strict=True):
            _curves(one, summaries[recipe]["rings"], column, colours)
            one.set_ylabel(f"{recipe}: {label}", fontsize=9)
            one.set_xticks(*_ticks(rings))
            one.grid(alpha=0.3)
    for one in axes[-1]:
        one.set(xlabel="separation of neighbours, deg, and robots")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8)
    figure.supxlabel("\n".join(said), x=0.01, ha="left", fontsize=8)
    return figure, axes


def _curves(
    axes: Any, rings: Sequence[Mapping[str, Any]], column: str, colours: Mapping[int, Floats]
) -> None:
    for clicks, colour in colours.items():
        rows = [r for r in rings if r["clicks"] == clicks and r[column] is not None]
        axes.plot(
            [row["separation_deg"] for row in rows],
            [row[column] for row in rows],
            marker="o",
            markersize=3,
            color=colour,
            label=f"{clicks} click{'s' if clicks != 1 else ''}",
        )


def _logarithmic(axes: Sequence[Any]) -> None:
    """Logarithmic heights, with numbers as people write them at 1, 2 and 5 of every decade; where
    nothing is above 0, as times are where ICP never ran, heights stay linear.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for one in axes:
        if not any(np.any(np.asarray(line.get_ydata()) > 0) for line in one.get_lines()):
            continue
        one.set(yscale="log")
        one.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        one.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        one.yaxis.set_minor_formatter(NullFormatter())


def _colours(numbers: Sequence[int]) -> dict[int, Floats]:
    """By number of clicks red, green, blue and opacity, from dark to bright."""
    from matplotlib import colormaps

    places = np.linspace(0.0, _BRIGHTEST, len(numbers))
    return dict(zip(numbers, np.asarray(colormaps["viridis"](places), np.float64), strict=True))


def _ticks(rings: Sequence[Mapping[str, Any]]) -> tuple[list[float], list[str]]:
    """Where an axis has its numbers, and these: the separation, below it the robots of the ring."""
    robots = {ring["separation_deg"]: ring["robots"] for ring in rings}
    every = -(-len(robots) // _MOST_TICKS)
    places = sorted(robots)[::every]
    return places, [f"{place:.3g}\n{robots[place]}" for place in places]


def _said(
    summaries: Mapping[str, dict[str, Any]], drawn: Sequence[str], columns: Collection[str]
) -> list[str]:
    """What the rings say of the paper's statements about some columns, a line each."""
    lines = [
        f"{recipe}: {statement.line}"
        for recipe in drawn
        for statement in statements(summaries[recipe]["rings"])
        if statement.column in columns
    ]
    return list(dict.fromkeys(lines))  # what was not asked is alike for mean and median
