"""`pose-eval clicks --consistent-wrong`, `--permuted`: clicks that are wrong and fit each other, in
the server's own site: is anybody located by them, is it told, and do right ones win afterwards?
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.bench.clicks.click_noise import Clicked, right_clicks
from fleetpose.evaluation.bench.clicks.command import pairs_in_range
from fleetpose.evaluation.bench.clicks.deceptive import (
    corners_in_order,
    in_other_orders,
    one_step_along,
)
from fleetpose.evaluation.bench.clicks.truth import true_pixels
from fleetpose.evaluation.bench.clicks.worker import kept, sizes_of, takes
from fleetpose.evaluation.bench.questions.play import aligned
from fleetpose.evaluation.bench.questions.server import FleetServer
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.scoring import Limits, optical_angle_deg, pose_errors, share
from fleetpose.evaluation.options.recorded import ClicksOptions
from fleetpose.evaluation.report.output import output_folder, write_csv, write_summary

RIGHT_CLICKS = 3
"""That the operator adds when it is told."""


@dataclass(frozen=True)
class Task:
    """One pair of views and one draw of clicks.

    Attributes:
        step_m: how far along the surface the wrong clicks are off; 0 for other orders instead.
        clicks: from and to how many, for a step.
        automatic: whether the server has aligned the pair by itself before; else it is left to the
            operator.
    """

    recording: Recording
    wires: tuple[Path, Path]
    pair: tuple[TrueView, TrueView]
    step_m: float
    clicks: tuple[int, int]
    automatic: bool
    limits: Limits
    seed: tuple[int, ...]


@dataclass
class Deceived:
    """One set of wrong clicks, and what the server made of it.

    Attributes:
        clicks, wrong: made, and how many of them are wrong.
        located: a robot beside the anchor is located by them.
        grave_located: and gravely off.
        told: all wrong clicks are outliers, or operators are told that something does not fit.
        text: what they are told.
        recovered: after three right clicks these are accepted, exactly the wrong ones are outliers,
            and nobody is located and gravely off.
        right_after: and what the server knows of the pair is not gravely off.
        located_after: and both robots are located.
        grave_located_after: a robot is located then, and gravely off.
    """

    i: int
    j: int
    angle_deg: float
    draw: int
    clicks: int
    wrong: int
    located: bool
    grave_located: bool
    told: bool
    text: str
    recovered: bool
    right_after: bool
    located_after: bool
    grave_located_after: bool
    position_error_m: float | None
    position_error_after_m: float | None


def run(options: ClicksOptions, out: Path) -> dict[str, Any]:
    """Deceives the server in all pairs; writes deceived.csv and summary.json; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or no pair is in the range.
    """
    recording = options.recording()
    pairs = pairs_in_range(recording, options)
    output_folder(out)
    limits = Limits.of(median_depth_m(recording), recording.is_rgbd)
    rows: list[Deceived] = []
    missing = 0
    with bench_of(options.workers) as bench:
        wires, _ = bench.on_the_wire(recording, [view for pair in pairs for view in pair])
        jobs = []
        for i, j in pairs:
            for draw in range(options.draws):
                task = Task(
                    recording,
                    (wires[i.index], wires[j.index]),
                    (i, j),
                    options.consistent_wrong_m,
                    options.clicks,
                    options.automatic,
                    limits,
                    (options.seed, i.index, j.index, draw),
                )
                jobs.append((None, (deceive, task)))
        for _, found in bench.as_done("draws", jobs):
            rows += found
            missing += not found
    rows.sort(key=lambda row: (row.i, row.j, row.draw))
    write_csv(out / "deceived.csv", Deceived, rows)
    summary = {"grave_m": limits.grave_m, "no_draw": missing, **summarize(rows)}
    write_summary(out, summary, "clicks that deceive")
    return summary


def summarize(rows: Sequence[Deceived]) -> dict[str, Any]:
    """Counts of what must not be, and shares of what must."""
    return {
        "draws": len(rows),
        "pairs": len({(row.i, row.j) for row in rows}),
        "grave_located": sum(row.grave_located for row in rows),
        "located": sum(row.located for row in rows),
        "told_wrong": share(row.told for row in rows),
        "recovered": share(row.recovered for row in rows),
        "right_after": share(row.right_after for row in rows),
        "located_after": share(row.located_after for row in rows),
        "grave_located_after": sum(row.grave_located_after for row in rows),
    }


def deceive(task: Task) -> list[Deceived]:
    """Runs in a worker: one set of wrong clicks, or every wrong order of four points; none where
    the two views have no places for it.
    """
    views = (kept(task.wires[0]), kept(task.wires[1]))
    rng = np.random.default_rng(task.seed)
    true = true_pixels(task.recording, *task.pair)
    if task.step_m:
        count = int(rng.integers(task.clicks[0], task.clicks[1] + 1))
        lift = takes(views)
        one = one_step_along(task.recording, task.pair, task.step_m, count, rng, lift)
        sets = [] if one is None else [one]
    else:
        right = corners_in_order(task.recording, task.pair, true, rng, takes(views))
        sets = [] if right is None else in_other_orders(right)
    later = right_clicks(true, RIGHT_CLICKS, rng, sizes_of(views), takes(views))
    if len(later) < RIGHT_CLICKS:
        return []
    return [_played(task, wrong, later) for wrong in sets]


def _played(task: Task, wrong: Clicked, later: Clicked) -> Deceived:
    server, names = _server(task)
    server.visit(names, _by_name(task, server, wrong))
    here = _standing(task, server)
    record = server.site.pair(*names)
    statuses = [kept.item.status for kept in server.site.correspondences.of(*names)]
    marked = np.array([status == "outlier" for status in statuses])
    told = bool(record.told) or bool(marked[wrong.wrong].all())
    text = record.told
    server.visit(names, _by_name(task, server, later))
    after = _standing(task, server)
    statuses = [kept.item.status for kept in server.site.correspondences.of(*names)]
    accepted = all(status == "accepted" for status in statuses[len(wrong) :])
    marked = [status == "outlier" for status in statuses[: len(wrong)]]
    recovered = accepted and marked == wrong.wrong.tolist() and not after.grave_located
    i, j = task.pair
    return Deceived(
        i.index,
        j.index,
        optical_angle_deg(i.T_world_camera, j.T_world_camera),
        task.seed[-1],
        len(wrong),
        int(wrong.wrong.sum()),
        here.located,
        here.grave_located,
        told,
        text,
        recovered,
        recovered and after.error_m is not None and not after.grave,
        after.located,
        after.grave_located,
        here.error_m,
        after.error_m,
    )


@dataclass(frozen=True)
class _Standing:
    """What the server knows of the pair: its error where it is joined, and whether both robots are
    located.
    """

    error_m: float | None
    grave: bool
    located: bool

    @property
    def grave_located(self) -> bool:
        return self.grave and self.located


def _server(task: Task) -> tuple[FleetServer, tuple[str, str]]:
    """A server of the two robots, and their names in order."""
    wires = {view.index: wire for view, wire in zip(task.pair, task.wires, strict=True)}
    a, b = sorted(task.wires, key=lambda wire: kept(wire).name.robot)
    names = (kept(a).name.robot, kept(b).name.robot)
    results = {names: aligned(a, b)} if task.automatic else {}
    server = FleetServer(wires, results)
    if not task.automatic:
        server.site.skip = frozenset({names})
        server.site.set_anchor(names[0])
    return server, names


def _by_name(task: Task, server: FleetServer, clicked: Clicked) -> list[tuple[Floats, Floats]]:
    """Clicks with the robots in order of their names."""
    first = server.names[task.pair[0].index] == min(server.views)
    pixels = clicked.pixels if first else clicked.pixels[::-1]
    return list(zip(*pixels, strict=True))


def _standing(task: Task, server: FleetServer) -> _Standing:
    i, j = (server.view(server.names[view.index]) for view in task.pair)
    T = server.site.relative(i, j)
    located = len(server.located_cameras()) == len(task.pair)
    if T is None:
        return _Standing(None, False, located)
    errors = pose_errors(task.pair[0].T_to(task.pair[1]), np.asarray(T, np.float64))
    return _Standing(errors[0], task.limits.grave(*errors), located)
