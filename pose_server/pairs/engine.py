"""A job: aligning two views, wherever a worker runs. Views are prepared once per worker."""

import ctypes
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pose_server.geometry.icp import Method
from pose_server.geometry.motion import Mask
from pose_server.pairs.judging import PairResult
from pose_server.pairs.moving import without_moving
from pose_server.pairs.recipes import RECIPES, RecipeName
from pose_server.pairs.refining import Start
from pose_server.pairs.starts import (
    Clicks,
    OperatorStart,
    gravity_between,
    operator_starts,
)
from pose_server.pairs.views import PreparedView, prepare_view
from protocol.arrays import MAX_DISTANCE_M
from protocol.codec import unpack
from protocol.errors import CodecError
from protocol.messages import View, ViewName

TRACK_POINTS = 700  # salient points used to follow a robot through its own views
_CACHED_VIEWS = 32
_FOUND = ("verified", "plausible")
_FOUND_SIGMA = 0.02  # of a pose that features found, as a start; share of the depth
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
Purpose = Literal["clicks", "track", "pair"]


@dataclass(frozen=True)
class EncodedView:
    """A view as it came over the wire, which workers prepare once.

    Attributes:
        name: the view.
        payload: its bytes.
        mask: where something moves in it.
        wide: bytes of the same view with the wide set of salient points, where its robot was asked.
    """

    name: ViewName
    payload: bytes
    mask: Mask | None = None
    wide: bytes | None = None


@dataclass(frozen=True)
class Job:
    """Align two views.

    Attributes:
        purpose: for clicks, to follow one robot's own motion (i is its keyframe), or for a pair of
            robots.
        i, j: the views.
        starts: poses to begin from, camera j in camera i.
        features: whether to look for a start by features as well.
        clicks: the operator's correspondences between the two views.
        usual: what the usual salient points gave, where the wide ones are to be tried now.
        known: what features gave for these very views: they need not be asked again.
        urgent: whether an operator waits for it.
        recipe: how pairs are aligned.
        icp: how its clouds are brought together.
    """

    purpose: Purpose
    i: EncodedView
    j: EncodedView
    starts: tuple[Start, ...] = ()
    features: bool = True
    clicks: Clicks | None = None
    usual: PairResult | None = None
    known: PairResult | None = None
    urgent: bool = False
    recipe: RecipeName = "full"
    icp: Method = "gicp"

    def click_sets(self, i: PreparedView, j: PreparedView) -> list[OperatorStart]:
        """The clicks as far as they agree; one or two take their rotation from what is known of the
        views, by other robots or by features.
        """
        if self.clicks is None:
            return []
        found, others = self.known or self.usual, list(self.starts)
        if found is not None and found.T_i_j is not None and found.verdict in _FOUND:
            others.append(Start("features", found.T_i_j, _FOUND_SIGMA))
        return operator_starts(i, j, self.clicks, others, gravity_between(i, j))

    @property
    def wide(self) -> bool:
        """Whether the wide sets of both views are there."""
        return self.i.wide is not None and self.j.wide is not None


@dataclass(frozen=True)
class Done:
    """A job's end: its result, or why there is none.

    Attributes:
        tries: workers that it was given to.
        worker_died: the last of them died of it, or beside it.
    """

    job: Job
    result: PairResult | None
    error: str = ""
    wall_ms: float = 0.0
    tries: int = 1
    worker_died: bool = False

    @property
    def outcome(self) -> PairResult:
        """What became of the pair: where there is no result, that it failed."""
        failed = PairResult(None, None, "rejected", (f"the alignment failed: {self.error}",))
        return self.result or failed


def use_one_thread() -> None:
    """Has this process compute in one thread, and keep its scratch memory: the processes are the
    parallelism.
    """
    libc = ctypes.CDLL(None)
    libc.mallopt(_M_TRIM_THRESHOLD, 1 << 29)  # scratch arrays are reused instead of given back:
    libc.mallopt(_M_MMAP_THRESHOLD, 1 << 25)  # page faults had cost more than the arithmetic
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


_prepared: OrderedDict[ViewName, PreparedView] = OrderedDict()
_widened: OrderedDict[ViewName, PreparedView] = OrderedDict()


def run_job(job: Job) -> PairResult:
    """Aligns the two views of a job; runs in a worker."""
    i, j = (without_moving(_view(encoded), encoded.mask) for encoded in (job.i, job.j))
    if job.purpose == "track":
        i, j = i.strongest(TRACK_POINTS), j.strongest(TRACK_POINTS)
    # a robot follows itself by features whatever its pairs are aligned by
    recipe = RECIPES["full" if job.purpose == "track" else job.recipe]
    return _finite(recipe.align(job, i, j, lambda: _both_wide(job)))


def _both_wide(job: Job) -> tuple[PreparedView, PreparedView]:
    i, j = (without_moving(_wide(encoded), encoded.mask) for encoded in (job.i, job.j))
    return i, j


def _finite(result: PairResult) -> PairResult:
    """The result, unless its numbers went astray: nothing else of the server looks again."""
    for numbers in (result.T_i_j, result.covariance):
        if numbers is not None and not (np.abs(numbers) < MAX_DISTANCE_M).all():
            raise CodecError("the alignment of these views has no finite answer")
    return result


def _view(encoded: EncodedView) -> PreparedView:
    return _cached(
        _prepared, encoded.name, lambda: prepare_view(_opened(encoded.name, encoded.payload))
    )


def _wide(encoded: EncodedView) -> PreparedView:
    assert encoded.wide is not None
    payload = encoded.wide
    return _cached(
        _widened,
        encoded.name,
        lambda: _view(encoded).with_salient(_opened(encoded.name, payload).salient),
    )


def _opened(name: ViewName, payload: bytes) -> View:
    view = unpack(View, payload)
    if view.name != name:
        raise CodecError(f"view {name} holds {view.name}")
    return view


def _cached(
    cache: OrderedDict[ViewName, PreparedView], name: ViewName, make: Callable[[], PreparedView]
) -> PreparedView:
    if name not in cache:
        cache[name] = make()
    cache.move_to_end(name)
    while len(cache) > _CACHED_VIEWS:
        cache.popitem(last=False)
    return cache[name]
