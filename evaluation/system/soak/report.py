"""What a soak noted: tables, a plot and the figures that are judged."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.report.output import new_figure, print_table, write_csv, write_summary
from fleetpose.evaluation.system.faults.clicker import Account

_PROCESSES = ("server", "router", "robots", "operator")
_WARM_S = 120.0  # views are kept for 60 s, so that caches are full by then


@dataclass(frozen=True)
class Second:
    """What was noted at one moment.

    Attributes:
        at_s: since the beginning.
        located, grave: robots that are, and of these that are gravely off.
        server_mb: resident memory, workers included; robots_mb: of the largest robot's agent.
        view_to_pose_s: the longest wait of a view whose pose came in this second; none without one.
        in_flight: updates of the restless operator without a receipt.
    """

    at_s: float
    located: int
    grave: int
    server_mb: float
    router_mb: float
    robots_mb: float
    operator_mb: float
    view_to_pose_s: float | None
    in_flight: int


@dataclass(frozen=True)
class Trouble:
    """What was done to a process, and after how many seconds all flowed again."""

    at_s: float
    kind: str
    target: str
    recovery_s: float


@dataclass(frozen=True)
class Soaked:
    """All that a soak noted.

    Attributes:
        receipted: updates that are final.
        account: of these, what the server lost or doubled.
        told: whether all was settled, and told of by a server that was started anew.
        undecodable: messages that no one could read.
    """

    robots: Sequence[str]
    seconds: Sequence[Second]
    troubles: Sequence[Trouble]
    receipted: int
    account: Account
    told: bool
    undecodable: int


def write_results(out: Path, soaked: Soaked) -> dict[str, Any]:
    """Writes seconds.csv, troubles.csv, soak.png and summary.json; returns the summary."""
    write_csv(out / "seconds.csv", Second, soaked.seconds)
    write_csv(out / "troubles.csv", Trouble, soaked.troubles)
    waits_s = [one.view_to_pose_s for one in soaked.seconds if one.view_to_pose_s is not None]
    summary = {
        "hours": soaked.seconds[-1].at_s / 3600.0 if soaked.seconds else 0.0,
        "robots": len(soaked.robots),
        "killed": sum(one.kind == "killed" for one in soaked.troubles),
        "frozen": sum(one.kind == "frozen" for one in soaked.troubles),
        "recovery_s_max": max((one.recovery_s for one in soaked.troubles), default=None),
        "receipted": soaked.receipted,
        "settled": soaked.told,
        "lost": len(soaked.account.lost),
        "doubled": len(soaked.account.doubled),
        "grave_located": sum(one.grave for one in soaked.seconds),
        "located_share": float(
            np.mean([one.located / len(soaked.robots) for one in soaked.seconds])
        ),
        "view_to_pose_s_p50": percentile(waits_s, 50),
        "view_to_pose_s_p95": percentile(waits_s, 95),
        "undecodable": soaked.undecodable,
        **{
            f"{name}_mb_per_min": slope_mb_per_min(soaked.seconds, soaked.troubles, name)
            for name in _PROCESSES
        },
    }
    for sentence in (*soaked.account.lost[:10], *soaked.account.doubled[:10]):
        print(sentence)
    _plot(out / "soak.png", soaked)
    write_summary(out, summary)
    print_table("a fleet under trouble", ("", "value"), list(summary.items()))
    return summary


def slope_mb_per_min(
    seconds: Sequence[Second], troubles: Sequence[Trouble], process: str
) -> float | None:
    """How fast a process grows: of the longest stretch in which nobody touched its kind, without
    the time in which its caches fill; none where no stretch is long enough.
    """
    touched = [one.at_s for one in troubles if _concerns(one.target, process)]
    ends = [0.0, *touched, seconds[-1].at_s if seconds else 0.0]
    began, ended = max(pairwise(ends), key=lambda stretch: stretch[1] - stretch[0])
    part = np.array(
        [
            (one.at_s, getattr(one, f"{process}_mb"))
            for one in seconds
            if began + _WARM_S <= one.at_s < ended
        ]
    )
    if len(part) < _WARM_S / 2:
        return None
    return float(60.0 * np.polyfit(part[:, 0] - part[0, 0], part[:, 1], 1)[0])


def _concerns(target: str, process: str) -> bool:
    own = {"server": ("server", "worker"), "router": ("router",), "operator": ("desk",)}
    if process != "robots":
        return target in own[process]
    return all(target not in others for others in own.values())


def _plot(path: Path, soaked: Soaked) -> None:
    at_min = np.array([one.at_s for one in soaked.seconds]) / 60.0
    drawn, first = new_figure(9.0, 8.0)
    first.remove()
    memory, waits, located = drawn.subplots(3, 1, sharex=True)
    for name in _PROCESSES:
        values = [getattr(one, f"{name}_mb") for one in soaked.seconds]
        memory.plot(at_min, values, label=name)
    memory.set_ylabel("resident memory, MB")
    memory.legend(fontsize="small")
    waits.plot(at_min, [one.view_to_pose_s for one in soaked.seconds], ".", markersize=2)
    waits.set_yscale("log")
    waits.set_ylabel("view to pose, s")
    located.plot(at_min, [one.located for one in soaked.seconds], label="located")
    located.plot(at_min, [one.grave for one in soaked.seconds], label="gravely off")
    located.set_ylabel("robots")
    located.set_xlabel("minutes; lines: a process was killed or frozen")
    located.legend(fontsize="small")
    for axes in (memory, waits, located):
        for one in soaked.troubles:
            axes.axvline(one.at_s / 60.0, color="0.8", linewidth=0.6, zorder=0)
    drawn.savefig(path)
