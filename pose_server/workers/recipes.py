"""Recipes: how two views of two robots are aligned. Both run in the live server, so that they can
be watched side by side.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

from fleetpose.pose_server.registration.align import align_from, align_pair, align_wide, is_settled
from fleetpose.pose_server.registration.clicked import with_clicks
from fleetpose.pose_server.registration.paper import align_as_published
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import RecipeName
from fleetpose.pose_server.workers.jobs import ClickJob, Job, RetryJob

BothWide = Callable[[], tuple[PreparedView, PreparedView]]


class Recipe(Protocol):
    """How a job becomes a result."""

    def align(self, job: Job, i: PreparedView, j: PreparedView, both_wide: BothWide) -> PairResult:
        """Aligns the two views of a job.

        Args:
            job: starts, clicks, what is known.
            i, j: its views.
            both_wide: gives the same with wide sets of salient points.
        """
        ...


class Full:
    """Several starts, features, surfaces, a verdict; clicks are evidence like any other."""

    def align(self, job: Job, i: PreparedView, j: PreparedView, both_wide: BothWide) -> PairResult:
        match job:
            case ClickJob():
                sets = job.sets(i, j)
                starts = [*job.starts, *(start for one in sets for start in one.starts)]
                if job.known is not None:
                    result = align_from(i, j, starts, job.known, job.icp)
                else:
                    result = align_pair(i, j, starts, job.features, job.icp)
                    result = _with_affine(job, result, starts, both_wide)
                return with_clicks(result, sets, job.clicks, i, j)
            case RetryJob():
                return _with_affine(job, job.before, job.starts, both_wide)
            case _:
                result = align_pair(i, j, job.starts, job.features, job.icp)
                return _with_affine(job, result, job.starts, both_wide)


def _with_affine(
    job: Job, result: PairResult, starts: Sequence[Start], both_wide: BothWide
) -> PairResult:
    """A result that is not settled, with what affine keypoints say, where they are there."""
    if not (job.features and job.affine) or is_settled(result):
        return result
    return align_wide(*both_wide(), result, starts, job.icp)


class Paper:
    """The method as published: see `pairs.paper`."""

    def align(self, job: Job, i: PreparedView, j: PreparedView, both_wide: BothWide) -> PairResult:
        clicks = job.clicks if isinstance(job, ClickJob) else None
        return align_as_published(i, j, clicks, job.starts)


RECIPES: dict[RecipeName, Recipe] = {"full": Full(), "paper": Paper()}
