"""Runs jobs on a Dask cluster, with the same job function as local workers.

A cluster that is gone costs nothing but time: jobs that it had run again when it is back.
"""

import logging
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from typing import Any

from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.workers.jobs import EncodedView, Job
from fleetpose.pose_server.workers.run import run_job, use_one_thread
from fleetpose.protocol.errors import FleetPoseError, UnreachableError

log = logging.getLogger(__name__)

CONNECT_S = 10.0
_LOOK_S = 1.0  # how often the number of workers is looked up
_LONGEST_PAUSE_S = 8.0  # between two tries to reach a cluster that is gone


class GivenUpError(FleetPoseError):
    """A job that Dask does not run again."""


class ClusterPool:
    """A Dask cluster.

    Args:
        address: of its scheduler, e.g. tcp://10.0.0.1:8786.

    Raises:
        UnreachableError: no scheduler answers there.
    """

    def __init__(self, address: str) -> None:
        self._address = address
        self._closed = threading.Event()
        self._client = _connected(address)
        self.workers = _threads(self._client)
        self._lock = threading.Lock()
        self._open: dict[Any, Future[PairResult]] = {}
        self._watcher = threading.Thread(target=self._watch, name="cluster", daemon=True)
        self._watcher.start()
        log.info("cluster at %s: %d workers", address, self.workers)

    def submit(self, job: Job) -> "Future[PairResult]":
        """Begins a job; Dask runs it again by itself where a worker was lost, within its limits."""
        answer: Future[PairResult] = Future()
        try:
            theirs = self._client.submit(run_job, job, pure=False, priority=10 * job.urgent)
        except Exception as error:  # the client is closed, or closing
            answer.set_exception(BrokenProcessPool(f"the cluster is gone: {error}"))
            return answer
        with self._lock:
            self._open[theirs.key] = answer
        theirs.add_done_callback(self._ended)
        return answer

    def prepare(self, views: Sequence[EncodedView]) -> None:
        """Does nothing: which worker will have the next job is not known."""

    def close(self) -> None:
        """Leaves the cluster; its workers go on without us."""
        self._closed.set()
        with suppress(Exception):
            self._client.close(timeout=1)

    def _ended(self, theirs: Any) -> None:
        with self._lock:
            answer = self._open.pop(theirs.key, None)
        if answer is None:
            return
        if theirs.status == "finished":
            try:
                answer.set_result(theirs.result(timeout=CONNECT_S))
            except Exception as error:
                answer.set_exception(BrokenProcessPool(f"the result was lost: {error}"))
        elif theirs.status == "error":
            answer.set_exception(_error_of(theirs))
        else:
            answer.set_exception(BrokenProcessPool(f"the cluster has {theirs.status} the job"))

    def _watch(self) -> None:
        """Follows the number of workers, and reaches for a cluster that is gone."""
        pause_s = _LOOK_S
        while not self._closed.wait(pause_s):
            try:
                if self._client.status != "running":
                    self._lose()
                    self._client = _connected(self._address)
                    log.info("the cluster at %s is back", self._address)
                self.workers = _threads(self._client)
                pause_s = _LOOK_S
            except Exception as error:
                log.warning("no cluster at %s: %s", self._address, error)
                self.workers = 0
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _lose(self) -> None:
        """What the lost cluster was given ends without a result."""
        self.workers = 0
        with self._lock:
            lost, self._open = list(self._open.values()), {}
        for answer in lost:
            if not answer.done():
                answer.set_exception(BrokenProcessPool("the cluster is gone"))


def _connected(address: str) -> Any:
    """A client of the scheduler whose workers compute in one thread each.

    Raises:
        UnreachableError: no scheduler answers.
    """
    import distributed

    try:
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise UnreachableError(f"no Dask scheduler at {address}: {error}") from error
    client.register_plugin(_OneThread(), name="fleetpose-one-thread")
    return client


def _OneThread() -> Any:
    import distributed

    class OneThread(distributed.WorkerPlugin):
        """Workers that come later are told as well."""

        def setup(self, worker: Any) -> None:
            use_one_thread()

    return OneThread()


def _threads(client: Any) -> int:
    """Jobs that the cluster runs at a time."""
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    return sum(worker["nthreads"] for worker in workers)


def _error_of(theirs: Any) -> BaseException:
    """Why a job failed; of a worker that died of it again and again Dask says so."""
    import distributed

    error = theirs.exception(timeout=CONNECT_S)
    if isinstance(error, distributed.scheduler.KilledWorker):
        return GivenUpError(f"given up, it killed its workers: {error}")
    return error
