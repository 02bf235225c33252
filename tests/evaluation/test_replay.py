"""A recorded site comes out of every replay the same, and near what its server had said."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from fleetpose.evaluation.__main__ import app
from fleetpose.evaluation.bench.replay.command import replay, sentence
from fleetpose.evaluation.bench.replay.compare import agreement
from fleetpose.evaluation.bench.replay.inputs import Recorded
from fleetpose.evaluation.bench.replay.server import ReplayServer
from fleetpose.pose_server import pipeline
from fleetpose.pose_server.calibration.clocks import LEAST_KEPT
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose
from fleetpose.pose_server.messages.builders import Stamp, robot_pose
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import CameraAnnouncement, OperatorUpdate, RobotPose, View
from fleetpose.protocol.recording.file import HERE, Record, Recorder, RecordingError
from fleetpose.protocol.slots import Sample
from tests.pose_server.scene import EPOCH, K, descriptors, turned, view, walls
from tests.pose_server.test_flows import Forgetful
from tests.protocol.message_examples import EXAMPLES

KEYS = Keys("demo")
ANGLES_DEG = {"r1": 0.0, "r2": 12.0, "r3": 24.0}


def fleet() -> tuple[list[View], np.ndarray]:
    """Two views of each of three robots that see the same walls, and the walls' points."""
    rng = np.random.default_rng(2)
    points, looks = walls(rng), descriptors(rng, 800)
    step = np.eye(4)
    views = []
    for seq in range(2):
        step[0, 3] = 0.1 * seq
        for robot, angle in ANGLES_DEG.items():
            T = inverse(turned(angle) @ step)
            views.append(view(rng, robot, points, looks, T, seq))
    return views, points


def live_poses(views: list[View]) -> list[RobotPose]:
    """What a server says that has all views before it aligns any."""
    site = Site(correspondences=CorrespondenceStore(Forgetful()), anchor="r1")
    for one in views:
        pipeline.receive_token(site, one.name.robot, EPOCH, True)
        pipeline.receive_view(site, open_view(pack(one), encoding_of(View), 0.0))
    pipeline.solve(site, 0.0)
    while compare_some(site, 0.0):
        pass
    while (job := pipeline.next_job(site, pipeline.QUIET_S)) is not None:
        pipeline.take_result(site, Done(job, run_job(job)), 0.0)
        pipeline.solve(site, 0.0)
    stamp, settings = Stamp("f" * 12, 0.0, 0), ServerSettings.model_validate({})
    found = [robot_pose(site, robot, settings, stamp) for robot in site.robots.values()]
    return [one[0] for one in found if one is not None]


def sample(key, message) -> Sample:
    return Sample(key, pack(message), encoding_of(type(message)))


def click(points, point: int, n: int) -> OperatorUpdate:
    """A point of the walls in the first views of r1 and r2."""
    seen = [
        (inverse(turned(ANGLES_DEG[robot])) @ [*points[point], 1.0])[:3] for robot in ("r1", "r2")
    ]
    pixels = [(K @ one)[:2] / one[2] for one in seen]
    names = [{"robot": robot, "epoch": EPOCH, "seq": 0} for robot in ("r1", "r2")]
    return OperatorUpdate.model_validate(
        {
            "operator": "anna",
            "session": EPOCH,
            "n": n,
            "action": "add",
            "i": "r1",
            "j": "r2",
            "base_revision": 0,
            "view_i": names[0],
            "view_j": names[1],
            "pixel_i": pixels[0],
            "pixel_j": pixels[1],
        }
    )


@pytest.fixture(scope="module")
def site_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("site") / "site.mcap"
    views, points = fleet()
    with Recorder(path, "demo", compressed=False) as recorder:
        for robot in ANGLES_DEG:
            recorder.token(KEYS.robot_alive(robot, EPOCH), True)
        for one in views:
            recorder.note("in", sample(KEYS.cloud(one.name.robot), one))
        middle = int(np.argmin(np.abs(points[:, :2]).sum(axis=1)))
        for n in (3, 4, 4):  # the recording begins behind two of its updates; one is said again
            recorder.note("in", sample(KEYS.updates("anna"), click(points, middle, n)))
        recorder.note("in", Sample(KEYS.cloud("r2"), b"damaged", encoding_of(View)))
        for pose in live_poses(views):
            recorder.note("in", sample(KEYS.pose(pose.robot), pose))
    return path


def files_of(folder) -> dict[str, bytes]:
    return {one.name: one.read_bytes() for one in folder.iterdir()}


@pytest.fixture(scope="module")
def replayed(site_file, tmp_path_factory):
    out = tmp_path_factory.mktemp("replayed")
    return out, replay(site_file, out, workers=2, job_ms=1.0)


def test_what_was_heard_is_replayed_and_lies_near_what_was_said(replayed):
    _, summary = replayed
    beside = summary["beside_the_recording"]
    assert summary["views"] == 6 and summary["located"] == list(ANGLES_DEG)
    assert summary["anchor"] == "r1" and sum(summary["drops"].values()) == 1
    assert summary["correspondences"] == 1  # the same point twice is a duplicate
    assert beside["common"] == 3 and beside["only_recorded"] == 0
    assert beside["max_m"] < 0.1 and beside["max_deg"] < 1.0
    assert beside["frame_m"] < 0.1
    assert "differ by" in sentence(summary)


def test_two_replays_give_the_same_bytes(site_file, replayed, tmp_path):
    out, _ = replayed
    replay(site_file, tmp_path, workers=2, job_ms=1.0)
    assert files_of(tmp_path) == files_of(out)
    assert {"poses.csv", "summary.json", "r1.tum", "r2.tum", "r3.tum"} == files_of(out).keys()


def test_the_command_replays_in_a_process_of_its_own_and_says_how_near_it_comes(
    site_file, tmp_path
):
    options = ["--out", str(tmp_path), "--job-ms", "5"]
    done = CliRunner().invoke(app, ["replay", str(site_file), *options])
    assert done.exit_code == 0, done.output
    assert "3 of 3 robots located" in done.output
    assert json.loads((tmp_path / "summary.json").read_text())["job_ms"] == 5.0


def test_other_frames_are_brought_together_and_one_wrong_pose_moves_none(site_file):
    views, _ = fleet()
    [pose, *_] = live_poses(views[:3])
    said = {}
    for seq in range(7):
        name = pose.view.model_copy(update={"seq": seq})
        T = make_pose(np.eye(3), np.array([float(seq), 0.0, 0.0]))
        said[name] = pose.model_copy(
            update={"view": name, "T_fleet_robot": T, "located": True, "component": "r1"}
        )
    turn = make_pose(exp_so3(np.array([0.0, 0.0, 0.5])), np.array([3.0, 0.0, 1.0]))
    moved = {
        name: one.model_copy(update={"T_fleet_robot": turn @ one.T_fleet_robot})
        for name, one in said.items()
    }
    wrong = next(iter(moved))
    off = moved[wrong].T_fleet_robot.copy()
    off[0, 3] += 5.0
    moved[wrong] = moved[wrong].model_copy(update={"T_fleet_robot": off})
    found = agreement(said, moved)
    assert found.median_m == pytest.approx(0.0, abs=1e-9) and found.max_m == pytest.approx(5.0)
    assert found.frame_deg == pytest.approx(np.degrees(0.5))
    assert agreement(said, {}) == replace(agreement({}, said), only_recorded=7, only_replayed=0)


def test_what_is_no_recording_of_a_site_is_refused(site_file, tmp_path):
    session = tmp_path / "session.mcap"
    with Recorder(session, "demo", "anna"):
        pass
    with pytest.raises(RecordingError, match="an operator's session"):
        replay(session, tmp_path)


@pytest.mark.parametrize("clock", ["live", "recorded"])
def test_a_robot_that_played_a_recording_is_not_blamed_for_its_stamps_in_a_replay(clock):
    server = ReplayServer(KEYS, Recorded(), lambda *told: None)
    announced = EXAMPLES[CameraAnnouncement].model_copy(
        update={"robot": "r1", "epoch": EPOCH, "clock": clock}
    )
    first = fleet()[0][0].model_copy(update={"stamp_ns": 10**15})  # a recording of another time
    names = [first.name.model_copy(update={"seq": seq}) for seq in range(LEAST_KEPT + 1)]
    heard = [
        sample(KEYS.camera("r1"), announced),
        *(sample(KEYS.cloud("r1"), first.model_copy(update={"name": name})) for name in names),
    ]
    token = Sample(KEYS.robot_alive("r1", EPOCH), HERE, "")
    server.hear(Record(0.0, "token", token, at_ns=10**9))
    for one in heard:
        server.hear(Record(0.0, "in", one, at_ns=10**9))
    assert [robot for robot, _ in server.site.depths.clocks.wrong()] == ["r1"] * (clock == "live")
