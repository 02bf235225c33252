"""The plot of a soak: memory, waits, robots and troubles over time."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fleetpose.evaluation.report.output import new_figure
from fleetpose.evaluation.system.soak.noting import Memory, Second
from fleetpose.evaluation.system.soak.troubles import KINDS, Trouble


def draw(
    path: Path,
    robots: int,
    seconds: Sequence[Second],
    memory: Sequence[Memory],
    troubles: Sequence[Trouble],
) -> None:
    """Writes a PNG; a trouble is a bar from when it began until all flowed again."""
    drawn, first = new_figure(10.0, 11.0)
    first.remove()
    heights = (3, 3, 2, 2)
    of_memory, of_waits, of_robots, of_troubles = drawn.subplots(
        4, 1, sharex=True, height_ratios=heights
    )
    _draw_memory(of_memory, memory)
    _draw_waits(of_waits, seconds)
    at_min = [one.at_s / 60.0 for one in seconds]
    of_robots.plot(at_min, [one.located for one in seconds], label="located")
    of_robots.plot(at_min, [one.grave for one in seconds], label="gravely off")
    of_robots.set_ylim(-0.2, robots + 0.2)
    of_robots.set_ylabel("robots")
    of_robots.legend(fontsize="small", loc="upper right")
    _draw_troubles(of_troubles, troubles)
    for axes in (of_memory, of_waits, of_robots):
        for one in troubles:
            axes.axvspan(one.at_s / 60.0, one.until_s / 60.0, color="0.92", zorder=0)
    drawn.savefig(path)


def _draw_memory(axes: Any, memory: Sequence[Memory]) -> None:
    for process in dict.fromkeys(one.process for one in memory):
        own = [one for one in memory if one.process == process]
        axes.plot([one.at_s / 60.0 for one in own], [one.mb for one in own], label=process)
    axes.set_ylabel("resident memory, MB")
    axes.legend(fontsize="small", ncols=4)


def _draw_waits(axes: Any, seconds: Sequence[Second]) -> None:
    for label, field in (("view to pose", "view_to_pose_s"), ("click to receipt", "click_s")):
        told = [(one.at_s / 60.0, getattr(one, field)) for one in seconds]
        known = [(at_min, wait_s) for at_min, wait_s in told if wait_s is not None]
        axes.plot([one[0] for one in known], [one[1] for one in known], ".", ms=3, label=label)
    axes.set_yscale("log")
    axes.set_ylabel("longest wait of a second, s")
    axes.legend(fontsize="small", loc="upper right")


def _draw_troubles(axes: Any, troubles: Sequence[Trouble]) -> None:
    for one in troubles:
        row, begin_min = KINDS.index(one.kind), one.at_s / 60.0
        width_min = (one.until_s - one.at_s) / 60.0
        axes.barh(row, width_min, left=begin_min, color=f"C{row}")
        axes.annotate(one.target, (begin_min, row), fontsize="x-small", va="center")
    axes.set_yticks(range(len(KINDS)), KINDS)
    axes.set_ylim(len(KINDS) - 0.5, -0.5)
    axes.set_xlabel("minutes")
