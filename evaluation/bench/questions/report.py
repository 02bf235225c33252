"""What the runs come to: a summary with a paired bootstrap, a table of every run, a plot."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.questions.play import Played, Run
from fleetpose.evaluation.data.splits import Split
from fleetpose.evaluation.metrics.intervals import DRAWS, LEVEL
from fleetpose.evaluation.metrics.scoring import share
from fleetpose.evaluation.report.output import plot, print_table, write_csv, write_summary

Floats = npt.NDArray[np.floating]

COLUMNS = ("seed", "policy", "robots", "components", "minimum", "clicks", "located", "grave")
COLUMNS += ("grave_verified", "claimed", "in_vain", "asked")
FLAGS = ("located", "grave", "grave_verified", "claimed")
ENDS = {
    "grave_ends_questions": "questions",
    "grave_ends_largest": "largest_error",
    "grave_ends_random": "random",
}
"""Keys of the summary for the plays of each policy that end with a robot located gravely wrong."""


def summarize(played: Sequence[Played], policies: Sequence[str], seed: int = 0) -> dict[str, Any]:
    """Means over the fleets with 95 % of the means of redrawn fleets; of two policies the same
    fleets are drawn together. A play counts until all robots are located and none is gravely off,
    one that never came there with all clicks that were allowed.
    """
    clicks = {policy: _clicks(played, policy) for policy in policies}
    minimum = np.array([one.runs[0].minimum for one in played], float)
    summary: dict[str, Any] = {"fleets": len(played)}
    for policy in policies:
        summary[f"clicks_{policy}"] = mean_with_interval(clicks[policy], seed)
    summary["clicks_minimum"] = float(minimum.mean())
    asked = clicks["questions"]
    for other in policies[1:]:
        low, high = ratio_interval(asked, clicks[other], seed)
        summary[f"ratio_{other}"] = float(asked.mean() / clicks[other].mean())
        summary[f"ratio_{other}_low"], summary[f"ratio_{other}_high"] = low, high
    summary["ratio_largest_high"] = summary["ratio_largest_error_high"]
    summary["ratio_minimum"] = float(asked.mean() / minimum.mean())
    runs = [run for one in played for run in one.runs]
    for key, policy in ENDS.items():
        summary[key] = sum(run.grave for run in runs if run.policy == policy)
    for what, flag in (
        ("failures", lambda run: not run.located),
        ("grave_located", lambda run: run.grave),
        ("grave_verified", lambda run: run.grave_verified),
        ("claimed_wrongly", lambda run: run.claimed),
    ):
        summary[what] = {p: sum(flag(r) for r in runs if r.policy == p) for p in policies}
    summary["asked_in_vain"] = {p: sum(r.in_vain for r in runs if r.policy == p) for p in policies}
    suggestions = [one for of in played for one in of.suggestions]
    summary["suggestions_judged"] = len(suggestions)
    summary["suggestions_true"] = share(true for _, true in suggestions)
    summary["suggestions_true_first"] = share(true for rank, true in suggestions if rank == 0)
    return summary


def mean_with_interval(values: Floats, seed: int = 0) -> dict[str, float]:
    """The mean, and between what 95 % of the means of redrawn values lie."""
    drawn = values[_draws(len(values), seed)].mean(axis=1)
    low, high = np.quantile(drawn, _TAILS)
    return {"mean": float(values.mean()), "low": float(low), "high": float(high)}


def ratio_interval(values: Floats, others: Floats, seed: int = 0) -> tuple[float, float]:
    """Between what 95 % of the ratios of means lie, when pairs of values are redrawn together."""
    drawn = _draws(len(values), seed)
    low, high = np.quantile(values[drawn].mean(axis=1) / others[drawn].mean(axis=1), _TAILS)
    return float(low), float(high)


_TAILS = ((1 - LEVEL) / 2, (1 + LEVEL) / 2)


def _draws(count: int, seed: int) -> npt.NDArray[np.int64]:
    return np.random.default_rng(seed).integers(count, size=(DRAWS, count))


def _clicks(played: Sequence[Played], policy: str) -> Floats:
    return np.array([r.clicks for one in played for r in one.runs if r.policy == policy], float)


def write_results(
    out: Path, played: Sequence[Played], policies: Sequence[str], split: Split
) -> dict[str, Any]:
    """Writes runs.csv, summary.json and clicks.png; prints and returns the summary."""
    runs = [run for one in played for run in one.runs]
    write_csv(out / "runs.csv", COLUMNS, (_cells(run) for run in runs))
    summary = {"split": split, **summarize(played, policies)}
    write_summary(out, summary)
    _plot(out / "clicks.png", played, policies)
    rows = [(key, *_short(value)) for key, value in summary.items()]
    print_table("clicks until the fleet is located and right", ("", "value", "low", "high"), rows)
    return summary


def _cells(run: Run) -> dict[str, Any]:
    asked = " ".join(f"{i}-{j}" for i, j in run.asked)
    flags = {flag: int(getattr(run, flag)) for flag in FLAGS}
    return {**vars(run), **flags, "asked": asked}


def _short(value: Any) -> tuple[Any, Any, Any]:
    if isinstance(value, dict) and "mean" in value:
        return value["mean"], value["low"], value["high"]
    if isinstance(value, dict):
        return ", ".join(f"{name} {count}" for name, count in value.items()), "", ""
    return value, "", ""


def _plot(path: Path, played: Sequence[Played], policies: Sequence[str]) -> None:
    """Every fleet as a dot, by policy, the mean as a line."""
    names = [*policies, "minimum"]
    columns = [_clicks(played, policy) for policy in policies]
    columns.append(np.array([one.runs[0].minimum for one in played], float))
    rng = np.random.default_rng(0)
    label = "clicks until all robots are located and right"
    with plot(path, ylabel=label, yscale="log", title=f"{len(played)} fleets") as axes:
        for place, values in enumerate(columns):
            axes.plot(place + rng.uniform(-0.15, 0.15, len(values)), values, "o", alpha=0.4)
            axes.hlines(values.mean(), place - 0.3, place + 0.3, color="black")
        axes.set_xticks(range(len(names)), [name.replace("_", "\n") for name in names])
