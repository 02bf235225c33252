"""One run of two robots, in a worker: clicks in their first views, and what becomes of the next."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from fleetpose.evaluation.bench.clicks import click_noise
from fleetpose.evaluation.bench.clicks.worker import as_job, encoded, kept, lifted, sizes_of, takes
from fleetpose.evaluation.bench.pairs.worker import prepared, timed
from fleetpose.evaluation.bench.persist.walks import Walk
from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.metrics.scoring import pose_errors
from fleetpose.evaluation.simulate.operator import by_view_depth

if TYPE_CHECKING:
    from fleetpose.pose_server.registration.refinement import Start
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult

Policy = Literal["with", "without", "without_but_carried", "paper_with", "paper_without"]
POLICIES: tuple[Policy, ...] = get_args(Policy)
"""Clicks in the first views, the pose carried on; no clicks, each pair of views by itself; no
clicks, what was found by itself carried on. The same by the paper's ICP alone: from the carried
pose, and from the identity."""
CARRIED_SIGMA = 0.03
"""Of a carried start, share of the depth: what the server gives to starts from its graph."""


@dataclass(frozen=True)
class Run:
    """Views of two robots in step; the operator clicks in the first two."""

    number: int
    a: Walk
    b: Walk
    clicks: int
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Step:
    """One pair of views after the first, by one policy.

    Attributes:
        run, step: number of the run, and of the view after the clicks.
        verdict: of its own alignment.
        source: `alignment`, `carried` where that failed, or `none`.
        position_error_m, rotation_error_deg: of the pose that the server would have; none: none.
        icp_ms, align_ms: of its own alignment.
    """

    policy: Policy
    run: int
    step: int
    verdict: str
    source: str
    position_error_m: float | None
    rotation_error_deg: float | None
    icp_ms: float
    align_ms: float


def follow(run: Run) -> list[Step]:
    """Follows two robots by all policies; nothing where the first views cannot be clicked in."""
    T_clicked = _by_clicks(run)
    if T_clicked is None:
        return []
    own = [_motions(walk) for walk in (run.a, run.b)]
    poses: dict[Policy, Floats | None] = dict.fromkeys(POLICIES)
    poses["with"] = poses["paper_with"] = T_clicked
    poses["without_but_carried"] = _accepted_pose(_aligned(run, 0, ())[0])
    steps = []
    for k in range(1, len(run.a.wires)):
        _aligned(run, k, ())  # prepares both views: the times are those of the pair alone
        for policy in POLICIES[:3]:
            carried = _carried(poses[policy], own[0][k], own[1][k])
            result, align_ms = _aligned(run, k, _starts(carried))
            found = _accepted_pose(result)
            pose = carried if found is None else found
            source = "none" if pose is None else "carried" if found is None else "alignment"
            steps.append(_step(policy, run, k, result, align_ms, pose, source))
            poses[policy] = None if policy == "without" else pose
        for policy in POLICIES[3:]:
            start = _carried(poses[policy], own[0][k], own[1][k])
            poses[policy], step = _by_paper(policy, run, k, start)
            steps.append(step)
    return steps


def _by_paper(policy: Policy, run: Run, k: int, start: Floats | None) -> tuple[Floats | None, Step]:
    """The paper's ICP from a start or from the identity, and the pose to carry on."""
    from fleetpose.pose_server.registration.paper import by_icp

    (i, _), (j, _) = prepared(run.a.wires[k]), prepared(run.b.wires[k])
    from_there = np.eye(4) if start is None else start
    found = by_icp(i, j, from_there)
    T = np.asarray(from_there if found is None else found.T_i_j, np.float64)
    icp_ms = 0.0 if found is None else found.report.ms
    errors = pose_errors(_true(run, k), T)
    step = Step(policy, run.number, k, "", "alignment", *errors, icp_ms, icp_ms)
    return (None if policy == "paper_without" else T), step


def _by_clicks(run: Run) -> Floats | None:
    """The server's pose of the first views with clicks; none where it cannot have them."""
    from fleetpose.pose_server.frontend.tracks import accepted
    from fleetpose.pose_server.workers.run import run_job
    from fleetpose.protocol import codec
    from fleetpose.protocol.messages import View

    wires = (run.a.wires[0], run.b.wires[0])
    views = (kept(wires[0]), kept(wires[1]))
    i, j = (codec.unpack(View, view.payload) for view in views)
    true = by_view_depth(i, j, _true(run, 0))
    rng = np.random.default_rng(run.seed)
    clicked = click_noise.right_clicks(true, run.clicks, rng, sizes_of(views), takes(views))
    if len(clicked) < run.clicks:
        return None
    at_i, at_j = (lifted(view, uv) for view, uv in zip(views, clicked.pixels, strict=True))
    result = run_job(as_job(*wires, at_i, at_j))
    return np.asarray(result.T_i_j, np.float64) if accepted(result) else None


def _motions(walk: Walk) -> list[Floats | None]:
    """T_before_now of each view, by aligning it with the one before; none where that fails."""
    from fleetpose.pose_server.workers.jobs import TrackJob
    from fleetpose.pose_server.workers.run import run_job

    motions: list[Floats | None] = [None]
    for before, now in zip(walk.wires, walk.wires[1:], strict=False):
        motions.append(_accepted_pose(run_job(TrackJob(encoded(before), encoded(now)))))
    return motions


def _carried(T_a_b: Floats | None, own_a: Floats | None, own_b: Floats | None) -> Floats | None:
    """The pose of the next views by what each robot moved; none if any of these is not known."""
    if T_a_b is None or own_a is None or own_b is None:
        return None
    return inverse(own_a) @ T_a_b @ own_b


def _starts(carried: Floats | None) -> tuple["Start", ...]:
    from fleetpose.pose_server.registration.refinement import Start

    return () if carried is None else (Start("graph", carried, CARRIED_SIGMA),)


def _aligned(run: Run, k: int, starts: Sequence["Start"]) -> tuple["PairResult", float]:
    from fleetpose.pose_server.workers.jobs import PairJob
    from fleetpose.pose_server.workers.run import run_job

    job = PairJob(encoded(run.a.wires[k]), encoded(run.b.wires[k]), tuple(starts))
    return timed(lambda: run_job(job))


def _accepted_pose(result: "PairResult") -> Floats | None:
    from fleetpose.pose_server.frontend.tracks import accepted

    return np.asarray(result.T_i_j, np.float64) if accepted(result) else None


def _step(
    policy: Policy,
    run: Run,
    k: int,
    result: "PairResult",
    align_ms: float,
    pose: Floats | None,
    source: str,
) -> Step:
    errors = (None, None) if pose is None else pose_errors(_true(run, k), pose)
    icp_ms = result.icp.ms if result.icp else 0.0
    return Step(policy, run.number, k, result.verdict, source, *errors, icp_ms, align_ms)


def _true(run: Run, k: int) -> Floats:
    return inverse(run.a.T_world_cameras[k]) @ run.b.T_world_cameras[k]
