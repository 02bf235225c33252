"""Jobs on a real Dask cluster on this machine, beside the same jobs on local workers."""

import os
import queue
import signal

import numpy as np
import pytest
from distributed import LocalCluster

from fleetpose.pose_server.workers.dask_pool import ClusterPool
from fleetpose.pose_server.workers.jobs import Done, EncodedView, Job, PairJob
from fleetpose.pose_server.workers.pools import Engine
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import pack
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.transport import free_port, wait_until
from tests.pose_server.scene import pair_of_views, turned

DONE_S = 90.0


@pytest.fixture(scope="module")
def cluster():
    with LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as made:
        yield made


@pytest.fixture
def engine(cluster):
    done: queue.SimpleQueue[Done] = queue.SimpleQueue()
    pool = ClusterPool(cluster.scheduler_address)
    made = Engine(pool, done.put)
    assert wait_until(lambda: pool.workers == 2, DONE_S)
    yield made, done
    made.close()


def jobs(count: int) -> list[Job]:
    """Pairs at several angles."""
    found = []
    for seed in range(count):
        views = pair_of_views(np.random.default_rng(seed), turned(5 + 5 * seed))
        i, j = (
            one.model_copy(update={"name": one.name.model_copy(update={"seq": seed})})
            for one in views
        )
        found.append(PairJob(EncodedView(i.name, pack(i)), EncodedView(j.name, pack(j))))
    return found


def final(engine: Engine, done: "queue.SimpleQueue[Done]") -> Done:
    while True:
        one = done.get(timeout=DONE_S)
        if engine.retire(one):
            return one


def test_the_poses_are_those_of_local_workers(engine):
    pool, done = engine
    assert pool.workers == 2 and pool.idle == 2
    wanted = jobs(4)
    for job in wanted:
        pool.submit(job)
    ends = [final(pool, done) for _ in wanted]
    assert pool.running == 0
    for end in ends:
        assert end.error == "" and end.result is not None
        here = run_job(end.job)
        assert np.abs(end.result.T_i_j - here.T_i_j).max() < 1e-6
        assert np.abs(end.result.covariance - here.covariance).max() < 1e-6
        assert end.result.verdict == here.verdict


def test_a_worker_killed_in_mid_job_costs_no_job(engine, cluster):
    pool, done = engine
    wanted = [job for job in jobs(4) for _ in range(3)]
    for job in wanted:
        pool.submit(job)
    victim = next(iter(cluster.workers.values()))
    os.kill(victim.pid, signal.SIGKILL)
    ends = [final(pool, done) for _ in wanted]
    assert all(end.result is not None for end in ends)
    assert pool.running == 0


def test_a_damaged_view_fails_its_job_alone(engine):
    pool, done = engine
    (job,) = jobs(1)
    unknown = job.j.name.model_copy(update={"seq": 99})
    pool.submit(PairJob(job.i, EncodedView(unknown, b"\xff\x00")))
    failed = final(pool, done)
    assert failed.result is None and not failed.worker_died
    assert "CodecError" in failed.error


def test_no_scheduler_is_told_in_a_sentence(monkeypatch):
    monkeypatch.setattr("fleetpose.pose_server.workers.dask_pool.CONNECT_S", 0.5)
    with pytest.raises(UnreachableError, match="no Dask scheduler at"):
        ClusterPool(f"tcp://127.0.0.1:{free_port()}")


def test_a_cluster_that_goes_is_waited_for_and_used_again():
    port, done = free_port(), queue.SimpleQueue()
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
    where = {"host": "127.0.0.1", "scheduler_port": port, "silence_logs": 50}
    with LocalCluster(**options, **where) as first:
        pool = ClusterPool(first.scheduler_address)
        engine = Engine(pool, done.put)
        assert wait_until(lambda: pool.workers == 1, DONE_S)
    try:
        assert wait_until(lambda: pool.workers == 0, DONE_S)
        assert engine.idle == 0 and not engine.idle_for_urgent
        with LocalCluster(**options, **where):
            assert wait_until(lambda: pool.workers == 1, DONE_S)
            engine.submit(jobs(1)[0])
            assert final(engine, done).result is not None
    finally:
        engine.close()
