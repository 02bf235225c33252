"""A pair whose last alignment failed waits again once a view changed, and not before."""

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.scheduling.settings import Weights
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done, Job
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import pack
from tests.pose_server.scene import descriptors, turned, view, walls
from tests.pose_server.test_flows import ENCODING, named, result, site_of

REST_S = Weights.retry_s
STEP_M = 0.5  # sideways at 10 m: seen by all pixels, not far enough for a keyframe
FAILED = PairResult(None, None, "rejected", ("nothing fits",))


class Two:
    """Two robots before one scene, of which r1 moves; every alignment of the pair fails."""

    def __init__(self, skip: frozenset[tuple[str, str]] = frozenset()) -> None:
        self.rng = np.random.default_rng(8)
        self.points, self.looks = walls(self.rng), descriptors(self.rng, 800)
        self.site: Site = site_of(
            self.seen("r1", 0, np.eye(4)), self.seen("r2", 0, inverse(turned(10))), skip=skip
        )

    def seen(self, robot: str, seq: int, T: np.ndarray):
        return view(self.rng, robot, self.points, self.looks, T, seq, noisy=False)

    def next_pair(self, now_s: float) -> Job | None:
        """The next job of the pair, after all that the robots' own motion takes."""
        pipeline.solve(self.site, now_s)
        while compare_some(self.site, now_s):
            pass
        while (job := pipeline.next_job(self.site, now_s)) is not None:
            if job.kind == "pair":
                return job
            pipeline.take_result(self.site, Done(job, run_job(job)), now_s)
        return None

    def fail(self, job: Job, now_s: float) -> None:
        pipeline.take_result(self.site, Done(job, FAILED), now_s)

    def move(self, seq: int, steps: float, now_s: float) -> None:
        """r1 sees the scene from so many steps beside where it began."""
        T = np.eye(4)
        T[0, 3] = steps * STEP_M
        message = pack(self.seen("r1", seq, T))
        pipeline.receive_view(self.site, open_view(message, ENCODING, now_s))


@pytest.fixture
def two() -> Two:
    return Two()


def failed_once(two: Two) -> None:
    job = two.next_pair(0.0)
    assert job is not None
    two.fail(job, 0.0)
    assert two.next_pair(0.0) is None


def test_a_robot_that_stands_is_not_asked_again(two):
    failed_once(two)
    for seq in range(1, 4):
        two.move(seq, 0.0, seq * 100 * REST_S)
        assert two.next_pair(seq * 100 * REST_S) is None


def test_a_view_that_changed_is_tried_with_the_newest_of_the_other(two):
    failed_once(two)
    two.move(1, 1.0, REST_S)
    job = two.next_pair(REST_S)
    assert job is not None
    assert (job.i.name, job.j.name) == (named(1, "r1"), named(0, "r2"))
    assert len(two.site.keyframes()) == 2  # it moved too little for a keyframe


def test_what_was_tried_again_is_not_tried_a_third_time_in_the_same_stand(two):
    failed_once(two)
    two.move(1, 1.0, REST_S)
    again = two.next_pair(REST_S)
    assert again is not None
    two.fail(again, REST_S)
    two.move(2, 1.0, 100 * REST_S)
    assert two.next_pair(100 * REST_S) is None
    two.move(3, 0.5, 200 * REST_S)
    assert two.next_pair(200 * REST_S) is not None


def test_each_failure_in_a_row_doubles_the_rest(two):
    failed_once(two)
    seq, now_s, rests_s = 0, 0.0, []
    for _ in range(3):
        failed_s = now_s
        job = None
        while job is None:
            seq, now_s = seq + 1, now_s + 0.5 * REST_S
            two.move(seq, 1.0 if seq % 2 else 0.5, now_s)
            job = two.next_pair(now_s)
        rests_s.append(now_s - failed_s)
        two.fail(job, now_s)
    assert rests_s == [REST_S, 2 * REST_S, 4 * REST_S]


def test_a_pair_that_was_aligned_is_left_alone(two):
    job = two.next_pair(0.0)
    assert job is not None
    pipeline.take_result(two.site, Done(job, result(turned(10))), 0.0)
    two.move(1, 1.0, 100 * REST_S)
    assert two.next_pair(100 * REST_S) is None


def test_a_pair_that_only_the_operator_may_start_is_not_tried_again():
    two = Two(skip=frozenset({("r1", "r2")}))
    assert two.next_pair(0.0) is None
    record = two.site.pair("r1", "r2")
    record.last, record.failures, record.last_s = FAILED, 1, 0.0
    two.move(1, 1.0, 100 * REST_S)
    assert two.next_pair(100 * REST_S) is None


def test_a_view_that_is_gone_before_its_turn_is_not_tried(two):
    failed_once(two)
    two.move(1, 1.0, REST_S)
    job = pipeline.next_job(two.site, REST_S)
    assert job is not None and job.kind == "track"
    pipeline.take_result(two.site, Done(job, run_job(job)), REST_S)
    assert two.site.pair("r1", "r2").retry == (named(1, "r1"), named(0, "r2"))
    two.site.views._views.pop(named(1, "r1"))  # as if it had waited for a minute
    assert two.next_pair(REST_S) is None
