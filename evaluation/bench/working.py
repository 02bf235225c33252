"""What commands share that align recorded views: worker processes, views on the wire, jobs."""

import ctypes
import itertools
import multiprocessing
import os
import random
import signal
from collections.abc import Container, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.pairs.worker import encode, use_one_thread
from fleetpose.evaluation.data.anonymize import random_name, strip
from fleetpose.evaluation.data.mirror import mirror_folder
from fleetpose.evaluation.data.recording import Recording, TrueView

_PR_SET_PDEATHSIG = 1  # of Linux, see prctl(2)


def worker_pool(workers: int) -> ProcessPoolExecutor:
    """Spawned processes whose libraries use one thread each, and that end with this one."""
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, context, _start_worker, (os.getpid(),))


def _start_worker(parent: int) -> None:
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before prctl could tell
        os._exit(1)
    use_one_thread()


def on_the_wire(
    recording: Recording,
    views: Sequence[TrueView],
    folder: Path,
    pool: ProcessPoolExecutor,
    progress: Any,
    seed: int | None = None,
    mirrored: Container[int] = (),
    images: bool = True,
) -> tuple[dict[int, Path], list[float]]:
    """What every view's robot sends, in one file each, and the milliseconds it took the robot.

    Each robot works on a stripped folder of its own: nothing of the truth is in these files. The
    robots' names are drawn by the seed. The cameras of `mirrored` views flip their images; without
    images robots have their clouds alone.
    """
    rng = random.Random(seed)
    task = progress.add_task("views", total=len(views))
    jobs: list[tuple[int, Future[float]]] = []
    wires: dict[int, Path] = {}
    for view in views:
        robot = random_name(rng)
        stripped = strip(recording, [view], folder / robot, rng)
        if view.index in mirrored:
            mirror_folder(stripped.path)
        wires[view.index] = folder / f"{robot}.msgpack"
        job = pool.submit(encode, robot, stripped.camera, stripped.path, wires[view.index], images)
        job.add_done_callback(lambda _: progress.advance(task))
        jobs.append((view.index, job))
    return wires, [job.result() for _, job in jobs]


def as_done(
    pool: ProcessPoolExecutor, jobs: Iterable[tuple[Any, tuple[Any, ...]]], in_flight: int
) -> Iterator[tuple[Any, Any]]:
    """Runs (label, (function, *arguments)) in order and yields (label, result) as they are done."""
    jobs = iter(jobs)
    running: dict[Future[Any], Any] = {}
    while True:
        for label, call in itertools.islice(jobs, in_flight - len(running)):
            running[pool.submit(*call)] = label
        if not running:
            return
        done, _ = wait(running, return_when=FIRST_COMPLETED)
        for future in done:
            yield running.pop(future), future.result()
