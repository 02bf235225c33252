"""The pool of workers: real processes that are killed, that die of a job, and that lose their
parent.
"""

import os
import queue
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pose_server.pairs.engine import MAX_TRIES, Done, EncodedView, Engine, Job
from protocol.codec import pack
from protocol.messages import View, ViewName
from protocol.transport import wait_until
from tests.pose_server.scene import EPOCH, pair_of_views, turned

DONE_S = 60.0


class Deadly:
    """Ends whoever unpickles it: the worker that takes the job."""

    def __reduce__(self):
        return os._exit, (7,)


@pytest.fixture
def engine():
    done: queue.SimpleQueue[Done] = queue.SimpleQueue()
    made = Engine(1, done.put)
    yield made, done
    made.close()


def encoded(message: View) -> EncodedView:
    return EncodedView(message.name, pack(message))


def good_job() -> Job:
    i, j = pair_of_views(np.random.default_rng(3), turned(15))
    return Job("pair", encoded(i), encoded(j))


def final(engine: Engine, done: "queue.SimpleQueue[Done]") -> Done:
    """The next end that the engine does not run again."""
    while True:
        one = done.get(timeout=DONE_S)
        if engine.retire(one):
            return one


def workers(engine: Engine) -> list[int]:
    return list(engine._pool._processes or {})


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
    deadly = Job("pair", EncodedView(name, Deadly()), EncodedView(name, b""))
    pool.submit(deadly)
    given_up = final(pool, done)
    assert given_up.result is None and given_up.worker_died and given_up.tries == MAX_TRIES
    assert "try 2" in given_up.error
    pool.submit(good_job())
    assert final(pool, done).result is not None


def test_a_damaged_view_fails_its_job_alone(engine):
    pool, done = engine
    job = good_job()
    pool.submit(Job("pair", job.i, EncodedView(job.j.name, b"\xff\x00")))
    failed = final(pool, done)
    assert failed.result is None and not failed.worker_died
    assert "CodecError" in failed.error
    pool.submit(job)
    assert final(pool, done).result is not None


def test_workers_end_with_their_parent_however_that_ends():
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT], stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True
    )
    try:
        assert parent.stdout is not None
        children = [int(pid) for pid in parent.stdout.readline().split()]
        assert len(children) == 2 and all(is_there(pid) for pid in children)
        parent.kill()
        parent.wait()
        assert wait_until(lambda: not any(is_there(pid) for pid in children), 5.0)
    finally:
        parent.kill()
        parent.communicate()


PARENT = """
import sys
from pose_server.pairs.engine import Engine
if __name__ == "__main__":
    engine = Engine(2, lambda done: None)
    print(*engine._pool._processes, flush=True)
    sys.stdin.read()
"""
