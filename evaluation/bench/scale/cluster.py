"""`pose-eval cluster`: pairs per second by Dask workers of this machine, and what one that dies
costs.

The server's own engine hands the same jobs to clusters of one, two, four workers. Each cluster does
them twice: the first time workers import and prepare views; the second counts. While the last one
does them once more, one of its workers is killed: each job must still end with a result.
"""

import os
import queue
import signal
import time
from collections.abc import Callable
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

from fleetpose.evaluation.bench.pairs.command import limited, pairs_of
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.options.recorded import ClusterOptions
from fleetpose.evaluation.report.output import (
    output_folder,
    print_table,
    progress_bar,
    write_csv,
    write_summary,
)
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.dask_pool import ClusterPool
from fleetpose.pose_server.workers.jobs import Done, Job, PairJob
from fleetpose.pose_server.workers.pools import Engine
from fleetpose.protocol.transport import wait_until

DONE_S = 120.0  # that a job may take at most
SCALES = 0.7  # a doubling of workers that gives less of a doubling of pairs is where it stops
COLUMNS = ("workers", "jobs", "seconds", "pairs_per_s", "times_one", "lost")


def run(options: ClusterOptions, out: Path) -> dict[str, Any]:
    """Runs all clusters; writes cluster.csv and summary.json; returns the summary.

    Raises:
        FleetPoseError: the data cannot be used, or the folder not made.
    """
    output_folder(out)
    jobs = _jobs(options)
    counts, rows, survived = sorted(set(options.workers)), [], 0
    with progress_bar() as progress:
        task = progress.add_task("pairs", total=len(jobs) * (2 * len(counts) + 1))
        for count in counts:
            with _cluster(count) as cluster, closing(_Working(cluster, count)) as working:
                working.told = lambda: progress.advance(task)
                working.through(jobs)
                began = time.perf_counter()
                ended = working.through(jobs)
                rows.append(_row(count, len(jobs), time.perf_counter() - began, ended, rows))
                if count == counts[-1]:
                    survived = working.through(jobs, next(iter(cluster.workers.values())).pid)
    summary = {
        "cores": os.cpu_count(),
        "load_average": os.getloadavg()[0],
        "stops_at": _stops_at(rows),
        "runs": rows,
        "killed_jobs": len(jobs),
        "killed_lost": len(jobs) - survived,
    }
    write_csv(out / "cluster.csv", COLUMNS, rows)
    write_summary(out, summary)
    _say(summary)
    return summary


class _Working:
    """The server's engine on a cluster.

    Attributes:
        told: called after each job.
    """

    def __init__(self, cluster: Any, workers: int) -> None:
        self.told: Callable[[], None] = lambda: None
        self._done: queue.SimpleQueue[Done] = queue.SimpleQueue()
        pool = ClusterPool(cluster.scheduler_address)
        self._engine = Engine(pool, self._done.put)
        wait_until(lambda: pool.workers == workers, DONE_S)

    def through(self, jobs: list[Job], victim: int | None = None) -> int:
        """How many of the jobs end with a result; as many are under way as the server would have.

        Args:
            victim: process that is killed once a quarter of them has ended.
        """
        todo, ended, good = list(reversed(jobs)), 0, 0
        while ended < len(jobs):
            while todo and self._engine.idle > 0:
                self._engine.submit(todo.pop())
            try:
                done = self._done.get(timeout=DONE_S)
            except queue.Empty:
                return good  # what never ended is lost
            if self._engine.retire(done):
                ended, good = ended + 1, good + (done.result is not None)
                self.told()
            if victim is not None and ended >= len(jobs) // 4:
                os.kill(victim, signal.SIGKILL)
                victim = None
        return good

    def close(self) -> None:
        """Leaves the cluster."""
        self._engine.close()


def _jobs(options: ClusterOptions) -> list[Job]:
    recording = options.recording()
    pairs = limited(pairs_of(recording), options.limit)
    with bench_of(2) as bench:
        views = {view.index: view for pair in pairs for view in pair}
        wires, _ = bench.on_the_wire(recording, views.values(), seed=0)
        kept = {index: open_view(wire.read_bytes(), None, 0.0) for index, wire in wires.items()}
    return [PairJob(kept[i.index].encoded, kept[j.index].encoded) for i, j in pairs]


def _cluster(workers: int) -> Any:
    from distributed import LocalCluster

    return LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    )


def _row(
    workers: int, jobs: int, seconds: float, ended: int, before: list[dict[str, Any]]
) -> dict[str, Any]:
    rate = ended / seconds
    one = before[0]["pairs_per_s"] if before else rate
    values = (workers, jobs, seconds, rate, rate / one, jobs - ended)
    return dict(zip(COLUMNS, values, strict=True))


def _stops_at(rows: list[dict[str, Any]]) -> int | None:
    """The number of workers beyond which more bring little; none where each brought its share."""
    for before, after in pairwise(rows):
        more = after["pairs_per_s"] / before["pairs_per_s"] - 1.0
        if more < SCALES * (after["workers"] / before["workers"] - 1.0):
            return before["workers"]
    return None


def _say(summary: dict[str, Any]) -> None:
    rows = [[row[column] for column in COLUMNS] for row in summary["runs"]]
    print_table(f"pairs by Dask workers, {summary['cores']} cores", COLUMNS, rows)
    if summary["stops_at"] is not None:
        print(f"more than {summary['stops_at']} workers bring little on this machine")
    print(f"one killed: {summary['killed_lost']} of {summary['killed_jobs']} jobs lost")
