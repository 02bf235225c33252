"""A job: aligning two views, wherever a worker runs. Views are prepared once per worker."""

import ctypes
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from threadpoolctl import threadpool_limits

from fleetpose.pose_server.frontend.moving_points import without_moving
from fleetpose.pose_server.registration.prepared_view import PreparedView, prepare_view
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.workers.jobs import EncodedView, Job, TrackJob
from fleetpose.pose_server.workers.recipes import RECIPES
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import View, ViewName
from fleetpose.protocol.messages.arrays import MAX_DISTANCE_M

TRACK_POINTS = 700  # salient points used to follow a robot through its own views
_CACHED_VIEWS = 32
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3


def use_one_thread() -> None:
    """Has this process compute in one thread, and keep its scratch memory: the processes are the
    parallelism.
    """
    libc = ctypes.CDLL(None)
    libc.mallopt(_M_TRIM_THRESHOLD, 1 << 29)  # scratch arrays are reused instead of given back:
    libc.mallopt(_M_MMAP_THRESHOLD, 1 << 25)  # page faults had cost more than the arithmetic
    threadpool_limits(1)


_prepared: OrderedDict[ViewName, PreparedView] = OrderedDict()
_widened: OrderedDict[ViewName, PreparedView] = OrderedDict()


def forget_views() -> None:
    """Forgets what was prepared: views are named within a site's life only. Who plays several sites
    in one process calls it between them.
    """
    _prepared.clear()
    _widened.clear()


def run_job(job: Job) -> PairResult:
    """Aligns the two views of a job; runs in a worker."""
    i, j = (without_moving(_view(encoded), encoded.mask) for encoded in (job.i, job.j))
    follows = isinstance(job, TrackJob)
    if follows:
        i, j = i.strongest(TRACK_POINTS), j.strongest(TRACK_POINTS)
    # a robot follows itself by features whatever its pairs are aligned by
    recipe = RECIPES["full" if follows else job.recipe]
    return _finite(recipe.align(job, i, j, lambda: _both_wide(job)))


def _both_wide(job: Job) -> tuple[PreparedView, PreparedView]:
    i, j = (without_moving(_wide(encoded), encoded.mask) for encoded in (job.i, job.j))
    return i, j


def prepare(views: Sequence[EncodedView]) -> None:
    """Prepares views that jobs will ask for, which tell what is damaged; runs in a worker."""
    for encoded in views:
        with suppress(CodecError):
            _view(encoded)


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
