"""Recipes: how two views of two robots are aligned. Both run in the live server, so that they can
be watched side by side.
"""

from collections.abc import Callable
from typing import Protocol

from fleetpose.pose_server.registration.align import align_from, align_pair, align_wide, is_settled
from fleetpose.pose_server.registration.clicked import with_clicks
from fleetpose.pose_server.registration.paper import align_as_published
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import RecipeName
from fleetpose.pose_server.workers.jobs import Job

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
        sets = job.click_sets(i, j)
        starts = [*job.starts, *(start for one in sets for start in one.starts)]
        if job.known is not None:
            result = align_from(i, j, starts, job.known, job.icp)
        else:
            result = job.usual or align_pair(i, j, starts, job.features, job.icp)
            if job.features and job.wide and not is_settled(result):
                result = align_wide(*both_wide(), result, starts, job.icp)
        return result if job.clicks is None else with_clicks(result, sets, job.clicks, i, j)


class Paper:
    """The method as published: see `pairs.paper`."""

    def align(self, job: Job, i: PreparedView, j: PreparedView, both_wide: BothWide) -> PairResult:
        return align_as_published(i, j, job.clicks, job.starts)


RECIPES: dict[RecipeName, Recipe] = {"full": Full(), "paper": Paper()}
