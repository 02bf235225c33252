"""`pose-eval persist`: what the operator's clicks are worth for the views that come after them.

The server carries an accepted pose over to later views by each robot's own motion and begins there.
So each pair of later views is aligned from the carried pose where there were clicks before, and
from nothing where there were none.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fleetpose.evaluation.bench.persist.following import POLICIES, Policy, Run, Step, follow
from fleetpose.evaluation.bench.persist.walks import Walk, recorded_walk, world_walk
from fleetpose.evaluation.bench.working import Bench, bench_of
from fleetpose.evaluation.data.opening import median_depth_m, open_recording
from fleetpose.evaluation.data.recording import Recording
from fleetpose.evaluation.metrics.scoring import Limits, percentile, share
from fleetpose.evaluation.options.recorded import PersistOptions
from fleetpose.evaluation.report import output
from fleetpose.protocol.errors import FleetPoseError

_WORLD_DEPTH_M = 8.0
"""Median depth of the synthetic world's views, to a few per cent."""


def run(options: PersistOptions, out: Path) -> dict[str, Any]:
    """Follows two robots with and without clicks; writes persist.csv, summary.json and persist.png.

    Returns:
        The summary.

    Raises:
        FleetPoseError: the data cannot be used, or in no first pair of views can be clicked.
    """
    recording = None if options.data is None else open_recording(options.data)
    output.output_folder(out)
    with bench_of(options.workers) as bench:
        a, b = _walks(options, recording, bench)
        runs = runs_of(a, b, options)
        jobs = [(None, (follow, one)) for one in runs]
        steps = [step for _, own in bench.as_done("runs", jobs, 8) for step in own]
    if not steps:
        raise FleetPoseError(
            f"in none of {len(runs)} first pairs of views {options.clicks} points can be clicked: "
            "the two halves of the walk do not look at the same; give more --runs"
        )
    steps.sort(key=lambda step: (step.run, step.step, step.policy))
    output.write_csv(out / "persist.csv", Step, steps)
    depth_m = _WORLD_DEPTH_M if recording is None else median_depth_m(recording)
    limits = Limits.of(depth_m, recording is not None)
    summary = {"median_depth_m": depth_m, **summarize(steps, limits)}
    output.write_summary(out, summary)
    plot(out / "persist.png", steps)
    _print(summary)
    return summary


def runs_of(a: Walk, b: Walk, options: PersistOptions) -> list[Run]:
    """Runs forward from the first views on and back from the last, in turn."""
    count = options.views + 1
    last = len(a.wires) - count
    ways: list[tuple[int, Literal[1, -1]]] = []
    for k in range(last + 1):
        ways.append((k, 1))
        ways.append((len(a.wires) - 1 - k, -1))
    chosen = np.unique(np.linspace(0, len(ways) - 1, options.runs).round().astype(int))
    return [
        Run(
            number=n,
            a=a.part(ways[k][0], count, ways[k][1]),
            b=b.part(ways[k][0], count, ways[k][1]),
            clicks=options.clicks,
            seed=(options.seed, n),
        )
        for n, k in enumerate(chosen.tolist())
    ]


def summarize(steps: Sequence[Step], limits: Limits) -> dict[str, Any]:
    """Each policy over all steps after the first views, and with beside without clicks.

    Errors and times are compared over the steps in which both have a pose.
    """
    summary: dict[str, Any] = {"runs": len({step.run for step in steps})}
    for policy in POLICIES:
        summary[policy] = _sums([step for step in steps if step.policy == policy], limits)
    summary["where_both_answer"] = _beside(steps, "with", "without")
    summary["where_both_answer_paper"] = _beside(steps, "paper_with", "paper_without")
    return summary


def _beside(steps: Sequence[Step], policy: Policy, other_policy: Policy) -> dict[str, Any]:
    """Mean errors and times of two policies over the steps in which both have a pose."""
    by_key = {(step.policy, step.run, step.step): step for step in steps}
    both = [
        (step, other)
        for step in steps
        if step.policy == policy
        and step.position_error_m is not None
        and (other := by_key[other_policy, step.run, step.step]).position_error_m is not None
    ]
    compared: dict[str, Any] = {"steps": len(both)}
    for name in ("position_error_m", "icp_ms", "align_ms"):
        for k, end in enumerate(("with", "without")):
            values = [vars(one[k])[name] for one in both]
            compared[f"{name}_{end}"] = float(np.mean(values)) if values else None
    return compared


def _sums(steps: Sequence[Step], limits: Limits) -> dict[str, Any]:
    errors = [(s.position_error_m, s.rotation_error_deg) for s in steps]
    given = [(m, deg) for m, deg in errors if m is not None and deg is not None]
    return {
        "steps": len(steps),
        "answered": len(given) / len(steps),
        "ok": sum(limits.ok(*error) for error in given) / len(steps),
        "not_grave": sum(not limits.grave(*error) for error in given) / len(steps),
        "verified": share(step.verdict == "verified" for step in steps),
        "position_error_median_m": percentile([m for m, _ in given], 50),
        # a view without a pose is no better than one with any error
        "position_error_median_all_m": float(
            np.median([np.inf if m is None else m for m, _ in errors])
        ),
        "icp_ms": float(np.mean([step.icp_ms for step in steps])),
        "align_ms": float(np.mean([step.align_ms for step in steps])),
    }


def plot(path: Path, steps: Sequence[Step]) -> None:
    """Median error, share without a pose, and time of alignment over the views after the clicks."""
    figure, axes = output.new_figure(12.0, 4.0)
    axes.remove()
    values = {
        "median position error, m": lambda own: percentile(
            [s.position_error_m for s in own if s.position_error_m is not None], 50
        ),
        "share of pairs with a pose": lambda own: share(s.source != "none" for s in own),
        "whole alignment, ms": lambda own: float(np.mean([s.align_ms for s in own])),
    }
    numbers = sorted({step.step for step in steps})
    for k, (label, value) in enumerate(values.items()):
        panel = figure.add_subplot(1, 3, k + 1)
        for policy in POLICIES:
            own = [[s for s in steps if s.policy == policy and s.step == n] for n in numbers]
            curve = [np.nan if (v := value(some)) is None else v for some in own]
            panel.plot(numbers, curve, label=policy.replace("_", " "))
        panel.set(xlabel="views after the clicks", ylabel=label, ylim=(0, None))
        panel.grid(alpha=0.3)
        panel.legend(fontsize=7)
    figure.savefig(path)


def _walks(options: PersistOptions, recording: Recording | None, bench: Bench) -> tuple[Walk, Walk]:
    """Both robots' walks; in the synthetic world a few views longer, for several runs."""
    if recording is None:
        views = options.views + 1 + options.runs // 2
        walk = partial(world_walk, options.separation_deg, options.seed)
    else:
        views, walk = options.views + 1, partial(recorded_walk, recording)
    jobs = [bench.pool.submit(walk, k, views, bench.folder) for k in (0, 1)]
    return jobs[0].result(), jobs[1].result()


def _print(summary: dict[str, Any]) -> None:
    columns = list(summary[POLICIES[0]])
    rows = [(name, *(summary[policy][name] for policy in POLICIES)) for name in columns]
    output.print_table("after the clicks", ("", *POLICIES), rows)
    for name in ("where_both_answer", "where_both_answer_paper"):
        output.print_table(name.replace("_", " "), ("", ""), list(summary[name].items()))
