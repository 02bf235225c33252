"""What a soak found: tables, a plot, the figures that are judged, and which miss their bars."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.report.output import print_table, write_csv, write_summary
from fleetpose.evaluation.system.faults.clicker import Account
from fleetpose.evaluation.system.soak.drawing import draw
from fleetpose.evaluation.system.soak.noting import Memory, Second
from fleetpose.evaluation.system.soak.troubles import KINDS, Trouble

MOST_MB_PER_MIN = 2.0
LOW_SHARE = 0.5
"""Where fewer are located, that none of them is gravely off says little."""
WARM_S = 120.0
"""Views are kept for 60 s, so that caches are full by then."""


@dataclass(frozen=True)
class Soaked:
    """All that a soak noted.

    Attributes:
        views_s: from each view to its pose; clicks_s: from each click to its receipt.
        receipted: updates that are final.
        account: of these, what the server lost or doubled.
        settled: whether all was settled, and told of by a server that was started anew.
        ended: processes that ended though nobody ended them.
        undecodable: messages that no one could read.
    """

    robots: Sequence[str]
    seconds: Sequence[Second]
    memory: Sequence[Memory]
    troubles: Sequence[Trouble]
    views_s: Sequence[float]
    clicks_s: Sequence[float]
    receipted: int
    account: Account
    settled: bool
    ended: Sequence[str]
    undecodable: int


def write_results(out: Path, soaked: Soaked) -> dict[str, Any]:
    """Writes seconds.csv, memory.csv, troubles.csv, soak.png and summary.json; returns the
    summary.
    """
    write_csv(out / "seconds.csv", Second, soaked.seconds)
    write_csv(out / "memory.csv", Memory, soaked.memory)
    write_csv(out / "troubles.csv", Trouble, soaked.troubles)
    summary = summarize(soaked)
    for sentence in (*soaked.account.lost[:10], *soaked.account.doubled[:10]):
        print(sentence)
    draw(out / "soak.png", len(soaked.robots), soaked.seconds, soaked.memory, soaked.troubles)
    write_summary(out, summary)
    print_table("a fleet under trouble", ("", "value"), list(summary.items()))
    share = summary["located_share"]
    if share < LOW_SHARE:
        print(
            f"located_share {share:.2f} is low, so that grave_located says little: poses are old "
            "when they come; give fewer --robots, a lower --rate, or a machine with less to do"
        )
    return summary


def summarize(soaked: Soaked) -> dict[str, Any]:
    """The figures, and the names of those that miss their bars."""
    seconds, robots = soaked.seconds, len(soaked.robots)
    slopes = slopes_mb_per_min(soaked.memory)
    located = [one.located / robots for one in seconds]
    judged = {
        "lost": len(soaked.account.lost),
        "doubled": len(soaked.account.doubled),
        "grave_located": sum(one.grave for one in seconds),
        "unexpected_ends": len(soaked.ended),
        "not_flowing_again": sum(not one.flowed for one in soaked.troubles),
    }
    return {
        "hours": seconds[-1].at_s / 3600.0 if seconds else 0.0,
        "robots": robots,
        "receipted": soaked.receipted,
        "settled": soaked.settled,
        **judged,
        "located_share": float(np.mean(located)) if located else 0.0,
        "click_s_p50": percentile(soaked.clicks_s, 50),
        "click_s_p95": percentile(soaked.clicks_s, 95),
        "view_to_pose_s_p50": percentile(soaked.views_s, 50),
        "view_to_pose_s_p95": percentile(soaked.views_s, 95),
        "undecodable": soaked.undecodable,
        **_of_troubles(soaked.troubles),
        **{f"rss_slope_{name}_mb_per_min": slope for name, slope in slopes.items()},
        "bars_missed": " ".join(_missed(judged, slopes, soaked.settled)) or None,
    }


def slopes_mb_per_min(memory: Sequence[Memory]) -> dict[str, float | None]:
    """How fast each process grows: in its longest life, without the time in which its caches fill;
    none where no life was long enough.
    """
    named = sorted(memory, key=lambda one: one.process)
    return {
        process: _slope_mb_per_min(list(notes))
        for process, notes in groupby(named, key=lambda one: one.process)
    }


def _slope_mb_per_min(notes: Sequence[Memory]) -> float | None:
    lives = [list(life) for _, life in groupby(notes, key=lambda one: one.life)]
    longest = max(lives, key=lambda life: life[-1].at_s - life[0].at_s)
    warm_s = longest[0].at_s + WARM_S
    warm = np.array([(one.at_s, one.mb) for one in longest if one.at_s >= warm_s])
    if len(warm) < WARM_S / 2:
        return None
    return float(60.0 * np.polyfit(warm[:, 0] - warm[0, 0], warm[:, 1], 1)[0])


def _of_troubles(troubles: Sequence[Trouble]) -> dict[str, float | int]:
    """Of each kind: how often, and the longest time that poses and receipts stayed away."""
    told: dict[str, float | int] = {}
    for kind in KINDS:
        those = [one for one in troubles if one.kind == kind]
        told[kind] = len(those)
        if those:
            told[f"{kind}_poses_away_s"] = max(one.poses_away_s for one in those)
            told[f"{kind}_receipts_away_s"] = max(one.receipts_away_s for one in those)
    return told


def _missed(
    judged: Mapping[str, int], slopes: Mapping[str, float | None], settled: bool
) -> list[str]:
    """Nothing may be lost, doubled, gravely off or end by itself; nothing may grow for ever."""
    growing = [
        f"rss_slope_{name}"
        for name, slope in slopes.items()
        if slope is not None and slope >= MOST_MB_PER_MIN
    ]
    return [*(name for name, n in judged.items() if n), *growing, *([] if settled else ["settled"])]
