"""What the workers do for one pair of views: the operator clicks, the server (or the paper's
method) aligns.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.clicks import click_noise
from fleetpose.evaluation.bench.clicks.click_noise import Clicked
from fleetpose.evaluation.bench.pairs.worker import (
    Answer,
    answer_of,
    of_wide,
    prepared,
    timed,
    widen,
)
from fleetpose.evaluation.metrics.geometry import Floats

if TYPE_CHECKING:
    from fleetpose.pose_server.geometry.lift import LiftedPoint
    from fleetpose.pose_server.state.views import KeptView
    from fleetpose.pose_server.workers.jobs import EncodedView, Job

Recipe = Literal["paper", "full"]


@dataclass(frozen=True)
class Plan:
    """So many clicks, of which so many are wrong."""

    clicks: int
    wrong: int = 0


@dataclass(frozen=True)
class Task:
    """One pair of views, one draw of clicks, aligned for each plan.

    Attributes:
        wire_i, wire_j: what the two robots sent.
        true: (N, 2) pixels of both views that show the same points, known to the operator.
        plans: plans with fewer clicks use the first ones of those with more.
        seed: of choice and noise.
    """

    wire_i: Path
    wire_j: Path
    true: tuple[Floats, Floats]
    plans: tuple[Plan, ...]
    recipe: Recipe
    seed: tuple[int, ...]


@dataclass(frozen=True)
class Lifted:
    """Clicked points in one view: (N, 3) places in the camera frame, (N, 3, 3) covariances."""

    p: Floats
    C: Floats


@dataclass(frozen=True)
class ClickedAnswer:
    """What became of a plan.

    Attributes:
        answer: of the alignment.
        icp_ms: of it, spent in ICP.
        at_i, at_j: the clicked points.
        wrong: (N,) which clicks are wrong.
        right_only: the answer without the wrong clicks, where there were any.
    """

    answer: Answer
    icp_ms: float
    at_i: Lifted
    at_j: Lifted
    wrong: npt.NDArray[np.bool_]
    right_only: Answer | None = None


def run_task(task: Task) -> list[ClickedAnswer]:
    """Clicks and aligns for each plan of a task, in their order."""
    views = (kept(task.wire_i), kept(task.wire_j))
    sizes = sizes_of(views)
    rng = np.random.default_rng(task.seed)
    most = max(plan.clicks for plan in task.plans)
    clicked = click_noise.right_clicks(task.true, most, rng, sizes, takes(views))
    answers = []
    for plan in task.plans:
        some = clicked.first(plan.clicks)
        if plan.wrong:
            own = np.random.default_rng((*task.seed, plan.clicks))
            lift = takes(views)
            some = click_noise.with_wrong(some, plan.wrong, own, sizes, lift)
        answers.append(_answered(task, views, some))
    return answers


def _answered(task: Task, views: Sequence["KeptView"], clicked: Clicked) -> ClickedAnswer:
    at_i, at_j = (lifted(view, uv) for view, uv in zip(views, clicked.pixels, strict=True))
    right_only = None
    if clicked.wrong.any():
        right = ~clicked.wrong
        ends = (Lifted(at.p[right], at.C[right]) for at in (at_i, at_j))
        right_only = _aligned(task, *ends)[0]
    answer, icp_ms = _aligned(task, at_i, at_j)
    return ClickedAnswer(answer, icp_ms, at_i, at_j, clicked.wrong, right_only)


def _aligned(task: Task, at_i: Lifted, at_j: Lifted) -> tuple[Answer, float]:
    if task.recipe == "paper":
        return by_paper(task.wire_i, task.wire_j, at_i, at_j)
    return by_server(task.wire_i, task.wire_j, at_i, at_j)


def by_paper(wire_i: Path, wire_j: Path, at_i: Lifted, at_j: Lifted) -> tuple[Answer, float]:
    """The paper's answer, and the milliseconds of its ICP."""
    from fleetpose.pose_server.registration.paper import by_icp, linear_start

    _prepare_paper(wire_i, wire_j)
    (i, _), (j, _) = prepared(wire_i), prepared(wire_j)
    start, start_ms = timed(lambda: linear_start(at_i.p, at_j.p))
    found, found_ms = timed(lambda: by_icp(i, j, start.T_i_j))
    T = np.asarray(start.T_i_j if found is None else found.T_i_j, np.float64)
    icp_ms = 0.0 if found is None else found.report.ms
    return Answer(T, None, "", (), start.model, 0, start_ms + found_ms), icp_ms


def by_server(wire_i: Path, wire_j: Path, at_i: Lifted, at_j: Lifted) -> tuple[Answer, float]:
    """The server's answer by its own job for clicks, and the milliseconds of its ICP."""
    from fleetpose.pose_server.registration.align import is_settled
    from fleetpose.pose_server.workers.run import run_job

    _prepare(wire_i, wire_j)
    job = as_job(wire_i, wire_j, at_i, at_j)
    with timed_icp() as icp:
        result, align_ms = timed(lambda: run_job(job))
    if is_settled(result):
        return answer_of(result, align_ms), icp.ms
    wide = replace(job, i=with_wide(job.i, wire_i), j=with_wide(job.j, wire_j))
    with timed_icp() as wide_icp:
        result, wide_ms = timed(lambda: run_job(wide))
    return answer_of(result, align_ms + wide_ms, wide=True), icp.ms + wide_icp.ms


@dataclass
class Spent:
    """Milliseconds spent in some function so far."""

    ms: float = 0.0


@contextmanager
def timed_icp() -> Iterator[Spent]:
    """Adds up all ICP of the server's alignments meanwhile, whichever of their steps asks for it:
    rough ICP from shapes, that of `with_surfaces`, what is left at the end, and that of clouds
    alone.
    """
    from fleetpose.pose_server.registration import refinement, surfaces

    spent = Spent()

    def timed(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            began = time.perf_counter()
            try:
                return function(*args, **options)
            finally:
                spent.ms += 1e3 * (time.perf_counter() - began)

        return call

    steps = [(refinement, "gicp"), (refinement, "registered"), (surfaces, "gicp")]
    steps.append((surfaces, "by_open3d"))
    before = [getattr(module, name) for module, name in steps]
    for (module, name), function in zip(steps, before, strict=True):
        setattr(module, name, timed(function))
    try:
        yield spent
    finally:
        for (module, name), function in zip(steps, before, strict=True):
            setattr(module, name, function)


def with_wide(view: "EncodedView", wire: Path) -> "EncodedView":
    """The view with its wide set of salient points, which its robot makes when it is asked."""
    widen(wire)
    return replace(view, wide=of_wide(wire).read_bytes())


def as_job(wire_i: Path, wire_j: Path, at_i: Lifted, at_j: Lifted) -> "Job":
    """The job that the server makes of a pair of views and the clicks in them."""
    from fleetpose.pose_server.registration.operator_starts import Clicks
    from fleetpose.pose_server.workers.jobs import ClickJob, PairJob

    i, j = encoded(wire_i), encoded(wire_j)
    if len(at_i.p) == 0:
        return PairJob(i, j)
    uv_i, uv_j = (_pixels(wire, at.p) for wire, at in ((wire_i, at_i), (wire_j, at_j)))
    sigma_i, sigma_j = (np.sqrt(at.C[:, 2, 2]) for at in (at_i, at_j))
    clicks = Clicks(uv_i, uv_j, at_i.p[:, 2], at_j.p[:, 2], sigma_i, sigma_j)
    return ClickJob(i, j, clicks=clicks)


def encoded(wire: Path) -> "EncodedView":
    """A view as jobs name it."""
    return kept(wire).encoded


def _pixels(wire: Path, points: Floats) -> Floats:
    """(N, 2) where points (N, 3) of a camera appear in its image."""
    uvw = points @ kept(wire).camera.K.T
    return uvw[:, :2] / uvw[:, 2:]


@lru_cache(maxsize=8)
def _prepare(wire_i: Path, wire_j: Path) -> None:
    """Has two views prepared in this worker: the time of an alignment is then that of the pair."""
    from fleetpose.pose_server.workers.jobs import PairJob
    from fleetpose.pose_server.workers.run import run_job

    run_job(PairJob(encoded(wire_i), encoded(wire_j)))


@lru_cache(maxsize=8)
def _prepare_paper(wire_i: Path, wire_j: Path) -> None:
    """The same for the paper's method, so that both are timed on a pair that they have seen."""
    from fleetpose.pose_server.registration.paper import by_icp

    by_icp(prepared(wire_i)[0], prepared(wire_j)[0], np.eye(4))


@lru_cache(maxsize=64)
def kept(wire: Path) -> "KeptView":
    """A view as the server keeps it."""
    from fleetpose.pose_server.state.views import open_view

    return open_view(wire.read_bytes(), None, 0.0)


def sizes_of(views: Sequence["KeptView"]) -> tuple[click_noise.Size, click_noise.Size]:
    """Widths and heights of two views."""
    i, j = (view.camera for view in views)
    return (i.width, i.height), (j.width, j.height)


def takes(views: Sequence["KeptView"]) -> click_noise.Lift:
    """Tells of a pixel in one of two views whether the server takes a click there."""
    return lambda view, pixel: lift(views[view], pixel)


def lift(view: "KeptView", pixel: Floats) -> "LiftedPoint | None":
    """The point under a click, by the server's own lifting; none where it refuses."""
    from fleetpose.pose_server.correspondences.lifting import NoDepthError

    try:
        return _lifter().lift(view, pixel)
    except NoDepthError:
        return None


@lru_cache(maxsize=1)
def _lifter():  # noqa: ANN202
    from fleetpose.pose_server.correspondences.lifting import Lifter

    return Lifter()


def lifted(view: "KeptView", pixels: Floats) -> Lifted:
    """The points under clicks (N, 2) that the server takes."""
    points = [point for uv in pixels if (point := lift(view, uv)) is not None]
    assert len(points) == len(pixels)  # only clicks that the server takes are drawn
    return Lifted(
        np.array([point.p for point in points], np.float64).reshape(-1, 3),
        np.array([point.C for point in points], np.float64).reshape(-1, 3, 3),
    )
