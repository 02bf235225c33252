"""Scheduling, tracking, kept views and the two flows, without network and workers."""

from dataclasses import replace

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.app.build import read_pairs
from fleetpose.pose_server.correspondences.records import BookState, Change
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.frontend.tracks import Track
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.persistence.restore import restore
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KEEP_AT_LEAST, ViewStore, open_view, stands_still
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.messages import OperatorUpdate, View, ViewName
from tests.pose_server.scene import EPOCH, K, descriptors, pair_of_views, turned, view, walls

ENCODING = encoding_of(View)


class Forgetful:
    """A recorder that holds nothing."""

    def load(self) -> BookState:
        return BookState()

    def record(self, change: Change) -> None:
        pass


def named(seq: int, robot: str = "r1") -> ViewName:
    return ViewName(robot=robot, epoch=EPOCH, seq=seq)


def result(T: np.ndarray, verdict="verified", overlap=0.9) -> PairResult:
    return PairResult(T, np.eye(6) * 1e-6, verdict, (), inliers=50, overlap=overlap)


def test_a_small_step_hangs_on_the_keyframe_and_a_far_one_becomes_a_keyframe():
    track = Track()
    track.begin(named(0))
    near, far = np.eye(4), np.eye(4)
    near[0, 3], far[0, 3] = 0.1, 2.0
    assert track.next_try(named(1), list) == named(0)
    assert track.take(named(1), named(0), result(near), 10.0, None) == "attached"
    assert track.next_try(named(2), list) == named(0)
    assert track.take(named(2), named(0), result(far), 10.0, None) == "keyframe"
    assert track.keyframes == [named(0), named(2)]
    link = track.link_of(named(2))
    assert link is not None and link.keyframe == named(0)


def test_a_robot_that_comes_back_hangs_on_its_old_keyframe():
    track = Track()
    track.begin(named(0))
    track.begin(named(1))
    far = np.eye(4)
    far[0, 3] = 2.0
    assert track.next_try(named(2), list) == named(1)
    assert track.take(named(2), named(1), result(far), 10.0, nearer=named(0)) == "try"
    assert track.next_try(named(2), list) == named(0)
    assert track.take(named(2), named(0), result(np.eye(4)), 10.0, None) == "attached"
    assert len(track.keyframes) == 2


def test_a_view_that_aligns_with_nothing_begins_a_segment():
    track = Track()
    track.begin(named(0))
    assert track.next_try(named(1), list) == named(0)
    assert track.take(named(1), named(0), result(np.eye(4), "rejected"), 10.0, None) == "try"
    assert track.next_try(named(1), list) is None
    assert track.give_up(named(1)) == "segment"
    assert track.link_of(named(1)) is None


def kept(message: View, now_s: float = 0.0):
    return open_view(pack(message), ENCODING, now_s)


def test_standing_still_is_seen_through_sensor_noise_and_a_pixel_of_motion_is_not_still():
    rng = np.random.default_rng(0)
    points, looks = walls(rng), descriptors(rng, 800)
    here = kept(view(rng, "r1", points, looks, np.eye(4), noisy=False))
    same = kept(view(rng, "r1", points, looks, np.eye(4), seq=1, noisy=False))
    step = np.eye(4)
    step[0, 3] = 10.0 / 600  # one pixel at the scene's depth
    moved = kept(view(rng, "r1", points, looks, step, seq=2, noisy=False))
    assert stands_still(here, same)
    assert not stands_still(here, moved)


def test_damaged_views_are_refused_and_say_why():
    rng = np.random.default_rng(1)
    message, _ = pair_of_views(rng, turned(5))
    payload = pack(message)
    for damaged in (payload[:100], payload[:-1], b"", b"\xff" * 50):
        with pytest.raises(CodecError):
            open_view(damaged, ENCODING, 0.0)
    with pytest.raises(CodecError, match="encoding"):
        open_view(payload, "application/msgpack;fleet.view.v9", 0.0)
    lonely = message.model_copy(
        update={"cloud": view(rng, "r1", walls(rng, 4), descriptors(rng, 4), np.eye(4)).cloud}
    )
    with pytest.raises(CodecError, match="need 10"):
        open_view(pack(lonely), ENCODING, 0.0)


def test_old_views_go_but_not_the_newest_twenty_nor_what_is_held():
    rng = np.random.default_rng(2)
    one = kept(view(rng, "r1", walls(rng, 60), descriptors(rng, 60), np.eye(4)))
    store = ViewStore()
    for seq in range(50):
        store.keep(replace(one, name=named(seq), received_s=float(seq)))
    dropped = store.prune(200.0, {named(3)})
    assert named(3) in store
    assert store.count("r1") == KEEP_AT_LEAST + 1
    assert dropped == {named(seq) for seq in range(50 - KEEP_AT_LEAST) if seq != 3}


def site_of(*messages: View, skip: frozenset[tuple[str, str]] = frozenset()) -> Site:
    site = Site(correspondences=CorrespondenceStore(Forgetful()), skip=skip)
    for message in messages:
        pipeline.receive_token(site, message.name.robot, message.name.epoch, True)
        pipeline.receive_view(site, kept(message))
    return site


def work_off(site: Site, most: int = 20) -> list[str]:
    """Runs the jobs that come, here instead of in a worker; their kinds."""
    kinds = []
    for _ in range(most):
        if site.dirty:
            pipeline.solve(site, 0.0)
        while compare_some(site, 0.0):
            pass
        job = pipeline.urgent_job(site) or pipeline.next_job(site, pipeline.QUIET_S)
        if job is None:
            break
        kinds.append(job.kind)
        pipeline.take_result(site, Done(job, run_job(job)), 0.0)
    pipeline.solve(site, 0.0)
    return kinds


def test_two_views_become_one_component():
    T_true = turned(15)
    site = site_of(*pair_of_views(np.random.default_rng(3), T_true))
    assert work_off(site) == ["pair"]
    T = site.relative(named(0, "r1"), named(0, "r2"))
    assert T is not None
    assert np.linalg.norm(T[:3, 3] - T_true[:3, 3]) < 0.1
    assert site.anchor == "r1"


def click(n: int, point: np.ndarray, T_i_j: np.ndarray, view_i=None) -> OperatorUpdate:
    at_j = inverse(T_i_j)[:3, :3] @ point + inverse(T_i_j)[:3, 3]
    return OperatorUpdate(
        operator="op",
        session="a" * 12,
        n=n,
        action="add",
        i="r1",
        j="r2",
        base_revision=n - 1,
        view_i=view_i or named(0, "r1"),
        view_j=named(0, "r2"),
        pixel_i=(K @ point)[:2] / point[2],
        pixel_j=(K @ at_j)[:2] / at_j[2],
    )


def scene_with_points_to_click(rng: np.random.Generator, T_true: np.ndarray):
    points, looks = walls(rng, 3000), descriptors(rng, 3000)
    messages = (
        view(rng, "r1", points, looks, np.eye(4)),
        view(rng, "r2", points, looks, inverse(T_true)),
    )
    far_apart = [points[np.argmin(np.abs(points[:, :2] - xy).sum(axis=1))] for xy in CORNERS]
    return messages, far_apart


CORNERS = ((-2.0, -2.0), (2.0, -1.5), (0.0, 2.0))


def test_a_skipped_pair_waits_for_the_operator_whose_clicks_come_first():
    T_true = turned(15)
    messages, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*messages, skip=frozenset({("r1", "r2")}))
    assert work_off(site) == []
    assert site.relative(named(0, "r1"), named(0, "r2")) is None
    for n, point in enumerate(points, 1):
        (outcome,) = pipeline.receive_update(site, click(n, point, T_true))
        assert outcome.accepted, outcome.reason
    job = pipeline.next_job(site, 0.0)
    assert job is not None and job.kind == "clicks" and not job.features
    pipeline.take_result(site, Done(job, run_job(job)), 0.0)
    pipeline.solve(site, 0.0)
    T = site.relative(named(0, "r1"), named(0, "r2"))
    assert T is not None and np.linalg.norm(T[:3, 3] - T_true[:3, 3]) < 0.2
    assert pipeline.judge_correspondences(site) == [("r1", "r2")]
    assert {kept.item.status for kept in site.correspondences.of("r1", "r2")} == {"accepted"}

    clear = OperatorUpdate(
        operator="op", session="a" * 12, n=4, action="clear", i="r1", j="r2", base_revision=3
    )
    (cleared,) = pipeline.receive_update(site, clear)
    assert cleared.accepted, cleared.reason
    assert work_off(site) == []
    assert site.relative(named(0, "r1"), named(0, "r2")) is None


def test_clicks_on_an_unknown_view_or_without_depth_are_rejected_with_the_reason():
    T_true = turned(15)
    messages, points = scene_with_points_to_click(np.random.default_rng(5), T_true)
    site = site_of(*messages)
    (gone,) = pipeline.receive_update(site, click(1, points[0], T_true, named(77, "r1")))
    assert not gone.accepted and "not kept" in gone.reason
    outside = click(2, points[0], T_true).model_copy(update={"pixel_i": np.array([900.0, 10.0])})
    (beyond,) = pipeline.receive_update(site, outside)
    assert not beyond.accepted and "outside" in beyond.reason


@pytest.mark.parametrize("robots", [("r2", "r1"), ("r1", "r1")])
def test_a_click_on_robots_in_another_order_is_rejected_and_is_of_no_pair_that_keys_name(robots):
    T_true = turned(15)
    messages, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*messages)
    odd = click(1, points[0], T_true).model_copy(update={"i": robots[0], "j": robots[1]})
    (outcome,) = pipeline.receive_update(site, odd)
    assert not outcome.accepted and "in order of name" in outcome.reason
    assert not site.knows(outcome.pair) and site.knows(("r1", "r2"))


def test_views_of_the_journal_are_keyframes_after_a_restart():
    T_true = turned(15)
    messages, _ = scene_with_points_to_click(np.random.default_rng(6), T_true)
    site = Site(correspondences=CorrespondenceStore(Forgetful()))
    restore(site, [kept(message) for message in messages])
    assert set(site.keyframes()) == {named(0, "r1"), named(0, "r2")}
    assert site.robots["r1"].track.newest is None


def test_a_file_of_pairs_is_read_and_a_bad_line_named(tmp_path):
    file = tmp_path / "pairs"
    file.write_text("# kept from the machine\nr2 r1\n\nr3 r4  # comment\n")
    assert read_pairs(file) == {("r1", "r2"), ("r3", "r4")}
    file.write_text("r1\n")
    with pytest.raises(FleetPoseError, match=":1:"):
        read_pairs(file)
    with pytest.raises(FleetPoseError, match="cannot read"):
        read_pairs(tmp_path / "none")


def test_a_view_with_nothing_new_is_read_once_and_one_with_another_camera_anew():
    rng = np.random.default_rng(7)
    first, other = (view(rng, "r1", walls(rng), descriptors(rng, 800), np.eye(4)) for _ in "ab")
    before = kept(first)

    def opened(message: View):
        return open_view(pack(message), ENCODING, 3.0, {"r1": before}.get)

    again = opened(first.model_copy(update={"name": named(1), "stamp_ns": first.stamp_ns + 5}))
    assert again.signature is before.signature and stands_still(before, again)
    assert (again.name, again.stamp_ns) == (named(1), first.stamp_ns + 5)
    assert again.received_s == 3.0 and again.payload != before.payload
    assert opened(other).signature is not before.signature
    zoomed = first.camera.model_copy(update={"K": first.camera.K * [[1.1], [1.1], [1.0]]})
    anew = opened(first.model_copy(update={"camera": zoomed}))
    assert anew.signature is not before.signature and not stands_still(before, anew)


def test_a_correspondence_that_was_moved_is_judged_again_though_no_pose_changed():
    T_true = turned(15)
    messages, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*messages)
    work_off(site)
    for n, point in enumerate(points, 1):
        (outcome,) = pipeline.receive_update(site, click(n, point, T_true))
        assert outcome.accepted, outcome.reason
    work_off(site)
    assert pipeline.judge_correspondences(site) == [("r1", "r2")]
    assert pipeline.judge_correspondences(site) == []
    moved = click(4, points[0], T_true).model_copy(
        update={"action": "move", "correspondence": 0, "base_revision": 0}
    )
    moved = moved.model_copy(update={"pixel_j": moved.pixel_j + np.array([60.0, 0.0])})
    (outcome,) = pipeline.receive_update(site, moved)
    assert outcome.accepted, outcome.reason
    assert pipeline.judge_correspondences(site) == [("r1", "r2")]
    (first,) = (one.item for one in site.correspondences.of("r1", "r2") if one.item.id == 0)
    assert first.residual_px > 20.0
