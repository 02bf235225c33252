"""Runs jobs in parallel: in processes of this machine, or wherever a pool has its workers.

One more worker than asked for takes the jobs that an operator waits for, so that these never wait
behind frames; it is idle most of the time. Every worker is a pool of its own, so that one that dies
takes no other job with it.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import parent_process
from typing import Protocol

from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.workers import preload
from fleetpose.pose_server.workers.jobs import Done, EncodedView, Job
from fleetpose.pose_server.workers.run import prepare, run_job, use_one_thread

MAX_TRIES = 2
NICE = 5  # of workers whose jobs nobody waits for


class Pool(Protocol):
    """Where jobs run; used from one thread. It is given no more jobs than it has workers, and one
    urgent one.
    """

    @property
    def workers(self) -> int:
        """Workers for jobs that are not urgent, at present."""
        ...

    def submit(self, job: Job) -> "Future[PairResult]":
        """Begins a job. The future fails with `BrokenProcessPool` where the job's worker died."""
        ...

    def prepare(self, views: Sequence[EncodedView]) -> None:
        """Urgent jobs with these views will follow: what can be worked out before may be."""
        ...

    def close(self) -> None:
        """Ends what belongs to this process."""
        ...


class Engine:
    """Hands jobs to a pool and their ends back.

    Used from one thread; `report` is called from others and must only store. Every `Done` is handed
    back to `retire`, which runs the job again where its worker died.
    """

    def __init__(self, pool: Pool, report: Callable[[Done], None]) -> None:
        self._pool, self._report = pool, report
        self._running = self._urgent = 0

    @property
    def workers(self) -> int:
        return self._pool.workers

    @property
    def running(self) -> int:
        return self._running + self._urgent

    @property
    def idle(self) -> int:
        """How many more jobs keep all workers busy."""
        return self._pool.workers - self._running

    @property
    def idle_for_urgent(self) -> bool:
        """Whether the worker for urgent jobs has none."""
        return self._pool.workers > 0 and not self._urgent

    @property
    def running_urgent(self) -> bool:
        """Whether an urgent job is on its way."""
        return self._urgent > 0

    def submit(self, job: Job, tries: int = 1) -> None:
        """Runs a job; its end is reported."""
        began = time.perf_counter()
        self._count(job, 1)
        future = self._pool.submit(job)
        future.add_done_callback(lambda ended: self._ended(job, tries, began, ended))

    def prepare(self, views: Sequence[EncodedView]) -> None:
        """Views that an operator looks at: a click in them is not to wait for their unpacking."""
        self._pool.prepare(views)

    def retire(self, done: Done) -> bool:
        """Takes a finished job off the books; False if it runs again, because its worker died."""
        self._count(done.job, -1)
        if done.worker_died and done.tries < MAX_TRIES:
            self.submit(done.job, done.tries + 1)
            return False
        return True

    def close(self) -> None:
        """Ends the workers."""
        self._pool.close()

    def _count(self, job: Job, by: int) -> None:
        if job.urgent:
            self._urgent += by
        else:
            self._running += by

    def _ended(self, job: Job, tries: int, began: float, future: "Future[PairResult]") -> None:
        if future.cancelled():
            return
        error = future.exception()
        wall_ms = 1e3 * (time.perf_counter() - began)
        if error is None:
            self._report(Done(job, future.result(), "", wall_ms, tries))
        else:
            died = isinstance(error, BrokenProcessPool)
            text = f"{type(error).__name__}: {error} (try {tries})"
            self._report(Done(job, None, text, wall_ms, tries, died))


class LocalPool:
    """Processes of this machine that end with this one. They start at once, so that the first view
    does not wait for their imports.
    """

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._executors = [_executor(NICE) for _ in range(workers)]
        self._executors.append(_executor(0))
        self._busy: list[Future[PairResult] | None] = [None] * (workers + 1)
        self._preparing: Future[None] | None = None

    def submit(self, job: Job) -> "Future[PairResult]":
        """Begins a job on a worker that has none; urgent ones on the last, if they can."""
        order = range(self.workers, -1, -1) if job.urgent else range(self.workers)
        place = next((k for k in order if _is_free(self._busy[k])), order[0])
        try:
            future = self._executors[place].submit(run_job, job)
        except BrokenProcessPool:
            self._executors[place].shutdown(wait=False)
            self._executors[place] = _executor(NICE if place < self.workers else 0)
            future = self._executors[place].submit(run_job, job)
        self._busy[place] = future
        return future

    def prepare(self, views: Sequence[EncodedView]) -> None:
        """The worker for urgent jobs prepares them, unless it still prepares others: clicks wait
        for a few views at most. A dead one will do so with its next job.
        """
        if views and (self._preparing is None or self._preparing.done()):
            with suppress(BrokenProcessPool):
                self._preparing = self._executors[self.workers].submit(prepare, views)

    def pids(self) -> list[int]:
        """Process ids of the workers, that for urgent jobs last."""
        return [pid for one in self._executors for pid in one._processes or {}]

    def close(self) -> None:
        """Ends the workers."""
        for executor in self._executors:
            for process in list((executor._processes or {}).values()):
                process.terminate()
        for executor in self._executors:  # its thread must be done before the interpreter ends
            executor.shutdown(wait=True, cancel_futures=True)


def _is_free(last: "Future[PairResult] | None") -> bool:
    return last is None or last.done()


def _executor(nice: int) -> ProcessPoolExecutor:
    """One worker, started."""
    executor = ProcessPoolExecutor(
        1, mp_context=preload.start(), initializer=_start_worker, initargs=(nice,)
    )
    executor.submit(os.getpid)
    return executor


def _start_worker(nice: int) -> None:
    """One thread per worker, ends with the server, and leaves Ctrl-C to it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_server, daemon=True).start()
    os.nice(nice)
    use_one_thread()


def _end_with_server() -> None:
    """However that ends: the process that workers are forked from lives as long as one of them."""
    server = parent_process()
    assert server is not None
    server.join()
    os._exit(1)
