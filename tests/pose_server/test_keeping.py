"""A site is recorded as it was said, and shown in files of which every message can be decoded."""

import sys
from collections import Counter

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner

from fleetpose.pose_server.__main__ import app
from fleetpose.pose_server.recording.foxglove_scene import scaled
from fleetpose.pose_server.recording.show import MAX_POINTS, ShownLink, show
from fleetpose.pose_server.recording.site import SiteRecorder
from fleetpose.protocol.clouds import points_of
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import FleetState, ImageHeader, PairCell, RobotState, View
from fleetpose.protocol.recording.file import HERE, Recorder, Recording
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until
from tests.pose_server.scene import EPOCH, K, pair_of_views, turned
from tests.protocol.message_examples import EXAMPLES, POSE

KEYS = Keys("demo")
JPEG = b"\xff\xd8 an image"


def views() -> list[View]:
    return list(pair_of_views(np.random.default_rng(1), turned(15)))


def told(view: View, located: bool = True):
    """A pose of the view's robot, which stands two metres ahead."""
    T = np.eye(4)
    T[0, 3] = 2.0
    changed = {"robot": view.name.robot, "view": view.name, "T_fleet_robot": T, "located": located}
    return POSE.model_copy(update=changed)


def sample(key, message) -> Sample:
    return Sample(key, pack(message), encoding_of(type(message)))


@pytest.fixture
def site_file(tmp_path):
    """Two robots, of which one is lost at the end."""
    path, both = tmp_path / "site.mcap", views()
    poses = [told(view) for view in both]
    state = EXAMPLES[FleetState]
    robots = tuple(
        RobotState(robot=p.robot, alive=True, newest_view=p.view, views_kept=1, pose=p, why_not="")
        for p in poses
    )
    cell = PairCell(i="r1", j="r2", state="tried", verdict="verified", rmse_m=0.01)
    state = state.model_copy(update={"robots": robots, "pairs": (cell,)})
    with Recorder(path, "demo", compressed=False) as recorder:
        for view, pose in zip(both, poses, strict=True):
            name = view.name.robot
            recorder.note("in", sample(KEYS.cloud(name), view))
            header = pack(ImageHeader(view=view.name, stamp_ns=view.stamp_ns, scale=2))
            recorder.note("in", Sample(KEYS.image(name), JPEG, "image/jpeg", header))
            recorder.note("in", sample(KEYS.pose(name), pose))
        recorder.note("in", sample(KEYS.state, state))
        recorder.note("in", sample(KEYS.state, state))  # nothing new: drawn once
        recorder.note("in", sample(KEYS.pose("r2"), told(both[1], located=False)))
        recorder.note("in", Sample(KEYS.cloud("r1"), b"damaged", encoding_of(View)))
    return path


def test_a_site_is_recorded_as_it_was_said_and_who_records_says_nothing(router, tmp_path):
    path = tmp_path / "site.mcap"
    view, epoch = views()[0], EPOCH
    said = {
        KEYS.cloud("r1"): sample(KEYS.cloud("r1"), view),
        KEYS.image("r1"): Sample(KEYS.image("r1"), JPEG, "image/jpeg", b"header"),
        KEYS.updates("anna"): Sample(KEYS.updates("anna"), b"any bytes", "x;y", None),
        KEYS.pose("r1"): sample(KEYS.pose("r1"), told(view)),
    }
    speaker, listener = (
        Link(open_session(SessionSettings(connect=(router,), timeout_s=5.0))) for _ in range(2)
    )
    try:
        speaker.token(KEYS.robot_alive("r1", epoch))
        latched = speaker.latched(KEYS.pose("r1"))
        latched.put(said[KEYS.pose("r1")].payload, said[KEYS.pose("r1")].encoding)  # before
        recorder = SiteRecorder(listener, KEYS, path)
        others = {
            key: speaker.bulk(key) if "robot" in key else speaker.latched(key)
            for key in said
            if key != KEYS.pose("r1")
        }
        bulk = [one for key, one in others.items() if "robot" in key]  # what is not latched
        assert wait_until(lambda: all(one.wanted for one in bulk), 10)
        for count, (key, publisher) in enumerate(others.items(), 3):  # beside token and pose
            publisher.put(said[key].payload, said[key].encoding, said[key].attachment)
            # one by one: a publisher that is in the way of a large one may drop what it has
            assert wait_until(lambda count=count: recorder.progress().messages >= count, 60), key
        ended = recorder.close()
    finally:
        speaker.close()
        listener.close()
    kept = list(Recording(path))
    assert {one.sample.key: one.sample for one in kept if one.way == "in"} == said
    [token] = [one.sample for one in kept if one.way == "token"]
    assert (token.key, token.payload) == (KEYS.robot_alive("r1", epoch), HERE)
    assert (ended.views, ended.left_out) == (1, 0) and "CPU" in ended.cost


def test_every_message_for_foxglove_can_be_decoded(site_file, tmp_path):
    out = tmp_path / "foxglove.mcap"
    done = CliRunner().invoke(app, ["show", str(site_file), "--foxglove", str(out)])
    assert done.exit_code == 0, done.output
    assert "2 views, 2 images, 2 poses, 1 messages could not be opened" in done.output
    messages = {}
    with out.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append(message)
    assert Counter({topic: len(several) for topic, several in messages.items()}) == {
        **{f"/robot/{r}/{what}": 1 for r in ("r1", "r2") for what in ("points", "pose", "image")},
        **{f"/robot/{r}/calibration": 1 for r in ("r1", "r2")},
        "/tf": 2,
        "/scene/robots": 3,
        "/scene/links": 1,
    }
    cloud = messages["/robot/r1/points"][0]
    xyz = np.frombuffer(cloud.data, "<f4").reshape(-1, 3)
    assert np.allclose(xyz, points_of(views()[0]).xyz, atol=1e-4) and len(xyz) <= MAX_POINTS
    tree = [(t.parent_frame_id, t.child_frame_id) for t in messages["/tf"][0].transforms]
    assert tree == [("fleet", "r1"), ("r1", "r1/camera")]
    assert messages["/tf"][0].transforms[0].translation.x == 2.0
    assert messages["/robot/r1/image"][0].data == JPEG
    assert len(messages["/scene/links"][0].entities[0].lines[0].points) == 2
    assert [one.id for one in messages["/scene/robots"][-1].deletions] == ["r2"]


class Seen:
    """A viewer that remembers what links it was given."""

    def __init__(self):
        self.drawn: list[list[ShownLink]] = []

    def links(self, at_ns, links):
        self.drawn.append(list(links))

    def __getattr__(self, name):
        return lambda *_: None


def test_links_are_drawn_anew_only_where_they_changed(site_file):
    viewer = Seen()
    show(Recording(site_file), viewer)
    [[link]] = viewer.drawn
    assert link.verdict == "verified" and link.a[0] == link.b[0] == 2.0


def test_a_small_image_shows_the_same_rays():
    small = scaled(K, 4)
    edge = np.array([-0.5, -0.5, 1.0])  # the corner of the first pixel, in both
    assert np.allclose(np.linalg.inv(small) @ edge, np.linalg.inv(K) @ edge)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((), "say what to write"),
        (("--foxglove", "{file}"), "is there already: name another file"),
        (("--foxglove", "{folder}/none/a.mcap"), "its folder is not there"),
        (("--rrd", "{folder}/a.rrd"), "rerun"),
    ],
)
def test_what_cannot_be_shown_is_said(site_file, tmp_path, monkeypatch, arguments, sentence):
    monkeypatch.setitem(sys.modules, "rerun", None)
    said = [one.format(file=site_file, folder=tmp_path) for one in arguments]
    done = CliRunner().invoke(app, ["show", str(site_file), *said])
    assert done.exit_code == 1 and sentence in str(done.exception)
