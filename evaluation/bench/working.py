"""What commands share that align recorded views: worker processes, views on the wire, jobs."""

import ctypes
import itertools
import multiprocessing
import os
import random
import signal
import tempfile
from collections.abc import Container, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.pairs.worker import encode, use_one_thread
from fleetpose.evaluation.data.anonymize import random_name, strip
from fleetpose.evaluation.data.mirror import mirror_folder
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.report.output import progress_bar

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


@dataclass(frozen=True)
class Bench:
    """Where a command works: processes, a folder that goes with it, and how far it is."""

    pool: ProcessPoolExecutor
    workers: int
    folder: Path
    progress: Any

    def on_the_wire(
        self,
        recording: Recording,
        views: Iterable[TrueView],
        seed: int | None = None,
        mirrored: Container[int] = (),
        images: bool = True,
    ) -> tuple[dict[int, Path], list[float]]:
        """What every view's robot sends, in one file each, and the milliseconds it took the robot.

        Each robot works on a stripped folder of its own: nothing of the truth is in these files.
        The robots' names are drawn by the seed. The cameras of `mirrored` views flip their images;
        without images robots have their clouds alone.
        """
        rng = random.Random(seed)
        jobs, wires = [], {}
        views = list({view.index: view for view in views}.values())
        task = self.progress.add_task("views", total=len(views))
        for view in views:
            robot = random_name(rng)
            stripped = strip(recording, [view], self.folder / robot, rng)
            if view.index in mirrored:
                mirror_folder(stripped.path)
            wires[view.index] = wire = self.folder / f"{robot}.msgpack"
            job = self.pool.submit(encode, robot, stripped.camera, stripped.path, wire, images)
            job.add_done_callback(lambda _: self.progress.advance(task))
            jobs.append(job)
        return wires, [job.result() for job in jobs]

    def as_done(
        self,
        name: str,
        jobs: Sequence[tuple[Any, tuple[Any, ...]]],
        in_flight: int | None = None,
    ) -> Iterator[tuple[Any, Any]]:
        """Runs (label, (function, *arguments)) in order, and yields (label, result) as they are
        done; so many wait or run at once.
        """
        task = self.progress.add_task(name, total=len(jobs))
        in_flight = in_flight or 2 * self.workers + 2
        todo, running = iter(jobs), {}
        while True:
            for label, call in itertools.islice(todo, in_flight - len(running)):
                running[self.pool.submit(*call)] = label
            if not running:
                return
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                self.progress.advance(task)
                yield running.pop(future), future.result()

    def by_label(self, name: str, jobs: Sequence[tuple[Any, tuple[Any, ...]]]) -> dict[Any, Any]:
        """The results of such jobs, in order of their labels."""
        return dict(sorted(self.as_done(name, jobs, self.workers)))


@contextmanager
def bench_of(workers: int) -> Iterator[Bench]:
    """A bench with so many workers."""
    with (
        tempfile.TemporaryDirectory(prefix="fleetpose-") as folder,
        worker_pool(workers) as pool,
        progress_bar() as progress,
    ):
        yield Bench(pool, workers, Path(folder), progress)
