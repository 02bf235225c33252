"""Wrong calibrations and things that move, in the synthetic world: from images to alarms."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from fleetpose.evaluation.simulate.world.materials.facades import poster
from fleetpose.evaluation.simulate.world.render import Quad, Renderer
from fleetpose.evaluation.simulate.world.ring import RingWorld
from fleetpose.evaluation.simulate.world.robots import HEIGHT, WIDTH
from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.correspondences.records import BookState
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.prepared_view import PreparedView, prepare_view
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView, open_view, something_moved, stands_still
from fleetpose.pose_server.workers.jobs import Done, EncodedView, PairJob, TrackJob
from fleetpose.protocol.codec import pack
from fleetpose.protocol.messages import View, ViewName
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.cameras.synthetic import mount
from fleetpose.robot_agent.features.keypoints import salient_points
from fleetpose.robot_agent.features.packing import view_of

ROBOTS, WRONG = 4, "r3"


class NoJournal:
    def load(self) -> BookState:
        return BookState()

    def record(self, change: object) -> None:
        pass


@pytest.fixture(scope="module")
def world() -> RingWorld:
    return RingWorld(ROBOTS, 36.0, seed=3)


@pytest.fixture(scope="module")
def shots(world):
    return {name: world.shoot(name) for name in world.names}


def seen(robot: str, rig: StereoRig, left, right, seq: int = 0) -> View:
    """The view that a robot sends of two images."""
    frame = StereoMatcher(rig).frame(left, right, seq)
    salient = salient_points(frame.image, frame.ranges, frame.model)
    return view_of(ViewName(robot=robot, epoch="0" * 12, seq=seq), frame, salient)


def alarms_with(world: RingWorld, shots, rig: StereoRig) -> Site:
    """The server's site after aligning neighbours, one robot having another rig."""
    site = Site(CorrespondenceStore(NoJournal()))
    views: dict[str, PreparedView] = {}
    for name, shot in shots.items():
        message = seen(name, rig if name == WRONG else world.rig, shot.left, shot.right)
        site.robot(name).camera = message.camera
        views[name] = prepare_view(message)
    for a, b in itertools.combinations(views, 2):
        job = PairJob(EncodedView(views[a].name, b""), EncodedView(views[b].name, b""))
        monitor.note_depths(site, Done(job, align_pair(views[a], views[b])))
    monitor.judge_calibrations(site)
    return site


def test_right_calibrations_raise_no_alarm(world, shots):
    assert alarms_with(world, shots, world.rig).alarms.standing == ()


def test_a_baseline_five_percent_too_long_is_named(world, shots):
    longer = world.rig.T_right_left.copy()
    longer[:3, 3] *= 1.05
    site = alarms_with(world, shots, replace(world.rig, T_right_left=longer))
    assert [(alarm.robot, alarm.kind) for alarm in site.alarms.standing] == [(WRONG, "scale")]
    percent = float(site.alarms.standing[0].text.split()[3])
    assert abs(percent - 5.0) < 1.0 and "too long" in site.alarms.standing[0].text


@pytest.mark.parametrize("axis", [1, 2], ids=["sideways", "rolled"])
def test_a_camera_turned_by_two_degrees_is_named(world, shots, axis):
    turned = world.rig.T_right_left.copy()
    turned[:3] = cv2.Rodrigues(np.radians(2.0) * np.eye(3)[axis])[0] @ turned[:3]
    site = alarms_with(world, shots, replace(world.rig, T_right_left=turned))
    assert [(alarm.robot, alarm.kind) for alarm in site.alarms.standing] == [(WRONG, "bent")]
    angle = float(site.alarms.standing[0].text.split("turned by ")[1].split()[0])
    assert angle == pytest.approx(2.0, abs=0.25)


def eyes(world: RingWorld, scene: Renderer, T_world_robot) -> list[np.ndarray]:
    T_world_left = T_world_robot @ mount()
    T_world_right = T_world_left @ np.linalg.inv(world.rig.T_right_left)
    return [
        scene.image(T, world.rig.K_left, (WIDTH, HEIGHT)) for T in (T_world_left, T_world_right)
    ]


def test_somebody_who_walks_through_the_view_is_masked(world):
    ahead, left = (world.T_world_robot("r2")[:3, k] for k in (0, 1))
    texture = poster(np.random.default_rng(5), 360, 200).astype(np.uint8)
    messages, places = [], []
    for seq in (0, 1):
        T_world_robot = world.T_world_robot("r2")
        middle = T_world_robot[:3, 3] + 4.5 * ahead + (0.5 - 0.6 * seq) * left
        T_world_robot[:3, 3] -= 0.25 * seq * left
        corner = middle + 0.5 * left + np.array((0.0, 0.0, 1.9))
        person = Quad(corner, -left, np.array((0.0, 0.0, -1.8)), texture)
        pair = eyes(world, world.scene.with_quads([person]), T_world_robot)
        messages.append(seen("r2", world.rig, *pair, seq=seq))
        T_camera_world = np.linalg.inv(T_world_robot @ mount())
        corners = np.array([corner, corner - left - np.array((0.0, 0.0, 1.8))])
        places.append(corners @ T_camera_world[:3, :3].T + T_camera_world[:3, 3])
    views = [prepare_view(message) for message in messages]
    result = align_pair(*views)
    assert result.verdict in ("verified", "plausible")  # who walks is seen through
    for view, corners, mask in zip(views, places, result.moving, strict=True):
        assert mask is not None
        (low, high), _ = view.observed.project(corners)
        uv = view.observed.uv
        inside = ((uv > low - 1) & (uv < high + 1)).all(axis=1)
        hit = mask.hits(uv)
        assert hit[inside].mean() > 0.6 and hit[~inside].mean() < 0.01


def turned_views(world: RingWorld, skew_s: float) -> list[View]:
    """What a robot that looks to and fro sends once in a second, with depths of before."""
    matcher = StereoMatcher(world.rig)
    messages = []
    for seq in range(9):
        at_s = 1.3 * seq
        shots = [world.shoot("r2", t_s) for t_s in (at_s, at_s - skew_s)]
        image, before = (matcher.frame(s.left, s.right, round(1e9 * at_s)) for s in shots)
        frame = replace(image, ranges=before.ranges)
        salient = salient_points(frame.image, frame.ranges, frame.model)
        messages.append(view_of(ViewName(robot="r2", epoch="0" * 12, seq=seq), frame, salient))
    return messages


@pytest.mark.parametrize("skew_s", [0.2, 0.0])
def test_depths_that_are_older_than_the_image_are_named(skew_s):
    turning = RingWorld(3, 36.0, seed=3, turning=("r2",))
    site = Site(CorrespondenceStore(NoJournal()))
    robot = site.robot("r2")
    messages = turned_views(turning, skew_s)
    first, *views = (prepare_view(message).strongest(700) for message in messages)
    flows = {}
    for message in messages:
        site.views.keep(open_view(pack(message), None, 0.0))
        # the server has this of its solution
        flows[message.name] = turning.T_world_robot("r2", 1e-9 * message.stamp_ns) @ mount()
    site.relative = lambda a, b: np.linalg.inv(flows[a]) @ flows[b]  # type: ignore[method-assign]
    robot.track.begin(first.name)
    for view in views:
        result = align_pair(first, view)
        robot.track.attached[view.name] = KeyframeRelativePose(
            view.name, first.name, np.eye(4), np.eye(6), "verified"
        )
        job = TrackJob(EncodedView(first.name, b""), EncodedView(view.name, b""))
        monitor.note_time_offset(site, Done(job, result))
        monitor.judge_calibrations(site)
    monitor.judge_calibrations(site)
    if skew_s == 0:
        assert site.alarms.standing == ()
        return
    assert [(alarm.robot, alarm.kind) for alarm in site.alarms.standing] == [("r2", "skew")]
    words = site.alarms.standing[0].text.split()
    assert float(words[3]) == pytest.approx(200, abs=50) and "older" in words


def kept(world: RingWorld, t_s: float, seq: int) -> KeptView:
    shot = world.shoot("r2", t_s)
    return open_view(pack(seen("r2", world.rig, shot.left, shot.right, seq)), None, t_s)


def test_who_walks_past_a_robot_that_stands_still_is_noticed(world):
    busy = RingWorld(2, 36.0, seed=0, person=True)
    before, *after = (kept(busy, t_s, k) for k, t_s in enumerate((0.0, 1.0, 2.2, 3.5)))
    assert all(stands_still(before, view) for view in after)
    assert sum(something_moved(before, view) for view in after) >= 2
    before, *after = (kept(world, 0.0, seq) for seq in range(4))
    assert not any(something_moved(before, view) for view in after)
