"""Observer and simulated operator over a real network, with a server played by the test."""

import queue
import time

import numpy as np
import pytest

from fleetpose.evaluation.simulate.operator import SimulatedOperator
from fleetpose.evaluation.system.observer import Observer, SeenView
from fleetpose.protocol import codec
from fleetpose.protocol.clouds import SalientPoints, encode_depth, encode_salient
from fleetpose.protocol.keys import Keys, new_epoch
from fleetpose.protocol.messages import (
    Alignment,
    Camera,
    FleetState,
    NoiseModel,
    OperatorUpdate,
    Question,
    Receipts,
    RobotPose,
    View,
    ViewName,
)
from fleetpose.protocol.transport import Sample, wait_until
from tests.evaluation.makers import HEIGHT, WIDTH, K

KEYS = Keys("test")
EPOCH = new_epoch()


def view(robot: str, seq: int, depth_m: float = 2.0) -> View:
    no_salient = SalientPoints(
        np.zeros((0, 2), np.float32),
        np.zeros(0, np.float32),
        np.zeros(0, np.float32),
        np.zeros((0, 128), np.uint8),
    )
    return View(
        name=ViewName(robot=robot, epoch=EPOCH, seq=seq),
        stamp_ns=time.time_ns(),
        camera=Camera(
            width=WIDTH,
            height=HEIGHT,
            K=K,
            T_robot_camera=np.eye(4),
            noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.002)),
            kind="rgbd",
        ),
        cloud=encode_depth(np.full((HEIGHT, WIDTH), depth_m)),
        salient=encode_salient(no_salient),
    )


def pose(robot: str, seq: int, n: int, located: bool = True) -> RobotPose:
    return RobotPose(
        robot=robot,
        view=ViewName(robot=robot, epoch=EPOCH, seq=seq),
        stamp_ns=time.time_ns(),
        T_fleet_robot=np.eye(4),
        covariance=np.eye(6),
        component="a",
        located=located,
        verdict="verified",
        gauge_revision=0,
        jumped=False,
        age_s=0.0,
        valid_until_ns=time.time_ns() + 5 * 10**9,
        server_epoch=EPOCH,
        n=n,
    )


def alignment(n: int) -> Alignment:
    return Alignment(
        view_i=ViewName(robot="a", epoch=EPOCH, seq=0),
        view_j=ViewName(robot="b", epoch=EPOCH, seq=0),
        T_i_j=np.eye(4),
        covariance=np.eye(6),
        information=np.eye(6),
        verdict="verified",
        reasons=(),
        regression_error_m2=0.0,
        regression_count=0,
        rmse_m=0.0,
        overlap=1.0,
        inliers=5,
        start="operator",
        timings_ms={},
        server_epoch=EPOCH,
        n=n,
    )


def state(n: int, questions: tuple[Question, ...] = ()) -> FleetState:
    return FleetState(
        server_epoch=EPOCH,
        n=n,
        stamp_ns=time.time_ns(),
        anchor="a",
        gauge_revision=0,
        up_assumed=True,
        robots=(),
        pairs=(),
        questions=questions,
        events=(),
    )


class Site:
    """Server and robots as far as the tests need them."""

    def __init__(self, link) -> None:
        self.link = link
        self._publishers = {}
        self._questions: tuple[Question, ...] = ()
        self._states = 0
        self._updates: queue.SimpleQueue[Sample] = queue.SimpleQueue()
        link.on_latched(KEYS.updates("*"), self._updates.put)

    def show(self, observer: Observer, *views: View):
        """Sends views one after the other: on a bulk stream, one in a hurry may be dropped."""
        for view in views:
            key, seen = KEYS.cloud(view.name.robot), len(observer.view_sizes)
            if key not in self._publishers:
                self._publishers[key] = self.link.bulk(key)
                assert wait_until(lambda key=key: self._publishers[key].wanted, 30)
            self._publishers[key].put(codec.pack(view), codec.encoding_of(View))
            assert wait_until(lambda seen=seen: len(observer.view_sizes) > seen, 30)

    def put(self, key, message):
        if key not in self._publishers:
            self._publishers[key] = self.link.latched(key)
        self._publishers[key].put(codec.pack(message), codec.encoding_of(type(message)))

    def ask(self, *questions: Question):
        """Publishes the state, as a server does again and again."""
        self._questions = questions
        self._states += 1
        self.put(KEYS.state, state(self._states, questions))

    def next_update(self, timeout_s: float = 20.0) -> OperatorUpdate | None:
        """The next update, repeats included, while the state is published twice a second."""
        end = time.monotonic() + timeout_s
        while time.monotonic() < end:
            try:
                sample = self._updates.get(timeout=0.5)
            except queue.Empty:
                self.ask(*self._questions)
                continue
            return codec.unpack(OperatorUpdate, sample.payload, sample.encoding)
        return None


@pytest.fixture
def site(open_link):
    return Site(open_link())


@pytest.fixture
def own_link(open_link):
    return open_link()


@pytest.fixture
def observer(own_link):
    observer = Observer(own_link, KEYS)
    yield observer
    observer.close()


def test_views_are_known_by_name_and_by_what_their_cloud_holds(site, observer):
    site.show(observer, view("a", 0, 2.0), view("a", 1, 3.0), view("b", 0, 3.0))
    newest = observer.newest_view("a")
    assert newest is not None
    assert newest.view.name.seq == 1
    first = observer.view(ViewName(robot="a", epoch=EPOCH, seq=0))
    other = observer.newest_view("b")
    assert first is not None
    assert other is not None
    assert first.digest != newest.digest
    assert newest.digest == other.digest


def test_a_pose_answers_its_view_and_all_older_ones(site, observer):
    site.show(observer, *(view("a", seq) for seq in range(3)))
    site.put(KEYS.pose("a"), pose("a", 1, n=1))
    assert wait_until(lambda: len(observer.view_to_pose_s) == 2, 30)
    site.put(KEYS.pose("a"), pose("a", 2, n=2))
    assert wait_until(lambda: len(observer.view_to_pose_s) == 3, 30)
    assert all(0.0 < s < 5.0 for s in observer.view_to_pose_s)


def test_a_view_that_its_own_pose_overtook_is_counted_and_tells_no_time(site, observer):
    site.put(KEYS.pose("a"), pose("a", 3, n=1))
    assert wait_until(lambda: "a" in observer.poses(), 30)
    site.show(observer, view("a", 3))
    assert wait_until(lambda: observer.views_overtaken == 1, 30)
    assert observer.view_to_pose_s == [] and observer.views_unanswered() == 0


def test_views_that_show_something_new_are_told_apart(site, observer):
    site.show(observer, view("a", 0), view("a", 1), view("a", 2, depth_m=3.0), view("a", 3))
    assert observer.views_unanswered() == 4
    site.put(KEYS.pose("a"), pose("a", 2, n=1))
    assert wait_until(lambda: len(observer.view_to_pose_s) == 3, 30)
    assert observer.moving_view_to_pose_s == observer.view_to_pose_s[2:]
    assert observer.views_unanswered() == 1


def test_the_number_of_located_robots_is_noted_when_it_changes(site, observer):
    site.put(KEYS.pose("a"), pose("a", 0, n=1))
    site.put(KEYS.pose("b"), pose("b", 0, n=1, located=False))
    assert wait_until(lambda: len(observer.poses()) == 2, 30)
    assert wait_until(lambda: observer.located_counts[-1][1] == 1, 30)
    site.put(KEYS.pose("b"), pose("b", 1, n=2))
    assert wait_until(lambda: observer.located_counts[-1][1] == 2, 30)


def test_presence_is_by_tokens(site, observer):
    assert not observer.server_alive()
    site.link.token(KEYS.robot_alive("a", EPOCH))
    site.link.token(KEYS.robot_alive("b", EPOCH))
    site.link.token(KEYS.server_alive(EPOCH))
    assert wait_until(lambda: observer.alive_robots() == 2 and observer.server_alive(), 30)
    site.link.close()
    assert wait_until(lambda: observer.alive_robots() == 0 and not observer.server_alive(), 30)


def test_bytes_that_are_no_message_are_counted_and_survived(site, observer):
    publisher = site.link.latched(KEYS.pose("a"))
    publisher.put(b"garbage", codec.encoding_of(RobotPose))
    publisher.put(b"", "text/plain")
    assert wait_until(lambda: observer.undecodable == 2, 30)
    site.put(KEYS.pose("b"), pose("b", 0, n=1))
    assert wait_until(lambda: "b" in observer.poses(), 30)


class SameEverywhere:
    """Every pixel of one view shows the same point as that pixel of the other."""

    def correspondences(self, i: SeenView, j: SeenView):
        pixels = np.random.default_rng(1).uniform(20, 100, (50, 2))
        return pixels, pixels.copy()


def question() -> Question:
    names = {robot: ViewName(robot=robot, epoch=EPOCH, seq=0) for robot in "ab"}
    return Question(i="a", j="b", view_i=names["a"], view_j=names["b"], reason="join", gain=1.0)


@pytest.fixture
def operator(own_link, observer, site):
    site.show(observer, view("a", 0), view("b", 0))
    operator = SimulatedOperator(observer, SameEverywhere(), clicks_per_minute=600, only_asked=True)
    operator.start()
    yield operator
    operator.close()


def receipt(update: OperatorUpdate, n: int, **more) -> Receipts:
    base = Receipts(
        operator=update.operator, session=update.session, n=n, rejections=(), server_epoch=EPOCH
    )
    return base.model_copy(update=more)


def test_nothing_is_clicked_that_was_not_asked(site, observer, operator):
    site.ask()
    assert wait_until(lambda: observer.state is not None, 30)
    assert site.next_update(timeout_s=1.0) is None
    assert operator.clicks == 0


def test_a_question_is_answered_and_the_click_timed_until_the_pose(site, observer, operator):
    site.ask(question())
    update = site.next_update()
    assert update is not None
    assert (update.action, update.i, update.j, update.n) == ("add", "a", "b", 1)
    assert update.view_i == question().view_i
    assert update.pixel_i == pytest.approx(update.pixel_j, abs=12.0)
    site.put(KEYS.receipts(update.operator), receipt(update, 1))
    # an alignment and a pose from before the receipt must not count: wait until it was read
    assert wait_until(lambda: any(s.receipted_s for s in operator.in_flight()), 30)
    assert operator.click_to_pose_s == []
    site.put(KEYS.alignment("a", "b"), alignment(1))
    assert wait_until(lambda: len(observer.alignments) == 1, 30)
    assert operator.click_to_pose_s == []
    first = next(sent for sent in operator.in_flight() if sent.update.n == 1)
    first.put_s -= 100.0  # it is still waited for after a minute and a half
    site.put(KEYS.pose("b"), pose("b", 0, n=1))
    assert wait_until(lambda: len(operator.click_to_pose_s) == 1, 30)
    assert 100.0 < operator.click_to_pose_s[0] < 110.0
    assert len(operator.unanswered_s()) == len(operator.in_flight())


def test_an_operator_who_errs_clicks_where_the_truth_is_not(own_link, site, observer):
    site.show(observer, view("a", 0), view("b", 0))
    operator = SimulatedOperator(observer, SameEverywhere(), 600, only_asked=True, mistakes=1.0)
    operator.start()
    try:
        site.ask(question())
        update = site.next_update()
    finally:
        operator.close()
    assert update is not None
    assert np.linalg.norm(update.pixel_i - update.pixel_j) > 6.0
    assert operator.wrong_clicks >= 3
    assert set(operator.answers) <= {"step", "mirrored"}  # what a plain wall allows


def test_an_update_is_repeated_until_its_receipt(site, operator):
    site.ask(question())
    updates = [site.next_update()]
    while [update.n for update in updates].count(1) < 3:
        updates.append(site.next_update())
    assert len({update.session for update in updates}) == 1
    newest = max(update.n for update in updates)
    site.put(KEYS.receipts("op-simulated"), receipt(updates[0], newest))
    assert wait_until(lambda: operator.in_flight()[0].receipted_s is not None, 30)


def test_a_rejected_click_is_noted_with_its_reason_and_not_timed(site, operator):
    from fleetpose.protocol.messages import Rejection

    site.ask(question())
    update = site.next_update()
    assert update is not None
    rejection = Rejection(n=1, reason="no depth there")
    site.put(KEYS.receipts(update.operator), receipt(update, 1, rejections=(rejection,)))
    assert wait_until(lambda: operator.rejected == ["no depth there"], 30)
    assert all(sent.update.n != 1 for sent in operator.in_flight())
