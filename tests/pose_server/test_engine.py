"""The pool of workers: real processes that are killed, that die of a job, and that lose their
parent.
"""

import os
import queue
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fleetpose.pose_server.workers.jobs import Done, EncodedView, Job, PairJob
from fleetpose.pose_server.workers.pools import MAX_TRIES, Engine, LocalPool
from fleetpose.protocol.codec import pack
from fleetpose.protocol.messages import View, ViewName
from fleetpose.protocol.transport import wait_until
from tests.pose_server.scene import EPOCH, pair_of_views, turned

DONE_S = 60.0


class Deadly:
    """Ends whoever unpickles it: the worker that takes the job."""

    def __reduce__(self):
        return os._exit, (7,)


@pytest.fixture
def engine():
    done: queue.SimpleQueue[Done] = queue.SimpleQueue()
    made = Engine(LocalPool(1), done.put)
    yield made, done
    made.close()


def encoded(message: View) -> EncodedView:
    return EncodedView(message.name, pack(message))


def good_job() -> Job:
    i, j = pair_of_views(np.random.default_rng(3), turned(15))
    return PairJob(encoded(i), encoded(j))


def final(engine: Engine, done: "queue.SimpleQueue[Done]") -> Done:
    """The next end that the engine does not run again."""
    while True:
        one = done.get(timeout=DONE_S)
        if engine.retire(one):
            return one


def workers(engine: Engine) -> list[int]:
    return engine._pool.pids()


def is_there(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0] != "Z"
    except OSError:
        return False


def test_a_job_comes_back_with_its_pose(engine):
    pool, done = engine
    pool.submit(good_job())
    found = final(pool, done)
    assert found.error == "" and found.result is not None
    assert np.linalg.norm(found.result.T_i_j[:3, 3] - turned(15)[:3, 3]) < 0.1
    assert pool.running == 0


def test_the_job_of_a_killed_worker_runs_again(engine):
    pool, done = engine
    pool.submit(good_job())
    os.kill(workers(pool)[0], signal.SIGKILL)
    found = final(pool, done)
    assert found.result is not None and found.tries == 2


def test_a_job_that_kills_its_workers_is_given_up_and_told_and_the_next_one_runs(engine):
    pool, done = engine
    name = ViewName(robot="r1", epoch=EPOCH, seq=0)
    deadly = PairJob(EncodedView(name, Deadly()), EncodedView(name, b""))
    pool.submit(deadly)
    given_up = final(pool, done)
    assert given_up.result is None and given_up.worker_died and given_up.tries == MAX_TRIES
    assert "try 2" in given_up.error
    pool.submit(good_job())
    assert final(pool, done).result is not None


def test_a_job_that_kills_its_workers_takes_no_other_job_with_it():
    done: queue.SimpleQueue[Done] = queue.SimpleQueue()
    engine = Engine(LocalPool(2), done.put)
    name = ViewName(robot="r1", epoch=EPOCH, seq=0)
    try:
        engine.submit(PairJob(EncodedView(name, Deadly()), EncodedView(name, b"")))
        engine.submit(good_job())
        engine.submit(replace(good_job(), urgent=True))
        ends = [final(engine, done) for _ in range(3)]
        assert sorted(end.tries for end in ends) == [1, 1, MAX_TRIES]
        assert sum(end.result is not None for end in ends) == 2
    finally:
        engine.close()


def test_an_urgent_job_has_a_worker_that_no_other_job_takes(engine):
    pool, done = engine
    pool.submit(good_job())
    assert pool.idle == 0 and pool.idle_for_urgent
    pool.submit(replace(good_job(), urgent=True))
    assert not pool.idle_for_urgent
    assert {final(pool, done).job.urgent for _ in range(2)} == {False, True}
    assert pool.idle == 1 and pool.idle_for_urgent


def test_a_damaged_view_fails_its_job_alone(engine):
    pool, done = engine
    job = good_job()
    pool.submit(PairJob(job.i, EncodedView(job.j.name, b"\xff\x00")))
    failed = final(pool, done)
    assert failed.result is None and not failed.worker_died
    assert "CodecError" in failed.error
    pool.submit(job)
    assert final(pool, done).result is not None


def test_a_pool_that_is_closed_while_it_starts_leaves_no_thread():
    """One that outlives its pool writes into a closed pipe, and says so, as the process ends."""
    before = set(threading.enumerate())
    pool = LocalPool(2)
    pool._executors[0].submit(len, bytes(50_000_000))  # more than the pipe holds
    pool.close()
    assert set(threading.enumerate()) <= before


def test_workers_end_with_their_parent_however_that_ends():
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True
    )
    try:
        assert parent.stdout is not None
        children = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(children) == 3 and all(is_there(pid) for pid in children)
        parent.kill()
        parent.wait()
        assert wait_until(lambda: not any(is_there(pid) for pid in children), DONE_S)
    finally:
        parent.kill()
        parent.communicate()


PARENT = """
import sys
from fleetpose.pose_server.workers.pools import LocalPool
if __name__ == "__main__":
    pool = LocalPool(2)
    print(*pool.pids(), flush=True)
    sys.stdin.read()
"""
