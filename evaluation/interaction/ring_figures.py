"""The pictures of `pose-eval ring`: the paper's Figs. 9 and 10, with its statements below them."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.geometry import Floats
from evaluation.interaction.statements import statements
from evaluation.report import new_figure

RECIPES = {"full": "-", "paper": "--"}
"""Recipes that are drawn, and how their lines look."""
_MOST_TICKS = 12  # more numbers of robots do not fit below an axis
_WIDTH, _HEIGHT = 4.6, 5.2  # of one panel, inches
_DARKEST, _BRIGHTEST = 0.0, 0.9  # of the colours; the brightest yellow is too pale on white


def plot_error_and_success(path: Path, summaries: Mapping[str, dict[str, Any]]) -> None:
    """Fig. 9: mean and median position error and success over separation, a curve per number of
    clicks.
    """
    panels = {
        "position_error_m": "mean position error of all robots, m",
        "position_error_median_m": "median position error of all robots, m",
        "success": "share of pairs that are ok",
    }
    figure, axes = _panels(panels, summaries)
    axes[0].sharey(axes[1])
    _logarithmic(axes[:2])
    axes[2].set(ylim=(0, 1.03))
    _say(figure, summaries, ("position_error_m", "position_error_median_m"))
    figure.savefig(path)


def plot_times(path: Path, summaries: Mapping[str, dict[str, Any]]) -> None:
    """Fig. 10: milliseconds of ICP, and of the whole alignment, over separation."""
    panels = {"icp_ms": "ICP, ms per pair", "align_ms": "whole alignment, ms per pair"}
    figure, axes = _panels(panels, summaries)
    _logarithmic(axes)
    _say(figure, summaries, ("icp_ms",))
    figure.savefig(path)


def _panels(
    panels: Mapping[str, str], summaries: Mapping[str, dict[str, Any]]
) -> tuple[Any, Sequence[Any]]:
    """A figure with a panel per column of the table, side by side, and one legend for all."""
    figure, only = new_figure(_WIDTH * len(panels), _HEIGHT)
    only.remove()
    axes = figure.subplots(1, len(panels))
    rings = [ring for summary in summaries.values() for ring in summary["rings"]]
    for one, (column, label) in zip(axes, panels.items(), strict=True):
        _curves(one, summaries, column)
        one.set(xlabel="separation of neighbours, deg, and robots", ylabel=label)
        one.set_xticks(*_ticks(rings))
        one.grid(alpha=0.3)
    figure.legend(
        *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=6, fontsize=8
    )
    return figure, axes


def _curves(axes: Any, summaries: Mapping[str, dict[str, Any]], column: str) -> None:
    numbers = sorted({r["clicks"] for summary in summaries.values() for r in summary["rings"]})
    colours = dict(zip(numbers, _colours(len(numbers)), strict=True))
    drawn = [recipe for recipe in RECIPES if recipe in summaries]
    for clicks, recipe in itertools.product(numbers, drawn):  # the legend has a column per number
        rows = [r for r in summaries[recipe]["rings"] if r["clicks"] == clicks]
        rows = [r for r in rows if r[column] is not None]
        axes.plot(
            [row["separation_deg"] for row in rows],
            [row[column] for row in rows],
            RECIPES[recipe],
            marker="o",
            markersize=3,
            color=colours[clicks],
            label=f"{recipe}, {clicks} click{'s' if clicks != 1 else ''}",
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


def _colours(count: int) -> Floats:
    """(N, 4) red, green, blue and opacity, from dark to bright."""
    from matplotlib import colormaps

    return np.asarray(colormaps["viridis"](np.linspace(_DARKEST, _BRIGHTEST, count)), np.float64)


def _ticks(rings: Sequence[Mapping[str, Any]]) -> tuple[list[float], list[str]]:
    """Where an axis has its numbers, and these: the separation, below it the robots of the ring."""
    robots = {ring["separation_deg"]: ring["robots"] for ring in rings}
    every = -(-len(robots) // _MOST_TICKS)
    places = sorted(robots)[::every]
    return places, [f"{place:.3g}\n{robots[place]}" for place in places]


def _say(figure: Any, summaries: Mapping[str, dict[str, Any]], columns: Iterable[str]) -> None:
    """Puts what the rings say of the paper's statements below the panels, a line each."""
    asked = set(columns)
    lines = [
        f"{recipe}: {statement.line}"
        for recipe in (one for one in RECIPES if one in summaries)
        for statement in statements(summaries[recipe]["rings"])
        if statement.column in asked
    ]
    figure.supxlabel("\n".join(dict.fromkeys(lines)), x=0.01, ha="left", fontsize=8)
