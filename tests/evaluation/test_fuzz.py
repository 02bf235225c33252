"""The fuzz sends only what is refused, and a short one passes."""

import random

import cv2
import numpy as np
import pytest

from fleetpose.evaluation.system.fuzz import command, ros
from fleetpose.evaluation.system.fuzz.state import changes
from fleetpose.evaluation.system.fuzz.targets import OPERATOR, targets_of
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Alignment,
    CameraAnnouncement,
    FleetState,
    ImageHeader,
    PairCorrespondences,
    RobotPose,
    ServerStatus,
    View,
    ViewName,
)
from fleetpose.protocol.transport import Sample
from tests.pose_server.scene import pair_of_views, turned
from tests.protocol.message_examples import CAMERA, EPOCH, EXAMPLES

KEYS = Keys("demo")
ROBOTS = ["r1", "r2"]


def heard() -> dict[str, Sample]:
    image = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes()
    samples = {}

    def put(key, message):
        samples[key] = Sample(key, pack(message), encoding_of(type(message)))

    put(KEYS.state, EXAMPLES[FleetState])
    put(KEYS.status, EXAMPLES[ServerStatus])
    put(KEYS.alignment("r1", "r2"), EXAMPLES[Alignment])
    put(KEYS.correspondences("r1", "r2"), EXAMPLES[PairCorrespondences])
    views = pair_of_views(np.random.default_rng(0), turned(10.0))
    for robot, view in zip(ROBOTS, views, strict=True):
        name = ViewName(robot=robot, epoch=EPOCH, seq=1)
        put(KEYS.cloud(robot), view.model_copy(update={"name": name}))
        put(KEYS.pose(robot), EXAMPLES[RobotPose].model_copy(update={"robot": robot}))
        put(
            KEYS.camera(robot),
            CameraAnnouncement(robot=robot, epoch=EPOCH, camera=CAMERA, rate_hz=1.0),
        )
        header = pack(ImageHeader(view=name, stamp_ns=0))
        samples[KEYS.image(robot)] = Sample(KEYS.image(robot), jpeg, "image/jpeg", header)
    return samples


def test_every_key_has_a_target_and_only_what_its_decoder_refuses_is_sent():
    targets = targets_of(KEYS, ROBOTS, heard())
    keys = {target.good.key for target in targets}
    assert set(heard()) <= keys
    assert {KEYS.updates(OPERATOR), KEYS.selection(OPERATOR), KEYS.receipts(OPERATOR)} <= keys
    chance = random.Random(1)
    kinds = set()
    for target in (t for t in targets if "stranger-" not in t.good.key):
        assert not target.refuses(target.good), target.good.key
        for k in range(40):
            kind, sample = target.bad(chance, large=k == 39)
            assert target.refuses(sample)
            kinds.add(kind)
    assert {"zstd bomb", "jpeg bomb", "deep", "not finite", "another's key", "oversize"} <= kinds


def test_a_seed_gives_the_same_messages():
    def drawn():
        chance = random.Random(5)
        (target,) = [t for t in targets_of(KEYS, ROBOTS, heard()) if t.good.key == KEYS.cloud("r1")]
        return [target.bad(chance, large=False) for _ in range(20)]

    assert drawn() == drawn()
    assert encoding_of(View) == heard()[KEYS.cloud("r1")].encoding


def test_what_differs_is_told():
    assert changes({"a": 1, "b": 2}, {"a": 1, "b": 3, "c": 4}) == ["b: 2 -> 3", "c: None -> 4"]


@pytest.mark.timeout(300)
def test_a_short_fuzz_of_live_processes_passes(tmp_path):
    summary = command.run(300, tmp_path / "out", seed=3)
    assert command.passed(summary), summary
    assert summary["messages"] == 300 and summary["leftover_processes"] == 0
    assert not command.passed({**summary, "counted": summary["counted"] - 1})
    assert (tmp_path / "out" / "summary.json").exists()


def test_damaged_input_of_ros_is_refused_or_taken_and_never_escapes(tmp_path):
    summary = ros.run(300, tmp_path, seed=5)
    assert ros.passed(summary), summary
    assert summary["given"] == 300 and summary["refused"] > 50 and summary["taken"] > 50


def test_what_comes_out_as_another_error_is_told_and_does_not_pass():
    outcome = ros.Outcome()
    outcome.give("a piece", lambda: {}["missing"])
    assert outcome.escaped.total() == 1 and not outcome.refused and not outcome.taken
